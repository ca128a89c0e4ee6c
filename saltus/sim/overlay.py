"""Overlays of a video: the predicted heightmap, and a simple shadow."""

from itertools import pairwise

import mujoco
import numpy as np

from saltus.arrays import Floats
from saltus.grid import HeightGrid
from saltus.rotations import roll_pitch_yaw, rotation_matrix, yaw_rotation
from saltus.terrain.terrain import Terrain

HEIGHTMAP_RGBA = (1.0, 0.25, 0.55, 1.0)
POINT_RADIUS, LINE_RADIUS = 0.012, 0.005  # [m]
SHADOW_RGBA = (0.05, 0.07, 0.10, 0.30)
HEAD_LENGTH = 0.12  # adds to the shadow of the trunk [m]
HIP_WIDTH = 0.0765  # likewise, of both sides [m]
FOOT_SHADOW_RADIUS = 0.028  # [m]
SHADOW_PIECE = 0.05  # length of a piece on boxes that are no columns [m]
LIFT = 0.003  # shadows float this far above the ground, else they flicker [m]


def draw_heightmap(
    shapes: mujoco.MjvScene, base_pose: Floats, grid: HeightGrid, height: Floats
) -> None:
    """Adds a ball for each finite point of a heightmap
    and lines between those that follow each other in x or in y.

    Args:
        shapes: What is drawn; shapes are added to it.
        base_pose: Position and quaternion of the base, shape (7,).
        grid: Of the heightmap.
        height: Relative to the base [m], shape (grid.size,).
    """
    points = heightmap_in_world(base_pose, grid, height).reshape(*grid.shape, 3)
    for point in _finite(points.reshape(-1, 3)):
        _add(shapes, mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, POINT_RADIUS), point, HEIGHTMAP_RGBA)
    for along in (*points.swapaxes(0, 1), *points):
        for start, end in pairwise(_finite(along)):
            line = _add(
                shapes, mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3), np.zeros(3), HEIGHTMAP_RGBA
            )
            mujoco.mjv_connector(line, mujoco.mjtGeom.mjGEOM_CAPSULE, LINE_RADIUS, start, end)


def heightmap_in_world(base_pose: Floats, grid: HeightGrid, height: Floats) -> Floats:
    """Points of a heightmap in the world [m], shape (grid.size, 3);
    arguments as for `draw_heightmap`.
    """
    local = np.concatenate([grid.points, np.asarray(height, dtype=np.float64)[:, None]], axis=1)
    return base_pose[:3] + local @ _heading(base_pose).T


def _finite(points: Floats) -> Floats:
    return points[np.isfinite(points).all(axis=1)]


def draw_shadow(
    shapes: mujoco.MjvScene, trunk_size: Floats, terrain: Terrain, base_pose: Floats, feet: Floats
) -> None:
    """Darkens the ground right below trunk and feet: shows how high the robot is, at no cost.

    Args:
        shapes: What is drawn; shapes are added to it.
        trunk_size: Full edge lengths of the trunk [m], shape (3,).
        terrain: The ground.
        base_pose: Position and quaternion of the base, shape (7,).
        feet: Centres of the feet in the world [m], shape (4, 3).
    """
    heading = _heading(base_pose)
    # A robot that has turned sideways gets a shadow that is too long
    along = max(abs(float(heading[0, 0])), 0.3)
    reach = 0.5 * (trunk_size[0] + HEAD_LENGTH) * along
    low, high = base_pose[0] - reach, base_pose[0] + reach
    edges = np.arange(low, high, SHADOW_PIECE) if terrain.columns is None else terrain.columns.x
    cuts = np.array([low, *(x for x in edges if low < x < high), high])
    for start, end in pairwise(cuts):  # one piece on each column of the terrain
        x = 0.5 * (start + end)
        y = base_pose[1] + (x - base_pose[0]) * heading[1, 0] / along
        size = np.array([0.5 * (end - start) / along, 0.5 * (trunk_size[1] + HIP_WIDTH), 0.001])
        _add(
            shapes, mujoco.mjtGeom.mjGEOM_BOX, size, _on_ground(terrain, x, y), SHADOW_RGBA, heading
        )
    for foot in feet:
        size = np.array([FOOT_SHADOW_RADIUS, 0.0005, 0.0])  # radius, half of the height
        # Above the trunk's shadow
        center = _on_ground(terrain, foot[0], foot[1]) + np.array([0.0, 0.0, LIFT])
        _add(shapes, mujoco.mjtGeom.mjGEOM_CYLINDER, size, center, SHADOW_RGBA)


def _heading(base_pose: Floats) -> Floats:
    """Rotation from the yaw frame of the base to the world, shape (3, 3)."""
    _, _, yaw = roll_pitch_yaw(rotation_matrix(np.asarray(base_pose[3:7], dtype=np.float64)))
    return yaw_rotation(yaw)


def _on_ground(terrain: Terrain, x: float, y: float) -> Floats:
    return np.array([x, y, float(terrain.height_at(float(x), float(y))) + LIFT])


def _add(
    shapes: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    size: Floats,
    position: Floats,
    rgba: tuple[float, ...],
    rotation: Floats | None = None,
) -> mujoco.MjvGeom:
    shape = shapes.geoms[shapes.ngeom]
    turn = np.eye(3) if rotation is None else rotation
    mujoco.mjv_initGeom(shape, kind, size, position, turn.ravel(), np.array(rgba, dtype=np.float32))
    shape.emission = 0.6 if rgba == HEIGHTMAP_RGBA else 0.0
    shapes.ngeom += 1
    return shape
