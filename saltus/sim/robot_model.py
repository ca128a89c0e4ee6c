"""Robot and terrain as one MuJoCo model: the robot's own,
with the terrain, motors and sensors added.

The robot is ideal: torque motors without limits, armature, no joint damping, no joint friction.
Everything else that a drive does is an effect.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from saltus.constants import PHYSICS_DT
from saltus.effects.body import (
    LEAST_TURNING_M,
    NOMINAL_CONTACT_TIME_CONSTANT_S,
    NOMINAL_FRICTION,
    NOMINAL_IMPEDANCE_DEPTH_M,
    NOMINAL_TOUCH_IMPEDANCE,
)
from saltus.robots import plain_mjcf
from saltus.robots.robot import JOINTS, LEGS, Robot
from saltus.terrain.boxes import Boxes
from saltus.terrain.terrain import Terrain
from saltus.terrain.terrain_stack import TerrainStack

FRICTION = NOMINAL_FRICTION
# Contacts nearly as stiff as the time step allows (the engine wants at least two steps): measured,
# a foot sinks 0.1 mm when the robot stands, and 2.6 mm when it lands at 2 m/s.
CONTACT_SOLREF = (NOMINAL_CONTACT_TIME_CONSTANT_S, 1.0)
CONTACT_SOLIMP = (NOMINAL_TOUCH_IMPEDANCE, 0.99, NOMINAL_IMPEDANCE_DEPTH_M, 0.5, 2.0)
# Ratio of frictional to normal constraint stiffness: at 1 a foot that stands creeps sideways by
# millimetres.
CONTACT_IMPRATIO = 10.0
# Dry friction of joints, where an effect adds it, as stiff as the time step allows (the engine
# wants at least two steps): measured, a joint that 1 Nm of friction holds against its link's weight
# creeps by less than 0.001 rad/s.
FRICTION_SOLREF = (0.004, 1.0)
FRICTION_SOLIMP = (0.99, 0.999, 0.001, 0.5, 2.0)
PAYLOAD_SIZE = np.array([0.20, 0.09, 0.04])  # a small computer, on top of the trunk

ROBOT_GROUP = 0
TERRAIN_GROUP = 1
VISUAL_GROUP = 2

FOOT_FORCE = slice(0, 12)
"""Where `sensordata` holds the force of each foot on the ground: four vectors in the world frame
[N]."""
FOOT_FORCE_Z = slice(2, 12, 3)
"""The vertical part of each."""
TRUNK_CONTACT = slice(12, 18)
"""Where `sensordata` holds the number of contacts of the trunk, of the payload and of each hip."""

TRUNK, PAYLOAD = plain_mjcf.TRUNK, plain_mjcf.PAYLOAD
TERRAIN_GEOM = "terrain_{}"


def build_spec(
    robot: Robot,
    terrain: Terrain,
    *,
    friction: float = FRICTION,
    payload_kg: float = 0.0,
    com_shift: Sequence[float] = (0.0, 0.0, 0.0),
    columns: int | None = None,
    dimensions: int = 3,
) -> mujoco.MjSpec:
    """Describes one robot on `terrain`.

    Args:
        robot: Whose model it is.
        terrain: Its boxes.
        friction: Coefficient of sliding friction between robot and terrain.
        payload_kg: Mass of a box on top of the trunk [kg].
        com_shift: Added to the trunk's centre of mass [m], base frame.
        columns: Number of terrain boxes where there may be more than `terrain` needs; the spare
            ones lie far below.
        dimensions: Of its contacts: 3, or 6 with friction against turning and rolling.

    Returns:
        A spec whose `qpos` is base position, base quaternion (w, x, y, z), joints in the order of
        `JOINTS`, and whose `sensordata` is laid out as `FOOT_FORCE` and `TRUNK_CONTACT` say.
    """
    spec = mujoco.MjSpec.from_string(robot.mjcf)
    _options(spec)
    _make_solid(spec, friction, dimensions)
    add_boxes(spec, TerrainStack([terrain]).boxes(columns or len(terrain.boxes)).of_robot(0))
    trunk = spec.body(TRUNK)
    trunk.ipos = trunk.ipos + np.asarray(com_shift, dtype=np.float64)
    _load(spec, robot, payload_kg)
    _add_motors(spec)
    _add_contact_sensors(spec)
    return spec


def add_boxes(spec: mujoco.MjSpec, boxes: Boxes, name: str = TERRAIN_GEOM) -> None:
    """Adds boxes to the terrain, named by their place; arrays without leading dimensions."""
    rows = zip(boxes.center, boxes.half_size, boxes.quaternion, strict=True)
    for i, (center, half_size, quaternion) in enumerate(rows):
        spec.worldbody.add_geom(
            name=name.format(i),
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=center,
            size=half_size,
            quat=quaternion,
            contype=1,
            conaffinity=0,
            group=TERRAIN_GROUP,
        )


def payload_inertia(payload_kg: float) -> np.ndarray:
    """Principal moments of the payload's uniform box [kg m^2], shape (3,)."""
    square = PAYLOAD_SIZE**2
    return payload_kg / 12.0 * (square.sum() - square)


def _options(spec: mujoco.MjSpec) -> None:
    spec.option.timestep = PHYSICS_DT
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = CONTACT_IMPRATIO
    # A simulation that has diverged must show it, not jump back to the start.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET


def _make_solid(spec: mujoco.MjSpec, friction: float, dimensions: int) -> None:
    """Shapes of the robot touch the terrain and nothing else.

    Their contact parameters win over the terrain's.
    """
    for geom in spec.geoms:
        geom.contype, geom.conaffinity, geom.condim, geom.priority = 0, 1, dimensions, 1
        geom.friction = friction, LEAST_TURNING_M, LEAST_TURNING_M
        geom.solref, geom.solimp = CONTACT_SOLREF, CONTACT_SOLIMP
        geom.group = ROBOT_GROUP


def _add_motors(spec: mujoco.MjSpec) -> None:
    for name in JOINTS:
        joint = spec.joint(name)
        joint.solref_friction, joint.solimp_friction = FRICTION_SOLREF, FRICTION_SOLIMP
        spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_motor()


def _load(spec: mujoco.MjSpec, robot: Robot, payload_kg: float) -> None:
    """Puts the payload on top of the trunk: a body of its own,
    so that a batch can give each robot another one.
    """
    payload = spec.body(PAYLOAD)
    x, y, z = robot.trunk_center
    payload.pos = (x, y, z + 0.5 * (robot.trunk_size[2] + PAYLOAD_SIZE[2]))
    payload.explicitinertial = True
    payload.ipos = (
        0.0,
        0.0,
        0.0,
    )  # where a spec says none, the engine puts the mass at `pos` once more
    payload.mass = payload_kg
    payload.inertia = payload_inertia(payload_kg)


def _add_contact_sensors(spec: mujoco.MjSpec) -> None:
    # The engine's codes: sum of all contacts as one, in the world frame; and their number
    net_force, found = (
        3,
        1,
    )
    data = mujoco.mjtConDataField
    for leg in LEGS:
        sensor = spec.add_sensor(name=f"{leg}_force", type=mujoco.mjtSensor.mjSENS_CONTACT)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_GEOM, f"{leg}_foot"
        sensor.intprm[:3] = (1 << int(data.mjCONDATA_FORCE), net_force, 1)
    for body in (TRUNK, PAYLOAD, *(f"{leg}_hip" for leg in LEGS)):
        sensor = spec.add_sensor(name=f"{body}_contact", type=mujoco.mjtSensor.mjSENS_CONTACT)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_BODY, body
        sensor.intprm[:3] = (1 << int(data.mjCONDATA_FOUND), 0, found)
