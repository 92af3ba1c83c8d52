"""The commands about stereo rigs: calibrate, depth."""
