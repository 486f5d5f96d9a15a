"""Docking as a task: staging, perception, approach, confirmation, retries, undocking, cancel."""

from clfcbf.session.docking_session import DockingSession
from clfcbf.session.docks import Dock, DockDatabase, DockType, parse_docks, read_docks
from clfcbf.session.interface import (
    DockContact,
    ErrorCode,
    Feedback,
    PhaseControllers,
    SessionResult,
    SessionState,
    Unsensed,
    reverse_out,
)
from clfcbf.session.policy import SessionPolicy

__all__ = [
    "Dock",
    "DockContact",
    "DockDatabase",
    "DockType",
    "DockingSession",
    "ErrorCode",
    "Feedback",
    "PhaseControllers",
    "SessionPolicy",
    "SessionResult",
    "SessionState",
    "Unsensed",
    "parse_docks",
    "read_docks",
    "reverse_out",
]
