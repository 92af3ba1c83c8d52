"""Cameras of Allied Vision through pymba and the Vimba SDK, or through vmbpy and Vimba X."""
