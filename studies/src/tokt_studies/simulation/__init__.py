"""Synthetic missions: rendered stereo frames whose labels, masks and depth are exact."""
