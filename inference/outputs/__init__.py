"""Verdicts on their way out: UDP v1 and v2, MAVLink, and the receiving end for a look."""
