"""Searching for the extractor and settings of a model, resumable and in parallel."""
