"""Sources of frames: folders and videos, a stream of another program, live cameras."""
