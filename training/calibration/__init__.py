"""Calibration files of other tools, to be converted into the form that a run reads."""
