"""What a hostile input has broken."""

from __future__ import annotations

__all__ = ["BrokenError", "HungError"]


class BrokenError(Exception):
    """A rule did not hold; ``data`` is the input."""

    def __init__(self, why: str, data: bytes) -> None:
        super().__init__(why)
        self.data = data


class HungError(BaseException):
    """The time is over; no ``except Exception`` may take this for an answer."""
