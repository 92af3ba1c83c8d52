"""The runtime: sources of frames, detectors, verdicts, datagrams and the loop that joins them.

`Source` (frames in) and `Detector` (a mask out, or why there is none) are its only two
interfaces. What no detector could judge is *unknown*, a value of its own that never becomes clear.
"""
