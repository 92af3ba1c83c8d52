"""The speed of stereo: the cases that judge pairs."""
