"""Random numbers of a seed on one device."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor


class SeededRandom:
    """Draws of one seed; the same seed gives the same numbers on the same kind of device."""

    def __init__(self, seed: int, device: torch.device) -> None:
        self.device = device
        self.generator = torch.Generator(device).manual_seed(seed)

    def begin(self, seed: int) -> None:
        """Goes on as one of another seed."""
        self.generator.manual_seed(seed)

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Evenly between two numbers."""
        return low + (high - low) * torch.rand(shape, generator=self.generator, device=self.device)

    def log_uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Evenly in the logarithm."""
        return self.uniform(math.log(low), math.log(high), *shape).exp()

    def normal(self, deviation: float, *shape: int) -> Tensor:
        """Normally distributed around 0."""
        return deviation * torch.randn(shape, generator=self.generator, device=self.device)

    def chance(self, share: float, *shape: int) -> Tensor:
        """True for this share."""
        return torch.rand(shape, generator=self.generator, device=self.device) < share

    def sign(self, *shape: int) -> Tensor:
        """-1 or 1."""
        return self.chance(0.5, *shape).float() * 2.0 - 1.0

    def one_of(self, values: Sequence[float], *shape: int) -> Tensor:
        """One of some numbers."""
        index = torch.randint(len(values), shape, generator=self.generator, device=self.device)
        return torch.tensor(values, device=self.device)[index]

    def number(self, count: int, *shape: int) -> Tensor:
        """A whole number from 0 to `count` - 1."""
        return torch.randint(count, shape, generator=self.generator, device=self.device)
