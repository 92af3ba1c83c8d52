"""Freshness: whether the picture of a frame is a new one, or is frozen, repeated or old."""
