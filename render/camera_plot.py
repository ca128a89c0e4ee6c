"""One picture of a camera: what it sees from the robot, what the network gets of it, and both from the side."""

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.depth import MODEL_CAMERA, RANGE_M, depth_in_millimetres, model_image
from saltus.depth_camera import DepthCamera
from saltus.errors import SaltusError
from saltus.grid import HeightGrid
from saltus.render.camera import RobotCamera, camera_pose
from saltus.render.preview import EXPOSURES, FRAME_S, INVALID_COLOUR, NOTHING_COLOUR, Depth, Scale, poses, views
from saltus.render.stereo.camera import StereoCamera, StereoConfig
from saltus.render.stereo.optics import Optics
from saltus.render.stereo_embree import StereoEmbree
from saltus.robots.robot import Robot
from saltus.terrain.terrain import Terrain

HEIGHT, WIDTH = 480, 900  # of the panels, and of the one from the side [px]
SPAN_M = (-0.6, 2.6)  # of the ground that is shown, from the base
MARGIN = 30
TRUNK, GROUND, INK, RAY = (170, 150, 120), (205, 205, 205), (40, 40, 40), (200, 120, 30)  # BGR
SEEN, HIDDEN = (60, 150, 0), (60, 60, 210)
FRAME = (255, 255, 255)
MEANINGS = {
    "invalid": INVALID_COLOUR, "nothing within range": NOTHING_COLOUR, "frame: what the network gets": FRAME,
    "trunk": TRUNK, "ground": GROUND, "camera": INK, "edges of the network's view": RAY,
    "heightmap point in view": SEEN, "not in view": HIDDEN,
}  # fmt: skip
BAR = (300, 14)  # width and height of the scale of colours [px]
CLEAR = 0.98  # of the ray to a point: short of the surface that it lies on


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
    """Points of the heightmap that are in the network's view and behind nothing, shape (points,)."""


def draw_camera(robot: Robot, grid: HeightGrid, terrain: Terrain, camera: DepthCamera, path: Path) -> CameraCoverage:
    """Draws a PNG of a camera on a robot that stands before a terrain's first edge.

    Args:
        robot: with its camera where this one sits.
        grid: of the heights that are to be in view.
        terrain: to look at.
        camera: to draw.
        path: of the picture; its folder must exist.

    Raises:
        SaltusError: the file cannot be written.
    """
    pose = tuple(array[0] for array in poses(terrain, views(robot)[:1]))
    depth = _seen(robot, terrain, camera, pose)
    near, valid = model_image(depth_in_millimetres(depth), camera.image)
    network = np.where(valid > 0.0, RANGE_M * near, np.float32(0.0))
    full = np.ones(depth.shape, np.uint16)
    view, points = RobotCamera.on(robot), _points(grid, terrain, pose[0])
    coverage = CameraCoverage(
        position=robot.camera_position,
        pitch=robot.camera_pitch,
        covered=float((model_image(full, camera.image)[1] > 0.0).mean()),
        invalid=float((valid == 0.0).mean()),
        visible=_visible(terrain, points, view, camera, pose),
    )
    scale = Scale.of([depth, network])
    panels = [
        _titled(_framed(scale, depth, camera), f"{camera.name}: {camera.image.width} x {camera.image.height}"),
        _titled(_enlarged(scale.coloured(network)), "network"),
        _titled(_from_aside(robot, terrain, view, coverage, points, pose), "from the right-hand side"),
    ]
    picture = np.hstack(panels)
    if not cv2.imwrite(str(path), np.vstack([picture, _legend(scale, picture.shape[1])])):
        raise SaltusError(f"cannot write {path}")
    return coverage


def _seen(robot: Robot, terrain: Terrain, camera: DepthCamera, pose: tuple[Floats, ...]) -> Depth:
    """An image of a camera that has stood still for a while [m]."""
    optics = Optics.behind(camera.image, camera)
    depth, hidden = StereoEmbree(terrain, optics, RobotCamera.on(robot, camera.image)).render_pair(*pose)
    stereo = StereoCamera(StereoConfig.of(camera), optics)
    state = stereo.init((), np.random.default_rng(0))
    for k in range(EXPOSURES):
        image, state = stereo.step(depth, hidden, np.asarray(FRAME_S * k), state)
    return np.asarray(camera.in_range(image.depth), np.float32)


def _visible(
    terrain: Terrain, points: Floats, view: RobotCamera, camera: DepthCamera, pose: tuple[Floats, ...]
) -> NDArray[np.bool_]:
    """See `CameraCoverage.visible`; legs are not in the way here."""
    origin, rotation = camera_pose(view.mount, pose[0], pose[1])
    x, y, z = np.moveaxis((points - origin) @ rotation, -1, 0)
    inside = (z > 0.0) & (camera.in_range(z) > 0.0)
    for pinhole in (MODEL_CAMERA, camera.image):
        u, v = pinhole.fx * x / z + pinhole.cx, pinhole.fy * y / z + pinhole.cy
        inside &= (u >= 0.0) & (u <= pinhole.width) & (v >= 0.0) & (v <= pinhole.height)
    line = origin + np.linspace(0.0, CLEAR, 400)[:, None, None] * (points - origin)
    clear: NDArray[np.bool_] = (line[..., 2] >= terrain.height_at(line[..., 0], line[..., 1])).all(0)
    return inside & clear & (z < RANGE_M)


def _points(grid: HeightGrid, terrain: Terrain, position: Floats) -> Floats:
    """The terrain at the grid of a robot that looks along x, world frame [m], shape (points, 3)."""
    x, y = grid.points_in_world(position[None], np.zeros(1))
    return np.stack([x[0], y[0], terrain.height_at(x[0], y[0])], axis=-1)


def _framed(scale: Scale, depth: Depth, camera: DepthCamera) -> NDArray[np.uint8]:
    """The image of a camera, with a frame about what the network gets of it."""
    picture, image = _enlarged(scale.coloured(depth)), camera.image
    to_picture = np.array([picture.shape[1] / image.width, picture.shape[0] / image.height])
    corners = [
        (np.array([image.cx, image.cy]) + np.array([image.fx, image.fy]) * side * _half_tangents()) * to_picture
        for side in (-1.0, 1.0)
    ]
    first, last = (tuple(np.rint(corner).astype(int).tolist()) for corner in corners)
    cv2.rectangle(picture, first, last, FRAME, 2)
    return picture


def _half_tangents() -> Floats:
    """Tangents of half of the network's field of view, across and up."""
    return np.array([MODEL_CAMERA.cx / MODEL_CAMERA.fx, MODEL_CAMERA.cy / MODEL_CAMERA.fy])


def _enlarged(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    width = round(HEIGHT * picture.shape[1] / picture.shape[0])
    return np.asarray(cv2.resize(picture, (width, HEIGHT), interpolation=cv2.INTER_NEAREST), np.uint8)


def _titled(picture: NDArray[np.uint8], title: str) -> NDArray[np.uint8]:
    """A panel with a margin and its title above."""
    panel = cv2.copyMakeBorder(picture, MARGIN, 10, 10, 10, cv2.BORDER_CONSTANT, value=(255, 255, 255))
    _write(panel, title, (10, 20))
    return np.asarray(panel, np.uint8)


def _write(picture: NDArray[np.uint8], words: str, place: tuple[int, int]) -> int:
    """Writes words with their left lower corner at a place [px]; returns where they end."""
    font = cv2.FONT_HERSHEY_SIMPLEX, 0.5
    cv2.putText(picture, words, place, *font, INK, 1, cv2.LINE_AA)
    return place[0] + int(cv2.getTextSize(words, *font, 1)[0][0])


def _legend(scale: Scale, width: int) -> NDArray[np.uint8]:
    """Draws the legend: the scale of depth, and a square for each other colour, in as many rows as they take."""
    legend = np.full((60, width, 3), 255, np.uint8)
    depths, right = np.geomspace(scale.near, scale.far, BAR[0]), 10 + BAR[0]
    legend[6 : 6 + BAR[1], 10:right] = scale.coloured(depths[None])
    for x in np.linspace(0, BAR[0] - 1, 4).astype(int).tolist():
        cv2.line(legend, (10 + x, 6 + BAR[1]), (10 + x, 10 + BAR[1]), INK, 1)
        _write(legend, f"{depths[x]:.2f}", (10 + min(max(x - 15, 0), BAR[0] - 35), 36))
    _write(legend, "m", (right + 8, 36))
    x, y = right + 40, 18
    for words, colour in MEANINGS.items():
        if x + 20 + cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)[0][0] > width:
            x, y = right + 40, y + 24
        cv2.rectangle(legend, (x, y - 11), (x + 12, y + 1), colour, -1)
        cv2.rectangle(legend, (x, y - 11), (x + 12, y + 1), INK, 1)
        x = _write(legend, words, (x + 20, y)) + 24
    return legend


def _from_aside(
    robot: Robot,
    terrain: Terrain,
    view: RobotCamera,
    coverage: CameraCoverage,
    points: Floats,
    pose: tuple[Floats, ...],
) -> NDArray[np.uint8]:
    """Trunk, ground, the network's view and the heightmap's points, from the right-hand side."""
    picture = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    position, scale = pose[0], WIDTH / (SPAN_M[1] - SPAN_M[0])
    bottom = float(terrain.height_at(np.array([position[0]]), np.zeros(1))[0]) - 0.5

    def px(points: Floats) -> NDArray[np.int32]:
        """Pixels of places x, z in the world [m], shape (n, 2)."""
        across = (points[:, 0] - position[0] - SPAN_M[0]) * scale
        return np.rint(np.stack([across, HEIGHT - (points[:, 1] - bottom) * scale], -1)).astype(np.int32)

    x = position[0] + np.linspace(*SPAN_M, 2 * WIDTH)
    ground = np.stack([x, terrain.height_at(x, np.zeros_like(x))], -1)
    below = np.array([[x[-1], bottom], [x[0], bottom]])
    cv2.fillPoly(picture, [px(np.vstack([ground, below]))], GROUND)
    half, centre = 0.5 * robot.trunk_size[[0, 2]], position[[0, 2]] + robot.trunk_center[[0, 2]]
    cv2.fillPoly(picture, [px(centre + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))], TRUNK)
    origin, rotation = camera_pose(view.mount, position, pose[1])
    for side in (-1.0, 1.0):
        ray = rotation @ np.array([0.0, side * _half_tangents()[1], 1.0])
        line = origin + np.linspace(0.0, RANGE_M, 600)[:, None] * ray
        under = line[:, 2] < terrain.height_at(line[:, 0], line[:, 1])
        line = line[: int(under.argmax())] if under.any() else line
        cv2.polylines(picture, [px(line[:, [0, 2]])], isClosed=False, color=RAY, thickness=2, lineType=cv2.LINE_AA)
    for place, seen in zip(px(points[:, [0, 2]]).tolist(), coverage.visible, strict=True):
        cv2.circle(picture, place, 5, SEEN if seen else HIDDEN, -1, cv2.LINE_AA)
    cv2.circle(picture, px(origin[None, [0, 2]])[0].tolist(), 6, INK, -1, cv2.LINE_AA)
    words = (
        f"camera at {', '.join(f'{p:.3f}' for p in coverage.position)} m, {math.degrees(coverage.pitch):.1f} deg down"
    )
    _write(picture, words, (10, 20))
    return picture
