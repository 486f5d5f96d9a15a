"""The MuJoCo scene as MJCF: a differential-drive robot, and the board it docks to."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Chassis3D", "scene_xml"]


@dataclass(frozen=True, slots=True)
class Chassis3D:
    """Dimensions of the robot; the rotation centre is the middle of the driven axle.

    Attributes
    ----------
    wheel_radius, track : of the driven wheels, and between their contact points [m]
    length, width, height : of the chassis box [m]
    front : from the rotation centre forward to the front face [m]
    casters : from the rotation centre back to the two passive wheels [m]
    mass : of the chassis without its wheels [kg]
    """

    wheel_radius: float = 0.08
    track: float = 0.42
    length: float = 0.55
    width: float = 0.5
    height: float = 0.3
    front: float = 0.2
    casters: float = 0.25
    mass: float = 45.0


TORQUE = 32.75
"""[N m] each wheel servo can give [Xie2024]_."""
SERVO_GAIN = 20.0
"""[N m s/rad] of the wheels' speed control: far faster than the velocity lag, no chatter."""
WHEEL_FRICTION = 0.8
"""Rubber tyre on a dry, smooth floor."""
WHEEL_MASS = 1.5
"""[kg] a wheel with its hub."""
ROTOR_INERTIA = 0.1
"""[kg m²] of a servo's rotor seen through its gear: 1e-5 kg m² through 1:100."""
CONTACT_TIME = 0.01
"""[s] of MuJoCo's soft contacts: tyres sink in 0.1 mm, and five physics steps resolve it."""
TYRE_HALF_WIDTH = 0.02
"""[m] an ellipsoid touches the floor in one point, so that the track is what it says."""
CLEARANCE = 0.05
"""[m] between chassis and floor."""
BOARD_HEIGHT = 0.5
"""[m] tall enough to meet the chassis wherever they overlap from above."""
BOARD_THICKNESS = 0.02
"""[m] of the board, whose front face is at the feature."""
TROLLEY_LENGTH = 0.9
"""[m] of the luggage trolley behind the board."""


def scene_xml(robot: Chassis3D, standoff: float, board_width: float) -> str:
    """MJCF of the scene in the goal's frame: the board's front face is centred at (standoff, 0).

    The board and the trolley behind it stand fast, as a trolley with its brake on. The casters
    slide without friction; ``priority`` keeps the floor's friction from being taken for theirs.
    The integrator is explicit in the servos: the implicit ones damp the wheels after the contact
    is solved, and the body would outrun wheels with little rotor inertia.

    Parameters
    ----------
    robot : dimensions, with this run's wheel radius and track
    standoff, board_width : distance of the board ahead of the goal, and its width [m]
    """
    r, half_track = robot.wheel_radius, 0.5 * robot.track
    box_x = robot.front - 0.5 * robot.length
    box_z = CLEARANCE + 0.5 * robot.height - r
    caster_y = 0.35 * robot.width
    caster_r = 0.5 * r
    board_x = standoff + 0.5 * BOARD_THICKNESS
    trolley_x = standoff + BOARD_THICKNESS + 0.5 * TROLLEY_LENGTH
    board_z = CLEARANCE + 0.5 * BOARD_HEIGHT
    wheel = f"{r} {TYRE_HALF_WIDTH} {r}"
    return f"""
<mujoco model="docking">
  <option integrator="Euler" cone="elliptic" impratio="10">
    <flag autoreset="disable"/>
  </option>
  <default>
    <geom solref="{CONTACT_TIME} 1"/>
    <default class="wheel">
      <joint type="hinge" axis="0 1 0" armature="{ROTOR_INERTIA}"/>
      <geom type="ellipsoid" size="{wheel}" mass="{WHEEL_MASS}" friction="{WHEEL_FRICTION}"/>
      <velocity kv="{SERVO_GAIN}" forcerange="{-TORQUE} {TORQUE}"/>
    </default>
    <default class="caster">
      <geom type="sphere" size="{caster_r}" mass="0.5" condim="1" priority="1"/>
    </default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" friction="{WHEEL_FRICTION}"/>
    <body name="board" pos="{board_x} 0 {board_z}">
      <geom type="box" size="{0.5 * BOARD_THICKNESS} {0.5 * board_width} {0.5 * BOARD_HEIGHT}"/>
    </body>
    <body name="trolley" pos="{trolley_x} 0 0">
      <geom type="box" pos="0 0 0.15" size="{0.5 * TROLLEY_LENGTH} {0.45 * board_width} 0.03"/>
      <geom type="box" pos="0.4 0 0.55" size="0.03 {0.45 * board_width} 0.4"/>
    </body>
    <body name="robot" pos="0 0 {r}">
      <freejoint name="base"/>
      <geom type="box" pos="{box_x} 0 {box_z}" mass="{robot.mass}"
            size="{0.5 * robot.length} {0.5 * robot.width} {0.5 * robot.height}"/>
      <geom class="caster" pos="{-robot.casters} {caster_y} {caster_r - r}"/>
      <geom class="caster" pos="{-robot.casters} {-caster_y} {caster_r - r}"/>
      <body name="left" pos="0 {half_track} 0" childclass="wheel">
        <joint name="left"/>
        <geom/>
      </body>
      <body name="right" pos="0 {-half_track} 0" childclass="wheel">
        <joint name="right"/>
        <geom/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <velocity name="left" joint="left" class="wheel"/>
    <velocity name="right" joint="right" class="wheel"/>
  </actuator>
</mujoco>
"""
