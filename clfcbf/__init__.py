"""Safe docking control for nonholonomic robots."""

from clfcbf.batch import BatchDecision, BatchState, filter_batch
from clfcbf.camera import FieldOfView
from clfcbf.constraints.barrier import Barrier, Sweep
from clfcbf.constraints.budget import ErrorBounds, error_budget
from clfcbf.constraints.capsule import Capsule
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.constraints.obstacle_set import Disc, Obstacles, Wall
from clfcbf.constraints.obstacles import Frame, ObstacleBarrier
from clfcbf.constraints.range_band import RangeBarrier
from clfcbf.constraints.robust import margin_of
from clfcbf.constraints.view import ViewBarrier
from clfcbf.controller import DockingController, TrackingController
from clfcbf.decision import Decision, Event, Failure, Phase, Status
from clfcbf.errors import (
    BackendError,
    ClfcbfError,
    ConfigurationError,
    GeometryError,
    LimitsError,
    MissingExtraError,
    PlanningError,
)
from clfcbf.hardware.protocols import Chassis, TargetSensor
from clfcbf.limits import Limits
from clfcbf.qp import QpSolution, QpStatus, QuadraticProgram, available_backends, solve_qp
from clfcbf.safety_filter import SafetyFilter
from clfcbf.scene import Observation, Reference, Scene
from clfcbf.se2 import Pose2, Twist, arc, wrap_angle
from clfcbf.trajectories.planner import Plan, Planner, plan_approach

__version__ = "0.1.0"

__all__ = [
    "BackendError",
    "Barrier",
    "BatchDecision",
    "BatchState",
    "Capsule",
    "Chassis",
    "ClfcbfError",
    "ConfigurationError",
    "Decision",
    "Disc",
    "DockingController",
    "ErrorBounds",
    "Event",
    "Failure",
    "FieldOfView",
    "FieldOfViewBarrier",
    "Frame",
    "GeometryError",
    "Limits",
    "LimitsError",
    "MissingExtraError",
    "Observation",
    "ObstacleBarrier",
    "Obstacles",
    "Phase",
    "Plan",
    "Planner",
    "PlanningError",
    "Pose2",
    "QpSolution",
    "QpStatus",
    "QuadraticProgram",
    "RangeBarrier",
    "Reference",
    "SafetyFilter",
    "Scene",
    "Status",
    "Sweep",
    "TargetSensor",
    "TrackingController",
    "Twist",
    "ViewBarrier",
    "Wall",
    "arc",
    "available_backends",
    "error_budget",
    "filter_batch",
    "margin_of",
    "plan_approach",
    "solve_qp",
    "wrap_angle",
]
