"""How pairs can be looked at, apart from what carries it out.

A runtime without a calibration starts sooner without that.
"""

BM, SGBM = "bm", "sgbm"
MATCHERS = (BM, SGBM)
HALF = 0.5
"""Scale of the views: half the camera's resolution."""
