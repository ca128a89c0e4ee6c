"""The network of the scan: a small convolutional one on the map,
which says height and half-width of every cell.

Where the map was measured it starts from the map's height, where it was not, from what the network
told last. Gates say how much of the rest counts, cell by cell, so that geometry stays what it is
where it is sharp.
"""

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from saltus.heightmap.scan.elevation import WIDEST
from saltus.heightmap.scan.network_inputs import (
    MEASURED,
    MEMORY,
    MOST_IMAGES,
    NUMBERS,
    OLDEST_S,
    MapHeights,
    ScanInputs,
)
from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.settings import NetworkSettings

USUAL_M = 0.1
"""A usual residual [m]."""
NARROWEST_M = 5e-4
"""The narrowest half-width [m]."""
_SHOWN = 3.0  # a difference of heights is shown as this many times USUAL_M at most
_NUMBERS = (0.005, 0.005, 0.005, 0.002, 0.002, MOST_IMAGES, 36.0, 1.0, 1.0)  # usual `NUMBERS`
_OUTPUTS = 4  # of a height: residual, its gate, the memory's gate, half-width
_OWN_FIRST = 5.0  # at first the network's own height counts e^5 times as much as another candidate
# Sides of squares of fine cells whose highest and lowest are candidates: 2 and 6 cm away
_AROUND = (
    3,
    7,
)
_TOLD_AROUND = 5
CANDIDATES = 2 * len(_AROUND) + 4 + 2 + 1
"""Heights of a cell that the network chooses among, beside its own: extremes of the map around it,
of its own points, of what was told around it, and the window's lowest."""


class ResidualBlock(nn.Module):
    """A residual block with a mean over the window, which is the same as none at first."""

    def __init__(self, channels: int, inner: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, inner, 3, padding=1)
        self.mean = nn.Conv2d(inner, inner, 1)
        self.second = nn.Conv2d(inner, channels, 3, padding=1)
        nn.init.zeros_(self.second.weight)
        nn.init.zeros_(self.second.get_parameter("bias"))

    def forward(self, x: Tensor) -> Tensor:
        """The same shape (batch, channels, rows, columns)."""
        y = functional.relu(self.first(x))
        y = functional.relu(y + self.mean(y.mean((2, 3), keepdim=True)))
        z: Tensor = self.second(y)
        return x + z


class ScanModel(nn.Module):
    """From planes of the map to height and half-width of each fine cell."""

    usual: Tensor

    def __init__(self, settings: NetworkSettings, map_settings: MapSettings) -> None:
        super().__init__()
        self.settings, self.sub = settings, map_settings.sub
        planes = 3 + len(MEASURED) + 2 * (len(MEMORY) if settings.memory else 0)
        a, b, c, d = settings.channels
        self.stem = nn.Conv2d(planes * self.sub**2 + len(NUMBERS), a, 3, padding=1)
        self.down = nn.ModuleList(
            nn.Conv2d(i, o, 3, stride=2, padding=1) for i, o in ((a, b), (b, c), (c, d))
        )
        self.deep = nn.Conv2d(d, d, 3, padding=1)
        self.up = nn.ModuleList(nn.Conv2d(i, o, 1) for i, o in ((d, c), (c, b), (b, a)))
        self.join = nn.ModuleList(nn.Conv2d(o, o, 3, padding=1) for o in (c, b, a))
        self.blocks = nn.ModuleList(
            ResidualBlock(d, settings.deep_channels) for _ in range(settings.deep)
        )
        outputs = _OUTPUTS + (1 + CANDIDATES if settings.choice else 0)
        self.head = nn.Conv2d(a, outputs * self.sub**2, 1)
        self.register_buffer("usual", torch.tensor(_NUMBERS), persistent=False)
        with torch.no_grad():
            self.head.weight *= 0.1
            bias = self.head.get_parameter("bias").zero_()
            if settings.choice:
                bias[_OUTPUTS * self.sub**2 : (_OUTPUTS + 1) * self.sub**2] = _OWN_FIRST

    def forward(
        self,
        filled: Tensor,
        measured: Tensor,
        memory: Tensor,
        numbers: Tensor,
        truth: Tensor | None = None,
    ) -> tuple[Tensor, ...]:
        """Height above `filled` [m] and half-width [m],
        each of shape (batch, side, side); see `ScanInputs`.

        With `truth`, true heights above `filled`, also the mean error [m] of the candidates by
        their weights.
        """
        x = self._shown(ScanInputs(filled, measured, memory, numbers))
        skips = []
        x = self._bounded(functional.relu(self.stem(x)))
        for down in self.down:
            skips.append(x)
            x = self._bounded(functional.relu(down(x)))
        x = self._bounded(x + functional.relu(self.deep(x)))
        for block in self.blocks:
            x = self._bounded(block(x))
        for up, join, skip in zip(self.up, self.join, reversed(skips), strict=True):
            x = functional.interpolate(up(x), scale_factor=2.0, mode="nearest") + skip
            x = self._bounded(x + functional.relu(join(x)))
        out = functional.pixel_shuffle(self.head(x), self.sub).float()
        height, half_width = self._own(out[:, :_OUTPUTS], measured, memory)
        if not self.settings.choice:
            return (
                (height, half_width)
                if truth is None
                else (height, half_width, (height - truth).abs())
            )
        candidates = torch.cat((height[:, None], _candidates(filled, measured, memory)), 1)
        weights = _softmax(out[:, _OUTPUTS:])
        height = (weights * candidates).sum(1)
        if truth is None:
            return height, half_width
        return height, half_width, (weights * (candidates - truth[:, None]).abs()).sum(1)

    def _bounded(self, x: Tensor) -> Tensor:
        """Features whose root mean square over a cell is within the bound, if there is one."""
        most = self.settings.features
        if not most:
            return x
        size = x.square().mean(1, keepdim=True)
        return x * (most**2 / size.clamp(min=most**2)).sqrt()

    def _own(self, out: Tensor, measured: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        residual, gate, keep, width = out.unbind(1)
        height = USUAL_M * residual * torch.sigmoid(gate)
        if self.settings.memory:
            # Begins with the map where measured, else with the memory
            unknown = 2.0 * (1.0 - 2.0 * measured[:, 0])
            has_told = (memory[:, 1] < WIDEST).float()
            height = height + torch.sigmoid(keep + unknown) * has_told * memory[:, 0]
        half_width = NARROWEST_M + USUAL_M * functional.softplus(width - 2.0)
        if not self.training:
            return height, half_width.clamp(max=WIDEST)
        # The same value, but with a slope at the limit too: without one, widths that reach it stay.
        beyond = WIDEST + (half_width - half_width.detach())
        return height, torch.where(half_width < WIDEST, half_width, beyond)

    def _shown(self, inputs: ScanInputs) -> Tensor:
        """Numbers of about 1: heights in `USUAL_M`,
        half-widths and deviations by their logarithm.
        """
        m = dict(zip(MEASURED, inputs.measured.unbind(1), strict=True))

        def heights(value: Tensor) -> Tensor:
            return (value / USUAL_M).clamp(-_SHOWN, _SHOWN)

        def fine(value: Tensor) -> Tensor:
            return (value / (0.1 * USUAL_M)).clamp(-_SHOWN, _SHOWN)

        planes = [
            (inputs.filled / (3.0 * USUAL_M)).clamp(-_SHOWN, _SHOWN), heights(inputs.filled),
            m["known"],
            (m["deviation"] / (0.1 * USUAL_M)).clamp(max=_SHOWN), m["age"] / OLDEST_S * _SHOWN,
            fine(m["new"]),
            m["new_count"].clamp(max=20.0).add(1.0).log(), heights(m["new_high"]),
            heights(m["new_low"]),
            heights(m["high"]), heights(m["low"]), fine(m["foot"]), m["foot_count"].clamp(max=1.0),
        ]  # fmt: skip
        if self.settings.memory:
            told, width = inputs.memory.unbind(1)
            planes += [
                heights(told),
                fine(told),
                (width / WIDEST + 1e-3).log() / 3.0,
                (width < WIDEST).float(),
            ]
        fine_planes = _unshuffled(torch.stack(planes, 1), self.sub)
        numbers = (inputs.numbers / self.usual).clamp(-_SHOWN, _SHOWN)
        side = fine_planes.shape[-1]
        # New ones last: a training may go on from a file that has none
        clear = _unshuffled(torch.stack((heights(m["clear"]), fine(m["clear"])), 1), self.sub)
        shown = (fine_planes, numbers[:, :, None, None].expand(-1, -1, side, side), clear)
        return torch.cat(shown, 1)


def _unshuffled(planes: Tensor, sub: int) -> Tensor:
    """Pixel unshuffle by slices: ONNX Runtime's transpose takes longer."""
    parts = [planes[..., i::sub, j::sub] for i in range(sub) for j in range(sub)]
    return torch.stack(parts, 2).flatten(1, 2)


def _softmax(values: Tensor) -> Tensor:
    """Softmax over dimension 1, in parts: ONNX Runtime's own takes four times as long there."""
    above = (values - values.amax(1, keepdim=True)).exp()
    return above / above.sum(1, keepdim=True)


def _candidates(filled: Tensor, measured: Tensor, memory: Tensor) -> Tensor:
    """Heights above `filled` that edges have, of shape (batch, CANDIDATES, side, side)."""
    told = filled + torch.where(memory[:, 1] < WIDEST, memory[:, 0], 0.0)
    around = [
        sign * functional.max_pool2d(sign * values[:, None], size, 1, size // 2)[:, 0] - filled
        for values, size in (*((filled, size) for size in _AROUND), (told, _TOLD_AROUND))
        for sign in (1.0, -1.0)
    ]
    own = [measured[:, MEASURED.index(name)] for name in ("high", "low", "new_high", "new_low")]
    return torch.stack((*around, *own, filled.amin((1, 2), keepdim=True) - filled), 1)


def told_heights(model: Callable[..., Any], inputs: ScanInputs, filled: Tensor) -> MapHeights:
    """Height and half-width that the network tells of each cell,
    in the world of `filled` (batch, side, side) [m].
    """
    height, half_width = model(*inputs)
    return MapHeights(filled + height, half_width)


def scan_loss(
    estimate: MapHeights, truth: Tensor, weight: Tensor, spread: Tensor | None = None
) -> Tensor:
    """Absolute error, and how far half-widths are from holding nine of ten errors,
    of each size as important.

    A median chooses a side of an edge. The second is the quantile loss of the logarithm of the
    error; it leaves the heights alone. `spread` is the mean error of the candidates of a cell by
    their weights: it counts half, so that weights gather on one.
    """
    error = (estimate.height - truth).abs()
    beyond = (error.detach() + 1e-4).log() - estimate.half_width.log()
    quantile = torch.maximum(0.9 * beyond, -0.1 * beyond)
    missed = error if spread is None else 0.5 * (error + spread)
    return (weight * (missed / USUAL_M + 0.5 * quantile)).sum() / weight.sum()


def parameter_count(model: nn.Module) -> int:
    """How many numbers it learns."""
    return sum(math.prod(p.shape) for p in model.parameters())
