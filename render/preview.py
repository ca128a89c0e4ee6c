"""What the camera sees along a terrain, effect by effect, as one HTML file that opens without a network."""

import base64
import html
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from saltus.depth import D435I, MILLIMETRE, RANGE_M, Intrinsics, depth_in_millimetres, model_image
from saltus.render.camera import RobotCamera, camera_pose, ray_directions
from saltus.render.embree import EmbreeRenderer
from saltus.render.stereo.camera import StereoCamera, StereoConfig
from saltus.render.stereo.optics import Optics
from saltus.render.stereo_embree import StereoEmbree
from saltus.robots.robot import Robot
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.terrain.terrain import Terrain
from saltus.wire.messages import DepthFrame, Floats

Depth = NDArray[np.float32]
Poses = tuple[Floats, Floats, Floats]

EXPOSURES = 5  # of a camera that stands still, before its picture is shown: the temporal filter has settled by then
FRAME_S = 0.02
NOTHING_COLOUR, INVALID_COLOUR = (110, 110, 110), (0, 0, 0)
PICTURE_HEIGHT = 240  # px, of small images too
CLOUD_STRIDE = 2  # of the pixels along both axes: 25,000 points turn smoothly in a browser
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 1340px; margin: 2em auto; padding: 0 1em; color: #222; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin: 2em 0 0.3em; } p { color: #555; margin: 0.2em 0; }
.row { display: flex; flex-wrap: wrap; gap: 16px; } figure { margin: 0.5em 0; max-width: 424px; }
figure.narrow { max-width: 150px; } img { image-rendering: pixelated; height: 240px; display: block; }
figcaption { font-size: 0.85em; min-height: 3em; }
.scale { width: 424px; height: 14px; background: linear-gradient(to right, SCALE); } .ends { width: 424px; }
.ends span:last-child { float: right; }
"""


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


def write_preview(robot: Robot, terrain: Terrain, path: Path) -> Path:
    """Writes an HTML file: depth from a few poses, the camera's effects one by one, what the model gets, a point cloud.

    Args:
        robot: that looks.
        terrain: to look at.
        path: of the file; its folder must exist.

    Returns:
        `path`.

    Raises:
        OSError: the file cannot be written.
    """
    shown = views(robot)
    robots = poses(terrain, shown)
    wide = StereoEmbree(terrain, Optics.of(D435I), RobotCamera.on(robot, D435I))
    depth, hidden = wide.render_pair_batch(*robots)
    narrow = EmbreeRenderer(terrain, RobotCamera.on(robot)).render_batch(*robots)
    stages = list(effect_stages(depth[EFFECTS_VIEW], hidden[EFFECTS_VIEW], StereoConfig()))
    cloud = cloud_figure(wide, robots, depth[EFFECTS_VIEW], stages[-1][2])
    page = "".join(
        [
            f"<h1>What the camera sees on {html.escape(terrain.kind.replace('_', ' '))}</h1>",
            _scale(),
            "<h2>True depth, 424 x 240 and 16 x 48 pixels</h2>",
            _row(f for i, view in enumerate(shown) for f in _clean(view, depth[i], narrow[i])),
            f"<h2>{shown[EFFECTS_VIEW].title.capitalize()}: the effects of the camera, switched on in turn</h2>",
            _row(_figure(title, text, image) for title, text, image in stages),
            "<h2>What the model gets: cut and pooled to 16 x 48</h2>",
            _row(_model_figures(depth[EFFECTS_VIEW], stages[-1][2])),
            "<h2>Point cloud: true and as reported</h2>",
            cloud.to_html(full_html=False, include_plotlyjs=True),
        ]
    )
    style = f"<style>{STYLE.replace('SCALE', _colours_of_scale())}</style>"
    path.write_text(f"<!doctype html><meta charset='utf-8'><title>Camera</title>{style}{page}")
    return path


def poses(terrain: Terrain, shown: Sequence[View]) -> Poses:
    """The robots of views: positions, quaternions, joints."""
    edge = terrain.first_edge_x if np.isfinite(terrain.first_edge_x) else 1.5
    x = np.array([edge - view.before_edge for view in shown])
    near = x[:, None] + np.linspace(-0.25, 0.25, 11)
    z = terrain.height_at(near, 0.0).max(axis=1) + [view.clearance for view in shown]
    level = np.zeros(len(shown))
    quaternion = quaternion_from_roll_pitch_yaw(level, np.array([view.pitch for view in shown]), level)
    return np.stack([x, level, z], axis=-1), quaternion, np.stack([view.joints for view in shown])


def effect_stages(depth: Depth, hidden: NDArray[np.bool_], config: StereoConfig) -> Iterator[tuple[str, str, Depth]]:
    """Name, meaning and picture of every effect together with all that come before it.

    Args:
        depth: true depth of the D435I's pixels [m], shape (240, 424).
        hidden: what the right imager does not see, same shape.
        config: of the camera; effects at their null value are left out.
    """
    names = [effect.name for effect in config.effects if not effect.is_null()]
    for count in range(1, len(names) + 1):
        camera = StereoCamera(config.only(names[:count]), Optics.of(D435I))
        state = camera.init((), np.random.default_rng(0))  # the same noise at every stage
        for k in range(EXPOSURES):
            image, state = camera.step(depth, hidden, np.asarray(FRAME_S * k), state)
        effect = next(effect for effect in config.effects if effect.name == names[count - 1])
        meaning = (type(effect).__doc__ or "").strip().splitlines()[0].replace("`", "")
        yield names[count - 1].replace("_", " "), meaning, np.asarray(image.depth, dtype=np.float32)


def cloud_figure(wide: StereoEmbree, robots: Poses, true: Depth, reported: Depth) -> go.Figure:
    """Both depth images as points in the world."""
    origin, rotation = camera_pose(wide.mount, robots[0][EFFECTS_VIEW], robots[1][EFFECTS_VIEW])
    rays = ray_directions(D435I)[::CLOUD_STRIDE, ::CLOUD_STRIDE] @ rotation.T
    figure = go.Figure()
    for name, depth, colour in (("true", true, "#999999"), ("as reported", reported, "#0072B2")):
        sampled = depth[::CLOUD_STRIDE, ::CLOUD_STRIDE]
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


def coloured(depth: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Colours of depth (BGR): near is red, 3 m is blue, nothing within sight is grey, invalid is black."""
    near = np.clip(1.0 - depth / RANGE_M, 0.0, 1.0)
    colours = cv2.applyColorMap((255 * near).astype(np.uint8), cv2.COLORMAP_TURBO)
    colours[~np.isfinite(depth)] = NOTHING_COLOUR
    colours[depth <= 0.0] = INVALID_COLOUR
    return colours.astype(np.uint8)


def _clean(view: View, wide: Depth, narrow: Depth) -> list[str]:
    nearest = float(wide.min())
    return [
        _figure(view.title, f"nearest {nearest:.2f} m" if np.isfinite(nearest) else "nothing in sight", wide),
        _figure("", "", narrow),
    ]


def _model_figures(true: Depth, reported: Depth) -> list[str]:
    figures = []
    for title, depth in (("true", true), ("as reported", reported)):
        seen = model_image(_frame(depth, D435I))
        figures.append(_figure(title, "", np.where(seen.valid, RANGE_M * seen.depth, np.float32(0.0))))
    return figures


def _frame(depth: Depth, camera: Intrinsics) -> DepthFrame:
    return DepthFrame(
        time_ns=0,
        frame_id=0,
        depth=depth_in_millimetres(depth),
        depth_unit_m=MILLIMETRE,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
    )


def _row(figures: Iterator[str] | list[str]) -> str:
    return f'<div class="row">{"".join(figures)}</div>'


def _figure(title: str, text: str, depth: Depth) -> str:
    """A picture with its caption, embedded."""
    picture = base64.b64encode(cv2.imencode(".png", coloured(depth))[1].tobytes()).decode()
    narrow = ' class="narrow"' if depth.shape[1] < depth.shape[0] else ""
    caption = f"<b>{html.escape(title)}</b> {html.escape(text)}"
    source = f'<img alt="{html.escape(title)}" src="data:image/png;base64,{picture}">'
    return f"<figure{narrow}>{source}<figcaption>{caption}</figcaption></figure>"


def _scale() -> str:
    ends = f'<div class="ends"><span>0 m</span><span>{RANGE_M:g} m and beyond</span></div>'
    return f'<p>Grey: nothing in sight. Black: invalid.</p><div class="scale"></div>{ends}'


def _colours_of_scale() -> str:
    colours = coloured(np.linspace(1e-3, RANGE_M, 16)[None])[0]
    return ", ".join(f"rgb({red},{green},{blue})" for blue, green, red in colours.tolist())
