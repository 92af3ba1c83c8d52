"""The texture detector: a model's decision values become a mask."""
