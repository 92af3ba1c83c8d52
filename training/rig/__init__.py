"""Stereo rigs: calibrate two cameras, and depth of a whole mission offline."""
