"""Trajectories: the paper's quintic, paths certified by the view, and the planner."""
