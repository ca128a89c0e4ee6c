"""What the camera sees along a terrain, effect by effect, as one HTML file that opens without a network."""

import base64
import html
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from saltus.depth import RANGE_M, depth_frame, depth_in_millimetres, model_image
from saltus.depth_camera import DepthCamera
from saltus.errors import SaltusError
from saltus.grid import LINE
from saltus.recordings.page import figure_html, page, write_page
from saltus.recordings.report import BLUE, add_ground
from saltus.render.camera import RobotCamera, camera_pose, ray_directions
from saltus.render.embree import EmbreeRenderer
from saltus.render.stereo.camera import StereoCamera, StereoConfig
from saltus.render.stereo.optics import Optics
from saltus.render.stereo_embree import StereoEmbree
from saltus.robots.robot import Robot
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.sim.video import render_run
from saltus.terrain.terrain import Terrain
from saltus.wire.messages import Floats

Depth = NDArray[np.float32]
Poses = tuple[Floats, Floats, Floats]

EXPOSURES = 5  # of a camera that stands still, before its picture is shown: the temporal filter has settled by then
FRAME_S = 0.02
NOTHING_COLOUR, INVALID_COLOUR = (110, 110, 110), (0, 0, 0)
CLOUD_POINTS = 12_000  # every third pixel of a D435i, along both axes; the page stays below 1 MB
ROBOT_SIZE, ROBOT_QUALITY = (320, 240), (cv2.IMWRITE_WEBP_QUALITY, 85)
LOSSLESS = (cv2.IMWRITE_WEBP_QUALITY, 101)  # above 100, as OpenCV says it; half the size of a PNG
STYLE = """
body { max-width: 1340px; } p { color: #555; margin: 0.2em 0; }
.row { display: flex; flex-wrap: wrap; gap: 16px; } figure { margin: 0.5em 0; max-width: 424px; }
figure.narrow { max-width: 150px; } img { image-rendering: pixelated; height: 240px; display: block; }
figcaption { font-size: 0.85em; min-height: 3em; } .scale { width: 424px; height: 14px; }
.marks { width: 424px; display: flex; justify-content: space-between; }
"""


@dataclass(frozen=True, kw_only=True)
class Scale:
    """Colours of depth, the same on a whole page: the nearest is bright, by the logarithm, in even steps to the eye."""

    near: float
    far: float
    """[m]; what is farther has the same colour."""

    @classmethod
    def of(cls, images: Sequence[Depth]) -> "Scale":
        """From the nearest to the farthest depth that some images have within the model's range."""
        depth = np.concatenate([image.ravel() for image in images])
        seen = depth[(depth > 0.0) & (depth <= RANGE_M)]
        far = float(seen.max(initial=0.0)) or RANGE_M
        return cls(near=min(float(seen.min(initial=far)), 0.9 * far), far=far)

    def coloured(self, depth: NDArray[np.floating]) -> NDArray[np.uint8]:
        """Colours of depth (BGR): nothing within range is grey, invalid is black."""
        share = np.log(np.clip(depth, self.near, self.far) / self.near) / math.log(self.far / self.near)
        colours = cv2.applyColorMap(np.rint(255 * (1.0 - share)).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
        colours[~np.isfinite(depth)] = NOTHING_COLOUR
        colours[depth <= 0.0] = INVALID_COLOUR
        return colours.astype(np.uint8)

    def figure(self, title: str, text: str, depth: Depth) -> str:
        """A picture with its caption, embedded."""
        shape = ' class="narrow"' if depth.shape[1] < depth.shape[0] else ""
        return _figure(title, text, self.coloured(depth), LOSSLESS, shape)

    def legend(self) -> str:
        """What the colours mean."""
        depths = np.geomspace(self.near, self.far, 16)
        colours = ", ".join(f"rgb({r},{g},{b})" for b, g, r in self.coloured(depths[None])[0].tolist())
        marks = "".join(f"<span>{depth:.2g} m</span>" for depth in depths[::5])
        return (
            "<p>Grey: nothing within range. Black: invalid.</p>"
            f'<div class="scale" style="background: linear-gradient(to right, {colours})"></div>'
            f'<div class="marks">{marks}</div>'
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """One pose to look from."""

    title: str
    before_edge: float
    """Distance of the base before the first edge [m]; before x = 1.5 m on flat ground."""
    clearance: float
    """Height of the base above the highest ground near it [m]."""
    pitch: float
    """[rad], nose down positive."""
    joints: Floats
    """[rad], shape (12,)."""


# front feet stretched ahead and inwards, nearly as far as joints allow: where the narrow camera can see them
REACHING = np.array([0.8, -0.6, -0.95, -0.8, -0.6, -0.95])
EFFECTS_VIEW = 3  # legs and terrain at different depths: every effect has something to act on


def views(robot: Robot) -> tuple[View, ...]:
    """The poses from which a robot looks."""
    stand = robot.stand_pose
    ahead = np.clip(np.concatenate([REACHING, stand[6:]]), robot.joint_lower, robot.joint_upper)
    return (
        View(title="standing", before_edge=0.8, clearance=robot.stand_height, pitch=0.0, joints=stand),
        View(title="taking off", before_edge=0.4, clearance=0.35, pitch=-0.25, joints=stand),
        View(title="in flight", before_edge=-0.3, clearance=0.40, pitch=0.15, joints=stand),
        View(title="reaching ahead", before_edge=0.9, clearance=0.45, pitch=0.0, joints=ahead),
    )


def write_preview(robot: Robot, terrain: Terrain, camera: DepthCamera, path: Path) -> Path:
    """Writes an HTML file: the course from the side, depth from a few poses, the camera's effects, what the model gets.

    Args:
        robot: with its camera where this one sits.
        terrain: to look at.
        camera: to look through, in the pixels in which its imagers match.
        path: of the file, which is returned; its folder must exist.

    Raises:
        OSError: the file cannot be written.
    """
    shown = views(robot)
    robots, sensor = poses(terrain, shown), camera.matching
    wide = StereoEmbree(terrain, Optics.behind(sensor, camera), RobotCamera.on(robot, sensor))
    depth, hidden = wide.render_pair_batch(*robots)
    narrow = EmbreeRenderer(terrain, RobotCamera.on(robot)).render_batch(*robots)
    scale = Scale.of([*depth, *narrow])
    true, size = depth[EFFECTS_VIEW], f"{sensor.width} x {sensor.height}"
    place = html.escape(f"{terrain.kind.replace('_', ' ')}: {camera.name}")
    stages = list(effect_stages(true, hidden[EFFECTS_VIEW], camera))
    reported = camera.in_range(stages[-1][2] if stages else true)
    effects = _row(scale.figure(title, text, image) for title, text, image in stages) or "<p>It has none.</p>"
    cloud = cloud_figure(wide, camera, robots, true, reported)
    body = "".join(
        [
            f"<h1>What the camera sees on {place}</h1>",
            "<h2>The course from the side, along its middle</h2>",
            figure_html(course_figure(terrain)),
            "<h2>Where it looks from</h2>",
            _row(_robots(robot, terrain, shown, robots)),
            scale.legend(),
            f"<h2>True depth, {size} and 16 x 48 pixels</h2>",
            _row(f for i, view in enumerate(shown) for f in _clean(view, scale, depth[i], narrow[i])),
            f"<h2>{shown[EFFECTS_VIEW].title.capitalize()}: the effects of the camera, switched on in turn</h2>",
            effects,
            "<h2>What the model gets: cut and pooled to 16 x 48</h2>",
            _row(_model_figures(scale, camera, true, reported)),
            "<h2>Point cloud: true and as reported</h2>",
            cloud.to_html(full_html=False, include_plotlyjs=False),
        ]
    )
    write_page(path, page("Saltus camera", body, STYLE))
    return path


def course_figure(terrain: Terrain) -> go.Figure:
    """The ground from the first box to the end of the last, with start and finish."""
    center, reach = terrain.box_center[:, 0], terrain.arrays.extent[:, 0]
    figure = go.Figure()
    add_ground(figure, terrain, (center - reach).min(), (center + reach).max())
    for name, x in (("start", terrain.start_x), ("finish", terrain.finish_x)):
        figure.add_vline(x=x, line={"color": BLUE, "width": 2}, opacity=1.0, annotation_text=name)
    figure.update_xaxes(title="x [m]")
    figure.update_yaxes(title="z [m]", scaleanchor="x", scaleratio=1)
    figure.update_layout(height=330)
    return figure


def poses(terrain: Terrain, shown: Sequence[View]) -> Poses:
    """The robots of views: positions, quaternions, joints."""
    edge = terrain.first_edge_x if np.isfinite(terrain.first_edge_x) else 1.5
    x = np.array([edge - view.before_edge for view in shown])
    near = x[:, None] + np.linspace(-0.25, 0.25, 11)
    z = terrain.height_at(near, 0.0).max(axis=1) + [view.clearance for view in shown]
    level = np.zeros(len(shown))
    quaternion = quaternion_from_roll_pitch_yaw(level, np.array([view.pitch for view in shown]), level)
    return np.stack([x, level, z], axis=-1), quaternion, np.stack([view.joints for view in shown])


def effect_stages(depth: Depth, hidden: NDArray[np.bool_], camera: DepthCamera) -> Iterator[tuple[str, str, Depth]]:
    """Name, meaning and picture of every effect together with all that come before it.

    Args:
        depth: true depth of the pixels in which the camera's imagers match [m], shape (height, width).
        hidden: what the right imager does not see, same shape.
        camera: whose effects; those at their null value are left out.
    """
    config, optics = StereoConfig.of(camera), Optics.behind(camera.matching, camera)
    names = [effect.name for effect in config.effects if not effect.is_null()]
    for count in range(1, len(names) + 1):
        stereo = StereoCamera(config.only(names[:count]), optics)
        state = stereo.init((), np.random.default_rng(0))  # the same noise at every stage
        for k in range(EXPOSURES):
            image, state = stereo.step(depth, hidden, np.asarray(FRAME_S * k), state)
        effect = next(effect for effect in config.effects if effect.name == names[count - 1])
        meaning = (type(effect).__doc__ or "").strip().splitlines()[0].replace("`", "")
        yield names[count - 1].replace("_", " "), meaning, np.asarray(image.depth, dtype=np.float32)


def cloud_figure(wide: StereoEmbree, camera: DepthCamera, robots: Poses, true: Depth, reported: Depth) -> go.Figure:
    """Both depth images as points in the world."""
    origin, rotation = camera_pose(wide.mount, robots[0][EFFECTS_VIEW], robots[1][EFFECTS_VIEW])
    stride = math.ceil(math.sqrt(true.size / CLOUD_POINTS))
    rays = ray_directions(camera.matching)[::stride, ::stride] @ rotation.T
    figure = go.Figure()
    for name, depth, colour in (("true", true, "#999999"), ("as reported", reported, "#0072B2")):
        sampled = depth[::stride, ::stride]
        shown = (sampled > 0.0) & (sampled < RANGE_M)
        x, y, z = np.round(origin + sampled[shown][:, None] * rays[shown], 4).astype(np.float32).T
        figure.add_scatter3d(x=x, y=y, z=z, name=name, mode="markers", marker={"size": 1.5, "color": colour})
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


def _robots(robot: Robot, terrain: Terrain, shown: Sequence[View], robots: Poses) -> Iterator[str]:
    """The robot in each pose, seen from aside; a sentence where there is no way to draw."""
    position, quaternion, joints = robots
    pose, none = np.concatenate([position, quaternion], axis=-1), np.full((len(shown), LINE.size), np.nan)
    time_s = np.arange(float(len(shown)))  # one a second, so that each is a picture of its own
    try:
        frames = list(render_run(robot, terrain, time_s, pose, joints, LINE, none, size=ROBOT_SIZE, fps=1))
    except SaltusError as error:
        yield f"<p>No pictures: {html.escape(str(error))}</p>"
        return
    for view, frame in zip(shown, frames, strict=True):
        yield _figure(view.title, "", cv2.cvtColor(frame, cv2.COLOR_RGB2BGR), ROBOT_QUALITY)


def _figure(title: str, text: str, picture: NDArray[np.uint8], quality: tuple[int, int], attribute: str = "") -> str:
    """A picture (BGR) with its caption, embedded."""
    data = base64.b64encode(cv2.imencode(".webp", picture, quality)[1].tobytes()).decode()
    source = f'<img alt="{html.escape(title)}" src="data:image/webp;base64,{data}">'
    return (
        f"<figure{attribute}>{source}<figcaption><b>{html.escape(title)}</b> {html.escape(text)}</figcaption></figure>"
    )


def _clean(view: View, scale: Scale, wide: Depth, narrow: Depth) -> list[str]:
    nearest = float(wide.min())
    text = f"nearest {nearest:.2f} m" if np.isfinite(nearest) else "nothing within range"
    return [scale.figure(view.title, text, wide), scale.figure("", "", narrow)]


def _model_figures(scale: Scale, camera: DepthCamera, true: Depth, reported: Depth) -> list[str]:
    figures = []
    for title, depth in (("true", true), ("as reported", reported)):
        seen = model_image(depth_frame(camera.matching, depth_in_millimetres(depth)))
        pixels = camera.for_model(np.where(seen.valid, RANGE_M * seen.depth, np.float32(0.0)))
        figures.append(scale.figure(title, "", pixels))
    return figures


def _row(figures: Iterator[str] | list[str]) -> str:
    return f'<div class="row">{"".join(figures)}</div>'
