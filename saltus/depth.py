"""From the image of any depth camera to what the heightmap model sees.

The model looks through a camera of 16 x 48 pixels. A frame is cropped to that field of view by its intrinsics and
pooled by area: each pixel of the model averages the valid part of what it covers.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from saltus.messages import DepthFrame, Floats

RANGE_M = 3.0
"""What is farther is as far as this (original)."""
MILLIMETRE = 0.001
"""Depth unit of simulated frames [m]; default of the D435i."""
NOTHING = 65535
"""Depth of a pixel that sees nothing within range; 0 is invalid."""
VALID_SHARE = 0.5  # a pixel is valid where at least half of its area is; below, most of the average would be guessed


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """A pin-hole camera: pixel (u, v) looks through ((u + 0.5 - cx) / fx, (v + 0.5 - cy) / fy)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


_HORIZONTAL_FOV = math.radians(21.43)  # original
_FOCAL = 8.0 / math.tan(0.5 * _HORIZONTAL_FOV)  # 42.28 px, half of 16 pixels over the tangent of half the angle
MODEL_CAMERA = Intrinsics(width=16, height=48, fx=_FOCAL, fy=_FOCAL, cx=8.0, cy=24.0)
"""What the model looks through (original: the centre of 424 x 240 pixels, 80 x 240, pooled by 5)."""
D435I = Intrinsics(width=424, height=240, fx=211.313, fy=211.313, cx=213.523, cy=120.012)
"""The camera on the authors' robot (original, which counts from pixel centres: there cx, cy are half a pixel less)."""


BASELINE_M = 0.050
"""Distance of the imagers of a D435i (D435i datasheet)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelImage:
    """What the model sees, for any leading batch dimensions."""

    depth: NDArray[np.float32]
    """Depth over 3 m in [0, 1]; 1 where nothing is in range or the pixel is invalid. Shape (..., 48, 16)."""
    valid: NDArray[np.bool_]
    """Shape (..., 48, 16)."""


def model_image(frame: DepthFrame) -> ModelImage:
    """Crops and pools a frame to the model's camera; parts that it does not cover are invalid.

    A frame with the model's own intrinsics keeps its pixels.
    """
    height, width = frame.depth.shape
    rows = _pooling(MODEL_CAMERA.height, MODEL_CAMERA.fy, MODEL_CAMERA.cy, height, frame.fy, frame.cy)
    columns = _pooling(MODEL_CAMERA.width, MODEL_CAMERA.fx, MODEL_CAMERA.cx, width, frame.fx, frame.cx)
    raw = frame.depth[rows.needed, columns.needed]
    layers = np.empty((raw.shape[0], 2, raw.shape[1]), np.float32)
    near = layers[:, 0]
    np.multiply(raw, np.float32(frame.depth_unit_m / RANGE_M), out=near)
    np.minimum(near, np.float32(1.0), out=near)
    near[raw == NOTHING] = 1.0  # whatever the unit
    np.greater(raw, 0, out=layers[:, 1], casting="unsafe")
    depth, share = _pooled(layers, rows, columns)
    seen = share >= VALID_SHARE
    share[~seen] = 1.0
    return _marked(depth / share, seen)


def model_images(depth_m: Floats) -> ModelImage:
    """The same for rendered images of the model's camera.

    Args:
        depth_m: along the optical axis [m]; infinite where nothing is hit, 0 or not a number where invalid. Shape
            (..., 48, 16).
    """
    depth = np.asarray(depth_m, dtype=np.float32)
    return _marked(np.minimum(depth * np.float32(1.0 / RANGE_M), np.float32(1.0)), depth > 0.0)


def depth_in_millimetres(depth_m: Floats) -> NDArray[np.uint16]:
    """Rendered depth [m] as a camera sends it: whole millimetres; `NOTHING` where it is infinite or beyond 65.5 m."""
    millimetres = np.rint(np.minimum(depth_m, NOTHING * MILLIMETRE) * (1.0 / MILLIMETRE))
    return millimetres.astype(np.uint16)


def _marked(depth: NDArray[np.float32], valid: NDArray[np.bool_]) -> ModelImage:
    """Invalid pixels look far, never near: what cannot be seen must not look like an obstacle at the lens."""
    return ModelImage(depth=np.where(valid, depth, np.float32(1.0)), valid=valid)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pooling:
    """Along one axis: which source pixels are needed, and how much of each model pixel each of them covers."""

    needed: slice
    """Of the source."""
    place: NDArray[np.int64]
    """For each model pixel those that may cover it, counted within `needed`, shape (count, some)."""
    weight: NDArray[np.float32]
    """Of each, shape (count, some); they add up to the covered share of a model pixel: 1 inside the source image."""


def _pooled(layers: NDArray[np.float32], rows: _Pooling, columns: _Pooling) -> NDArray[np.float32]:
    """Weighted sums for all model pixels of layers of shape (height, n, width); shape (n, 48, 16).

    Not as products with matrices: for these BLAS may wake and await threads.
    """
    height, count, width = layers.shape
    flat = layers.reshape(height, count * width)
    tall = np.einsum("nk,nkw->nw", rows.weight, flat[rows.place]).reshape(len(rows.place), count, width)
    result: NDArray[np.float32] = np.einsum("nk,mcnk->cmn", columns.weight, tall[:, :, columns.place])
    return result


@lru_cache(maxsize=64)
def _pooling(
    count: int, focal: float, centre: float, source_count: int, source_focal: float, source_centre: float
) -> _Pooling:
    scale = source_focal / focal
    edges = source_centre + (np.arange(count + 1) - centre) * scale
    first = min(max(math.floor(edges[0]), 0), source_count)
    last = max(min(math.ceil(edges[-1]), source_count), first)
    begin, end = np.floor(edges[:-1]), np.ceil(edges[1:])
    pixel = begin[:, None] + np.arange(int(np.max(end - begin)) if last > first else 0)
    overlap = np.minimum(edges[1:, None], pixel + 1.0) - np.maximum(edges[:-1, None], pixel)
    inside = (pixel >= first) & (pixel < last)
    return _Pooling(
        needed=slice(first, last),
        place=np.clip(pixel - first, 0, max(last - first - 1, 0)).astype(np.int64),
        weight=(np.where(inside, np.maximum(overlap, 0.0), 0.0) / scale).astype(np.float32),
    )
