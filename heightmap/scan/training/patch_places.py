"""Where the law of each patch of ground lies."""

import math
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from saltus.heightmap.scan.training.seeded_random import SeededRandom
from saltus.heightmap.scan.training.settings import FlightSettings


@dataclass(frozen=True)
class PatchPlaces:
    """Where the terrain of each of n patches of ground lies in its patch."""

    x: Tensor
    """Places of the raster's cells [m], shape (1, raster, 1), and `y` of shape (1, 1, raster)."""
    y: Tensor
    u: Tensor
    """Along the law's direction, at any yaw, from its origin [m], shape (n, raster, raster); `v`
    across."""
    v: Tensor
    shift: Tensor
    """Where along u the middle of the law lies [m], shape (n,)."""
    trench: Tensor
    """Depth of trenches [m], shape (n,)."""
    patch_m: float

    @classmethod
    def drawn(cls, n: int, settings: FlightSettings, draws: SeededRandom) -> Self:
        """Any yaw, an origin near the patch's middle, any depth of trenches."""
        steps = (
            torch.arange(settings.raster, device=draws.device) + 0.5
        ) * settings.raster_m - 0.5 * settings.patch_m
        x, y = steps[None, :, None], steps[None, None, :]
        yaw = draws.uniform(-math.pi, math.pi, n)[:, None, None]
        along = draws.uniform(-0.5, 0.5, n), draws.uniform(-0.5, 0.5, n)
        dx, dy = x - along[0][:, None, None], y - along[1][:, None, None]
        return cls(
            x=x, y=y, u=yaw.cos() * dx + yaw.sin() * dy, v=yaw.cos() * dy - yaw.sin() * dx,
            shift=draws.uniform(-0.5, 0.5, n), trench=draws.log_uniform(*settings.trench_m, n),
            patch_m=settings.patch_m,
        )  # fmt: skip

    @property
    def n(self) -> int:
        """How many patches."""
        return len(self.shift)

    def segments(self, shortest_m: float) -> int:
        """How many segments of at least this length cover a patch from corner to corner."""
        return math.ceil(1.6 * self.patch_m / shortest_m)
