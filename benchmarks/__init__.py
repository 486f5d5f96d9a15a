"""Benchmarks of clfcbf, run as ``python -m benchmarks.<name>``; no part of the wheel."""
