"""Nominal laws, each with its Lyapunov function."""
