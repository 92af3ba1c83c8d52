"""Live cameras: one driver for each kind, and one source that makes frames of what they deliver."""
