"""From the image of any depth camera to what the heightmap model sees.

The model looks through a camera of 16 x 48 pixels. A frame is cropped to that field of view by its intrinsics and
pooled by area: each pixel of the model averages the valid part of what it covers.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Reals
from saltus.wire.messages import DepthFrame

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


def sampled_model_camera(rows: int, columns: int) -> Intrinsics:
    """The model's camera with `rows` times `columns` samples for each of its pixels."""
    model = MODEL_CAMERA
    return Intrinsics(
        width=model.width * columns,
        height=model.height * rows,
        fx=model.fx * columns,
        fy=model.fy * rows,
        cx=model.cx * columns,
        cy=model.cy * rows,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelImage:
    """What the model sees, for any leading batch dimensions."""

    depth: NDArray[np.float32]
    """Depth over 3 m in [0, 1]; 1 where nothing is in range or the pixel is invalid. Shape (..., 48, 16)."""
    valid: NDArray[np.bool_]
    """Shape (..., 48, 16)."""


def model_image(frame: DepthFrame) -> ModelImage:
    """Crops and pools a frame to the model's camera; parts that it does not cover are invalid.

    A frame with the model's own intrinsics keeps its pixels. Depth that is not a positive number counts as invalid.
    """
    height, width = frame.depth.shape
    rows = _pooling(MODEL_CAMERA.height, MODEL_CAMERA.fy, MODEL_CAMERA.cy, height, frame.fy, frame.cy)
    columns = _pooling(MODEL_CAMERA.width, MODEL_CAMERA.fx, MODEL_CAMERA.cx, width, frame.fx, frame.cx)
    raw = frame.depth[rows.needed, columns.needed]
    layers = _layers(rows.covering(raw), frame.depth_unit_m)  # (2, some, 48, width)
    tall = rows.total(layers, axis=1)  # (2, 48, width)
    across = columns.covering(tall.reshape(2 * MODEL_CAMERA.height, raw.shape[1]).T)  # (some, 16, 2 * 48)
    depth, share = columns.total(across, axis=0).reshape(-1, *tall.shape[:2]).transpose(1, 2, 0)  # (2, 48, 16)
    seen = share >= VALID_SHARE
    seen &= depth <= share  # which is not true of what is not a number
    mean = np.ones(seen.shape, np.float32)  # what cannot be seen must not look like an obstacle at the lens
    np.divide(depth, share, out=mean, where=seen)
    return ModelImage(depth=mean, valid=seen)


def model_images(depth_m: Reals) -> ModelImage:
    """The same for rendered images of the model's camera.

    Args:
        depth_m: along the optical axis [m]; infinite where nothing is hit, 0 or not a number where invalid. Shape
            (..., 48, 16).
    """
    depth = np.asarray(depth_m, dtype=np.float32)
    valid = depth > 0.0
    # Far, never near: what cannot be seen must not look like an obstacle at the lens
    near = np.where(valid, np.minimum(depth * np.float32(1.0 / RANGE_M), np.float32(1.0)), np.float32(1.0))
    return ModelImage(depth=near, valid=valid)


def depth_in_millimetres(depth_m: Reals) -> NDArray[np.uint16]:
    """Rendered depth [m] as a camera sends it: whole millimetres; `NOTHING` where it is infinite or beyond 65.5 m."""
    millimetres = np.rint(np.minimum(depth_m, NOTHING * MILLIMETRE) * (1.0 / MILLIMETRE))
    return millimetres.astype(np.uint16)


def depth_frame(camera: Intrinsics, depth_mm: NDArray[np.uint16], *, time_ns: int = 0, frame_id: int = 0) -> DepthFrame:
    """An image [mm], shape (height, width), as a camera sends it."""
    return DepthFrame(
        time_ns=time_ns,
        frame_id=frame_id,
        depth=depth_mm,
        depth_unit_m=MILLIMETRE,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pooling:
    """Along one axis: which source pixels are needed, and how much of each model pixel each of them covers."""

    needed: slice
    """Of the source."""
    count: int
    """Of model pixels."""
    reached: slice
    """Model pixels that the source covers at all. Through a long lens these are few, and each is the mean of many."""
    place: NDArray[np.int64] | None
    """For each of these the source pixels that may cover it, counted within `needed`, shape (some, reached); None where
    the model pixels are those of the source."""
    weight: NDArray[np.float32]
    """Of each, shape (some, reached, 1), or without dimensions where all are the same; they add up to the covered share
    of a model pixel: 1 inside the source image."""

    def covering(self, values: NDArray[Any]) -> NDArray[Any]:
        """Of values along the first axis of the source those that cover model pixels: (some, reached, ...)."""
        return values[None] if self.place is None else np.take(values, self.place, axis=0)

    def total(self, covering: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
        """Weighted sums of what `covering` returned, in its memory, 0 for model pixels that nothing covers.

        Not as products with matrices: for these BLAS may wake and await threads.

        Args:
            covering: Of any shape that has the axes "some" and "reached" one after the other.
            axis: The one called "some"; in the result that of all model pixels.
        """
        if self.place is None:
            return covering.reshape(*covering.shape[:axis], *covering.shape[axis + 1 :])
        covering *= self.weight
        sums: NDArray[np.float32] = np.add.reduce(covering, axis=axis)
        if sums.shape[axis] == self.count:
            return sums
        whole = np.zeros((*sums.shape[:axis], self.count, *sums.shape[axis + 1 :]), np.float32)
        whole[(slice(None),) * axis + (self.reached,)] = sums
        return whole


def _layers(raw: NDArray[np.uint16], unit_m: float) -> NDArray[np.float32]:
    """Depth over 3 m in [0, 1], and 1 where there is one and 0 where not; shape (2, ...)."""
    scale = np.float32(unit_m / RANGE_M)
    layers = np.empty((2, *raw.shape), np.float32)
    near = layers[0]
    near[...] = raw
    near *= scale
    near.clip(0.0, 1.0, out=near)
    if scale * NOTHING < 1.0:
        near[raw == NOTHING] = 1.0
    layers[1] = raw > 0
    return layers


@lru_cache(maxsize=64)
def _pooling(
    count: int, focal: float, centre: float, source_count: int, source_focal: float, source_centre: float
) -> _Pooling:
    scale = source_focal / focal
    edges = source_centre + (np.arange(count + 1) - centre) * scale
    first = min(max(math.floor(edges[0]), 0), source_count)
    last = max(min(math.ceil(edges[-1]), source_count), first)
    begin, end = np.floor(edges[:-1]), np.ceil(edges[1:])
    pixel = begin + np.arange(int(np.max(end - begin)) if last > first else 0)[:, None]  # (some, count)
    overlap = np.minimum(edges[1:], pixel + 1.0) - np.maximum(edges[:-1], pixel)
    inside = (pixel >= first) & (pixel < last)
    covered = np.flatnonzero(inside.any(0))
    reached = slice(int(covered[0]), int(covered[-1]) + 1) if len(covered) else slice(0)
    place = np.clip(pixel - first, 0, max(last - first - 1, 0)).astype(np.int64)[:, reached]
    weight = (np.where(inside, np.maximum(overlap, 0.0), 0.0) / scale).astype(np.float32)[:, reached]
    own = np.array_equal(place, [np.arange(count)]) and bool((weight == 1.0).all())
    same = weight.size > 0 and bool((weight == weight[0, 0]).all())
    return _Pooling(
        needed=slice(first, last),
        count=count,
        reached=reached,
        place=None if own else place,
        weight=weight[0, 0, ...] if same else weight[..., None],
    )
