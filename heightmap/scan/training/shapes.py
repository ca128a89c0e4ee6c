"""Rasters that families of ground are made of."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn import functional

from saltus.heightmap.scan.training.draws import Draws

if TYPE_CHECKING:
    from saltus.heightmap.scan.training.families import Place


def smooth(values: Tensor, raster: int) -> Tensor:
    """Bicubic through a coarse grid of values: (n, k, k) -> (n, raster, raster)."""
    return functional.interpolate(values[:, None], size=(raster, raster), mode="bicubic", align_corners=True)[:, 0]


def profile(u: Tensor, edges: Tensor, height: Tensor) -> Tensor:
    """Height of the segment in which each place lies.

    Args:
        u: Places [m], shape (n, raster, raster).
        edges: Where segments begin but the first, ascending [m], shape (n, k).
        height: Of the segments [m], shape (n, k + 1).
    """
    index = torch.searchsorted(edges, u.flatten(1).contiguous())
    return height.gather(1, index).view_as(u)


def slopes(u: Tensor, edges: Tensor, height: Tensor) -> Tensor:
    """Linear between heights at the edges, both of shape (n, k), held beyond."""
    index = torch.searchsorted(edges, u.flatten(1).contiguous()).clamp(1, edges.shape[1] - 1)
    left, right = edges.gather(1, index - 1), edges.gather(1, index)
    share = ((u.flatten(1) - left) / (right - left)).clamp(0.0, 1.0)
    return torch.lerp(height.gather(1, index - 1), height.gather(1, index), share).view_as(u)


def edges_of(runs: Tensor, place: "Place") -> Tensor:
    """Edges of segments of these lengths (n, k) [m], laid from before the patch on, somewhere around its middle."""
    edges = runs.cumsum(1)
    return edges - edges[:, edges.shape[1] // 2, None] + place.shift[:, None]


def with_boxes(
    height: Tensor, place: "Place", draws: Draws, *, count: int, side: tuple[float, float], tall: tuple[float, float]
) -> Tensor:
    """Ground with boxes of any yaw on it, whose tops are level, `tall` above the ground in their middles [m]."""
    n, raster = height.shape[0], height.shape[-1]
    half = 0.5 * place.patch_m
    for _ in range(count):
        x, y = draws.uniform(-half, half, n), draws.uniform(-half, half, n)
        yaw, a, b = draws.uniform(0.0, 3.1416, n), draws.log_uniform(*side, n), draws.log_uniform(*side, n)
        cos, sin = (f(yaw)[:, None, None] for f in (torch.cos, torch.sin))
        dx, dy = place.x - x[:, None, None], place.y - y[:, None, None]
        inside = ((dx * cos + dy * sin).abs() < 0.5 * a[:, None, None]) & (
            (dy * cos - dx * sin).abs() < 0.5 * b[:, None, None]
        )
        i, j = (((c + half) / place.patch_m * raster).long().clamp(0, raster - 1) for c in (x, y))
        under = height[torch.arange(n, device=height.device), i, j]
        top = (under + draws.uniform(*tall, n))[:, None, None]
        height = torch.where(inside, torch.maximum(height, top), height)
    return height
