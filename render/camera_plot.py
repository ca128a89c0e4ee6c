"""A page about a camera: what it sees from the robot,
what the network gets of it, and both from the side.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.depth import MODEL_CAMERA, RANGE_M
from saltus.depth_camera import DepthCamera
from saltus.grid import HeightGrid
from saltus.render.camera import RobotCamera, camera_pose
from saltus.render.preview import (
    CaptionedPicture,
    Depth,
    DepthColours,
    ViewPoses,
    for_network,
    make_viewpoints,
    settled_image,
    view_poses,
)
from saltus.render.stereo.camera import StereoConfig
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_embree import StereoEmbree
from saltus.reports.figures import GREEN, GREY, ORANGE, RED, ground_figure, laid_out
from saltus.reports.page import render_page, write_page
from saltus.robots.robot import Robot
from saltus.terrain.terrain import Terrain

SPAN_M = (-0.6, 2.6)  # of the ground that is shown, from the base
ENLARGED = 2  # a camera's picture, in which its frame is two pixels wide
FRAME = (255, 255, 255)
CLEAR = 0.98  # of the ray to a point: short of the surface that it lies on
HALF_TANGENTS = np.array([MODEL_CAMERA.cx / MODEL_CAMERA.fx, MODEL_CAMERA.cy / MODEL_CAMERA.fy])
"""Tangents of half of the network's field of view, across and up."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraCoverage:
    """Ground that a camera sees from a robot that stands."""

    position: Floats
    """Position of its optical centre, base frame [m], shape (3,)."""
    pitch: float
    """Nose down positive [rad]."""
    covered: float
    """Share of the network's view that its image covers."""
    invalid: float
    """Share of the network's image that is invalid."""
    visible: NDArray[np.bool_]
    """Points of the heightmap that are in the network's view and behind nothing, shape
    (points,)."""


def draw_camera(
    robot: Robot, grid: HeightGrid, terrain: Terrain, camera: DepthCamera, path: Path
) -> CameraCoverage:
    """Writes an HTML page about a camera on a robot that stands before a terrain's first edge.

    Args:
        robot: with its camera where this one sits.
        grid: of the heights that are to be in view.
        terrain: to look at.
        camera: to draw.
        path: of the page; its folder must exist.

    Raises:
        OSError: the file cannot be written.
    """
    x, quaternion, joints = view_poses(terrain, make_viewpoints(robot)[:1])
    pose = x[0], quaternion[0], joints[0]
    depth, network = _seen(robot, terrain, camera, pose)
    view, points = RobotCamera.on(robot), _points(grid, terrain, pose[0])
    covered = for_network(np.ones(depth.shape, np.float32), camera.image) > 0.0
    coverage = CameraCoverage(
        position=robot.camera_position,
        pitch=robot.camera_pitch,
        covered=float(covered.mean()),
        invalid=float((network == 0.0).mean()),
        visible=_visible(terrain, points, view, camera, pose),
    )
    scale = DepthColours.of([depth, network])
    text = render_page(
        __file__,
        name=camera.name,
        coverage=coverage,
        pitch_deg=np.degrees(coverage.pitch),
        legend=scale.legend(),
        pictures=[
            _framed(scale, depth, camera),
            scale.picture("", "What the network gets", network),
        ],
        aside=_from_aside(robot, terrain, view, coverage, points, pose),
    )
    write_page(path, text)
    return coverage


def _seen(
    robot: Robot, terrain: Terrain, camera: DepthCamera, pose: ViewPoses
) -> tuple[Depth, Depth]:
    """An image of a camera that has stood still for a while,
    and what the network gets of it [m].
    """
    optics = StereoOptics.behind(camera.image, camera)
    pair = StereoEmbree(terrain, optics, RobotCamera.on(robot, camera.image)).render_pair(*pose)
    depth = camera.in_range(settled_image(StereoConfig.of(camera), optics, *pair))
    return np.asarray(depth, np.float32), for_network(depth, camera.image)


def _visible(
    terrain: Terrain, points: Floats, view: RobotCamera, camera: DepthCamera, pose: ViewPoses
) -> NDArray[np.bool_]:
    """See `CameraCoverage.visible`; legs are not in the way here."""
    origin, rotation = camera_pose(view.mount, pose[0], pose[1])
    x, y, z = np.moveaxis((points - origin) @ rotation, -1, 0)
    inside = (z > 0.0) & (camera.in_range(z) > 0.0)
    for pinhole in (MODEL_CAMERA, camera.image):
        u, v = pinhole.fx * x / z + pinhole.cx, pinhole.fy * y / z + pinhole.cy
        inside &= (u >= 0.0) & (u <= pinhole.width) & (v >= 0.0) & (v <= pinhole.height)
    line = origin + np.linspace(0.0, CLEAR, 400)[:, None, None] * (points - origin)
    clear: NDArray[np.bool_] = (line[..., 2] >= terrain.height_at(line[..., 0], line[..., 1])).all(
        0
    )
    return inside & clear & (z < RANGE_M)


def _points(grid: HeightGrid, terrain: Terrain, position: Floats) -> Floats:
    """The terrain at the grid of a robot that looks along x, world frame [m], shape (points, 3)."""
    x, y = grid.points_in_world(position[None], np.zeros(1))
    return np.stack([x[0], y[0], terrain.height_at(x[0], y[0])], axis=-1)


def _framed(scale: DepthColours, depth: Depth, camera: DepthCamera) -> CaptionedPicture:
    """The image of a camera, with a frame about what the network gets of it."""
    image, picture = camera.image, scale.coloured(depth)
    picture = cv2.resize(
        picture, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_NEAREST
    ).astype(np.uint8)
    centre, reach = np.array([image.cx, image.cy]), np.array([image.fx, image.fy]) * HALF_TANGENTS
    first, last = (
        tuple(np.rint(ENLARGED * corner).astype(int).tolist())
        for corner in (centre - reach, centre + reach)
    )
    cv2.rectangle(picture, first, last, FRAME, 2)
    return CaptionedPicture.of(
        f"{image.width} x {image.height}", "In the frame: what the network gets", picture
    )


def _from_aside(
    robot: Robot,
    terrain: Terrain,
    view: RobotCamera,
    coverage: CameraCoverage,
    points: Floats,
    pose: ViewPoses,
) -> go.Figure:
    """Trunk, ground, the network's view and the heightmap's points, from the right-hand side."""
    position, quaternion, _ = pose
    figure = ground_figure(terrain, position[0] + SPAN_M[0], position[0] + SPAN_M[1])
    centre, half = position + robot.trunk_center, 0.5 * robot.trunk_size
    corners = centre + half * np.array(
        [[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1], [-1, 0, -1]]
    )
    _add(figure, "trunk", corners, mode="lines", fill="toself", line={"color": GREY})
    origin, rotation = camera_pose(view.mount, position, quaternion)
    for side in (-1.0, 1.0):
        ray = rotation @ np.array([0.0, side * HALF_TANGENTS[1], 1.0])
        line = origin + np.linspace(0.0, RANGE_M, 600)[:, None] * ray
        under = line[:, 2] < terrain.height_at(line[:, 0], line[:, 1])
        line = line[: int(under.argmax())] if under.any() else line
        _add(
            figure,
            "edges of the network's view",
            line,
            mode="lines",
            line={"color": ORANGE},
            showlegend=side > 0.0,
        )
    for name, seen, colour in (
        ("in view", coverage.visible, GREEN),
        ("not in view", ~coverage.visible, RED),
    ):
        _add(
            figure,
            f"heightmap points {name}",
            points[seen],
            mode="markers",
            marker={"color": colour},
        )
    _add(figure, "camera", origin[None], mode="markers", marker={"color": ORANGE, "size": 12})
    return laid_out(figure, 480, x="x [m]", y="z [m]", legend_y=1.12)


def _add(figure: go.Figure, name: str, points: Floats, **look: object) -> None:
    """Draws points of the world, shape (n, 3), from the side."""
    figure.add_scatter(x=points[:, 0], y=points[:, 2], name=name, **look)
