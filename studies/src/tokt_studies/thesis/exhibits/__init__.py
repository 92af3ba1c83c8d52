"""The tables and figures of the thesis, one after the other."""
