"""How fast tokt is, measured against the libraries and the thesis's pipeline in one run."""
