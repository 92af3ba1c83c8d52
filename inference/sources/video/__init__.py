"""Video as vehicles send it: network streams and USB cameras, each read by a process of its own."""
