r"""Half-planes that keep a seen point in the camera's view, and the field-of-view barrier.

Each edge of the view is a half-plane of the robot frame, and its barrier function the signed
distance from it: linear in the point, smooth everywhere, of one gain everywhere. An edge is
three numbers, so a view with unequal edges, or one that a part of the robot cuts, is two
other ``Edge``. The same set in terms of bearings is in ``clfcbf.constraints.bearing``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from clfcbf.camera import FieldOfView
from clfcbf.constraints.barrier import HERE, Sweep
from clfcbf.constraints.bearing import bearing_rows, paper_row
from clfcbf.constraints.checks import check_finite, check_positive
from clfcbf.constraints.rows import Priority, Row, Rows
from clfcbf.errors import GeometryError
from clfcbf.scene import Scene
from clfcbf.se2 import Point, Pose2

__all__ = [
    "Edge",
    "FieldOfViewBarrier",
    "bearing_rows",
    "camera_edges",
    "edge_rows",
    "half_plane_rows",
    "paper_row",
]

_AT_REST: Point = (0.0, 0.0)
_SAFETY = Priority.SAFETY
_new = tuple.__new__  # makes a named tuple in half the time of its own constructor
_RIGHT_ANGLE = 0.5 * math.pi
_SIXTH = math.pi / 3.0  # the arc of a chord of half the radius, over the chord
_NO_DISTANCE = 5e-324  # [m] in place of none


class Edge(NamedTuple):
    r"""An edge of the view in the robot frame: the half-plane :math:`n^\top p \ge d`.

    Attributes
    ----------
    normal_x, normal_y : unit normal :math:`n`, pointing into the view
    offset : :math:`d = n^\top c` for an edge through the camera centre c [m]
    """

    normal_x: float
    normal_y: float
    offset: float

    @classmethod
    def through(cls, point: Point, direction: float, inward: float) -> Edge:
        """The edge from ``point`` along ``direction`` [rad].

        ``inward`` is +1 if the view lies to the left of that ray, -1 if to the right.
        """
        n_x, n_y = -inward * math.sin(direction), inward * math.cos(direction)
        return cls(n_x, n_y, n_x * point[0] + n_y * point[1])


def camera_edges(camera: FieldOfView) -> tuple[Edge, Edge]:
    """Left and right edge of a camera's view."""
    x, y, yaw = camera.camera
    return (
        Edge.through((x, y), yaw + camera.half_angle, inward=-1.0),
        Edge.through((x, y), yaw - camera.half_angle, inward=+1.0),
    )


def half_plane_rows(
    names: tuple[str, ...],
    edges: tuple[Edge, ...],
    points: Sequence[Point],
    gain: float,
    point_velocity: Point = _AT_REST,
) -> Rows:
    r"""Rows of every point and edge, the edges of a point together; inputs are not checked.

    .. math:: \dot h = -n_xv + (n_xy - n_yx)\,\omega + n^\top\dot p_{ext} \ge -\lambda h,
              \qquad h = n^\top p - d

    ``names`` has one name a row; the values are h [m].
    """
    coefficients: list[Row] = []
    values: list[float] = []
    for x, y in points:
        for n_x, n_y, offset in edges:
            h = n_x * x + n_y * y - offset
            values.append(h)
            coefficients.append((n_x, n_y * x - n_x * y, gain * h))
    if point_velocity is not _AT_REST:
        u_x, u_y = point_velocity
        drifts = [n_x * u_x + n_y * u_y for _ in points for n_x, n_y, _ in edges]
        coefficients = [(a, c, b + d) for (a, c, b), d in zip(coefficients, drifts, strict=True)]
    return _new(Rows, (names, tuple(coefficients), _SAFETY, tuple(values)))


def edge_rows(
    point: Point,
    camera: FieldOfView,
    gain: float,
    margin: float = 0.0,
    point_velocity: Point = _AT_REST,
) -> Rows:
    r"""Rows that keep a seen point between the camera's two edges.

    An edge through the camera centre :math:`c` with inward normal :math:`n` gives
    :math:`h = n^\top (p - c)` and, for a point at rest,
    :math:`\dot h = -n_x v + (n_x y - n_y x)\,\omega`  [Xie2024]_ in half-plane form.
    Each row states :math:`\dot h \ge -\lambda h`. Smooth everywhere, the apex included.

    Inside the view standing still meets both rows. Together they bound the speed by
    :math:`v \le \lambda(x - c_x) + \omega y` in the axes of a camera that looks ahead:
    the robot slows down toward the point, unless :math:`\lambda` exceeds its speed over the
    distance.

    Parameters
    ----------
    point : seen point in the robot frame, (x, y) [m]
    camera : half angle [rad] and pose of the camera in the robot frame
    gain : class-K gain :math:`\lambda` [1/s]; too large and it asks for more than the
        acceleration limits can give, which the guard then has to refuse
    margin : taken off the half angle [rad], in [0, half_angle)
    point_velocity : velocity of the point over ground, in the robot's axes [m/s]

    Returns
    -------
    Rows named "fov.left" and "fov.right", A of shape (2, 2), b of shape (2,), priority
    SAFETY, values h [m]

    Raises
    ------
    GeometryError : the point or its velocity is not finite
    ConfigurationError : the gain is not positive, or the margin out of range
    """
    check_positive("gain", gain)
    check_finite("point and its velocity", point, point_velocity)
    edges = camera_edges(camera.eroded(margin))
    return half_plane_rows(("fov.left", "fov.right"), edges, (point,), gain, point_velocity)


@dataclass(frozen=True, slots=True)
class FieldOfViewBarrier:
    r"""Keeps the viewed feature between the camera's edges, by half-planes.

    With ``camera.width`` :math:`l > 0` both ends of the feature are kept,
    :math:`p_\pm = d \pm \tfrac{l}{2}(-\sin\theta, \cos\theta)` for a board at :math:`d`
    perpendicular to its heading :math:`\theta`. The view is a convex cone, so the whole board
    is in it when both ends are; that needs a distance of :math:`l/(2\tan\Phi)` from the
    camera at least. The ends are taken to be at rest, as the feature is.

    What is kept is :meth:`FieldOfView.eroded`: the points that stay in view when they are turned
    about the camera by up to ``margin`` and then displaced by up to ``setback``.

    Attributes
    ----------
    camera : the view, and the extent of the feature to be kept in it
    gain : class-K gain :math:`\lambda` [1/s], see ``edge_rows``
    margin : taken off the half angle [rad], in [0, half_angle)
    name : prefix of the rows' names; give each camera its own
    setback : by which both edges are moved inward [m], at least 0
    kept : the view that is kept, made of these

    Raises
    ------
    ConfigurationError : the gain is not positive, or margin or setback out of range
    """

    camera: FieldOfView
    gain: float
    margin: float = 0.0
    name: str = "fov"
    setback: float = 0.0
    kept: FieldOfView = field(init=False, compare=False)
    _edges: tuple[Edge, ...] = field(init=False, repr=False, compare=False)
    _names: tuple[str, ...] = field(init=False, repr=False, compare=False)
    _eye: tuple[float, float, float, float, float] = field(init=False, repr=False, compare=False)
    _half_angle: float = field(init=False, repr=False, compare=False)
    _width: float = field(init=False, repr=False, compare=False)
    _lever: float = field(init=False, repr=False, compare=False)
    _most_turn: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_positive("gain", self.gain)
        ends = (".left_end", ".right_end") if self.camera.width > 0.0 else ("",)
        names = tuple(f"{self.name}.{side}{end}" for end in ends for side in ("left", "right"))
        kept = self.camera.eroded(self.margin, self.setback)
        x, y, yaw = kept.camera
        eye = (x, y, math.cos(yaw), math.sin(yaw), 1.0 / math.sin(kept.half_angle))
        for name, value in (
            ("kept", kept),
            ("_edges", camera_edges(kept)),
            ("_names", names),
            ("_eye", eye),
            ("_half_angle", kept.half_angle),
            ("_width", kept.width),
            ("_lever", math.hypot(x, y)),
            ("_most_turn", kept.half_angle - abs(yaw)),
        ):
            object.__setattr__(self, name, value)

    @property
    def bare(self) -> FieldOfViewBarrier:
        """The same without margin and setback: the view itself."""
        return FieldOfViewBarrier(self.camera, self.gain, name=self.name)

    @property
    def edges(self) -> tuple[Edge, ...]:
        """The edges of the view that is kept."""
        return self._edges

    def rows(self, scene: Scene, motion: Pose2 | None = None) -> Rows:
        """Rows of the feature after ``motion``, two for its centre or four for its ends.

        Named "fov.left" and "fov.right", with ".left_end" or ".right_end" behind where the
        feature has a width; values h [m].

        Raises
        ------
        GeometryError : the feature is not finite, or has a width and no heading
        """
        points: Sequence[Point] = self._points(scene[1])
        if motion is not None:
            points = [motion.seen(point) for point in points]
        return half_plane_rows(self._names, self._edges, points, self.gain)

    def clearance(self, scene: Scene, motion: Pose2 = HERE) -> float:
        """Angle from the feature to the nearer edge that is kept [rad].

        Negative outside, the smaller of the two ends where the feature has a width. Minus
        infinity behind the camera, from where no row leads back into view. Seen from the
        camera's own centre the bearing counts as 0.

        Raises
        ------
        GeometryError : as ``rows``, or the motion is not finite
        """
        eye_x, eye_y, cos, sin, _ = self._eye
        widest = 0.0
        for point in self._points(scene[1]):
            x, y = motion.seen(point)
            x, y = x - eye_x, y - eye_y
            bearing = abs(math.atan2(cos * y - sin * x, cos * x + sin * y))
            if bearing != bearing:
                raise GeometryError(f"motion must be finite, got {motion!r}")
            widest = max(widest, bearing)
        return self._half_angle - widest if widest < _RIGHT_ANGLE else -math.inf

    def clearance_along(self, scene: Scene, sweep: Sweep) -> float:
        """The smallest clearance at the corners of the sweep, which stand for all of it.

        That is true while the robot's forward direction stays in the view turned by each corner,
        and the feature ahead of the rotation centre and of the camera: minus infinity otherwise.
        The sweep's ``blur`` moves both edges inward by as much.
        """
        eye_x, eye_y, cos, sin, reach = self._eye
        (x, y, heading), (v_body, w_body), lag, (v, w), duration, _, _, blur = sweep
        shift, most = blur * reach, self._most_turn
        coasting, braking = w_body * lag, w * duration
        if abs(coasting) > most or abs(braking) > most or abs(coasting + braking) > most:
            return -math.inf
        coast_x, coast_y, coast_c, coast_s = _arc(v_body * lag, 0.5 * coasting)
        brake_x, brake_y, brake_c, brake_s = _arc(v * duration, 0.5 * braking)
        c, s = math.cos(heading), math.sin(heading)
        steepest = 0.0
        for px, py in self._points(scene[1]):
            dx, dy = px - x, py - y
            ahead, left = c * dx + s * dy, c * dy - s * dx
            dx, dy = ahead - coast_x, left - coast_y
            coasted = coast_c * dx + coast_s * dy, coast_c * dy - coast_s * dx
            for ahead, left in ((ahead, left), coasted):  # noqa: B020  # before it is braked
                dx, dy = ahead - brake_x, left - brake_y
                braked, aside = brake_c * dx + brake_s * dy, brake_c * dy - brake_s * dx
                if not (ahead > 0.0 and braked > 0.0):
                    return -math.inf
                dx, dy = ahead - eye_x, left - eye_y
                depth = cos * dx + sin * dy - shift
                slope = abs(cos * dy - sin * dx)
                dx, dy = braked - eye_x, aside - eye_y
                further = cos * dx + sin * dy - shift
                if not (depth > 0.0 and further > 0.0):
                    return -math.inf
                slope /= depth
                steepest = slope if slope > steepest else steepest
                slope = abs(cos * dy - sin * dx) / further
                steepest = slope if slope > steepest else steepest
        return self._half_angle - math.atan(steepest)

    def clearance_around(self, scene: Scene, sweep: Sweep) -> tuple[float, float]:
        r"""Clearance at the sweep's start, and a lower bound of it over all that is near.

        From a camera moved by at most :math:`d` a feature at the distance :math:`\rho` moves by
        at most :math:`\arcsin(d/\rho)` in bearing, beside what the camera turns. Up to half the
        distance that is no more than :math:`\tfrac{\pi}{3} d/\rho`.
        """
        eye_x, eye_y, cos, sin, reach = self._eye
        (x, y, heading), _, _, _, _, turn, travel, blur = sweep
        moved = travel + self._lever * turn + blur * reach
        c, s = math.cos(heading), math.sin(heading)
        widest = farthest = 0.0
        for px, py in self._points(scene[1]):
            dx, dy = px - x, py - y
            seen_x, seen_y = c * dx + s * dy - eye_x, c * dy - s * dx - eye_y
            bearing = abs(math.atan2(cos * seen_y - sin * seen_x, cos * seen_x + sin * seen_y))
            share = moved / (math.sqrt(seen_x * seen_x + seen_y * seen_y) or _NO_DISTANCE)
            # Motions that are not finite are no share up to a half either.
            reached = bearing + turn + _SIXTH * share if share <= 0.5 else math.inf
            widest = bearing if bearing > widest else widest
            farthest = reached if reached > farthest else farthest
        half_angle = self._half_angle
        return (
            half_angle - widest if widest < _RIGHT_ANGLE else -math.inf,
            half_angle - farthest if farthest < _RIGHT_ANGLE else -math.inf,
        )

    def _points(self, feature: Pose2) -> tuple[Point, ...]:
        """The points to be kept: the feature's centre, or its left and right end."""
        x, y = feature[0], feature[1]
        total = x + y
        if total - total != 0.0:
            raise GeometryError(f"feature must be finite, got {feature!r}")
        width = self._width
        if not width > 0.0:
            return ((x, y),)
        if len(feature) < 3 or not math.isfinite(feature[2]):
            raise GeometryError(
                f"a feature of width {width!r} m needs a finite heading, got {feature!r}"
            )
        dx, dy = -0.5 * width * math.sin(feature[2]), 0.5 * width * math.cos(feature[2])
        return (x + dx, y + dy), (x - dx, y - dy)


def _arc(length: float, half: float) -> tuple[float, float, float, float]:
    """An arc of a length, turning by twice ``half``: its end x, y, cosine and sine of the turn."""
    c, s = math.cos(half), math.sin(half)
    chord = length * (s / half) if half else length  # the quotient first: half may be denormal
    return chord * c, chord * s, c * c - s * s, 2.0 * c * s
