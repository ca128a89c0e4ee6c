"""Planes of the map that the network is shown, and the meaning of its answer:
plain numbers in SI units.
"""

from typing import NamedTuple

from saltus.arrays import Array, namespace
from saltus.heightmap.scan.elevation import (
    WIDEST,
    ElevationMap,
    MapContext,
    MapUpdate,
    is_known,
)

MEASURED = (
    "known", "deviation", "age", "new", "new_count", "new_high", "new_low", "high", "low", "foot",
    "foot_count", "clear",
)  # fmt: skip
"""Planes of `ScanInputs.measured`: whether a cell was ever measured (1 or 0), standard deviation
[m], time since its last point [s]; of this image's points the mean height, their count, the highest
and the lowest; the highest and lowest height lately; of standing feet mean height and count; and
the lowest line of sight over the cell, clipped to `REACH_M`, which also says that there was none.
Heights are above `ScanInputs.filled` [m]. Where nothing was measured, the others are 0."""
MEMORY = ("told", "told_width")
"""Planes of `ScanInputs.memory`: what the network told of the cell last, above `ScanInputs.filled`,
and its half-width [m]."""
NUMBERS = (
    "drift_x", "drift_y", "drift_z", "unrest_m", "unrest_rad", "images", "feet",
    "odometry_error", "mount_error",
)  # fmt: skip
"""`ScanInputs.numbers`: how far this image and the feet moved the pose [m], how much images lately
moved and tilted it [m, rad], how many images the map has, cells under standing feet, and the
errors that odometry and mounts are known to have (`MapUpdate`)."""
OLDEST_S, MOST_IMAGES = 3.0, 20.0
"""An older cell, or a map of more images, looks like this."""
REACH_M = 2.0
"""No height is farther than this from the ground under the robot; what is, looks like this."""


class ScanInputs(NamedTuple):
    """Inputs of the scan's network: planes of the robot's elevation map, cell by cell."""

    filled: Array
    """The map, filled where it knows nothing, above the ground under the base [m], shape (batch,
    side, side)."""
    measured: Array
    """Shape (batch, len(MEASURED), side, side)."""
    memory: Array
    """Shape (batch, 2, side, side)."""
    numbers: Array
    """Shape (batch, len(NUMBERS))."""


class MapHeights(NamedTuple):
    """Heights as the scan's network tells them: of each cell in the odometry's world, or of each
    point of a grid, relative to the base.
    """

    height: Array
    """[m]."""
    half_width: Array
    """Half of the 90 % interval [m]."""


def inputs_of(
    state: ElevationMap, around: MapContext, now_s: Array, image: MapUpdate
) -> ScanInputs:
    """Inputs of the network after an image; `now_s` has shape (batch,)."""
    xp = namespace(state.height)
    level = (around.base[:, 2] - image.body_height)[:, None, None]
    age = (now_s[:, None, None] - state.seen_s).clip(0.0, OLDEST_S)
    # Numpy multiplies by 0 or 1 in a tenth of the time of a choice
    known, hit, foot = (
        xp.astype(mask, age.dtype)
        for mask in (is_known(state), around.new.count > 0.0, around.feet.count > 0.0)
    )

    def above(height: Array, mask: Array) -> Array:
        return mask * (height - around.filled)

    measured = [
        known, (known * state.variance) ** 0.5, age,
        above(around.new.mean, hit), around.new.count, above(around.new.high, hit),
        above(around.new.low, hit),
        above(state.high, known), above(state.low, known), above(around.feet.mean, foot),
        around.feet.count, (state.clear - around.filled).clip(-REACH_M, REACH_M),
    ]  # fmt: skip
    told = (state.told_width < WIDEST) * (state.told - around.filled)
    images = state.images.clip(0.0, MOST_IMAGES)
    feet = xp.sum(around.feet.count, axis=(1, 2))
    return ScanInputs(
        filled=(around.filled - level).clip(-REACH_M, REACH_M),
        measured=xp.stack(measured, axis=1),
        memory=xp.stack([told.clip(-REACH_M, REACH_M), state.told_width], axis=1),
        numbers=xp.concat(
            [
                around.drift,
                state.unrest,
                xp.stack([images, feet, image.odometry_error, image.mount_error], axis=-1),
            ],
            axis=-1,
        ),
    )


def remember_told(state: ElevationMap, told: MapHeights) -> ElevationMap:
    """The map with what the network told, which it is shown at the next image."""
    return state._replace(told=told.height, told_width=told.half_width.clip(0.0, 0.99 * WIDEST))
