"""Logs and recordings of a run."""
