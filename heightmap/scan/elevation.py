"""The robocentric map: heights along the odometry's axes
in a window that follows the base by whole cells.

Positions are those of the odometry, corrected by what matching and standing feet tell of its drift.
So the map stays where it is, and the robot moves in it; nothing is blurred by resampling. One law
for numpy and torch; a batch of robots always, one when deployed.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from saltus.arrays import Array, Constant, namespace
from saltus.heightmap.scan.cells import (
    NO_LINE_M,
    CellHeights,
    HitCells,
    cell_centres,
    fine_cell_positions,
    lowest_lines,
    move_window,
    sample_bilinear,
    sorted_into_cells,
    window_corner,
)
from saltus.heightmap.scan.filling import fill_cells
from saltus.heightmap.scan.matching import PoseError, match_drift, slopes_of
from saltus.heightmap.scan.settings import MapSettings

UNKNOWN_M2 = 1e3
"""Variance of a height that nothing is known about [m^2]."""
NEVER_S = -1e6
"""When a cell was seen that never was [s]."""
FADES = 0.9
"""Share that an image leaves of the distance of a cell's extremes from its height."""
CALMS = 0.9
"""Share of `ElevationMap.unrest` that an image leaves."""
SURE = 3.0
"""So many deviations of depth at the end of a line of sight are left out, as if it were level."""
BODY_M = 0.15
"""Half of a square under the base for whose height the body's usual one is a guess [m]."""
BODY_WEIGHT = 1e-3
"""Weight of that guess beside a measured height."""
_SOLE = Constant([[i, j, 0] for i in (-1, 0, 1) for j in (-1, 0, 1)])
"""Cells around its centre that a foot covers: one of 2 to 3 cm covers three by three of 2 cm."""
WIDEST = 1.0
"""Half-width [m] that a map without memory starts with."""


class OdometryPoses(NamedTuple):
    """Poses of the bases of a batch of robots in the odometry's world."""

    position: Array
    """[m], shape (batch, 3)."""
    rotation: Array
    """Base to world, shape (batch, 3, 3)."""


class MapUpdate(NamedTuple):
    """Everything that one image and the robot's state at its arrival tell the elevation map."""

    points: Array
    """In the base frame at the exposure [m], shape (batch, n, 3)."""
    depth: Array
    """Along the camera's axis [m], which says how sure a point is; 0 where there is none. Shape
    (batch, n)."""
    exposed: OdometryPoses
    """When the image was taken."""
    now: OdometryPoses
    feet: Array
    """In the base frame now: undersides of feet [m], shape (batch, feet, 3)."""
    standing: Array
    """Which of them surely stand, as truth values, shape (batch, feet)."""
    body_height: Array
    """Height of the base above the ground when the robot stands [m], roughly. Shape (batch,)."""
    exposed_s: Array
    """Time of the exposure [s], on any clock. Shape (batch,)."""
    odometry_error: Array
    """Errors that the odometry is known to have, in units of usual ones (speed off by 3 %, attitude
    by 0.4 degrees; `saltus.heightmap.scan.training.flight_odometry`): 0 none. Shape (batch,)."""
    mount_error: Array
    """The same of where the cameras sit and of their scale (usual: 0.3 degrees, 3 mm, 0.8 %;
    `saltus.depth_camera.DepthCamera.mount_error`). Shape (batch,)."""
    viewpoint: Array
    """Place of the camera that saw each point, in the base frame at the exposure [m], shape
    (batch, n, 3), or (batch, 1, 3) for one camera."""


class ElevationMap(NamedTuple):
    """State of a batch of robots' elevation maps: heights and their variances in cells around the
    base.

    Arrays of cells have shape (batch, side, side), heights are in the odometry's world [m].
    """

    height: Array
    variance: Array
    """[m^2]."""
    high: Array
    """The highest point that a cell had lately, and likewise `low`."""
    low: Array
    clear: Array
    """The lowest line of sight that passed over the cell, of the last half metre before each point;
    `NO_LINE_M` where none did."""
    seen_s: Array
    """Time of the last image with a point in the cell [s]."""
    told: Array
    """Height that the network told of the cell last."""
    told_width: Array
    """Its half-width [m]; `WIDEST` where it told none."""
    corner: Array
    """First cell of the window, see `saltus.heightmap.scan.cells.window_corner`.

    Shape (batch, 2).
    """
    correction: Array
    """Added to the odometry's positions [m], shape (batch, 3)."""
    images: Array
    """How many the map was made from, shape (batch,)."""
    unrest: Array
    """How much images lately moved [m] and tilted [rad] the pose: how good the odometry is.
    Shape (batch, 2)."""


class MapContext(NamedTuple):
    """Quantities beside the elevation map that the scan's network is told after an image."""

    filled: Array
    """Height of every cell in the odometry's world [m]."""
    new: CellHeights
    """Heights of this image."""
    feet: CellHeights
    """Heights of the feet that stand."""
    base: Array
    """Position of the base, corrected [m], shape (batch, 3)."""
    drift: Array
    """Change by this image and the feet of the correction [m], shape (batch, 3)."""


def new_map(batch: int, settings: MapSettings, like: Array) -> ElevationMap:
    """A map that knows nothing, with library, type and device of `like`."""
    xp, shape = namespace(like), (batch, settings.side, settings.side)
    of: dict[str, Any] = {"dtype": like.dtype, "device": like.device}
    zeros = [xp.zeros(shape, **of) for _ in range(4)]
    return ElevationMap(
        height=zeros[0],
        variance=xp.full(shape, UNKNOWN_M2, **of),
        high=zeros[1],
        low=zeros[2],
        clear=xp.full(shape, NO_LINE_M, **of),
        seen_s=xp.full(shape, NEVER_S, **of),
        told=zeros[3],
        told_width=xp.full(shape, WIDEST, **of),
        corner=xp.zeros((batch, 2), dtype=xp.int64, device=like.device),
        correction=xp.zeros((batch, 3), **of),
        images=xp.zeros((batch,), **of),
        unrest=xp.zeros((batch, 2), **of),
    )


def is_known(state: ElevationMap) -> Array:
    """Where the map was measured, as truth values."""
    return state.variance < 0.5 * UNKNOWN_M2


def advance_map(
    state: ElevationMap, measured: MapUpdate, settings: MapSettings
) -> tuple[ElevationMap, MapContext]:
    """The map after an image: moved to the base,
    corrected for drift, and with the new heights in it.
    """
    before = state.correction
    state = _moved(state, measured.now.position + before, settings)
    # Looks before the last one are for matching alone, which needs no extremes.
    new = _of_image(state, measured, settings, extremes=not settings.matching)
    if settings.matching:
        state, measured, new = _matched(state, measured, new, settings)
    clear = _clear(state, measured, new, settings)
    state = _fused(state, new, settings)._replace(images=state.images + 1.0, clear=clear)
    state, feet = _with_feet(state, measured, settings)
    xp, known = namespace(state.height), is_known(state)
    latest = xp.where(new.count > 0.0, measured.exposed_s[:, None, None], state.seen_s)
    state = state._replace(seen_s=latest)
    base = measured.now.position + state.correction
    guess, weight = _under_body(state, base, measured.body_height, settings)
    whole = fill_cells(xp.where(known, state.height, guess), xp.where(known, 1.0, weight))
    return state, MapContext(
        filled=whole, new=new, feet=feet, base=base, drift=state.correction - before
    )


def _matched(
    state: ElevationMap, measured: MapUpdate, new: CellHeights, settings: MapSettings
) -> tuple[ElevationMap, MapUpdate, CellHeights]:
    """The map with its pose corrected by what an image shows of the drift, the image tilted back,
    and its heights from there.
    """
    exposed = measured.exposed
    shift: Array = 0.0
    tilt: Array = 0.0
    known = is_known(state)
    slopes = slopes_of(state.height, known, settings.fine_m)
    for look in range(settings.looks):
        away = _away(state, exposed.position + state.correction, settings)
        found = match_drift(state.height, state.variance, known, slopes, new, away, settings)
        shift, tilt = shift + found.shift, tilt + found.tilt
        state = state._replace(correction=state.correction - found.shift)
        measured = measured._replace(exposed=_tilted(exposed, tilt))
        new = _of_image(state, measured, settings, extremes=look + 1 == settings.looks)
    return state._replace(unrest=_unrest(state.unrest, PoseError(shift, tilt))), measured, new


def _moved(state: ElevationMap, position: Array, settings: MapSettings) -> ElevationMap:
    corner = window_corner(position, settings)
    by = (corner - state.corner) * settings.sub
    if isinstance(by, np.ndarray) and not by.any():  # of a GPU this is not asked, as that waits
        return state
    unknown = {
        "variance": UNKNOWN_M2, "clear": NO_LINE_M, "seen_s": NEVER_S, "told_width": WIDEST
    }  # fmt: skip
    cells = ("height", "variance", "high", "low", "clear", "seen_s", "told", "told_width")
    kept = {name: move_window(getattr(state, name), by, unknown.get(name, 0.0)) for name in cells}
    return state._replace(corner=corner, **kept)


def _of_image(
    state: ElevationMap, measured: MapUpdate, settings: MapSettings, *, extremes: bool
) -> CellHeights:
    """Heights of an image's points."""
    points = _in_odometry(state, measured.points, measured.exposed)
    variance = _depth_deviation(measured, settings) ** 2 + settings.point_noise_m**2
    return sorted_into_cells(
        points, variance, measured.depth > 0.0, state.corner, settings, extremes=extremes
    )


def _tilted(pose: OdometryPoses, tilt: Array) -> OdometryPoses:
    """The pose tilted back by what matching found [rad]."""
    x, y, z = (pose.rotation[:, row] for row in range(3))
    rows = [x, y, z - tilt[:, :1] * y + tilt[:, 1:] * x]
    return pose._replace(rotation=namespace(tilt).stack(rows, axis=1))


def _in_odometry(state: ElevationMap, points: Array, exposed: OdometryPoses) -> Array:
    """Points (batch, n, 3) in the base frame, in the odometry's corrected world [m]."""
    xp, position = namespace(state.height), exposed.position + state.correction
    # Each axis lies in one piece, in which numpy adds and compares in a sixth of the time
    turned = xp.matrix_transpose(exposed.rotation @ xp.matrix_transpose(points))
    return turned + position[:, None, :]


def _depth_deviation(measured: MapUpdate, settings: MapSettings) -> Array:
    """Standard deviation of each depth [m]."""
    return settings.depth_noise * measured.depth**2


def _clear(
    state: ElevationMap, measured: MapUpdate, new: CellHeights, settings: MapSettings
) -> Array:
    """The lower of the map's and an image's lines of sight over each cell [m].

    Where the image's mean height in a cell is above that, the line is raised by a tenth of the
    difference.
    """
    xp = namespace(state.height)
    points, viewpoint = (
        _in_odometry(state, places, measured.exposed)
        for places in (measured.points, measured.viewpoint)
    )
    start = SURE * _depth_deviation(measured, settings)
    lines = lowest_lines(points, viewpoint, start, measured.depth > 0.0, state.corner, settings)
    clear = xp.minimum(state.clear, lines)
    above = (new.count > 0.0) * (new.mean - clear).clip(0.0, math.inf)
    return clear + (1.0 - FADES) * above


def _away(state: ElevationMap, position: Array, settings: MapSettings) -> tuple[Array, Array]:
    """X and y of the window's fine cells from a position [m]."""
    x, y = cell_centres(state.corner, settings, position)
    return x - position[:, :1, None], y - position[:, 1:2, None]


def _unrest(before: Array, change: PoseError) -> Array:
    """A mean that forgets, of the lengths of what was corrected."""
    xp = namespace(before)
    lengths = [xp.sum(part**2, axis=-1) ** 0.5 for part in change]
    return CALMS * before + (1.0 - CALMS) * xp.stack(lengths, axis=-1)


def _fused(state: ElevationMap, new: CellHeights, settings: MapSettings) -> ElevationMap:
    """Kalman's mean of each cell that the image hit."""
    hit = HitCells(new.count > 0.0)
    old, was_high, was_low = map(hit.of, (state.height, state.high, state.low))
    seen, spread, high, low = map(hit.of, (new.mean, new.variance, new.high, new.low))
    variance = hit.of(state.variance)
    xp, known, off = namespace(old), variance < 0.5 * UNKNOWN_M2, seen - old
    doubt = variance + xp.where(known, settings.surprise * off**2, 0.0)
    gain = doubt / (doubt + spread)
    height = old + gain * off
    was_high = xp.where(known, height + FADES * (was_high - old), high)
    was_low = xp.where(known, height + FADES * (was_low - old), low)
    variance = (gain * spread).clip(settings.least_m**2, UNKNOWN_M2)
    return state._replace(
        height=hit.put(state.height, height),
        variance=hit.put(state.variance, variance),
        high=hit.put(state.high, xp.maximum(high, was_high)),
        low=hit.put(state.low, xp.minimum(low, was_low)),
    )


def _with_feet(
    state: ElevationMap, measured: MapUpdate, settings: MapSettings
) -> tuple[ElevationMap, CellHeights]:
    """Moves the pose towards where standing feet touch the map,
    and puts them into it where it knows nothing.
    """
    xp = namespace(state.height)
    position = measured.now.position + state.correction
    feet = measured.feet @ xp.matrix_transpose(measured.now.rotation) + position[:, None, :]
    place = fine_cell_positions(feet[..., :2], state.corner, settings)
    known = sample_bilinear(xp.astype(is_known(state), feet.dtype), place) > 0.99
    gap = feet[..., 2] - sample_bilinear(state.height, place)
    counts = xp.astype(measured.standing & known & (xp.abs(gap) < settings.gate_m), feet.dtype)
    mean = xp.sum(counts * gap, axis=-1) / xp.sum(counts, axis=-1).clip(1.0, None)
    change = settings.foot_gain * mean
    level = xp.zeros_like(change)
    state = state._replace(correction=state.correction - xp.stack([level, level, change], -1))
    feet = feet - xp.stack([level, level, change], -1)[:, None, :]
    soles = feet[:, :, None, :] + settings.fine_m * _SOLE.like(feet)
    stands = xp.repeat(measured.standing, soles.shape[2], axis=1)
    soles = xp.reshape(soles, (len(feet), -1, 3))
    variance = xp.zeros_like(soles[..., 2]) + settings.foot_noise_m**2
    cells = sorted_into_cells(soles, variance, stands, state.corner, settings, extremes=False)
    # Where the map knows the ground, feet move the pose: a height that was drawn to the foot would
    # hide the drift.
    new = cells._replace(count=~is_known(state) * cells.count)
    return _fused(state, new, settings), cells


def _under_body(
    state: ElevationMap, base: Array, body_height: Array, settings: MapSettings
) -> tuple[Array, Array]:
    """The guess that the ground under the base is as far below it as usual,
    and its weight by cell.
    """
    xp = namespace(base)
    x, y = _away(state, base, settings)
    # One is a column, the other a row: cheaper than whole planes
    along, across = (xp.astype(xp.abs(way) < BODY_M, base.dtype) for way in (x, y))
    return (base[:, 2] - body_height)[:, None, None], BODY_WEIGHT * along * across
