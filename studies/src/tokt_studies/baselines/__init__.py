"""The methods the thesis and its field are compared with, for comparison only: never deployed.

References
----------
The thesis: L. S. Brusletto, *Computer Vision Based Obstacle Avoidance for a Remotely Operated
Vehicle*, NTNU 2016. Its program is AURlabCVsimulator.
"""
