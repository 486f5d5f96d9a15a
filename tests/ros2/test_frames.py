"""Rotations and frames, against matrices; what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clfcbf.errors import ConfigurationError
from clfcbf.ros2.detection import TILT, UNIT, DetectionFrame, Refusal
from clfcbf.ros2.messages import Point, Pose, Quaternion
from clfcbf.ros2.rotations import OPTICAL, from_rpy, inverse, product, rotated, yaw
from clfcbf.se2 import Pose2, wrap_angle
from tests.strategies import angles, poses

vectors = st.tuples(*[st.floats(-5.0, 5.0)] * 3)
rpys = st.tuples(angles, angles, angles)
level = st.floats(-0.4, 0.4)


def matrix(roll, pitch, yaw_):
    """Rz Ry Rx, as REP-103's fixed axes ask for."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw_))
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return rz @ ry @ rx


# Rows are the axes of the body frame seen in the optical one: x is its z, y is its -x, z is its -y.
OPTICAL_IN_BODY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@given(rpys, vectors)
def test_rotation_is_that_of_the_matrices(rpy, vector):
    np.testing.assert_allclose(rotated(from_rpy(*rpy), vector), matrix(*rpy) @ vector, atol=1e-13)


@given(rpys, rpys, vectors)
def test_product_is_that_of_the_matrices(outer, inner, vector):
    q = product(from_rpy(*outer), from_rpy(*inner))
    np.testing.assert_allclose(
        rotated(q, vector), matrix(*outer) @ matrix(*inner) @ vector, atol=1e-13
    )
    np.testing.assert_allclose(rotated(inverse(q), rotated(q, vector)), vector, atol=1e-13)


@given(angles)
def test_yaw_of_a_turn_about_z(angle):
    assert wrap_angle(yaw(from_rpy(0.0, 0.0, angle)) - angle) == pytest.approx(0.0, abs=1e-14)


@given(vectors)
def test_optical_frame_has_z_forward_x_right_y_down(vector):
    np.testing.assert_allclose(rotated(OPTICAL, vector), OPTICAL_IN_BODY @ vector, atol=1e-14)
    np.testing.assert_allclose(OPTICAL_IN_BODY, matrix(-math.pi / 2, 0.0, -math.pi / 2), atol=1e-15)


@given(poses, angles, angles, st.booleans(), rpys, poses)
def test_what_a_detector_tells_is_understood(mount, roll, pitch, optical, rotation, feature):
    frame = DetectionFrame("camera", mount, roll, pitch, optical, rotation)
    found = frame.decode(frame.encode(feature))
    assert isinstance(found, Pose2)
    assert math.dist(found[:2], feature[:2]) < 1e-12
    assert wrap_angle(found.theta - feature.theta) == pytest.approx(0.0, abs=1e-12)


@given(poses, level, level, st.booleans(), rpys, vectors, rpys)
def test_decoding_is_that_of_homogeneous_matrices(
    mount, roll, pitch, optical, rotation, position, attitude
):
    frame = DetectionFrame("camera", mount, roll, pitch, optical, rotation)
    told = Pose(Point(*position), Quaternion(*from_rpy(*attitude)))
    mounting = matrix(roll, pitch, mount.theta) @ (OPTICAL_IN_BODY if optical else np.eye(3))
    at = np.array([mount.x, mount.y, 0.0]) + mounting @ position
    ahead = (mounting @ matrix(*attitude) @ matrix(*rotation))[:, 0]
    found = frame.decode(told)
    flat = math.hypot(ahead[0], ahead[1])
    if flat < math.cos(TILT) - 1e-9:
        assert found is Refusal.TILTED
    elif flat > math.cos(TILT) + 1e-9:
        np.testing.assert_allclose(found[:2], at[:2], atol=1e-12)
        heading = math.atan2(ahead[1], ahead[0])
        assert wrap_angle(found.theta - heading) == pytest.approx(0.0, abs=1e-12)


def test_a_marker_straight_ahead_of_a_camera_by_hand():
    """A tag 2 m in front of an optical frame, its own axes those of the image."""
    camera = DetectionFrame(
        "camera_optical_frame", Pose2(0.2, 0.0, 0.0), optical=True,
        rotation=(0.0, -math.pi / 2, math.pi / 2),
    )  # fmt: skip
    found = camera.decode(Pose(Point(0.3, 0.1, 2.0), Quaternion()))
    assert found[:2] == pytest.approx((2.2, -0.3))
    assert found.theta == pytest.approx(0.0, abs=1e-15)


def test_an_optical_pose_declared_as_a_body_pose_is_refused():
    """The mistake that is made most: the robot must not steer by it."""
    optical = DetectionFrame("camera", optical=True)
    told = optical.encode(Pose2(1.5, 0.2, 0.1))
    assert DetectionFrame("camera").decode(told) is Refusal.TILTED


FINE = Pose(Point(1.0, 2.0, 3.0), Quaternion(0.0, 0.0, 0.0, 1.0))


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("part", "axis"), [*(("position", a) for a in "xyz"), *(("orientation", a) for a in "xyzw")]
)
def test_a_number_that_is_none_is_refused(wrong, part, axis):
    told = replace(FINE, **{part: replace(getattr(FINE, part), **{axis: wrong})})
    assert DetectionFrame().decode(told) is Refusal.NOT_FINITE


@given(st.floats(0.0, 2.0), rpys)
def test_a_quaternion_has_a_norm_of_one(norm, rpy):
    told = Pose(Point(), Quaternion(*(norm * c for c in from_rpy(0.0, 0.0, rpy[2]))))
    found = DetectionFrame().decode(told)
    if abs(norm - 1.0) > 1.001 * UNIT:
        assert found is Refusal.QUATERNION
    elif abs(norm - 1.0) < 0.999 * UNIT:
        assert wrap_angle(found.theta - rpy[2]) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    "wrong",
    [
        {"name": ""}, {"mount": Pose2(math.nan, 0.0, 0.0)}, {"roll": math.inf},
        {"pitch": math.nan}, {"rotation": (0.0, math.nan, 0.0)},
    ],
)  # fmt: skip
def test_a_frame_is_checked(wrong):
    with pytest.raises(ConfigurationError):
        DetectionFrame(**wrong)
