"""The network of the scan: a small convolutional one on the map, which says height and half-width of every cell.

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
from saltus.heightmap.scan.planes import MEASURED, MEMORY, MOST_IMAGES, NUMBERS, OLDEST_S, Heights, Inputs
from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.settings import NetworkSettings

USUAL_M = 0.1
"""A usual residual [m]."""
NARROWEST_M = 5e-4
"""The narrowest half-width [m]."""
_SHOWN = 3.0  # a difference of heights is shown as this many times USUAL_M at most
_NUMBERS = (0.005, 0.005, 0.005, 0.002, 0.002, MOST_IMAGES, 36.0)  # what usual `NUMBERS` are
_OUTPUTS = 4  # of a height: residual, its gate, the memory's gate, half-width


class ScanModel(nn.Module):
    """From planes of the map to height and half-width of each fine cell."""

    usual: Tensor

    def __init__(self, settings: NetworkSettings, map_settings: MapSettings) -> None:
        super().__init__()
        self.settings, self.sub = settings, map_settings.sub
        planes = 2 + len(MEASURED) + 2 * (len(MEMORY) if settings.memory else 0)
        a, b, c, d = settings.channels
        self.stem = nn.Conv2d(planes * self.sub**2 + len(NUMBERS), a, 3, padding=1)
        self.down = nn.ModuleList(nn.Conv2d(i, o, 3, stride=2, padding=1) for i, o in ((a, b), (b, c), (c, d)))
        self.deep = nn.Conv2d(d, d, 3, padding=1)
        self.up = nn.ModuleList(nn.Conv2d(i, o, 1) for i, o in ((d, c), (c, b), (b, a)))
        self.join = nn.ModuleList(nn.Conv2d(o, o, 3, padding=1) for o in (c, b, a))
        self.head = nn.Conv2d(a, _OUTPUTS * self.sub**2, 1)
        self.register_buffer("usual", torch.tensor(_NUMBERS), persistent=False)
        with torch.no_grad():
            self.head.weight *= 0.1
            self.head.get_parameter("bias").zero_()

    def forward(self, filled: Tensor, measured: Tensor, memory: Tensor, numbers: Tensor) -> tuple[Tensor, Tensor]:
        """Height above `filled` [m] and half-width [m], each of shape (batch, side, side); see `Inputs`."""
        x = self._shown(Inputs(filled, measured, memory, numbers))
        skips = []
        x = functional.relu(self.stem(x))
        for down in self.down:
            skips.append(x)
            x = functional.relu(down(x))
        x = x + functional.relu(self.deep(x))
        for up, join, skip in zip(self.up, self.join, reversed(skips), strict=True):
            x = functional.interpolate(up(x), scale_factor=2.0, mode="nearest") + skip
            x = x + functional.relu(join(x))
        out = functional.pixel_shuffle(self.head(x), self.sub).float()
        return self._told(out, measured, memory)

    def _told(self, out: Tensor, measured: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        residual, gate, keep, width = out.unbind(1)
        height = USUAL_M * residual * torch.sigmoid(gate)
        if self.settings.memory:
            unknown = 2.0 * (1.0 - 2.0 * measured[:, 0])  # begins with the map where measured, else with the memory
            has_told = (memory[:, 1] < WIDEST).float()
            height = height + torch.sigmoid(keep + unknown) * has_told * memory[:, 0]
        return height, (NARROWEST_M + USUAL_M * functional.softplus(width - 2.0)).clamp(max=WIDEST)

    def _shown(self, inputs: Inputs) -> Tensor:
        """Numbers of about 1: heights in `USUAL_M`, half-widths and deviations by their logarithm."""
        m = dict(zip(MEASURED, inputs.measured.unbind(1), strict=True))

        def heights(value: Tensor) -> Tensor:
            return (value / USUAL_M).clamp(-_SHOWN, _SHOWN)

        def fine(value: Tensor) -> Tensor:
            return (value / (0.1 * USUAL_M)).clamp(-_SHOWN, _SHOWN)

        planes = [
            (inputs.filled / (3.0 * USUAL_M)).clamp(-_SHOWN, _SHOWN), heights(inputs.filled), m["known"],
            (m["deviation"] / (0.1 * USUAL_M)).clamp(max=_SHOWN), m["age"] / OLDEST_S * _SHOWN, fine(m["new"]),
            m["new_count"].clamp(max=20.0).add(1.0).log(), heights(m["new_high"]), heights(m["new_low"]),
            heights(m["high"]), heights(m["low"]), fine(m["foot"]), m["foot_count"].clamp(max=1.0),
        ]  # fmt: skip
        if self.settings.memory:
            told, width = inputs.memory.unbind(1)
            planes += [heights(told), fine(told), (width / WIDEST + 1e-3).log() / 3.0, (width < WIDEST).float()]
        fine_planes = functional.pixel_unshuffle(torch.stack(planes, 1), self.sub)
        numbers = (inputs.numbers / self.usual).clamp(-_SHOWN, _SHOWN)
        side = fine_planes.shape[-1]
        return torch.cat((fine_planes, numbers[:, :, None, None].expand(-1, -1, side, side)), 1)


def told(model: Callable[..., Any], inputs: Inputs, filled: Tensor) -> Heights:
    """Height and half-width that the network tells of each cell, in the world of `filled` (batch, side, side) [m]."""
    height, half_width = model(*inputs)
    return Heights(filled + height, half_width)


def loss(estimate: Heights, truth: Tensor, weight: Tensor) -> Tensor:
    """Absolute error, and how far half-widths are from holding nine of ten errors, of each size as important.

    A median chooses a side of an edge. The second is the quantile loss of the logarithm of the
    error; it leaves the heights alone.
    """
    error = (estimate.height - truth).abs()
    beyond = (error.detach() + 1e-4).log() - estimate.half_width.log()
    quantile = torch.maximum(0.9 * beyond, -0.1 * beyond)
    return (weight * (error / USUAL_M + 0.5 * quantile)).sum() / weight.sum()


def parameters(model: nn.Module) -> int:
    """How many numbers it learns."""
    return sum(math.prod(p.shape) for p in model.parameters())
