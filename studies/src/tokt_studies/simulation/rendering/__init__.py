"""Rendering of scenes into frames with exact labels, masks and depth."""
