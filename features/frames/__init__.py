"""Missions, image files, camera frames, and the grid of patches over a frame."""
