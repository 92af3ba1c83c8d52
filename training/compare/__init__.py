"""Comparing models on frames that none of them learnt from."""
