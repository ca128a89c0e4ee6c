"""A contact sheet of what the camera sees along a terrain."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from render.backends import make_renderer
from render.renderer import Renderer
from saltus import go1
from saltus.depth import D435I, MILLIMETRE, MODEL_CAMERA, RANGE_M, Intrinsics, depth_in_millimetres, model_image
from saltus.errors import SaltusError
from saltus.kinematics import quaternion_from_roll_pitch_yaw
from saltus.messages import DepthFrame, Floats
from saltus.terrain.terrain import Terrain

Image = NDArray[np.uint8]

MARGIN = 12  # px
TITLE = 22  # px
FONT = cv2.FONT_HERSHEY_SIMPLEX
NOTHING_COLOUR = (70, 70, 70)
BACKGROUND = 255
HEADINGS = ("424 x 240, as rendered", "16 x 48, as rendered", "cut from 424 x 240")


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


# front feet stretched ahead and inwards, as far as the joints allow: where the narrow camera can see them
REACHING = np.array([0.8, -0.6, -0.95, -0.8, -0.6, -0.95, 0.0, 0.9, -1.8, 0.0, 0.9, -1.8])
VIEWS = (
    View(title="standing", before_edge=0.8, clearance=go1.STAND_HEIGHT, pitch=0.0, joints=go1.STAND_POSE),
    View(title="taking off", before_edge=0.4, clearance=0.35, pitch=-0.25, joints=go1.STAND_POSE),
    View(title="in flight", before_edge=-0.3, clearance=0.40, pitch=0.15, joints=go1.STAND_POSE),
    View(title="reaching ahead", before_edge=0.9, clearance=0.45, pitch=0.0, joints=REACHING),
)


def write_preview(terrain: Terrain, path: Path, renderer: str = "auto") -> Path:
    """Writes a PNG with depth at both resolutions from a few poses; near is red, 3 m is blue, nothing is grey.

    Args:
        terrain: to look at.
        path: of the image; its folder must exist.
        renderer: name of the back end.

    Returns:
        `path`.

    Raises:
        SaltusError: the file cannot be written.
    """
    wide = _seen(make_renderer(renderer, terrain, D435I))
    narrow = _seen(make_renderer(renderer, terrain, MODEL_CAMERA))
    sheet = contact_sheet([(VIEWS[i].title, wide[i], narrow[i]) for i in range(len(VIEWS))])
    try:
        written = cv2.imwrite(str(path), sheet)
    except cv2.error as error:
        raise SaltusError(f"cannot write {path}: {error}") from error
    if not written:
        raise SaltusError(f"cannot write {path}: does its folder exist?")
    return path


def contact_sheet(rows: list[tuple[str, NDArray[np.float32], NDArray[np.float32]]]) -> Image:
    """One row a view: title, depth of the wide camera and of the model's [m]; returns a BGR image."""
    strips = []
    for title, wide, narrow in rows:
        cut = model_image(_frame(wide, D435I))
        pictures = [_coloured(wide), _coloured(narrow), _coloured(np.where(cut.valid, RANGE_M * cut.depth, np.inf))]
        cells = [_titled(p, t) for p, t in zip(pictures, (f"{title}: {HEADINGS[0]}", *HEADINGS[1:]), strict=True)]
        strips.append(np.concatenate(cells, axis=1))
    return np.concatenate(strips, axis=0)


def _seen(renderer: Renderer) -> NDArray[np.float32]:
    """Depth from every view, shape (views, height, width)."""
    edge = renderer.terrain.first_edge_x if np.isfinite(renderer.terrain.first_edge_x) else 1.5
    x = np.array([edge - view.before_edge for view in VIEWS])
    near = x[:, None] + np.linspace(-0.25, 0.25, 11)
    z = renderer.terrain.height_at(near).max(axis=1) + [view.clearance for view in VIEWS]
    level = np.zeros(len(VIEWS))
    quaternion = quaternion_from_roll_pitch_yaw(level, np.array([view.pitch for view in VIEWS]), level)
    depth = renderer.render_batch(np.stack([x, level, z], axis=-1), quaternion, np.stack([v.joints for v in VIEWS]))
    renderer.close()
    return depth


def _frame(depth: NDArray[np.float32], camera: Intrinsics) -> DepthFrame:
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


def _coloured(depth: NDArray[np.floating]) -> Image:
    """Colours of depth, enlarged to the height of the wide camera without smoothing."""
    near = np.clip(1.0 - depth / RANGE_M, 0.0, 1.0)
    colours = cv2.applyColorMap((255 * near).astype(np.uint8), cv2.COLORMAP_TURBO)
    colours[~np.isfinite(depth)] = NOTHING_COLOUR
    scale = D435I.height // depth.shape[0]
    return colours.repeat(scale, axis=0).repeat(scale, axis=1)


def _titled(picture: Image, title: str) -> Image:
    """A picture in a white frame with its title on top; the frame is as wide as the title needs."""
    text_width = cv2.getTextSize(title, FONT, 0.45, 1)[0][0]
    width = max(picture.shape[1], text_width)
    cell = np.full((picture.shape[0] + TITLE + MARGIN, width + 2 * MARGIN, 3), BACKGROUND, dtype=np.uint8)
    cell[TITLE : TITLE + picture.shape[0], MARGIN : MARGIN + picture.shape[1]] = picture
    cv2.putText(cell, title, (MARGIN, TITLE - 7), FONT, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return cell
