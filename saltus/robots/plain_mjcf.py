"""Writes the model of a robot in the one form from which the simulator is built.

A trunk of one box and a place for a load on it; then hip, thigh and calf of each leg, named and in
the order of `saltus.robots.robot`, their frames in the axes of the base where all joints are at
zero, all angles counted our way. Each link has one capsule, the calf a foot besides. Numbers are
written in full, so that compiling changes none.
"""

from collections.abc import Iterable
from xml.etree import ElementTree

import mujoco
import numpy as np

from saltus.arrays import Floats
from saltus.robots.robot import JOINTS, LEGS, LINKS
from saltus.robots.structure import AXES, LegStructure, RobotStructure

# Proportions of the rods that stand for links of which the model says more, or nothing: radius of
# the hip and half of its length by the abduction offset, radius of thigh and calf by their lengths.
HIP_RADIUS, HIP_HALF_LENGTH, THIGH_RADIUS, CALF_RADIUS = 0.575, 0.25, 0.08, 0.0375
TRUNK, PAYLOAD = "trunk", "payload"

GeomAttributes = dict[str, str]
"""Attributes of a geom."""


def trunk_box(structure: RobotStructure) -> tuple[Floats, Floats]:
    """Centre and full edge lengths [m], base frame,
    of the box around all that is solid of the trunk, shapes (3,).
    """
    model, geoms = structure.model, _geoms(structure.model, structure.base)
    solid = [
        geom for geom in geoms if model.geom_contype[geom] | model.geom_conaffinity[geom]
    ] or geoms
    corners = (
        np.concatenate([_corners(model, geom) for geom in solid]) if solid else np.zeros((1, 3))
    )
    low, high = corners.min(axis=0), corners.max(axis=0)
    return 0.5 * (low + high), high - low


def write_mjcf(
    name: str,
    structure: RobotStructure,
    *,
    stand_height: float,
    trunk_center: Floats,
    trunk_size: Floats,
    joint_lower: Floats,
    joint_upper: Floats,
    armature: Floats,
) -> str:
    """The text of the model; arrays as in `saltus.robots.robot.Robot`."""
    root = ElementTree.Element("mujoco", model=name)
    ElementTree.SubElement(root, "compiler", angle="radian")
    world = ElementTree.SubElement(root, "worldbody")
    trunk = _add(world, "body", name=TRUNK, pos=_text([0.0, 0.0, stand_height]))
    _add(trunk, "freejoint", name="base")
    _add_inertia(trunk, structure, structure.base, np.eye(3), np.zeros(3))
    _add(
        trunk, "geom", name=TRUNK, type="box", size=_text(0.5 * trunk_size), pos=_text(trunk_center)
    )
    top = np.array([trunk_center[0], trunk_center[1], trunk_center[2] + 0.5 * trunk_size[2]])
    _add(trunk, "body", name=PAYLOAD, pos=_text(top))
    for i, leg in enumerate(structure.legs):
        parent = trunk
        for k in range(len(LINKS)):
            joint = len(LINKS) * i + k
            limits = {"range": _text([joint_lower[joint], joint_upper[joint]])}
            has_limits = np.isfinite(joint_lower[joint]) and np.isfinite(joint_upper[joint])
            parent = _add(parent, "body", name=JOINTS[joint], pos=_text(leg.offset[k]))
            _add(
                parent, "joint", name=JOINTS[joint], axis=_text(np.eye(3)[AXES[k][0]]),
                armature=_text([armature[joint]]), **(limits if has_limits else {}),
            )  # fmt: skip
            start = structure.model.jnt_pos[leg.joint[k]]
            _add_inertia(parent, structure, leg.body[k], leg.rotation[k], start)
            _add(
                parent, "geom", name=JOINTS[joint], type="capsule", **_rod(structure.model, leg, k)
            )
        radius = _text([leg.foot_radius])
        _add(
            parent,
            "geom",
            name=f"{LEGS[i]}_foot",
            type="sphere",
            size=radius,
            pos=_text(leg.offset[3]),
        )
    ElementTree.indent(root)
    # Within TOML these need no escape
    text = ElementTree.tostring(root, encoding="unicode").replace('"', "'")
    return text + "\n"


def kept_rod(model: mujoco.MjModel, leg: LegStructure, link: int) -> int | None:
    """The one capsule that is all that is solid of a link,
    besides the foot; None where it is not so.
    """
    solid = [
        geom
        for geom in _geoms(model, leg.body[link])
        if geom != leg.foot and model.geom_contype[geom] | model.geom_conaffinity[geom]
    ]
    is_capsule = len(solid) == 1 and model.geom_type[solid[0]] == mujoco.mjtGeom.mjGEOM_CAPSULE
    return solid[0] if is_capsule else None


def _rod(model: mujoco.MjModel, leg: LegStructure, link: int) -> GeomAttributes:
    kept = kept_rod(model, leg, link)
    if kept is not None:
        position = leg.rotation[link] @ (model.geom_pos[kept] - model.jnt_pos[leg.joint[link]])
        quaternion = _in_base(leg.rotation[link], model.geom_quat[kept])
        return {
            "size": _text(model.geom_size[kept][:2]),
            "pos": _text(position),
            "quat": _text(quaternion),
        }
    end = leg.offset[link + 1]
    if link == 0:
        middle, half = 0.5 * end * (0.0, 1.0, 1.0), np.array([0.0, HIP_HALF_LENGTH * end[1], 0.0])
        return {
            "size": _text([HIP_RADIUS * abs(end[1])]),
            "fromto": _text([*(middle - half), *(middle + half)]),
        }
    length = float(np.linalg.norm(end))
    radius = (THIGH_RADIUS if link == 1 else CALF_RADIUS) * length
    tip = end if link == 1 else end * (1.0 - leg.foot_radius / length)
    return {"size": _text([radius]), "fromto": _text([0.0, 0.0, 0.0, *tip])}


def _add_inertia(
    element: ElementTree.Element,
    structure: RobotStructure,
    body: int,
    rotation: Floats,
    start: Floats,
) -> None:
    model = structure.model
    _add(
        element,
        "inertial",
        mass=_text([model.body_mass[body]]),
        pos=_text(rotation @ (model.body_ipos[body] - start)),
        quat=_text(_in_base(rotation, model.body_iquat[body])),
        diaginertia=_text(model.body_inertia[body]),
    )


def _in_base(rotation: Floats, quaternion: Floats) -> Floats:
    """A quaternion of a frame in a body as one of a frame in the base."""
    own, turned = np.zeros(4), np.zeros(4)
    mujoco.mju_mat2Quat(own, np.ascontiguousarray(rotation).ravel())
    mujoco.mju_mulQuat(turned, own, np.asarray(quaternion))
    return turned


def _geoms(model: mujoco.MjModel, body: int) -> list[int]:
    return list(
        range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
    )


def _corners(model: mujoco.MjModel, geom: int) -> Floats:
    """Corners of the box around a geom, in the frame of its body [m], shape (8, 3)."""
    center, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    signs = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]), axis=-1).reshape(8, 3)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    return np.asarray((center + signs * half) @ rotation.reshape(3, 3).T + model.geom_pos[geom])


def _add(parent: ElementTree.Element, kind: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, kind, attributes)


def _text(values: Iterable[float]) -> str:
    """Numbers in full, without the sign of zero and without .0."""
    return " ".join(repr(float(value) + 0.0).removesuffix(".0") for value in values)
