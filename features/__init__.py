"""Missions, frames, grids, and the extractors that turn a frame into one feature row a patch."""
