"""Depth from a mission's stereo pairs: pictures, a curve over the frames, and a point cloud."""
