"""Ground in two dimensions as rasters of heights, drawn in batches on one device.

Heights are exact at the raster's cells and bilinear in between: a vertical face is one cell wide.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from saltus.heightmap.scan.training.families import DEEP, KINDS
from saltus.heightmap.scan.training.patch_places import PatchPlaces
from saltus.heightmap.scan.training.rasters import smooth_bicubic, with_boxes
from saltus.heightmap.scan.training.seeded_random import SeededRandom
from saltus.heightmap.scan.training.settings import FAMILIES, FlightSettings

HIGHEST_M = 3.0
"""No ground is farther than this from its middle [m]."""
SINKS_M = 0.1
"""No base sinks further into a trench than this [m]: robots step and jump across."""


class GroundPatches(NamedTuple):
    """Grounds of the robots of a flight, one patch each, in its own world, whose origin is the
    patch's middle.
    """

    height: Tensor
    """[m], shape (robots, raster, raster): rows along x, columns along y."""
    family: Tensor
    """Place in `FAMILIES`, shape (robots,)."""
    floor: Tensor
    """Height below which no base sinks, however deep the trench [m], shape (robots,)."""
    top: Tensor
    """Height of the highest place [m], shape (robots,); `bottom` of the lowest."""
    bottom: Tensor


def draw_ground(robots: int, settings: FlightSettings, draws: SeededRandom) -> GroundPatches:
    """Ground of families that are equally often drawn."""
    kinds = torch.tensor([FAMILIES.index(name) for name in settings.families], device=draws.device)
    family = kinds[draws.number(len(kinds), robots)]
    height = torch.zeros(robots, settings.raster, settings.raster, device=draws.device)
    floor = torch.full((robots,), -HIGHEST_M, device=draws.device)
    for kind in sorted(set(kinds.tolist())):
        rows = (family == kind).nonzero()[:, 0]
        if len(rows):
            place = PatchPlaces.drawn(len(rows), settings, draws)
            height[rows] = KINDS[FAMILIES[kind]](place, draws)
            if FAMILIES[kind] in DEEP:
                floor[rows] = -SINKS_M
    height += _bumps(robots, settings, draws)
    rows = draws.chance(0.15, robots).nonzero()[:, 0]
    if len(rows):
        place = PatchPlaces.drawn(len(rows), settings, draws)
        height[rows] = with_boxes(
            height[rows], place, draws, count=6, side=(0.05, 0.5), tall=(0.02, 0.4)
        )
    height.clamp_(-HIGHEST_M, HIGHEST_M)
    return GroundPatches(height, family, floor, top=height.amax((1, 2)), bottom=height.amin((1, 2)))


def _bumps(robots: int, settings: FlightSettings, draws: SeededRandom) -> Tensor:
    """Small roughness of some, slow waves of a few."""
    fine = draws.uniform(0.0, 0.01, robots) * draws.chance(0.4, robots)
    slow = draws.uniform(0.0, 0.12, robots) * draws.chance(0.2, robots)
    side, raster = settings.patch_m, settings.raster
    waves = smooth_bicubic(draws.normal(1.0, robots, 8, 8), raster) * slow[:, None, None]
    return (
        waves
        + smooth_bicubic(
            draws.normal(1.0, robots, max(4, round(side / 0.08)), max(4, round(side / 0.08))),
            raster,
        )
        * (fine[:, None, None])
    )


def heights_at(height: Tensor, x: Tensor, y: Tensor, raster_m: float) -> Tensor:
    """Bilinear heights [m] of patches (robots, raster, raster) at places [m],
    each of shape (robots, ...).
    """
    raster = height.shape[-1]
    i, j = ((c / raster_m + (0.5 * raster - 0.5)).clamp(0.0, raster - 1.001) for c in (x, y))
    first_i, first_j = i.floor(), j.floor()
    s, t = i - first_i, j - first_j
    # Exact in single precision below 4,096 cells a side
    index = ((first_i * raster + first_j).long()).flatten(1)
    flat = height.flatten(1)
    a, b, c, d = (flat.gather(1, index + step).view_as(i) for step in (0, 1, raster, raster + 1))
    return torch.lerp(torch.lerp(a, b, t), torch.lerp(c, d, t), s)


def nearest_heights(height: Tensor, x: Tensor, y: Tensor, raster_m: float) -> Tensor:
    """Heights of the cells [m] at places [m], each of shape (robots, ...)."""
    raster = height.shape[-1]
    i, j = ((c / raster_m + 0.5 * raster).clamp(0.0, raster - 1.0).int() for c in (x, y))
    return height.flatten(1).gather(1, (i * raster + j).long().flatten(1)).view_as(x)
