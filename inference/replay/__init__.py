"""Replay of logged runs, and challengers that judge the same frames in the shadow."""
