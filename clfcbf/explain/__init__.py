"""Why a tick sent what it sent: as data, as one sentence, and from a file.

Nothing here runs in a tick. A :class:`~clfcbf.decision.Decision` holds the rows, the input box,
the program's answer and the guard's verdict; multipliers and conflicts are computed from them
when they are asked for, today or from a tick that was saved.

Examples
--------
>>> import json, math
>>> from clfcbf import FieldOfView, Limits, Pose2, SafetyFilter, Scene, Twist
>>> from clfcbf.explain import decision_from_json, decision_to_json, explain
>>> limits = Limits(v_max=0.22, omega_max=0.4, a_max=0.3, alpha_max=1.0)
>>> camera = FieldOfView(half_angle=math.radians(35), camera=Pose2(0.2, 0.0, 0.0))
>>> safe = SafetyFilter(limits, [camera], period=1 / 30)
>>> scene = Scene(goal=Pose2(1.4, 0.0, 0.0), feature=Pose2(2.0, 0.0, 0.0), stamp=0.0)
>>> decision = safe.filter(Twist(0.2, 0.0), scene, applied=Twist(0.0, 0.0), now=0.0)
>>> print(explain(decision))  # doctest: +NORMALIZE_WHITESPACE
Optimal: the limit v upper (acceleration) held the nominal command v = 0.2 m/s,
omega = 0 rad/s back to v = 0.01 m/s, omega = 0 rad/s.
>>> saved = json.dumps(decision_to_json(decision))  # a tick to keep: clfcbf explain FILE
>>> decision_from_json(json.loads(saved)) == decision
True
"""

from clfcbf.explain.analysis import explain
from clfcbf.explain.conflict import Conflict, HalfPlane, smallest_conflict
from clfcbf.explain.explanation import Explanation, LimitReport, RowReport
from clfcbf.explain.serial import decision_from_json, decision_to_json, decisions_in

__all__ = [
    "Conflict",
    "Explanation",
    "HalfPlane",
    "LimitReport",
    "RowReport",
    "decision_from_json",
    "decision_to_json",
    "decisions_in",
    "explain",
    "smallest_conflict",
]
