"""A vehicle, its world and its planner around the real runtime: where verdicts lead, simulated."""
