"""The speed of tokt against the libraries and the thesis's pipeline, measured in one run."""
