"""Pictures of what a run saw and predicted, for pages and beside the robot in videos."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from saltus.depth import RANGE_M
from saltus.watch.scene import HeightsInWorld, Scene, SceneWorld
from saltus.wire.messages import DepthFrame, HeightmapStatus

RgbPicture = NDArray[np.uint8]

NEAR_M = 0.2  # what is nearer has the same colour; a D435i sees nothing there
NOTHING_COLOUR, INVALID_COLOUR = (110, 110, 110), (0, 0, 0)
PLOTTED_M = (-0.9, 0.7)  # a trench of 0.4 m below a standing robot, a step of 0.8 m ahead of it
PALETTE = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[
    :, 0, ::-1
]

BESIDE = (416, 720)
"""Width and height of what stands beside the robot in a video [px]."""
PAPER, INK, PALE, BAND = (255, 255, 255), (40, 44, 52), (150, 156, 165), (246, 219, 200)
# Okabe and Ito's palette, as on the page
PREDICTED, TRUE, UNTRUSTED = (
    (213, 94, 0),
    (0, 158, 115),
    (150, 150, 150),
)
DEPTH_BOX = (20, 150, 236, 300)  # left, top, width and height: of the image, which keeps its shape
PLOT_BOX = (56, 500, 340, 180)
TICKS_X, TICKS_Z = (-0.4, 0.0, 0.4, 0.8), (-0.8, -0.4, 0.0, 0.4)  # [m]


def depth_picture(frame: DepthFrame) -> NDArray[np.uint8]:
    """A depth image in colours (RGB): near is bright,
    nothing within range is grey, invalid is black.
    """
    depth = frame.depth.astype(np.float64) * frame.depth_unit_m
    share = np.log(np.clip(depth, NEAR_M, RANGE_M) / NEAR_M) / math.log(RANGE_M / NEAR_M)
    colours = PALETTE[np.rint(255 * (1.0 - share)).astype(np.uint8)].copy()
    colours[frame.depth == np.iinfo(np.uint16).max] = NOTHING_COLOUR
    colours[frame.depth == 0] = INVALID_COLOUR
    return colours


def heightmap_curves(heights: HeightsInWorld, scene: Scene) -> tuple[NDArray[np.float64], ...]:
    """x, lower and upper end of the 90 % interval,
    prediction and truth (prediction, where nobody knows it) [m].

    Heights are relative to the base, those of the grid's middle column; each of shape (rows,).
    """
    base = 0.0 if scene.base_pose is None else float(scene.base_pose[2])
    predicted = heights.predicted[:, 2] - base
    # A plot holds numbers only
    true = predicted if heights.true is None else heights.true[:, 2] - base
    found = (
        heights.x,
        predicted - heights.half_width_90,
        predicted + heights.half_width_90,
        predicted,
        true,
    )
    middle = heights.shape[1] // 2
    return tuple(
        np.asarray(curve, dtype=np.float64).reshape(heights.shape)[:, middle] for curve in found
    )


def video_panel(world: SceneWorld, scene: Scene) -> RgbPicture:
    """Time and speed, the depth image and the heights of a scene, for a video.

    Shape (720, 416, 3), RGB.
    """
    page = np.full((BESIDE[1], BESIDE[0], 3), PAPER, dtype=np.uint8)
    _write(page, world.title, (20, 36), 0.62)
    speed = f"{scene.speed_mps:.2f} m/s" if math.isfinite(scene.speed_mps) else ""
    mode = "" if scene.mode is None else scene.mode.name.lower()
    for left, name, value in (
        (20, "time", f"{scene.time_s:.2f} s"),
        (150, "speed", speed),
        (300, "mode", mode),
    ):
        _write(page, name, (left, 68), 0.45, PALE)
        _write(page, value, (left, 96), 0.68)
    _write(page, "depth image", (20, 138), 0.45, PALE)
    if scene.depth is not None:
        _draw_depth(page, scene.depth, scene.time_s)
    _write(page, "heights relative to the base [m], by distance ahead [m]", (20, 484), 0.45, PALE)
    _draw_heights(page, scene)
    return page


def _draw_depth(page: RgbPicture, frame: DepthFrame, now_s: float) -> None:
    left, top, width, height = DEPTH_BOX
    rows, columns = frame.depth.shape
    scale = min(width / columns, height / rows)
    size = (max(1, round(scale * columns)), max(1, round(scale * rows)))
    page[top : top + size[1], left : left + size[0]] = cv2.resize(
        depth_picture(frame), size, interpolation=cv2.INTER_NEAREST
    )
    bar = left + size[0] + 14
    colours = cv2.resize(PALETTE[:, None].copy(), (10, size[1]), interpolation=cv2.INTER_LINEAR)
    page[top : top + size[1], bar : bar + 10] = colours
    for share, depth_m in zip(
        np.linspace(0.0, 1.0, 5), np.geomspace(RANGE_M, NEAR_M, 5), strict=True
    ):
        _write(
            page, f"{depth_m:.2g} m", (bar + 16, round(top + 8 + share * (size[1] - 8))), 0.4, PALE
        )
    told = (
        f"{1e3 * (now_s - 1e-9 * frame.time_ns):.0f} ms old",
        f"{100 * float((frame.depth == 0).mean()):.0f} % invalid",
    )
    for row, text in enumerate(told):
        _write(page, text, (bar + 70, top + 14 + 22 * row), 0.45)


def _draw_heights(page: RgbPicture, scene: Scene) -> None:
    left, top, width, height = PLOT_BOX
    heights = scene.heights

    def place(x: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.int32]:
        right = left + width * (x - TICKS_X[0]) / (TICKS_X[-1] - TICKS_X[0])
        down = top + height * (PLOTTED_M[1] - np.clip(z, *PLOTTED_M)) / (
            PLOTTED_M[1] - PLOTTED_M[0]
        )
        return np.rint(np.stack([right, down], axis=-1)).astype(np.int32)

    for tick in TICKS_Z:
        (_, y) = place(np.array(0.0), np.array(tick)).tolist()
        cv2.line(page, (left, y), (left + width, y), (228, 231, 235), 1)
        _write(page, f"{tick:.1f}", (20, y + 4), 0.4, PALE)
    for tick in TICKS_X:
        (x, _) = place(np.array(tick), np.array(0.0)).tolist()
        _write(page, f"{tick:.1f}", (x - 12, top + height + 22), 0.4, PALE)
    if heights is None:
        return
    x, low, high, predicted, true = heightmap_curves(heights, scene)
    usable = heights.status in (HeightmapStatus.OK, HeightmapStatus.DEGRADED)
    cv2.fillPoly(
        page,
        [np.concatenate([place(x, low), place(x, high)[::-1]])],
        BAND if usable else (225, 225, 225),
    )
    if heights.true is not None:
        cv2.polylines(page, [place(x, true)], False, TRUE, 2, cv2.LINE_AA)
    cv2.polylines(
        page, [place(x, predicted)], False, PREDICTED if usable else UNTRUSTED, 2, cv2.LINE_AA
    )
    _write(
        page,
        "predicted, 90 % interval",
        (left + 4, top + 16),
        0.42,
        PREDICTED if usable else UNTRUSTED,
    )
    if heights.true is not None:
        _write(page, "true", (left + 210, top + 16), 0.42, TRUE)


def _write(
    page: RgbPicture,
    text: str,
    place: tuple[int, int],
    size: float,
    colour: tuple[int, int, int] = INK,
) -> None:
    cv2.putText(page, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
