"""The docking session: from a dock's name to a robot that is docked, confirmed, or told why not.

Stage, see, approach, confirm; back off and try again where that failed; undock; and a stop on
request at any point of it. A session is itself a controller that a ``ControlLoop`` ticks. It
passes each tick on to the controller of its phase and changes phase only at rest, to which it
brakes along the robot's own curvature within the acceleration limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from clfcbf import defaults
from clfcbf.decision import Decision, Failure, Phase, Status
from clfcbf.errors import ConfigurationError
from clfcbf.limits import Limits, check_period
from clfcbf.runtime.braking import Braking
from clfcbf.runtime.loop import LoopController
from clfcbf.scene import Observation
from clfcbf.se2 import Pose2, Twist
from clfcbf.session.docks import Dock, DockDatabase
from clfcbf.session.interface import (
    DockContact,
    ErrorCode,
    Feedback,
    PhaseControllers,
    SessionResult,
    Unsensed,
)
from clfcbf.session.policy import SessionPolicy
from clfcbf.session.progress import Progress, Stage
from clfcbf.trajectories.following import at_rest

__all__ = ["DockingSession"]

_REST = Twist(0.0, 0.0)


_UNSEEN = (Failure.LOST, Failure.AMBIGUOUS)
_CONTACT = "the dock's contact"


class DockingSession:
    """Docks and undocks a robot, one task after another.

    Parameters
    ----------
    controllers : who drives in which phase
    docks : that are known by name
    limits, period : of the chassis and the loop, for its own braking
    contact : what the dock tells; by default nothing, and the pose decides
    policy : time-outs and retries
    robot_pose : gives the robot's pose in the docks' frame, to see whether it is staged already;
        without it a robot that nobody stages is taken to be there

    Raises
    ------
    ConfigurationError : the period is not finite and positive

    Notes
    -----
    ``cancel`` may be called from any thread; everything else from that of the loop, or while
    the loop does not run.
    """

    def __init__(
        self,
        controllers: PhaseControllers,
        docks: DockDatabase,
        limits: Limits,
        period: float,
        *,
        contact: DockContact | None = None,
        policy: SessionPolicy | None = None,
        robot_pose: Callable[[], Pose2] | None = None,
    ) -> None:
        self._controllers = controllers
        self._docks = docks
        self._limits = limits
        self._period = check_period(period)
        self._contact: DockContact = contact if contact is not None else Unsensed()
        self._policy = policy or SessionPolicy()
        self._robot_pose = robot_pose
        self._braking = Braking(limits, period)
        self._certified = True
        self._progress = Progress(self._policy)
        self._canceled = False
        self._approach: LoopController | None = None
        self._controller: LoopController | None = None
        self._looks = 0
        self._heard = math.nan
        self._asked = ""

    @property
    def result(self) -> SessionResult | None:
        """Of the last task, None until it has ended and the robot stands."""
        return self._progress.result

    @property
    def active(self) -> bool:
        """Whether a task is in progress."""
        return self._progress.active

    @property
    def feedback(self) -> Feedback:
        """State, duration and retries as of the last tick."""
        return self._progress.feedback

    def dock(self, name: str) -> None:
        """Dock at a dock of the database, from the next tick on; one not in it ends at once."""
        self._check_idle()
        dock = self._docks.docks.get(name)
        if dock is None:
            known = ", ".join(map(repr, self._docks.docks)) or "none"
            self._progress.refuse(ErrorCode.DOCK_NOT_IN_DB, f"no dock {name!r} (known: {known})")
        else:
            self._task(dock, Stage.STAGING)

    def dock_at(self, pose: Pose2, kind: str = "", frame: str = "map") -> None:
        """Dock at a pose; the type may be left out where only one is known.

        Raises
        ------
        ConfigurationError : the pose is not finite, or a task is in progress
        """
        self._check_idle()
        types = self._docks.types
        found = next(iter(types.values())) if not kind and len(types) == 1 else types.get(kind)
        if found is None:
            known = ", ".join(map(repr, types))
            self._progress.refuse(ErrorCode.DOCK_NOT_VALID, f"no type {kind!r} (known: {known})")
        else:
            self._task(Dock("", found, pose, frame), Stage.STAGING)

    def undock(self, name: str | None = None) -> None:
        """Leave a dock, by default that of the last task, from the next tick on."""
        self._check_idle()
        dock = self._progress.dock if name is None else self._docks.docks.get(name)
        if dock is None:
            known = ", ".join(map(repr, self._docks.docks)) or "none"
            self._progress.refuse(
                ErrorCode.DOCK_NOT_VALID, f"no dock {name!r} to leave (known: {known})"
            )  # fmt: skip
            return
        if dock is not self._progress.dock:
            self._approach = None
        self._task(dock, Stage.UNDOCKING)

    def cancel(self) -> None:
        """Ask the task to end: it brakes from the next tick on. Without a task it does nothing."""
        self._canceled = True

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """The command of this tick; whatever a part raises ends the task, and is told."""
        applied = self._braking.known(applied)
        if observation is not None or math.isnan(self._heard):
            self._heard = now
        try:
            decision = self._stepped(observation, applied, now)
        except Exception as error:  # of a controller or the contact: a command must go out
            part = f"{self._asked} raised " if self._asked else ""
            self._progress.end(ErrorCode.UNKNOWN, f"{part}{type(error).__name__}: {error}")
            decision = self._brake(applied)
        self._braking.accepted(decision.twist)
        return decision

    # Tasks ---------------------------------------------------------------------------------

    def _check_idle(self) -> None:
        if self.active:
            raise ConfigurationError(
                f"a task is in progress ({self._progress.stage.value[0]}); cancel it"
            )

    def _task(self, dock: Dock, first: Stage) -> None:
        self._canceled = False
        self._progress.begin(dock, first)

    # Ticks ---------------------------------------------------------------------------------

    def _stepped(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        self._asked = ""
        self._progress.tick(now, self._canceled)
        while (stage := self._progress.following) is not None:
            if not at_rest(applied):
                return self._brake(applied)
            self._enter(stage)
        return _TICKS[self._progress.stage](self, observation, applied, now)

    def _enter(self, stage: Stage) -> None:
        """Begin a stage, at rest; where it has nothing to do the next one follows at once."""
        self._progress.enter(stage)
        self._controller = None
        if stage is Stage.STAGING:
            self._begin_staging(self._task_dock())
        elif stage is Stage.PERCEIVING:
            self._looks = 0
        elif stage is Stage.APPROACHING:
            self._asked = "the maker of the approach's controller"
            self._controller = self._approach = self._controllers.approach(self._task_dock())
        elif stage in (Stage.RETREATING, Stage.UNDOCKING):
            self._asked = _CONTACT
            self._contact.release()

    def _begin_staging(self, dock: Dock) -> None:
        off = self._off_staging(dock)
        if off <= self._policy.prestaging_tolerance:
            self._progress.following = Stage.PERCEIVING
        elif self._controllers.stage is None:
            self._progress.end(
                ErrorCode.FAILED_TO_STAGE,
                f"{off:.2f} off the staging pose, and nothing that drives there",
            )
        else:
            self._asked = "the maker of the staging controller"
            self._controller = self._controllers.stage(dock)

    def _off_staging(self, dock: Dock) -> float:
        """Norm of the difference to the staging pose; where nobody knows or stages, none."""
        if self._robot_pose is not None:
            self._asked = "robot_pose"
            return math.hypot(*dock.staging_pose.relative(self._robot_pose()))
        return math.inf if self._controllers.stage is not None else 0.0

    def _task_dock(self) -> Dock:
        if (dock := self._progress.dock) is None:
            raise ConfigurationError("no dock was given")
        return dock

    def _stay(self, _: Observation | None, applied: Twist, __: float) -> Decision:
        """No task, or one that has ended: stand, and say how it ended."""
        ended, decision = self._progress.ending, self._brake(applied)
        if ended is None:
            return decision._replace(phase=Phase.WAITING)
        return decision._replace(
            done=ended.success and decision.twist == _REST,
            phase=Phase.DONE if ended.success else Phase.FAILED,
            reason=ended.error_msg,
        )

    def _stage_robot(
        self, observation: Observation | None, applied: Twist, now: float
    ) -> Decision:  # fmt: skip
        limit = self._policy.max_staging_time
        if self._progress.waited(limit):
            self._progress.end(ErrorCode.FAILED_TO_STAGE, f"not staged within {limit:g} s")
            return self._brake(applied)
        decision = self._drive(observation, applied, now)
        if decision.done:
            self._progress.following = Stage.PERCEIVING
        elif decision.phase is Phase.FAILED:
            self._progress.end(
                ErrorCode.FAILED_TO_STAGE, decision.reason or "the robot was not staged"
            )
        return _underway(decision)

    def _perceive(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        limit = self._policy.initial_perception_timeout
        self._looks += observation is not None
        if self._looks >= self._policy.looks:
            self._progress.following = Stage.APPROACHING
        elif self._progress.waited(limit):
            self._progress.failed(
                ErrorCode.FAILED_TO_DETECT_DOCK,
                f"dock not seen within {limit:g} s{self._silence(now)}",
            )
        return self._brake(applied)

    def _come_near(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        limit = self._policy.approach_timeout
        self._asked = _CONTACT
        if self._contact.docked():
            self._progress.following = Stage.CONFIRMING
            return self._brake(applied)
        if self._progress.waited(limit):
            self._progress.failed(ErrorCode.FAILED_TO_CONTROL, f"not docked within {limit:g} s")
            return self._brake(applied)
        decision = self._drive(observation, applied, now)
        if decision.done:
            if self._task_dock().type.contact:
                self._progress.failed(
                    ErrorCode.FAILED_TO_CONTROL, "at the dock's pose without contact"
                )
            else:
                self._progress.following = Stage.CONFIRMING
        elif decision.phase is Phase.FAILED:
            unseen = decision.failure in _UNSEEN
            code = ErrorCode.FAILED_TO_DETECT_DOCK if unseen else ErrorCode.FAILED_TO_CONTROL
            told = decision.reason or "the approach failed"
            self._progress.failed(code, told + (self._silence(now) if unseen else ""))
        return _underway(decision)

    def _confirm(self, _: Observation | None, applied: Twist, now: float) -> Decision:
        limit = self._policy.wait_charge_timeout
        self._asked = _CONTACT
        if not self._task_dock().type.confirm or self._contact.confirmed():
            self._progress.end(ErrorCode.NONE)
        elif self._progress.waited(limit):
            self._progress.failed(ErrorCode.FAILED_TO_CHARGE, f"not confirmed within {limit:g} s")
        return self._brake(applied)

    def _retreat(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """Out of the dock, to undock or for another attempt, once it has let go."""
        dock, undocking = self._task_dock(), self._progress.stage is Stage.UNDOCKING
        limit = self._policy.max_undocking_time
        if self._progress.waited(limit):
            self._progress.end(
                ErrorCode.FAILED_TO_CONTROL, f"not out of the dock within {limit:g} s"
            )
            return self._brake(applied)
        if self._controller is None:
            self._asked = _CONTACT
            if not self._contact.released():
                return self._brake(applied)
            self._asked = "the maker of the controller for the way out"
            distance = dock.undocking_distance if undocking else dock.type.backoff
            approach = self._approach or self._controllers.approach(dock)
            self._controller = self._controllers.retreat(approach, dock, distance)
        decision = self._drive(observation, applied, now)
        if decision.done:
            if undocking:
                self._progress.end(ErrorCode.NONE)
            else:
                self._progress.following = Stage.PAUSING
        elif decision.phase is Phase.FAILED:
            self._progress.end(ErrorCode.FAILED_TO_CONTROL, decision.reason or "could not back out")
        return _underway(decision)

    def _pause(self, _: Observation | None, applied: Twist, now: float) -> Decision:
        if self._progress.waited(self._policy.pause_before(self._progress.retries)):
            self._progress.following = Stage.PERCEIVING
        return self._brake(applied)

    def _drive(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        if self._controller is None:
            raise ConfigurationError(f"no controller for {self._progress.stage.value[0]}")
        self._asked = f"the controller ({self._progress.stage.value[0]})"
        decision = self._controller.step(observation, applied, now)
        self._certified = decision.certified
        return decision

    def _silence(self, now: float) -> str:
        """That the sensor has given nothing at all, where it has not."""
        silence = now - self._heard
        if not silence > defaults.BLIND_TIME:
            return ""
        return f"; the sensor has delivered nothing for {silence:.1f} s"

    def _brake(self, applied: Twist) -> Decision:
        """The brake's next command, which is certified as the controller's last one was."""
        twist = self._braking.command(applied)
        certified = self._certified or twist == _REST == applied
        return Decision(
            twist, Status.STOPPED, certified, _REST, math.nan,
            box=self._limits.input_box(applied, self._period), phase=Phase.STOPPING,
            limits=self._limits,
        )  # fmt: skip


def _underway(decision: Decision) -> Decision:
    """A controller's decision as that of a task which is not over."""
    phase = Phase.STOPPING if decision.phase in (Phase.DONE, Phase.FAILED) else decision.phase
    return decision._replace(done=False, phase=phase, failure=None)


_Tick = Callable[[DockingSession, Observation | None, Twist, float], Decision]

_TICKS: dict[Stage, _Tick] = {
    Stage.IDLE: DockingSession._stay,
    Stage.STAGING: DockingSession._stage_robot,
    Stage.PERCEIVING: DockingSession._perceive,
    Stage.APPROACHING: DockingSession._come_near,
    Stage.CONFIRMING: DockingSession._confirm,
    Stage.RETREATING: DockingSession._retreat,
    Stage.PAUSING: DockingSession._pause,
    Stage.UNDOCKING: DockingSession._retreat,
    Stage.ENDED: DockingSession._stay,
}
