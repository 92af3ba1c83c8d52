"""The contents of rendered water: towers, walls, fish, dust, and the stereo rig."""
