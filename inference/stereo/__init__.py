"""Stereo detectors: calibration, rectification, matching, distances in metres."""
