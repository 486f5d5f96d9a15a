"""Constraint builders: typed rows of Lyapunov and barrier functions."""
