r"""Rotations in space as far as planar docking needs them: unit quaternions (x, y, z, w).

Conventions are those of REP-103: angles counter-clockwise, roll, pitch and yaw about the *fixed*
axes x, y and z, so that :math:`R = R_z(\psi) R_y(\theta) R_x(\phi)`; a camera's optical frame has
z forward, x to the right and y down.
"""

from __future__ import annotations

import math

__all__ = ["OPTICAL", "Rotation", "Vector", "from_rpy", "inverse", "product", "rotated", "yaw"]

Rotation = tuple[float, float, float, float]
"""A unit quaternion (x, y, z, w), as ROS orders it."""

Vector = tuple[float, float, float]

OPTICAL: Rotation = (-0.5, 0.5, -0.5, 0.5)
"""Of an optical frame in its body frame (x forward, y left, z up): roll and yaw of -90°."""


def product(p: Rotation, q: Rotation) -> Rotation:
    """The rotation ``q`` followed by ``p``: of a frame in a frame, that of the inner in the outer.

    Hamilton's product; the norm is the product of the norms.
    """
    px, py, pz, pw = p
    qx, qy, qz, qw = q
    return (
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
        pw * qw - px * qx - py * qy - pz * qz,
    )


def inverse(q: Rotation) -> Rotation:
    """The rotation back, the conjugate."""
    x, y, z, w = q
    return -x, -y, -z, w


def rotated(q: Rotation, vector: Vector) -> Vector:
    r"""A vector given in the rotated frame, in the frame that it is rotated in.

    :math:`v' = v + 2w\,(u\times v) + 2\,u\times(u\times v)` with :math:`u = (x, y, z)`.
    """
    x, y, z, w = q
    a, b, c = vector
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return (
        a + w * tx + y * tz - z * ty,
        b + w * ty + z * tx - x * tz,
        c + w * tz + x * ty - y * tx,
    )


def from_rpy(roll: float, pitch: float, yaw: float) -> Rotation:
    r"""Of roll, pitch and yaw [rad] about the fixed axes, :math:`R_z R_y R_x`."""
    q: Rotation = (math.sin(0.5 * roll), 0.0, 0.0, math.cos(0.5 * roll))
    q = product((0.0, math.sin(0.5 * pitch), 0.0, math.cos(0.5 * pitch)), q)
    return product((0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)), q)


def yaw(q: Rotation) -> float:
    """Direction of the rotated x axis in the plane [rad]; undefined where that is vertical."""
    x, y, _ = rotated(q, (1.0, 0.0, 0.0))
    return math.atan2(y, x)
