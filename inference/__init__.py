"""The runtime: live sources, detectors, verdicts and UDP."""
