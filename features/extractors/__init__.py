"""Extractors turn a frame and a grid into one feature row a patch, as a JSON spec says."""
