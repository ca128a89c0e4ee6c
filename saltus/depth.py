"""From the image of any depth camera to what the heightmap model sees.

The model looks through a camera of 16 x 48 pixels. A frame is cropped to that field of view by its
intrinsics and pooled by area: each pixel of the model averages the valid part of what it covers.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Array, namespace
from saltus.wire.messages import DepthFrame

RANGE_M = 3.0
"""Greatest depth; farther things count as this far (original)."""
MILLIMETRE = 0.001
"""Depth unit of simulated frames [m]; default of the D435i."""
NOTHING = 65535
"""Depth of a pixel that sees nothing within range; 0 is invalid."""
# A pixel is valid where at least half of its area is; below, most of the average would be guessed
VALID_SHARE = 0.5
_ROUNDING = 1e-9


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
# 42.28 px, half of 16 pixels over the tangent of half the angle
_FOCAL = 8.0 / math.tan(0.5 * _HORIZONTAL_FOV)
MODEL_CAMERA = Intrinsics(width=16, height=48, fx=_FOCAL, fy=_FOCAL, cx=8.0, cy=24.0)
"""Intrinsics of the images that the model sees (original: the centre of 424 x 240 pixels, 80 x 240,
pooled by 5)."""
D435I = Intrinsics(width=424, height=240, fx=211.313, fy=211.313, cx=213.523, cy=120.012)
"""The camera on the authors' robot (original, which counts from pixel centres: there cx, cy are
half a pixel less)."""


BASELINE_M = 0.050
"""Distance of the imagers of a D435i (D435i datasheet)."""


def supersampled_model_camera(samples_down: int, samples_across: int) -> Intrinsics:
    """The model's camera with `samples_down` times `samples_across` samples for each pixel."""
    model = MODEL_CAMERA
    return Intrinsics(
        width=model.width * samples_across,
        height=model.height * samples_down,
        fx=model.fx * samples_across,
        fy=model.fy * samples_down,
        cx=model.cx * samples_across,
        cy=model.cy * samples_down,
    )


def is_within_model(camera: Intrinsics) -> bool:
    """True where a camera sees nothing beside the view of the model's."""
    sides = zip(_tangents(camera), _tangents(MODEL_CAMERA), strict=True)
    return all(own <= model + _ROUNDING for own, model in sides)


def _tangents(camera: Intrinsics) -> tuple[float, float, float, float]:
    """Tangents of the angles from its axis to which a camera sees: left, right, up and down."""
    right, bottom = camera.width - camera.cx, camera.height - camera.cy
    return camera.cx / camera.fx, right / camera.fx, camera.cy / camera.fy, bottom / camera.fy


def model_image(
    depth: Array, camera: Intrinsics | DepthFrame = MODEL_CAMERA, unit_m: float = MILLIMETRE
) -> Array:
    """Makes what a network sees of depth images: cropped and pooled to its camera, and normalised.

    Images of the model's own camera keep their pixels. What a camera does not cover is invalid.

    Args:
        depth: Whole steps of `unit_m`, 0 where invalid, `NOTHING` where nothing is within range.
            Numpy or torch, shape (..., height, width).
        camera: Intrinsics of the camera that took them, or a frame of it.
        unit_m: One step [m].

    Returns:
        Depth over 3 m in [0, 1], which is 1 where nothing is in range or the pixel is invalid; and
        1 where the pixel is valid, else 0. float32, shape (..., 2, 48, 16).
    """
    height, width = depth.shape[-2:]
    model = MODEL_CAMERA
    rows = _pooling(model.height, model.fy, model.cy, height, camera.fy, camera.cy)
    columns = _pooling(model.width, model.fx, model.cx, width, camera.fx, camera.cx)
    xp, batch = namespace(depth), tuple(depth.shape[:-2])
    raw = depth[..., rows.needed, columns.needed]
    image = xp.empty((*batch, 2, model.height, model.width), dtype=xp.float32, device=depth.device)
    if rows.place is None and columns.place is None:  # the model's own pixels: each is whole
        _fill(image[..., 0, :, :], image[..., 1, :, :], raw, unit_m)
        image[..., 0, :, :][raw == 0] = 1.0
        return image
    raw = rows.covering(raw.reshape((math.prod(batch), *raw.shape[-2:])), axis=1)
    layers = xp.empty((2, *raw.shape), dtype=xp.float32, device=raw.device)
    _fill(layers[0], layers[1], raw, unit_m)  # (2, n, some, 48, width)
    tall = rows.total(layers, axis=2)  # (2, n, 48, width)
    flat = tall.reshape((math.prod(tall.shape[:-1]), tall.shape[-1]))
    across = columns.covering(flat.T, axis=0)  # (some, 16, 2 * n * 48)
    sums = columns.total(across, axis=0).T.reshape((2, *batch, model.height, model.width))
    total, share = sums[0], sums[1]
    seen = (share >= VALID_SHARE) & (total <= share)  # which is not true of what is not a number
    # Far, never near: what cannot be seen must not look like an obstacle at the lens
    image[..., 0, :, :] = xp.where(seen, total / xp.where(seen, share, 1.0), 1.0)
    image[..., 1, :, :] = seen
    return image


def depth_in_millimetres(depth_m: Array) -> Array:
    """Depth [m] as a camera sends it: whole millimetres, `NOTHING` where it is beyond 65.5 m.

    Numpy's are uint16; torch's are int32, as torch has few operations for the other. Any shape.
    """
    xp = namespace(depth_m)
    steps = xp.round(xp.clip(depth_m, max=NOTHING * MILLIMETRE) * (1.0 / MILLIMETRE))
    return xp.astype(steps, xp.uint16 if xp is np else xp.int32)


def intrinsics_of(frame: DepthFrame) -> Intrinsics:
    """The camera that a frame says it was taken through."""
    height, width = frame.depth.shape
    return Intrinsics(
        width=width, height=height, fx=frame.fx, fy=frame.fy, cx=frame.cx, cy=frame.cy
    )


def depth_frame(
    camera: Intrinsics, depth_mm: NDArray[np.uint16], *, time_ns: int = 0, frame_id: int = 0
) -> DepthFrame:
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
    """Along one axis: which source pixels are needed,
    and how much of each model pixel each of them covers.
    """

    needed: slice
    """Pixels of the source that are needed."""
    count: int
    """Number of model pixels."""
    reached: slice
    """Model pixels that the source covers at all.

    Through a long lens these are few, and each is the mean of many.
    """
    place: NDArray[np.int64] | None
    """For each of these the source pixels that may cover it, counted within `needed`, shape (some,
    reached); None where the model pixels are those of the source."""
    weight: NDArray[np.float32]
    """Weight of each source pixel, shape (some, reached, 1), or without dimensions where all are
    the same; they add up to the covered share of a model pixel: 1 inside the source image."""

    def covering(self, values: Array, axis: int) -> Array:
        """Values that cover model pixels: the axis of the source becomes two, (some, reached)."""
        if self.place is None:
            return values[(slice(None),) * axis + (None,)]
        xp = namespace(values)
        taken = xp.take(values, xp.asarray(self.place.reshape(-1), device=values.device), axis=axis)
        return taken.reshape((*values.shape[:axis], *self.place.shape, *values.shape[axis + 1 :]))

    def total(self, covering: Array, axis: int) -> Array:
        """Weighted sums of what `covering` returned, in its memory,
        0 for model pixels that nothing covers.

        Not as products with matrices: for these BLAS may wake and await threads.

        Args:
            covering: Of any shape whose last axes are "some", "reached" and one more.
            axis: The one called "some"; in the result that of all model pixels.
        """
        if self.place is None:
            return covering.reshape((*covering.shape[:axis], *covering.shape[axis + 1 :]))
        xp = namespace(covering)
        covering *= xp.asarray(self.weight, device=covering.device)
        sums = xp.sum(covering, axis=axis)
        if sums.shape[axis] == self.count:
            return sums
        shape = (*sums.shape[:axis], self.count, *sums.shape[axis + 1 :])
        whole = xp.zeros(shape, dtype=xp.float32, device=covering.device)
        whole[(slice(None),) * axis + (self.reached,)] = sums
        return whole


def _fill(near: Array, seen: Array, raw: Array, unit_m: float) -> None:
    """Writes depth over 3 m in [0, 1], and 1 where there is one and 0 where not."""
    scale = float(np.float32(unit_m / RANGE_M))
    near[...] = raw
    near *= scale
    near[...] = namespace(near).minimum(near, 1.0)
    if scale * NOTHING < 1.0:
        near[raw == NOTHING] = 1.0
    seen[...] = raw > 0


@lru_cache(maxsize=64)
def _pooling(
    count: int,
    focal: float,
    centre: float,
    source_count: int,
    source_focal: float,
    source_centre: float,
) -> _Pooling:
    scale = source_focal / focal
    edges = source_centre + (np.arange(count + 1) - centre) * scale
    first = min(max(math.floor(edges[0]), 0), source_count)
    last = max(min(math.ceil(edges[-1]), source_count), first)
    begin, end = np.floor(edges[:-1]), np.ceil(edges[1:])
    # (some, count)
    pixel = begin + np.arange(int(np.max(end - begin)) if last > first else 0)[:, None]
    overlap = np.minimum(edges[1:], pixel + 1.0) - np.maximum(edges[:-1], pixel)
    inside = (pixel >= first) & (pixel < last)
    covered = np.flatnonzero(inside.any(0))
    reached = slice(int(covered[0]), int(covered[-1]) + 1) if len(covered) else slice(0)
    place = np.clip(pixel - first, 0, max(last - first - 1, 0)).astype(np.int64)[:, reached]
    weight = (np.where(inside, np.maximum(overlap, 0.0), 0.0) / scale).astype(np.float32)[
        :, reached
    ]
    own = np.array_equal(place, [np.arange(count)]) and bool((weight == 1.0).all())
    same = weight.size > 0 and bool((weight == weight[0, 0]).all())
    return _Pooling(
        needed=slice(first, last),
        count=count,
        reached=reached,
        place=None if own else place,
        weight=weight[0, 0, ...] if same else weight[..., None],
    )
