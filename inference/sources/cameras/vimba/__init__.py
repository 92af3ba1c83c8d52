"""Cameras of Allied Vision through pymba and the Vimba SDK."""
