"""Safe docking control for nonholonomic robots."""

from clfcbf.batch import BatchDecision, BatchState, filter_batch
from clfcbf.camera import FieldOfView
from clfcbf.constraints.barrier import Barrier
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.controller import DockingController, TrackingController
from clfcbf.decision import Decision, Phase, Status
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
    "Chassis",
    "ClfcbfError",
    "ConfigurationError",
    "Decision",
    "DockingController",
    "FieldOfView",
    "FieldOfViewBarrier",
    "GeometryError",
    "Limits",
    "LimitsError",
    "MissingExtraError",
    "Observation",
    "Phase",
    "Plan",
    "Planner",
    "PlanningError",
    "Pose2",
    "QpSolution",
    "QpStatus",
    "QuadraticProgram",
    "Reference",
    "SafetyFilter",
    "Scene",
    "Status",
    "TargetSensor",
    "TrackingController",
    "Twist",
    "arc",
    "available_backends",
    "filter_batch",
    "plan_approach",
    "solve_qp",
    "wrap_angle",
]
