"""Policies: which detectors judge a frame, and what their verdicts come to over time."""
