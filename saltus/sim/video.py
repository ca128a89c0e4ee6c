"""A recorded run as a video: the robot, the terrain,
and on it what the robot believed the terrain to be.
"""

from collections.abc import Generator, Iterable, Iterator
from itertools import pairwise
from pathlib import Path

import cv2
import imageio_ffmpeg
import mujoco
import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.errors import SaltusError
from saltus.grid import HeightGrid
from saltus.robots.robot import LEGS, Robot
from saltus.rotations import roll_pitch_yaw, rotation_matrix, yaw_rotation
from saltus.sim import robot_model
from saltus.sim.appearance import add_looks
from saltus.sim.osmesa import drawing_context, read_pixels
from saltus.sim.plant import standing_pose
from saltus.terrain import level
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


Frame = NDArray[np.uint8]

FPS = 30
SIZE = (640, 480)
# Frames are drawn larger and averaged: half the price of multi-sampling in a software renderer
SUPERSAMPLING = 1.5
# The index first, so that a browser can start at once
ENCODING = [
    "-preset",
    "veryfast",
    "-movflags",
    "+faststart",
]
# Camera: from behind and the right, so that risers, which face the robot, face the camera too.
AZIMUTH_DEG, ELEVATION_DEG, DISTANCE_M = 62.0, -17.0, 1.75
LOOK_AHEAD_M = 0.35
SMOOTHING_S = (
    0.4  # the camera follows the mean of the trunk over this time to either side, not every bounce
)
MAX_SHAPES = 5000  # enough for a heightmap of 40 x 40 points


def render_run(
    robot: Robot,
    terrain: Terrain,
    time_s: Floats,
    base_pose: Floats,
    joint_position: Floats,
    grid: HeightGrid,
    heightmap: Floats,
    *,
    size: tuple[int, int] = SIZE,
    fps: int = FPS,
) -> Iterator[Frame]:
    """Draws a run at an even rate, each frame from the newest sample at its time.

    Args:
        robot: Whose run it is.
        terrain: Where it took place.
        time_s: Of the samples, rising [s], shape (n,).
        base_pose: Position [m] and quaternion (w, x, y, z) of the base in the world, shape (n, 7).
        joint_position: [rad], shape (n, 12).
        grid: Of the heightmaps.
        heightmap: Height relative to the base [m], shape (n, grid.size); NaN where there was none.
        size: Width and height [px].
        fps: Frames per second of simulated time.

    Yields:
        NDArray[np.uint8]s, shape (height, width, 3), uint8, first row on top.

    Raises:
        SaltusError: there is no sample, or no way to draw.
    """
    if len(time_s) == 0:
        raise SaltusError("a video needs at least one sample of the robot's pose")
    model = _model(robot, terrain)
    data = mujoco.MjData(model)
    shapes = mujoco.MjvScene(model, MAX_SHAPES)
    shapes.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
    shapes.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = (
        False  # triples the time of a frame; see `draw_shadow`
    )
    shapes.flags[mujoco.mjtRndFlag.mjRND_HAZE] = True
    option, camera = _option(), _camera()
    aim = _aim(time_s, base_pose[:, :3])
    drawn = (round(SUPERSAMPLING * size[0]), round(SUPERSAMPLING * size[1]))
    feet = [model.geom(f"{leg}_foot").id for leg in LEGS]
    frame_times = np.arange(time_s[0], time_s[-1] + 1e-9, 1.0 / fps)
    with drawing_context(model, *drawn) as context:
        for i in np.searchsorted(time_s, frame_times + 1e-9, side="right") - 1:
            data.qpos[:] = np.concatenate([base_pose[i], joint_position[i]])
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            camera.lookat[:] = aim[i]
            mujoco.mjv_updateScene(
                model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, shapes
            )
            draw_shadow(shapes, robot.trunk_size, terrain, base_pose[i], data.geom_xpos[feet])
            draw_heightmap(shapes, base_pose[i], grid, heightmap[i])
            mujoco.mjr_render(mujoco.MjrRect(0, 0, *drawn), shapes, context)
            picture = read_pixels(context, *drawn)
            yield cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(
                np.uint8, copy=False
            )


def render_snapshots(
    robot: Robot,
    terrain: Terrain,
    base_pose: Floats,
    joint_position: Floats,
    grid: HeightGrid,
    heightmap: Floats,
    *,
    size: tuple[int, int],
) -> list[Frame]:
    """A picture of each pose, as `render_run` draws them; arguments and errors as there."""
    time_s = np.arange(float(len(base_pose)))  # one a second, so that each is a frame of its own
    return list(
        render_run(
            robot, terrain, time_s, base_pose, joint_position, grid, heightmap, size=size, fps=1
        )
    )


def write_video(
    path: Path, frames: Iterable[Frame], *, size: tuple[int, int] = SIZE, fps: int = FPS
) -> int:
    """Writes frames as H.264 in an MP4 that browsers play; returns how many there were.

    Args:
        path: Of the file, which is replaced.
        frames: NDArray[np.uint8]s of shape (height, width, 3), uint8.
        size: Width and height [px], multiples of 16.
        fps: Frames per second.
    """
    writer: Generator[None, NDArray[np.uint8] | None] = imageio_ffmpeg.write_frames(
        str(path),
        size,
        fps=fps,
        codec="libx264",
        quality=7,
        ffmpeg_log_level="error",
        output_params=ENCODING,
    )
    writer.send(None)
    count = 0
    try:
        for frame in frames:
            writer.send(frame)
            count += 1
    finally:
        writer.close()
    return count


def test_frame(robot: Robot, grid: HeightGrid) -> Frame:
    """One picture of the robot in front of stairs, shape (480, 640, 3):
    shows that drawing works on this machine.
    """
    terrain = level.make("stairs", steps=5, rise_m=0.06, run_m=0.25)
    x, zero = np.asarray(terrain.first_edge_x - 0.4), np.zeros(())
    pose = standing_pose(robot, terrain, x, zero, clearance=0.0)
    heights = terrain.height_at(*grid.points_in_world(pose[:2], zero)) - pose[2]
    return next(
        render_run(robot, terrain, np.zeros(1), pose[None, :7], pose[None, 7:], grid, heights[None])
    )


def _model(robot: Robot, terrain: Terrain) -> mujoco.MjModel:
    spec = robot_model.build_spec(robot, terrain)
    add_looks(spec, robot, terrain)
    spec.visual.quality.offsamples = 0
    # Round enough at this size
    spec.visual.quality.numslices, spec.visual.quality.numstacks = (
        20,
        10,
    )
    spec.stat.extent, spec.stat.center = 3.0, (0.0, 0.0, 0.0)  # scales clipping planes and haze
    return spec.compile()


def _option() -> mujoco.MjvOption:
    option = mujoco.MjvOption()
    option.geomgroup[:] = 0
    option.geomgroup[robot_model.TERRAIN_GROUP] = option.geomgroup[robot_model.VISUAL_GROUP] = 1
    return option


def _camera() -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = AZIMUTH_DEG, ELEVATION_DEG, DISTANCE_M
    return camera


def _aim(time_s: Floats, position: Floats) -> Floats:
    """Where the camera looks at each sample:
    a moving mean of the base, a little ahead of it, shape (n, 3).
    """
    first = np.searchsorted(time_s, time_s - SMOOTHING_S, side="left")
    last = np.searchsorted(time_s, time_s + SMOOTHING_S, side="right")
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(position, axis=0)])
    mean = (total[last] - total[first]) / (last - first)[:, None]
    return mean + np.array([LOOK_AHEAD_M, 0.0, -0.05])
