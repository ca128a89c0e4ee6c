"""The legs of an MJCF, found by how bodies and joints hang together, whatever their names are.

A leg of our kind is a chain of three hinges below a base that floats: abduction about x, then thigh
and calf about y, seen where all joints are at zero, with a sphere at its end. There are four, one
in each quarter of the base, all with the same links.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from saltus.arrays import Floats
from saltus.errors import ModelError
from saltus.robots.robot import LEGS

AXES = ((0, "x"), (1, "y"), (1, "y"))  # of the base, about which hip, thigh and calf turn
QUARTERS = {(1, -1): "FR", (1, 1): "FL", (-1, -1): "RR", (-1, 1): "RL"}  # signs of x and y
TOLERANCE = 1e-6  # of axes [-] and lengths [m]: numbers of an MJCF have about six digits


@dataclass(frozen=True, kw_only=True, eq=False)
class LegStructure:
    """Bodies, joints and foot of one leg in a compiled model.

    Vectors and rotations are those in the base frame where all joints are at zero.
    """

    body: tuple[int, ...]
    """Body of hip, thigh and calf, as joints and signs."""
    joint: tuple[int, ...]
    sign: tuple[float, ...]
    """+1, or -1 where the model counts an angle the other way."""
    offset: Floats
    """Abduction axis from the base, thigh axis from there, knee from there, foot from there [m],
    shape (4, 3)."""
    rotation: Floats
    """Rotation of each body to the base, shape (3, 3, 3)."""
    foot: int
    """Geom of the sphere at its end."""
    foot_radius: float
    """[m]."""

    @property
    def lengths(self) -> dict[str, float]:
        """Lengths and angles that all legs must have in common [m], [rad]."""
        thigh, calf = self.offset[2], self.offset[3]
        return {
            "length of the thigh": float(np.hypot(thigh[0], thigh[2])),
            "length of the calf": float(np.hypot(calf[0], calf[2])),
            "angle of the thigh at zero": _from_straight_down(thigh),
            "angle of the calf at zero": _from_straight_down(calf),
            "radius of the foot": self.foot_radius,
        }

    @property
    def sideways(self) -> float:
        """Distance of the foot from the abduction axis, to the left [m]."""
        return float(self.offset[1, 1] + self.offset[2, 1] + self.offset[3, 1])


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotStructure:
    """A compiled model, its base and its four legs in the order of `LEGS`."""

    model: mujoco.MjModel
    base: int
    legs: tuple[LegStructure, ...]


def read_structure(path: str) -> RobotStructure:
    """Reads an MJCF file and finds its legs; `ModelError` says why that fails."""
    try:
        spec = mujoco.MjSpec.from_file(path)
        spec.compiler.fusestatic = True  # bodies that are fixed to others become part of them
        model = spec.compile()
    except (ValueError, OSError, mujoco.FatalError) as error:
        raise ModelError(f"cannot read the model {path}: {str(error).splitlines()[0]}") from error
    try:
        base = _base(model)
        return RobotStructure(model=model, base=base, legs=_legs(model, base))
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error


def _base(model: mujoco.MjModel) -> int:
    floating = [
        int(model.jnt_bodyid[j])
        for j in range(model.njnt)
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE
    ]
    if not floating:
        raise ModelError(
            "no body with a free joint: the trunk of the robot must float, add <freejoint/> to it"
        )
    if len(floating) > 1:
        names = ", ".join(_name(model, body) for body in floating)
        raise ModelError(
            f"{names} have a free joint each: give a model of the robot alone, whose trunk has the "
            "only one"
        )
    return floating[0]


def _legs(model: mujoco.MjModel, base: int) -> tuple[LegStructure, ...]:
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    data.qpos[model.jnt_qposadr[model.body_jntadr[base]] + 3] = 1.0
    mujoco.mj_kinematics(model, data)
    limbs = [_chain(model, body) for body in _children(model, base)]
    if len(limbs) != len(LEGS):
        raise ModelError(f"the base {_name(model, base)} has {len(limbs)} limbs, not four legs")
    found: dict[str, LegStructure] = {}
    for limb in limbs:
        leg = _leg(model, data, limb)
        hip = leg.offset[0] + leg.offset[1] * (1.0, 0.0, 0.0)
        quarter = QUARTERS.get((int(np.sign(hip[0])), int(np.sign(hip[1]))), "")
        if quarter in ("", *found) or np.sign(leg.sideways) != np.sign(hip[1]):
            where = ", ".join(f"{value:.3g}" for value in hip)
            raise ModelError(
                f"leg {_name(model, limb[0])} at ({where}) m: no leg, or a second one, in this "
                "quarter"
            )
        found[quarter] = leg
    legs = tuple(found[name] for name in LEGS)
    _check_alike(model, legs)
    return legs


def _chain(model: mujoco.MjModel, first: int) -> tuple[int, ...]:
    """The three bodies of a leg."""
    chain = [first]
    while children := _children(model, chain[-1]):
        if len(children) > 1:
            raise ModelError(
                f"limb {_name(model, first)} branches at {_name(model, chain[-1])}: no leg of our "
                "kind"
            )
        chain.append(children[0])
    joints = [
        int(model.body_jntadr[body] + k) for body in chain for k in range(model.body_jntnum[body])
    ]
    hinges = sum(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE for joint in joints)
    if not len(chain) == len(joints) == hinges == len(AXES):
        kinds = f"{len(joints)} joints, of which {hinges} are hinges, on {len(chain)} bodies"
        raise ModelError(
            f"limb {_name(model, first)} has {kinds}: a leg has three hinges, one on each body"
        )
    return tuple(chain)


def _leg(model: mujoco.MjModel, data: mujoco.MjData, chain: tuple[int, ...]) -> LegStructure:
    joints = tuple(int(model.body_jntadr[body]) for body in chain)
    signs = tuple(
        _sign(model, data, joint, *axis) for joint, axis in zip(joints, AXES, strict=True)
    )
    rotation = np.array([data.xmat[body].reshape(3, 3) for body in chain])
    offset, frame, start = [], np.eye(3), np.zeros(3)
    for body, joint, own in zip(chain, joints, rotation, strict=True):
        offset.append(
            frame
            @ (model.body_pos[body] + _turned(model.body_quat[body], model.jnt_pos[joint]) - start)
        )
        frame, start = own, model.jnt_pos[joint]
    foot = _foot(model, chain)
    offset.append(frame @ (model.geom_pos[foot] - start))
    if abs(offset[1][2]) > TOLERANCE:
        name = model.joint(joints[1]).name
        raise ModelError(
            f"the axis of '{name}' is {offset[1][2]:.3g} m above that of the abduction: it must be "
            "level"
        )
    return LegStructure(
        body=chain, joint=joints, sign=signs, offset=np.array(offset) + 0.0, rotation=rotation,
        foot=foot,
        foot_radius=float(model.geom_size[foot, 0]),
    )  # fmt: skip


def _sign(model: mujoco.MjModel, data: mujoco.MjData, joint: int, axis: int, name: str) -> float:
    along = data.xaxis[joint]
    if abs(abs(along[axis]) - 1.0) > TOLERANCE:
        shown = ", ".join(f"{value:.3g}" for value in along)
        raise ModelError(
            f"joint '{model.joint(joint).name}' turns about ({shown}), not about {name} of the base"
        )
    return float(np.sign(along[axis]))


def _foot(model: mujoco.MjModel, chain: tuple[int, ...]) -> int:
    """The sphere of the calf that is farthest from the knee.

    One that can touch the ground, where there is one.
    """
    calf = chain[-1]
    geoms = range(model.body_geomadr[calf], model.body_geomadr[calf] + model.body_geomnum[calf])
    spheres = [geom for geom in geoms if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE]
    if not spheres:
        raise ModelError(
            f"leg {_name(model, chain[0])} ends in no sphere: give its calf a sphere where the "
            "foot is"
        )
    knee = model.jnt_pos[model.body_jntadr[calf]]
    solid = [geom for geom in spheres if model.geom_contype[geom] | model.geom_conaffinity[geom]]
    return max(
        solid or spheres, key=lambda geom: float(np.linalg.norm(model.geom_pos[geom] - knee))
    )


def _check_alike(model: mujoco.MjModel, legs: tuple[LegStructure, ...]) -> None:
    first, *others = legs
    for leg in others:
        for what, length in leg.lengths.items():
            if abs(length - first.lengths[what]) > TOLERANCE:
                a, b = _name(model, first.body[0]), _name(model, leg.body[0])
                raise ModelError(
                    f"legs {a} and {b} differ: the {what} is {first.lengths[what]:g} and {length:g}"
                )


def _from_straight_down(vector: Floats) -> float:
    """Angle about y [rad]; positive swings backwards."""
    return float(np.arctan2(-vector[0], -vector[2])) + 0.0


def _turned(quaternion: Floats, vector: Floats) -> Floats:
    turned = np.zeros(3)
    mujoco.mju_rotVecQuat(turned, np.asarray(vector), np.asarray(quaternion))
    return turned


def _children(model: mujoco.MjModel, body: int) -> list[int]:
    return [int(child) for child in np.flatnonzero(model.body_parentid == body) if child != body]


def _name(model: mujoco.MjModel, body: int) -> str:
    return f"'{model.body(body).name or body}'"
