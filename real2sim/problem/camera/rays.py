"""Exact depth of a world of boxes and ground, for many rays at once."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from saltus.arrays import Floats
from saltus.errors import RecordingError

NEAREST_M = 1e-3  # what is nearer to the image plane is behind the lens


@dataclass(frozen=True, kw_only=True, eq=False)
class VisibleScene:
    """Things that can be seen, in the world frame."""

    box_low: Floats
    """Lowest corner of each box [m], shape (boxes, 3)."""
    box_high: Floats
    """Highest corner [m], shape (boxes, 3)."""
    has_ground: bool
    """True where there is a plane z = 0."""

    def depth(self, origin: Floats, direction: Floats) -> Floats:
        """Along each ray in lengths of its direction, infinite where nothing is hit.

        Args:
            origin: of the rays [m], world frame, shape (n, 3).
            direction: world frame, shape (n, 3, rays); of depth 1, so that the result is depth along the optical axis.

        Returns:
            Shape (n, rays).
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / direction
            nearest = np.full((len(origin), direction.shape[2]), np.inf)
            if self.has_ground:
                ground = -origin[:, 2:] * inverse[:, 2]
                nearest = np.where(ground > NEAREST_M, ground, np.inf)
            for low, high in zip(self.box_low, self.box_high, strict=True):
                first, last = _slab(origin, inverse, low, high)
                np.copyto(nearest, first, where=(first <= last) & (first > NEAREST_M) & (first < nearest))
        return nearest


def _slab(origin: Floats, inverse: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Where rays enter and leave a box, shape (n, rays) each; entry is behind exit where they miss it."""
    first = last = np.empty(0)
    for axis in range(3):
        one = (low[axis] - origin[:, axis, None]) * inverse[:, axis]
        two = (high[axis] - origin[:, axis, None]) * inverse[:, axis]
        near, far = np.fmin(one, two), np.fmax(one, two)
        first = np.maximum(first, near) if axis else near
        last = np.minimum(last, far) if axis else far
    return first, last


def claimed_scenes(terrain: Any) -> tuple[VisibleScene, ...]:
    """Readings of what `meta.json` says of the terrain, the likelier first.

    "flat" is the plane z = 0. A list of boxes may hold the ground as a box, or may leave it out; which it is shows in
    the images. `RecordingError` for anything else.
    """
    if terrain is None or terrain == "flat":
        return (VisibleScene(box_low=np.empty((0, 3)), box_high=np.empty((0, 3)), has_ground=True),)
    try:
        centre = np.array([box["center"] for box in terrain], dtype=np.float64).reshape(-1, 3)
        size = np.array([box["size"] for box in terrain], dtype=np.float64).reshape(-1, 3)
    except (TypeError, KeyError, ValueError) as error:
        raise RecordingError(f"meta.json: terrain must be 'flat' or a list of boxes: {error!r}") from error
    low, high = centre - 0.5 * size, centre + 0.5 * size
    return tuple(VisibleScene(box_low=low, box_high=high, has_ground=ground) for ground in (True, False))
