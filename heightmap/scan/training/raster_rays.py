"""Where rays meet the ground: marched along the raster, then bisected."""

import torch
from torch import Tensor

from saltus.heightmap.scan.training.ground_patches import GroundPatches, heights_at, nearest_heights

BISECTIONS = 9
"""A bracket of 10 cm becomes one of 0.2 mm."""
REACH = 0.75
"""Part of a cell: so far from where a ray enters the cells' ground it may enter the bilinear
one."""
FURTHEST_M = 0.25
"""Greatest distance along a steep ray from where it enters the cells' ground [m]."""
MARGIN_M = 0.01
"""By this rays begin above the highest ground, and end below the lowest [m]."""
_LEVEL = 1e-6  # a ray that is more level than this meets no ground that it does not stand before


def first_hits(
    ground: GroundPatches,
    origin: Tensor,
    direction: Tensor,
    near: Tensor,
    far: Tensor,
    raster_m: float,
    samples: int,
) -> Tensor:
    """How far along each ray the ground is, in lengths of its direction.

    It is 0 where there is none, where a ray begins in the ground, and where it only grazes an edge,
    which a camera does not see either.

    Args:
        ground: Of the robots.
        origin: Of the rays [m], shape (robots, n, 3).
        direction: Of any length, shape (robots, n, 3).
        near: Where rays begin, shape (robots, n).
        far: Where they end, shape (robots, n).
        raster_m: Side of the raster's cells [m].
        samples: Places between which a hit is looked for; an obstacle that is thinner along the ray
            may be missed.
    """
    height, top, bottom = (
        ground.height,
        ground.top[:, None] + MARGIN_M,
        ground.bottom[:, None] - MARGIN_M,
    )
    fall = direction[..., 2].clamp(max=-_LEVEL)
    falls = direction[..., 2] < -_LEVEL
    begin = torch.maximum(near, torch.where(falls, (top - origin[..., 2]) / fall, near))
    end = torch.minimum(far, torch.where(falls, (bottom - origin[..., 2]) / fall, far))
    step = (end - begin).clamp(min=0.0) / samples
    index = _first_below(height, origin, direction, begin, step, raster_m, samples)
    # The march compares with cells, the bisection with what is bilinear between them, up to most of
    # a cell away.
    reach = (REACH * raster_m / direction[..., :2].norm(dim=-1).clamp(min=1e-3)).clamp(
        max=FURTHEST_M
    )
    number = index.clamp(1, samples)
    low = torch.maximum(begin + (number - 1) * step - reach, begin)
    size = begin + number * step + torch.minimum(reach, step + raster_m) - low

    def above(along: Tensor) -> Tensor:
        place = origin + along[..., None] * direction
        return place[..., 2] > heights_at(height, place[..., 0], place[..., 1], raster_m)

    hit = (index > 0) & (index <= samples) & above(low) & ~above(low + size)
    for _ in range(BISECTIONS):
        size = 0.5 * size
        low = torch.where(above(low + size), low + size, low)
    return torch.where(hit, low + 0.5 * size, 0.0)


def _first_below(
    height: Tensor,
    origin: Tensor,
    direction: Tensor,
    begin: Tensor,
    step: Tensor,
    raster_m: float,
    samples: int,
) -> Tensor:
    """Number of the first sample that is in the ground; `samples` + 1 where none is."""
    numbers = torch.arange(samples + 1, device=height.device, dtype=height.dtype)
    along = begin[..., None] + step[..., None] * numbers
    x, y, z = (origin[..., i, None] + along * direction[..., i, None] for i in range(3))
    below = z <= nearest_heights(height, x, y, raster_m)
    return torch.where(below, numbers, float(samples + 1)).amin(-1)
