"""Looks of the robot, the terrain and the light in a video. No effect on physics.

Shapes and colours are free inventions in the proportions of a small dog; nothing here comes from a
measurement.
"""

from functools import partial

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from saltus.robots.robot import LEGS, Robot
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.sim import robot_model
from saltus.sim.robot_model import VISUAL_GROUP
from saltus.terrain.columns import Columns
from saltus.terrain.terrain import Terrain

Rgba = tuple[float, float, float, float]

SHELL: Rgba = (0.90, 0.91, 0.93, 1.0)
DARK: Rgba = (0.13, 0.14, 0.17, 1.0)
JOINT: Rgba = (0.30, 0.32, 0.36, 1.0)
ACCENT: Rgba = (0.95, 0.45, 0.12, 1.0)
CASE: Rgba = (0.75, 0.77, 0.8, 1.0)
LENS: Rgba = (0.05, 0.25, 0.45, 1.0)
NOSING: Rgba = (0.98, 0.93, 0.80, 1.0)
RISER: Rgba = (0.36, 0.42, 0.50, 1.0)
HAZE: Rgba = (0.86, 0.91, 0.96, 1.0)

SPHERE = mujoco.mjtGeom.mjGEOM_SPHERE
CAPSULE = mujoco.mjtGeom.mjGEOM_CAPSULE
CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER
ELLIPSOID = mujoco.mjtGeom.mjGEOM_ELLIPSOID
BOX = mujoco.mjtGeom.mjGEOM_BOX
ACROSS = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)  # turns a cylinder's axis from z to y
ALONG = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)  # turns it from z to x

CHECKER_M = 0.25  # side of a square of the ground's pattern [m]
STRIP_M = 0.012  # half-width of the bright strip along an edge [m]


def add_looks(spec: mujoco.MjSpec, robot: Robot, terrain: Terrain) -> None:
    """Adds looks to what `robot_model.build_spec` made of both.

    Draw the groups of terrain and visual shapes only.
    """
    _add_sky_and_light(spec)
    _add_ground(spec, terrain)
    _add_trunk(spec.body(robot_model.TRUNK), robot)
    _add_camera(spec.body(robot_model.TRUNK), robot)
    for leg in range(len(LEGS)):
        _add_leg(spec, robot, leg)


def _add_sky_and_light(spec: mujoco.MjSpec) -> None:
    gradient = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky = spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=gradient,
        width=256,
        height=1536,
    )
    sky.rgb1, sky.rgb2 = (0.45, 0.65, 0.88), HAZE[:3]
    spec.visual.headlight.ambient = (0.38, 0.38, 0.40)
    spec.visual.headlight.diffuse = (0.22, 0.22, 0.22)
    spec.visual.headlight.specular = (0.0, 0.0, 0.0)
    spec.visual.rgba.haze = HAZE
    spec.body(robot_model.TRUNK).add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
        pos=(0.0, 0.0, 3.0),
        dir=(0.45, 0.35, -1.0),
        diffuse=(0.62, 0.60, 0.56),
        specular=(0.15, 0.15, 0.15),
        castshadow=False,
    )


def _add_ground(spec: mujoco.MjSpec, terrain: Terrain) -> None:
    texture = spec.add_texture(
        name="checker",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        width=256,
        height=256,
    )
    texture.rgb1, texture.rgb2 = (0.66, 0.70, 0.74), (0.56, 0.61, 0.67)
    material = spec.add_material(
        name="ground", texrepeat=(0.5 / CHECKER_M, 0.5 / CHECKER_M), texuniform=True
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "checker"
    for geom in spec.geoms:
        if geom.group == robot_model.TERRAIN_GROUP:
            geom.material = "ground"
    lowest = float((terrain.arrays.center - terrain.arrays.extent)[:, 2].min())
    _add(
        spec.worldbody,
        1.0,
        mujoco.mjtGeom.mjGEOM_PLANE,
        HAZE,
        pos=(0.0, 0.0, lowest),
        size=(0.0, 0.0, 1.0),
    )
    if terrain.columns is not None:
        _add_walls(spec.worldbody, terrain.columns)


def _add_walls(world: mujoco.MjsBody, columns: Columns) -> None:
    half = 0.5 * columns.width
    for x, low, high in _walls(columns):
        side = 1.0 if columns.height_at(np.asarray(x + 1e-6)) == high else -1.0
        middle, tall = 0.5 * (low + high), 0.5 * (high - low)
        _add(world, 1.0, BOX, RISER, pos=(x, 0.0, middle), size=(0.002, half, tall - 0.002))
        _add(
            world,
            1.0,
            BOX,
            NOSING,
            pos=(x + side * STRIP_M, 0.0, high - 0.001),
            size=(STRIP_M, half, 0.002),
        )


def _walls(columns: Columns) -> list[tuple[float, float, float]]:
    """Where the height changes by more than what can be drawn: x, lower and upper end [m]."""
    tops = columns.top
    walls = zip(
        columns.x[1:-1],
        np.minimum(tops[1:], tops[:-1]),
        np.maximum(tops[1:], tops[:-1]),
        strict=True,
    )
    return [(float(x), float(low), float(high)) for x, low, high in walls if high - low > 0.005]


def _add_trunk(trunk: mujoco.MjsBody, robot: Robot) -> None:
    add = partial(_add, trunk, _scale(robot))
    front = 0.5 * robot.trunk_size[0] / _scale(robot)
    add(BOX, DARK, pos=(0.0, 0.0, -0.012), size=(front - 0.02, 0.052, 0.036))
    for y in (-0.026, 0.026):
        add(CAPSULE, SHELL, pos=(-0.01, y, 0.022), size=(0.036, front - 0.045, 0.0), quat=ALONG)
    add(BOX, SHELL, pos=(-0.01, 0.0, 0.036), size=(front - 0.045, 0.03, 0.022))
    add(BOX, ACCENT, pos=(-0.01, 0.0, 0.0585), size=(0.09, 0.012, 0.001))
    for side in (-1.0, 1.0):
        add(BOX, ACCENT, pos=(0.0, side * 0.0525, -0.008), size=(0.07, 0.001, 0.006))
    add(ELLIPSOID, SHELL, pos=(front + 0.03, 0.0, 0.02), size=(0.062, 0.058, 0.044))
    add(ELLIPSOID, DARK, pos=(front + 0.052, 0.0, 0.016), size=(0.048, 0.046, 0.032))
    add(ELLIPSOID, DARK, pos=(-front - 0.005, 0.0, 0.012), size=(0.03, 0.052, 0.036))


def _add_camera(trunk: mujoco.MjsBody, robot: Robot) -> None:
    angles = (
        np.array(angle) for angle in (robot.camera_roll, robot.camera_pitch, robot.camera_yaw)
    )
    tilt = quaternion_from_roll_pitch_yaw(*angles)
    camera, add = robot.camera_position, partial(_add, trunk, 1.0)
    add(
        BOX,
        JOINT,
        pos=(camera[0] - 0.02, 0.0, camera[2] - 0.03),
        size=(0.006, 0.012, 0.03),
        quat=tilt,
    )
    add(
        BOX,
        CASE,
        pos=camera - np.array([0.012, 0.0075, 0.0]),
        size=(0.011, 0.045, 0.0125),
        quat=tilt,
    )
    for y in (-0.03, 0.0, 0.03):
        add(SPHERE, LENS, pos=camera + np.array([-0.003, y - 0.0075, 0.0]), size=(0.0075, 0.0, 0.0))


def _add_leg(spec: mujoco.MjSpec, robot: Robot, leg: int) -> None:
    name, side, fore = LEGS[leg], float(robot.side[leg]), float(np.sign(robot.hip_anchor[leg, 0]))
    hip, thigh, calf = (spec.body(f"{name}_{part}") for part in ("hip", "thigh", "calf"))
    scale = _scale(robot)
    offset, knee, foot = (
        np.asarray(where.pos) / scale for where in (thigh, calf, spec.geom(f"{name}_foot"))
    )
    _add(
        hip,
        scale,
        CYLINDER,
        JOINT,
        pos=(-0.01 * fore, 0.0, 0.0),
        size=(0.04, 0.035, 0.0),
        quat=ALONG,
    )
    _add(hip, scale, CYLINDER, SHELL, pos=0.5 * offset, size=(0.043, 0.028, 0.0), quat=ACROSS)
    _add(
        thigh,
        scale,
        CYLINDER,
        DARK,
        pos=(0.0, 0.004 * side, 0.0),
        size=(0.044, 0.019, 0.0),
        quat=ACROSS,
    )
    _add(
        thigh,
        scale,
        CYLINDER,
        ACCENT,
        pos=(0.0, 0.024 * side, 0.0),
        size=(0.018, 0.002, 0.0),
        quat=ACROSS,
    )
    x, y, z = 0.75 * knee
    _add(
        thigh,
        scale,
        CAPSULE,
        SHELL,
        fromto=(0.008, 0.0, -0.02, x + 0.004, y, z),
        size=(0.022, 0.0, 0.0),
    )
    _add(thigh, scale, CAPSULE, SHELL, fromto=(-0.006, 0.0, -0.02, *knee), size=(0.017, 0.0, 0.0))
    _add(calf, scale, CYLINDER, JOINT, size=(0.02, 0.017, 0.0), quat=ACROSS)
    _add(
        calf, scale, CAPSULE, DARK, fromto=(0.0, 0.0, 0.0, *(0.55 * foot)), size=(0.0125, 0.0, 0.0)
    )
    _add(calf, scale, CAPSULE, DARK, fromto=(0.0, 0.0, 0.0, *foot), size=(0.0095, 0.0, 0.0))
    _add(calf, scale, SPHERE, JOINT, pos=foot, size=(robot.foot_radius / scale, 0.0, 0.0))


def _scale(robot: Robot) -> float:
    """The shapes are made for legs of this length."""
    return robot.leg_length / 0.426


def _add(
    body: mujoco.MjsBody, scale: float, shape: mujoco.mjtGeom, rgba: Rgba, **how: ArrayLike
) -> None:
    """Adds a shape that is only seen; lengths are in units of `scale`."""
    lengths = {
        key: np.asarray(how.pop(key)) * scale for key in ("pos", "size", "fromto") if key in how
    }
    body.add_geom(
        type=shape, rgba=rgba, group=VISUAL_GROUP, contype=0, conaffinity=0, **lengths, **how
    )
