"""Calibration of a stereo rig: from a mission's own frames, or from pictures of a checkerboard."""
