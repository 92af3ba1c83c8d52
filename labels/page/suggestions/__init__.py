"""A model's suggestions for a mission's frames, and which frame to label next."""
