"""What is mutated, and the tests that have to notice."""

from __future__ import annotations

__all__ = ["SHARED", "TARGETS"]

_PARTS = "tests/qp/test_geometry.py"
_WHOLE = "tests/qp/test_lexicographic.py"
_ONE_SHOT = "tests/qp/test_one_shot.py"

TARGETS: dict[str, tuple[str, ...]] = {
    "clfcbf/guard.py": ("tests/test_guard.py",),
    "clfcbf/constraints/cbf.py": ("tests/constraints/test_cbf.py",),
    "clfcbf/constraints/barrier.py": ("tests/constraints/test_cbf.py", "tests/test_guard.py"),
    "clfcbf/constraints/bearing.py": ("tests/constraints/test_cbf.py",),
    "clfcbf/se2.py": ("tests/test_se2.py",),
    "clfcbf/limits.py": ("tests/test_limits.py",),
    "clfcbf/qp/one_shot.py": (_ONE_SHOT,),
    "clfcbf/qp/objective.py": (_PARTS, _ONE_SHOT),
    "clfcbf/qp/rational.py": (_PARTS, _WHOLE),
    "clfcbf/qp/polygon.py": (_PARTS, _WHOLE),
    "clfcbf/qp/projection.py": (_PARTS, _ONE_SHOT, _WHOLE),
    "clfcbf/qp/relaxation.py": (_PARTS, _WHOLE),
    "clfcbf/qp/chord.py": (_PARTS, _ONE_SHOT, _WHOLE),
    "clfcbf/qp/segment.py": ("tests/qp/test_segment.py", _PARTS, _WHOLE),
    "clfcbf/qp/least_violation.py": ("tests/qp/test_least_violation.py", _PARTS, _WHOLE),
    "clfcbf/qp/lexicographic.py": (_PARTS, _WHOLE),
}
"""Module to its own test files, those that fail soonest first."""

SHARED = ("tests/conftest.py", "tests/qp/conftest.py", "tests/strategies.py")
"""What the tests draw from: a survivor is tried again when any of it has changed."""
