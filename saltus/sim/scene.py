"""Go1 and terrain as one MuJoCo model, written from the numbers in `saltus.go1` and `saltus.sim.links`.

The robot is ideal: torque motors without limits, armature, no joint damping, no joint friction. Everything else that
a drive does is an effect.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from saltus import go1
from saltus.constants import PHYSICS_DT
from saltus.effects.body import NOMINAL_CONTACT_TIME_CONSTANT_S, NOMINAL_FRICTION, BodyModel
from saltus.robots.robot import JOINTS, LEGS
from saltus.sim import links
from saltus.sim.links import Inertia
from saltus.terrain.boxes import Boxes
from saltus.terrain.stack import TerrainStack
from saltus.terrain.terrain import Terrain

FRICTION = NOMINAL_FRICTION
# Contacts nearly as stiff as the time step allows (the engine wants at least two steps): measured, a foot sinks 0.1 mm
# when the robot stands, and 2.6 mm when it lands at 2 m/s.
CONTACT_SOLREF = (NOMINAL_CONTACT_TIME_CONSTANT_S, 1.0)
CONTACT_SOLIMP = (0.95, 0.99, 0.001, 0.5, 2.0)
# Ratio of frictional to normal constraint stiffness: at 1 a foot that stands creeps sideways by millimetres.
CONTACT_IMPRATIO = 10.0
# Dry friction of joints, where an effect adds it, as stiff as the time step allows (the engine wants at least two
# steps): measured, a joint that 1 Nm of friction holds against its link's weight creeps by less than 0.001 rad/s.
FRICTION_SOLREF = (0.004, 1.0)
FRICTION_SOLIMP = (0.99, 0.999, 0.001, 0.5, 2.0)
PAYLOAD_SIZE = np.array([0.20, 0.09, 0.04])  # a small computer, on top of the trunk
THIGH_RADIUS = 0.017  # half the depth of unitree_ros's collision box
CALF_RADIUS = 0.008

ROBOT_GROUP = 0
TERRAIN_GROUP = 1
VISUAL_GROUP = 2

FOOT_FORCE = slice(0, 12)
"""Where `sensordata` holds the force of each foot on the ground: four vectors in the world frame [N]."""
TRUNK_CONTACT = slice(12, 18)
"""Where `sensordata` holds the number of contacts of the trunk, of the payload and of each hip."""

TRUNK = "trunk"
PAYLOAD = "payload"
TERRAIN_GEOM = "terrain_{}"


def build_spec(
    terrain: Terrain,
    *,
    friction: float = FRICTION,
    payload_kg: float = 0.0,
    com_shift: Sequence[float] = (0.0, 0.0, 0.0),
    columns: int | None = None,
) -> mujoco.MjSpec:
    """Describes one Go1 on `terrain`.

    Args:
        terrain: Its boxes.
        friction: Coefficient of sliding friction between robot and terrain.
        payload_kg: Mass of a box on top of the trunk [kg].
        com_shift: Added to the trunk's centre of mass [m], base frame.
        columns: Number of terrain boxes where there may be more than `terrain` needs; the spare ones lie far below.

    Returns:
        A spec whose `qpos` is base position, base quaternion (w, x, y, z), joints in the order of `saltus.go1`, and
        whose `sensordata` is laid out as `FOOT_FORCE` and `TRUNK_CONTACT` say.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "go1"
    spec.compiler.degree = False
    _options(spec)
    add_boxes(spec, TerrainStack([terrain]).boxes(columns or len(terrain.boxes)).of_robot(0))
    base = _add_trunk(spec, np.asarray(com_shift, dtype=np.float64), payload_kg)
    for leg in range(4):
        _add_leg(base, leg)
    for geom in spec.geoms:
        if geom.group == ROBOT_GROUP:
            geom.friction[0] = friction
    for name in JOINTS:
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
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


def set_body(model: mujoco.MjModel, body: BodyModel) -> None:
    """Puts what effects say of one robot's body and ground into a compiled model of `build_spec`."""
    geoms = model.geom_group == ROBOT_GROUP
    model.geom_friction[geoms, 0] = float(body.friction)
    model.geom_solref[geoms, 0] = float(body.contact_time_constant)
    payload, trunk = model.body(PAYLOAD).id, model.body(TRUNK).id
    model.body_mass[payload] = float(body.payload_kg)
    model.body_inertia[payload] = payload_inertia(float(body.payload_kg))
    model.body_ipos[trunk] = links.trunk().com + np.asarray(body.com_shift)
    model.body_inertia[trunk] *= float(body.inertia_scale)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _options(spec: mujoco.MjSpec) -> None:
    spec.option.timestep = PHYSICS_DT
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = CONTACT_IMPRATIO
    # A simulation that has diverged must show it, not jump back to the start.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET


def _set_inertia(body: mujoco.MjsBody, inertia: Inertia) -> None:
    body.explicitinertial = True
    body.mass = inertia.mass
    body.ipos = inertia.com
    t = inertia.tensor
    body.fullinertia = [t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]]


def _add_trunk(spec: mujoco.MjSpec, com_shift: np.ndarray, payload_kg: float) -> mujoco.MjsBody:
    base = spec.worldbody.add_body(name=TRUNK, pos=(0.0, 0.0, go1.STAND_HEIGHT))
    base.add_freejoint(name="base")
    trunk = links.trunk()
    _set_inertia(base, Inertia(mass=trunk.mass, com=trunk.com + com_shift, tensor=trunk.tensor))
    _add_robot_geom(base, TRUNK, mujoco.mjtGeom.mjGEOM_BOX, size=0.5 * go1.TRUNK_SIZE)
    # A body of its own, so that a batch can give each robot another payload by scaling mass and inertia.
    payload = base.add_body(name=PAYLOAD, pos=(0.0, 0.0, 0.5 * (go1.TRUNK_SIZE[2] + PAYLOAD_SIZE[2])))
    payload.explicitinertial = True
    payload.mass = payload_kg
    payload.inertia = payload_inertia(payload_kg)
    return base


def _add_leg(base: mujoco.MjsBody, leg: int) -> None:
    name, side = LEGS[leg], float(go1.SIDE[leg])
    hip = base.add_body(name=f"{name}_hip", pos=go1.HIP_ANCHOR[leg])
    _add_hinge(hip, 3 * leg, axis=(1.0, 0.0, 0.0))
    _set_inertia(hip, links.hip(leg))
    middle = 0.5 * side * go1.ABDUCTION_LENGTH
    half = 0.5 * links.HIP_LENGTH
    _add_robot_geom(
        hip,
        f"{name}_hip",
        mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=(0.0, middle - half, 0.0, 0.0, middle + half, 0.0),
        size=(links.HIP_RADIUS, 0.0, 0.0),
    )
    thigh = hip.add_body(name=f"{name}_thigh", pos=(0.0, side * go1.ABDUCTION_LENGTH, 0.0))
    _add_hinge(thigh, 3 * leg + 1, axis=(0.0, 1.0, 0.0))
    _set_inertia(thigh, links.thigh(leg))
    _add_rod(thigh, f"{name}_thigh", THIGH_RADIUS, go1.THIGH_LENGTH)
    calf = thigh.add_body(name=f"{name}_calf", pos=(0.0, 0.0, -go1.THIGH_LENGTH))
    _add_hinge(calf, 3 * leg + 2, axis=(0.0, 1.0, 0.0))
    _set_inertia(calf, links.calf())
    _add_rod(calf, f"{name}_calf", CALF_RADIUS, go1.CALF_LENGTH - go1.FOOT_RADIUS)
    foot = (0.0, 0.0, -go1.CALF_LENGTH)
    _add_robot_geom(calf, f"{name}_foot", mujoco.mjtGeom.mjGEOM_SPHERE, pos=foot, size=(go1.FOOT_RADIUS, 0.0, 0.0))


def _add_hinge(body: mujoco.MjsBody, joint: int, axis: Sequence[float]) -> None:
    body.add_joint(
        name=JOINTS[joint],
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=axis,
        limited=True,
        range=(go1.JOINT_LOWER[joint], go1.JOINT_UPPER[joint]),
        armature=go1.ARMATURE[joint],
        solref_friction=FRICTION_SOLREF,
        solimp_friction=FRICTION_SOLIMP,
    )


def _add_rod(body: mujoco.MjsBody, name: str, radius: float, length: float) -> None:
    """A capsule that hangs from the body's origin."""
    ends = (0.0, 0.0, 0.0, 0.0, 0.0, -length)
    _add_robot_geom(body, name, mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=(radius, 0.0, 0.0))


def _add_robot_geom(body: mujoco.MjsBody, name: str, shape: mujoco.mjtGeom, **how: object) -> None:
    """Adds a shape that touches the terrain and nothing else; its contact parameters win over the terrain's."""
    body.add_geom(
        name=name,
        type=shape,
        contype=0,
        conaffinity=1,
        condim=3,
        priority=1,
        solref=CONTACT_SOLREF,
        solimp=CONTACT_SOLIMP,
        group=ROBOT_GROUP,
        **how,
    )


def _add_contact_sensors(spec: mujoco.MjSpec) -> None:
    net_force, found = 3, 1  # the engine's codes: sum of all contacts as one, in the world frame; and their number
    data = mujoco.mjtConDataField
    for leg in LEGS:
        sensor = spec.add_sensor(name=f"{leg}_force", type=mujoco.mjtSensor.mjSENS_CONTACT)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_GEOM, f"{leg}_foot"
        sensor.intprm[:3] = (1 << int(data.mjCONDATA_FORCE), net_force, 1)
    for body in (TRUNK, PAYLOAD, *(f"{leg}_hip" for leg in LEGS)):
        sensor = spec.add_sensor(name=f"{body}_contact", type=mujoco.mjtSensor.mjSENS_CONTACT)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_BODY, body
        sensor.intprm[:3] = (1 << int(data.mjCONDATA_FOUND), 0, found)
