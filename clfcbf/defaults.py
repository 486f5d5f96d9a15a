"""Every default of the controllers in one table, each with its reason.

Units are in square brackets. What describes the simulated world (limits, sensor, body) stands
with the scenarios; what is a choice of ours stands here.
"""

from __future__ import annotations

import hashlib
import math

from clfcbf.estimation import NoiseModel

__all__ = ["fingerprint"]

# The program ------------------------------------------------------------------------------------

QP_WEIGHT = (1.0, 0.0, 0.3)
"""Distance to the nominal command: 0.1 m/s weighs as much as 0.18 rad/s, half of each range."""

CLF_FRACTION = 0.5
"""Share of the law's own decay that the Lyapunov row demands: half leaves room for the barrier."""

# The guard --------------------------------------------------------------------------------------

GUARD_LAG = 0.28
"""[s] A lag of the body up to 0.25 s, twice that of the robots met so far, and 30 ms of latency
that the stamps do not tell."""

VIEW_MARGIN = math.radians(3.0)
"""[rad] Declared margin of the field of view. A long search gains 1.1° by a bearing error of 1°,
1.1° by a lag of 0.25 s where 0.12 s is modelled, 0.6° by slip in 220 ms of dead reckoning, 0.05°
by range, and nothing by latency; all of them together, close to the feature, up to 5.0°, which
this does not cover (see benchmarks.falsify). It costs no time in R1, R3 and R4."""

VIEW_SETBACK = 0.02
"""[m] """

# The path-following law -------------------------------------------------------------------------

FOLLOW_K2 = 25.0
"""[1/m²] Lateral errors decay over 0.2 m of travel, a tenth of the shortest approach."""

FOLLOW_K3 = 10.0
"""[1/m] 2 sqrt(k2), critical damping."""

FOLLOW_HEADING = 3.0
"""[1/s] Heading gain at rest: what k3 v is at full speed, half as much again."""

SETTLE_X = 4.0
"""[1/s] The last millimetres in half a second; more would answer to the sensor's noise."""

SETTLE_THETA = 5.0
"""[1/s] As above; with a lag of 0.12 s still well damped."""

SETTLE_FROM = 0.004
"""[m] Where the regulator takes over: twice what the estimate is worth there."""

DONE_X = 0.003
"""[m] A third of the strict tolerance of 10 mm."""

DONE_THETA = math.radians(0.4)
"""[rad] A fifth of the strict tolerance of 2°."""

LATERAL_TOLERANCE = 0.007
"""[m] Lateral error at the end that is worth another approach: strict is 10 mm."""

# The planner ------------------------------------------------------------------------------------

PLAN_TURN_RATE = 0.9375
"""Share of the turn rate that a plan uses; feedback on the path needs the rest."""

PLAN_ACCELERATION = 0.9
"""Share of both accelerations that a plan uses."""

PLAN_EDGE = math.radians(3.75)
"""[rad] From the camera's edge to the edge that a plan rides: the guard's margin and 0.75° to
spare for its look-ahead along an arc, which leaves the spiral by 0.4°."""

PLAN_CURVES = 10
"""Terminal curves to each side: turns that end 0.25 s apart."""

PLAN_REACH = 3.4
"""[m] Length of the terminal curves, beyond the farthest start."""

PLAN_THIN_CURVES = 2
"""Every second curve is enough after a first leg, which adds a choice of its own."""

PLAN_THIN_SAMPLES = 6
"""Every sixth sample (3 cm) keeps the search after 200 first legs at 20 ms."""

PLAN_TRIES = 8
"""Candidates driven in simulation at most, a few milliseconds each."""

PLAN_SLACK = 0.5
"""[s] By how much a simulated time exceeds its estimate; ends the search for a better one."""

PLAN_PATIENCE = 10.0
"""[s] A candidate that takes this much longer than estimated is given up."""

PLAN_ERROR = 0.006
"""[m] Predicted error at the goal above which a candidate does not count as arriving."""

PLAN_ERROR_THETA = math.radians(1.0)
"""[rad] As above, for the heading."""

PLAN_REVERSES = (0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0)
"""[m] Lengths of a first leg in reverse."""

# The docking controller -------------------------------------------------------------------------

FIRST_LOOKS = 2
"""Measurements that must agree before the first plan: one alone may be an outlier."""

PATIENCE = 2.0
"""[s] Longest dead reckoning: at 1 % slip and 0.22 m/s the target moves by 5 mm in it."""

GIVE_UP = 7.0
"""[s] Without a measurement for so long the target is lost."""

ATTEMPTS = 8
"""Plans before it gives up; one is the rule, two where it has to back off."""

STUCK_TIME = 8.0
"""[s] Without a centimetre of progress for so long it plans anew; a turn by 90° takes 5 s."""

STANDOFF_ERROR = 0.1
"""[m] A feature seen so far from where the standoff puts it is not the one configured."""

OFF_COURSE = 0.08
"""[m] Farther beside its path than any disturbance it was designed for: plan anew."""

OFF_COURSE_THETA = 0.35
"""[rad] As above, for the heading."""

PAPER_STRETCHES = (1.0, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 8.0)
"""Durations tried for the paper's quintic, in units of that of a straight line."""

PAPER_WAIT = 5.0
"""[s] After the end of the paper's trajectory, for its tracker to catch up."""

NOISE = NoiseModel(
    sigma_xy=0.008,
    sigma_theta=0.01,
    along=0.015,
    across=0.003,
    turn=0.02,
    drift=0.003,
    gate=4.5,
    rejections=4,
)
"""Of a measurement without a covariance, 8 mm and 0.6°, a tag at 2 m; of dead reckoning, 1.5 %
of the way, 0.3 % of it sideways, 2 % of the turning and 3 mrad/s; a gate that one sound
measurement in ten thousand fails; four rejected in a row that agree mean the target has moved."""


def fingerprint() -> str:
    """Hash of every value in this table, to tell whether two results share their defaults."""
    table = sorted((k, repr(v)) for k, v in globals().items() if k.isupper())
    return hashlib.sha256(repr(table).encode()).hexdigest()[:16]
