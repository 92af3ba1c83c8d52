"""The tables and figures of the thesis, computed again from a mission's frames."""
