"""Rasters that families of ground are made of."""

import torch
from torch import Tensor
from torch.nn import functional

from saltus.heightmap.scan.training.patch_places import PatchPlaces
from saltus.heightmap.scan.training.seeded_random import SeededRandom

TOGETHER = 8
"""Boxes that are drawn at once: many small calls take a GPU longer than a few large ones."""


def smooth_bicubic(values: Tensor, raster: int) -> Tensor:
    """Bicubic through a coarse grid of values: (n, k, k) -> (n, raster, raster)."""
    return functional.interpolate(
        values[:, None], size=(raster, raster), mode="bicubic", align_corners=True
    )[:, 0]


def segment_heights(u: Tensor, edges: Tensor, height: Tensor) -> Tensor:
    """Height of the segment in which each place lies.

    Args:
        u: Places [m], shape (n, raster, raster).
        edges: Where segments begin but the first, ascending [m], shape (n, k).
        height: Of the segments [m], shape (n, k + 1).
    """
    index = torch.searchsorted(edges, u.flatten(1).contiguous())
    return height.gather(1, index).view_as(u)


def linear_between_edges(u: Tensor, edges: Tensor, height: Tensor) -> Tensor:
    """Linear between heights at the edges, both of shape (n, k), held beyond."""
    index = torch.searchsorted(edges, u.flatten(1).contiguous()).clamp(1, edges.shape[1] - 1)
    left, right = edges.gather(1, index - 1), edges.gather(1, index)
    share = ((u.flatten(1) - left) / (right - left)).clamp(0.0, 1.0)
    return torch.lerp(height.gather(1, index - 1), height.gather(1, index), share).view_as(u)


def edges_of(runs: Tensor, place: PatchPlaces) -> Tensor:
    """Edges of segments of these lengths (n, k) [m],
    laid from before the patch on, somewhere around its middle.
    """
    edges = runs.cumsum(1)
    return edges - edges[:, edges.shape[1] // 2, None] + place.shift[:, None]


def with_boxes(
    height: Tensor,
    place: PatchPlaces,
    draws: SeededRandom,
    *,
    count: int,
    side: tuple[float, float],
    tall: tuple[float, float],
) -> Tensor:
    """Ground with boxes of any yaw on it, whose tops are level,
    `tall` above the ground in their middles [m].
    """
    n, raster = height.shape[0], height.shape[-1]
    half = 0.5 * place.patch_m
    x, y = draws.uniform(-half, half, n, count), draws.uniform(-half, half, n, count)
    yaw, a, b = (
        draws.uniform(0.0, 3.1416, n, count),
        *(0.5 * draws.log_uniform(*side, n, count) for _ in range(2)),
    )
    i, j = (((c + half) / place.patch_m * raster).long().clamp(0, raster - 1) for c in (x, y))
    under = height.flatten(1).gather(1, i * raster + j)
    tops = under + draws.uniform(*tall, n, count)
    for first in range(0, count, TOGETHER):
        part = slice(first, first + TOGETHER)
        cos, sin, a_, b_, top = (t[:, part, None, None] for t in (yaw.cos(), yaw.sin(), a, b, tops))
        dx, dy = (
            place.x[:, None] - x[:, part, None, None],
            place.y[:, None] - y[:, part, None, None],
        )
        inside = ((cos * dx + sin * dy).abs() < a_) & ((cos * dy - sin * dx).abs() < b_)
        height = torch.maximum(height, torch.where(inside, top, -torch.inf).amax(1))
    return height
