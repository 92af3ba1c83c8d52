"""Checks of frames before any detector judges them."""
