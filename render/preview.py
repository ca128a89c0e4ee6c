"""Images of a camera along a terrain, effect by effect,
as one HTML file that opens without a network.
"""

import inspect
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from saltus.arrays import Floats, Reals
from saltus.depth import RANGE_M, Intrinsics, depth_in_millimetres, model_image
from saltus.depth_camera import DepthCamera
from saltus.errors import SaltusError
from saltus.grid import HeightGrid
from saltus.render.camera import RobotCamera, camera_pose, ray_directions
from saltus.render.embree import EmbreeRenderer
from saltus.render.stereo.camera import StereoCamera, StereoConfig
from saltus.render.stereo.optics import StereoOptics
from saltus.render.stereo_embree import StereoEmbree
from saltus.reports.figures import BLUE, ground_figure, laid_out
from saltus.reports.page import render_page, write_page
from saltus.reports.page_templates import data_url
from saltus.robots.robot import Robot
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.sim.video import render_snapshots
from saltus.terrain.terrain import Terrain

Depth = NDArray[np.float32]
ViewPoses = tuple[Floats, Floats, Floats]

# Of a camera that stands still, before its picture is shown: the temporal filter has settled by
# then
EXPOSURES = 5
FRAME_S = 0.02
NOTHING_COLOUR, INVALID_COLOUR = (110, 110, 110), (0, 0, 0)
CLOUD_POINTS = 12_000  # every third pixel of a D435i, along both axes; the page stays below 1 MB
ROBOT_SIZE, ROBOT_QUALITY = (320, 240), (cv2.IMWRITE_WEBP_QUALITY, 85)
LOSSLESS = (cv2.IMWRITE_WEBP_QUALITY, 101)  # above 100, as OpenCV says it; half the size of a PNG


class CaptionedPicture(NamedTuple):
    """A picture of a preview page, with its caption."""

    title: str
    text: str
    source: str
    """A data URL."""
    is_narrow: bool = False

    @classmethod
    def of(cls, title: str, text: str, colours: NDArray[np.uint8]) -> "CaptionedPicture":
        """A picture (BGR) as it is."""
        return cls(title, text, _source(colours, LOSSLESS), colours.shape[1] < colours.shape[0])


_NO_HEIGHTS = HeightGrid(x=(0.0,))
"""No heights of pictures without a heightmap."""


@dataclass(frozen=True, kw_only=True)
class DepthColours:
    """Colours of depth, the same on a whole page:
    the nearest is bright, by the logarithm, in even steps to the eye.
    """

    near: float
    far: float
    """[m]; what is farther has the same colour."""

    @classmethod
    def of(cls, images: Sequence[Depth]) -> "DepthColours":
        """The scale from the nearest to the farthest depth of images within the model's range."""
        depth = np.concatenate([image.ravel() for image in images])
        seen = depth[(depth > 0.0) & (depth <= RANGE_M)]
        far = float(seen.max(initial=0.0)) or RANGE_M
        return cls(near=min(float(seen.min(initial=far)), 0.9 * far), far=far)

    def coloured(self, depth: Reals) -> NDArray[np.uint8]:
        """Colours of depth (BGR): nothing within range is grey, invalid is black."""
        share = np.log(np.clip(depth, self.near, self.far) / self.near) / math.log(
            self.far / self.near
        )
        colours = cv2.applyColorMap(
            np.rint(255 * (1.0 - share)).astype(np.uint8), cv2.COLORMAP_VIRIDIS
        )
        colours[~np.isfinite(depth)] = NOTHING_COLOUR
        colours[depth <= 0.0] = INVALID_COLOUR
        return colours.astype(np.uint8)

    def picture(self, title: str, text: str, depth: Depth) -> CaptionedPicture:
        """Depth in colours, with its caption."""
        return CaptionedPicture.of(title, text, self.coloured(depth))

    def legend(self) -> list[tuple[float, tuple[int, int, int]]]:
        """Depths [m] from the nearest to the farthest, and their colours (red, green, blue)."""
        depths = np.geomspace(self.near, self.far, 16)
        return [
            (float(d), (r, g, b))
            for d, (b, g, r) in zip(depths, self.coloured(depths[None])[0].tolist(), strict=True)
        ]


@dataclass(frozen=True, kw_only=True, eq=False)
class Viewpoint:
    """One pose of the robot from which a preview looks."""

    title: str
    before_edge: float
    """Distance of the base before the first edge [m]; before x = 1.5 m on flat ground."""
    clearance: float
    """Height of the base above the highest ground near it [m]."""
    pitch: float
    """[rad], nose down positive."""
    joints: Floats
    """[rad], shape (12,)."""


# front feet stretched ahead and inwards, nearly as far as joints allow: where the narrow camera can
# see them
REACHING = np.array([0.8, -0.6, -0.95, -0.8, -0.6, -0.95])
EFFECTS_VIEW = 3  # legs and terrain at different depths: every effect has something to act on


def make_viewpoints(robot: Robot) -> tuple[Viewpoint, ...]:
    """The poses from which a robot looks."""
    stand = robot.stand_pose
    ahead = np.clip(np.concatenate([REACHING, stand[6:]]), robot.joint_lower, robot.joint_upper)
    return (
        Viewpoint(
            title="standing", before_edge=0.8, clearance=robot.stand_height, pitch=0.0, joints=stand
        ),
        Viewpoint(title="taking off", before_edge=0.4, clearance=0.35, pitch=-0.25, joints=stand),
        Viewpoint(title="in flight", before_edge=-0.3, clearance=0.40, pitch=0.15, joints=stand),
        Viewpoint(title="reaching ahead", before_edge=0.9, clearance=0.45, pitch=0.0, joints=ahead),
    )


def write_preview(robot: Robot, terrain: Terrain, camera: DepthCamera, path: Path) -> Path:
    """Writes an HTML file: the course from the side, depth from a few poses,
    the camera's effects, what the model gets.

    Args:
        robot: with its camera where this one sits.
        terrain: to look at.
        camera: to look through, in the pixels in which its imagers match.
        path: of the file, which is returned; its folder must exist.

    Raises:
        OSError: the file cannot be written.
    """
    shown = make_viewpoints(robot)
    robots, sensor = view_poses(terrain, shown), camera.matching
    wide = StereoEmbree(terrain, StereoOptics.behind(sensor, camera), RobotCamera.on(robot, sensor))
    depth, hidden = wide.render_pair_batch(*robots)
    narrow = EmbreeRenderer(terrain, RobotCamera.on(robot)).render_batch(*robots)
    scale = DepthColours.of([*depth, *narrow])
    true = depth[EFFECTS_VIEW]
    stages = list(effect_stages(true, hidden[EFFECTS_VIEW], camera))
    reported = camera.in_range(stages[-1][2] if stages else true)
    robots_seen, trouble = _robots(robot, terrain, shown, robots)
    text = render_page(
        __file__,
        place=f"{terrain.kind.replace('_', ' ')}: {camera.name}",
        course=course_figure(terrain),
        robots=robots_seen,
        trouble=trouble,
        legend=scale.legend(),
        size=f"{sensor.width} x {sensor.height}",
        clean=[
            picture
            for i, view in enumerate(shown)
            for picture in _clean(view, scale, depth[i], narrow[i])
        ],
        effects_view=shown[EFFECTS_VIEW].title,
        effects=[scale.picture(*stage) for stage in stages],
        for_model=_for_model(scale, camera, true, reported),
        cloud=cloud_figure(wide, camera, robots, true, reported),
    )
    write_page(path, text)
    return path


def course_figure(terrain: Terrain) -> go.Figure:
    """The ground from the first box to the end of the last, with start and finish."""
    center, reach = terrain.arrays.center[:, 0], terrain.arrays.extent[:, 0]
    figure = ground_figure(terrain, (center - reach).min(), (center + reach).max())
    for name, x in (("start", terrain.start_x), ("finish", terrain.finish_x)):
        figure.add_vline(x=x, line={"color": BLUE, "width": 2}, opacity=1.0, annotation_text=name)
    return laid_out(figure, 330, x="x [m]", y="z [m]")


def view_poses(terrain: Terrain, shown: Sequence[Viewpoint]) -> ViewPoses:
    """The robots of views: positions, quaternions, joints."""
    edge = terrain.first_edge_x if np.isfinite(terrain.first_edge_x) else 1.5
    x = np.array([edge - view.before_edge for view in shown])
    near = x[:, None] + np.linspace(-0.25, 0.25, 11)
    z = terrain.height_at(near, 0.0).max(axis=1) + [view.clearance for view in shown]
    level = np.zeros(len(shown))
    quaternion = quaternion_from_roll_pitch_yaw(
        level, np.array([view.pitch for view in shown]), level
    )
    return np.stack([x, level, z], axis=-1), quaternion, np.stack([view.joints for view in shown])


def effect_stages(
    depth: Depth, hidden: NDArray[np.bool_], camera: DepthCamera
) -> Iterator[tuple[str, str, Depth]]:
    """Name, meaning and picture of every effect together with all that come before it.

    Args:
        depth: true depth of the pixels in which the camera's imagers match [m], shape (height,
            width).
        hidden: what the right imager does not see, same shape.
        camera: whose effects; those at their null value are left out.
    """
    config, optics = StereoConfig.of(camera), StereoOptics.behind(camera.matching, camera)
    names = [effect.name for effect in config.effects if not effect.is_null()]
    for count in range(1, len(names) + 1):
        stage = settled_image(config.only(names[:count]), optics, depth, hidden)
        effect = next(effect for effect in config.effects if effect.name == names[count - 1])
        said = inspect.getdoc(type(effect)) or ""
        meaning = said.partition("\n\n")[0].replace("\n", " ").replace("`", "")
        yield names[count - 1].replace("_", " "), meaning, stage


def settled_image(
    config: StereoConfig, optics: StereoOptics, depth: Depth, hidden: NDArray[np.bool_]
) -> Depth:
    """The image of a stereo camera that has stood still for a while [m].

    Its noise is always the same.
    """
    stereo = StereoCamera(config, optics)
    state = stereo.init((), np.random.default_rng(0))
    for k in range(EXPOSURES):
        image, state = stereo.step(depth, hidden, np.asarray(FRAME_S * k), state)
    return np.asarray(image.depth, dtype=np.float32)


def for_network(depth: Depth, camera: Intrinsics) -> Depth:
    """The pixels of an image that a network gets [m], 0 where invalid, shape (48, 16)."""
    near, valid = model_image(depth_in_millimetres(depth), camera)
    return np.where(valid > 0.0, RANGE_M * near, np.float32(0.0))


def cloud_figure(
    wide: StereoEmbree, camera: DepthCamera, robots: ViewPoses, true: Depth, reported: Depth
) -> go.Figure:
    """A figure of two depth images, true and reported, as points in the world."""
    origin, rotation = camera_pose(wide.mount, robots[0][EFFECTS_VIEW], robots[1][EFFECTS_VIEW])
    stride = math.ceil(math.sqrt(true.size / CLOUD_POINTS))
    rays = ray_directions(camera.matching)[::stride, ::stride] @ rotation.T
    figure = go.Figure()
    for name, depth, colour in (("true", true, "#999999"), ("as reported", reported, "#0072B2")):
        sampled = depth[::stride, ::stride]
        shown = (sampled > 0.0) & (sampled < RANGE_M)
        x, y, z = np.round(origin + sampled[shown][:, None] * rays[shown], 4).astype(np.float32).T
        figure.add_scatter3d(
            x=x, y=y, z=z, name=name, mode="markers", marker={"size": 1.5, "color": colour}
        )
    figure.update_layout(
        height=640,
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        legend={"itemsizing": "constant", "x": 0, "y": 1},
        scene={
            "aspectmode": "data",
            "camera": {"eye": {"x": -1.2, "y": -1.0, "z": 0.8}},
            **{f"{axis}axis": {"title": f"{axis} [m]"} for axis in "xyz"},
        },
    )
    return figure


def _robots(
    robot: Robot, terrain: Terrain, shown: Sequence[Viewpoint], robots: ViewPoses
) -> tuple[list[CaptionedPicture], str]:
    """The robot in each pose, seen from aside; or why there is no way to draw it."""
    position, quaternion, joints = robots
    pose, none = (
        np.concatenate([position, quaternion], axis=-1),
        np.full((len(shown), _NO_HEIGHTS.size), np.nan),
    )
    try:
        frames = render_snapshots(robot, terrain, pose, joints, _NO_HEIGHTS, none, size=ROBOT_SIZE)
    except SaltusError as error:
        return [], str(error)
    sources = [_source(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR), ROBOT_QUALITY) for frame in frames]
    return [
        CaptionedPicture(view.title, "", source)
        for view, source in zip(shown, sources, strict=True)
    ], ""


def _source(picture: NDArray[np.uint8], quality: tuple[int, int]) -> str:
    return data_url("webp", cv2.imencode(".webp", picture, quality)[1])


def _clean(
    view: Viewpoint, scale: DepthColours, wide: Depth, narrow: Depth
) -> list[CaptionedPicture]:
    nearest = float(wide.min())
    text = f"nearest {nearest:.2f} m" if np.isfinite(nearest) else "nothing within range"
    return [scale.picture(view.title, text, wide), scale.picture("", "", narrow)]


def _for_model(
    scale: DepthColours, camera: DepthCamera, true: Depth, reported: Depth
) -> list[CaptionedPicture]:
    pictures = []
    for title, depth in (("true", true), ("as reported", reported)):
        pictures.append(
            scale.picture(title, "", camera.masked(for_network(depth, camera.matching)))
        )
    return pictures
