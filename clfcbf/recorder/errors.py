"""What is raised for a log that cannot be read, written or replayed."""

from __future__ import annotations

from clfcbf.errors import ClfcbfError

__all__ = ["LogError"]


class LogError(ClfcbfError, ValueError):
    """A flight recorder's log is unusable; the message says what is wrong with it, and where."""
