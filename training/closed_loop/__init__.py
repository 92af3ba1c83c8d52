"""A vehicle, its world and its planner around the real runtime: what a verdict comes to at sea."""
