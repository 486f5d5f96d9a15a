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
"""[rad] By which the edges of the view are turned in, see :meth:`FieldOfView.eroded`. A bearing
error of 1° takes a third of it; lag, stamps and slip share the rest."""

VIEW_SETBACK = 0.02
"""[m] By which they are moved in: near the feature a centimetre is worth 2°. With both the
adversary of ``benchmarks.falsify`` leaves 1° at least; what is proved for the worst of everything
at once is :func:`clfcbf.error_budget`, 4.7° and 74 mm, which costs 4 to 12 % of time."""

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

STOP_FROM = 0.09
"""[m] From the goal, where the fastest stop takes over: it needs 8 cm from 0.22 m/s."""

FACE_FROM = 0.02
"""[m] As above, of the heading: the path's own last turn is over by then."""

DONE_X = 0.003
"""[m] A third of the strict tolerance of 10 mm."""

DONE_THETA = math.radians(0.4)
"""[rad] A fifth of the strict tolerance of 2°."""

LATERAL_TOLERANCE = 0.007
"""[m] Lateral error at the end that is worth another approach: strict is 10 mm."""

CONCESSION = 0.5
"""Tolerances conceded for each approach made: a sensor whose bias changes with the distance may
never agree with itself to 7 mm, and 28 mm after eight approaches is better than none."""

# The planner ------------------------------------------------------------------------------------

PLAN_TURN_RATE = 0.9375
"""Share of the turn rate that a plan uses; feedback on the path needs the rest."""

PLAN_ACCELERATION = 0.95
"""Share of both accelerations that a plan uses; with all of it docking is no faster."""

PLAN_EDGE = math.radians(4.5)
"""[rad] From the camera's edge, moved in by the setback, to the edge that a plan rides: the guard's
margin and 1.5° to spare for its look-ahead along an arc, which leaves the spiral by 0.4°, and
along the line before it; with half as much the guard slows down more than the wider edge gains."""

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

PLAN_SLACK = 0.1
"""[s] By how much a simulated time exceeds its estimate; ends the search for a better one."""

PLAN_PATIENCE = 10.0
"""[s] A candidate that takes this much longer than estimated is given up."""

PLAN_ERROR = 0.006
"""[m] Predicted error at the goal above which a candidate does not count as arriving."""

PLAN_ERROR_THETA = math.radians(1.0)
"""[rad] As above, for the heading."""

PLAN_PAST = 0.01
"""[m] By which a predicted motion may run past the goal, behind which stands what is docked to."""

PLAN_REVERSES = (
    0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7, 0.8, 1.0, 1.2, 1.5,
)  # fmt: skip
"""[m] Lengths driven in reverse before an approach; the fastest need up to 0.6 m, one start of 400
in R5, beside the goal and turned by 55°, more than 1 m."""

PLAN_BACKS = (0.1, 0.2, 0.35, 0.5, 0.8)
"""[m] Lengths driven straight back to a stop: for small corrections at the goal."""

PLAN_TURNS = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Shares of the turn rate in reverse and through the change of gear."""

PLAN_LEADS = (0.0, 0.4, 0.8)
"""[s] By which a turn changes before the gear does: up to the time that its ramp takes."""

TRACK_WAIT = 0.05
"""[m] Behind a leg by time from which the virtual target waits: a guard that holds the robot."""

TRACK_WAIT_THETA = 0.15
"""[rad] As above, for the heading: a third of what counts as off course."""

# The docking controller -------------------------------------------------------------------------

FIRST_LOOKS = 2
"""Measurements that must agree before the first plan: one alone may be an outlier."""

PATIENCE = 2.0
"""[s] Longest dead reckoning: at 1 % slip and 0.22 m/s the target moves by 5 mm in it."""

GIVE_UP = 12.0
"""[s] Without a measurement: 2 s of dead reckoning, a stop, and 9 s for the longest search."""

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

# Loss and recovery ------------------------------------------------------------------------------

BLIND_TIME = 0.3
"""[s] Without a measurement for so long it is more than latency and a few drop-outs."""

WATCHDOG = 0.5
"""[s] Longest time for which a chassis is believed to hold a command that is not renewed: 15
periods at 30 Hz. At 0.22 m/s it then has driven 0.11 m, and stops within another 0.11 m."""

RECOVERY_NEAR = 0.5
"""[m] From the goal: an error found later than here may be too late to be removed on the way."""

RECOVERY_SIGMAS = 2.0
"""Standard deviations that have to be within the tolerance, 95 % of a normal error."""

RECOVERY_ALONG = 0.010
"""[m] Tolerance along the goal's axis and ..."""

RECOVERY_TURNED = math.radians(2.0)
"""[rad] ... of the heading: the strict ones. That of the lateral error is the controller's."""

RECOVERY_GROWN = 2.0
"""Growth of a variance since the last look above which dead reckoning is to blame for it, not
the sensor: a poor sensor is not helped by waiting for it."""

RECOVERY_FACING = math.radians(5.0)
"""[rad] Bearing at which a lost target counts as looked at: a tenth of a usual view."""

RECOVERY_LOOK = 0.5
"""[s] A look at rest: three times the longest latency met so far."""

RECOVERY_BEYOND = 0.3
"""[m] Further back than where the target was last seen: clear of whatever hides it, and a target
that was moved aside comes 4° nearer to the axis at a metre and a half."""

RETRACE = 0.7
"""[m] Longest way back: what is driven blind in 2 s and in a stop at 0.22 m/s, and
``RECOVERY_BEYOND``."""

RETRACE_SPEED = 0.15
"""[m/s] Of the way back, at most: nobody behind the robot expects it; 8 cm to stop."""

# The estimate ------------------------------------------------------------------------------------

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
