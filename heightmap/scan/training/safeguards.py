"""Safeguards of a training: bursts of the gradient are clipped;
a network that went astray returns to one of before.

In a network without norms, what grows in one layer grows in all that follow: one burst moves every
weight by tens of learning rates, features grow by 10^20 within 50 updates, and no gradient brings
them back (docs/history.md, "Trainings of the scan from nothing"). First and last layer have nearly
all of the gradient's norm, and the burst moved the layers between them most. So each layer's
gradient is clipped by what is usual of it, not all of them by one norm.
"""

import math
from collections.abc import Iterable

import torch
from torch import Tensor

from saltus.heightmap.scan.training.model import ScanModel

BURST = 2.0
"""No layer's gradient counts for more than so many times its usual norm."""
NORM_SHARE = 0.02
"""Share of an update's norms in the usual ones."""
ASTRAY = (0.8, 0.97)
"""A training has gone astray if fewer or more of all heights are within their half-widths, for
which the loss asks 0.9. The four whose figures were kept had 0.02, or 0.98 and more."""
STARTS_IN = 3
"""Rounds in which half-widths of a new network need not hold yet."""
KEPT = 5
"""So many sets of weights a training can return to, the first among them."""
SLOWER = 0.8
"""Factor of the learning rate for each return."""


def is_astray(loss: float, inside: float) -> bool:
    """True where the figures of a round are those of a network that has gone astray."""
    low, high = ASTRAY
    return not (math.isfinite(loss) and low < inside < high)


class Safeguards:
    """The safeguards of one network and its optimiser;
    they work in place, as a recorded update asks.
    """

    def __init__(
        self, model: ScanModel, average: ScanModel, optimiser: torch.optim.Optimizer
    ) -> None:
        self._model, self._average, self._optimiser = model, average, optimiser
        weights = list(model.parameters())
        self.usual_norm = torch.zeros(len(weights), device=weights[0].device)
        """Running means of the norms of the weights' gradients; 0 before the first that is none.
        Shape (weights,)."""
        self.returns = 0
        """How often the training went astray and returned."""
        self._kept: list[list[Tensor]] = []

    @property
    def slower(self) -> float:
        """Factor of the learning rate."""
        return SLOWER**self.returns

    @torch.no_grad()
    def clip(self, largest: float) -> Tensor:
        """Limits the norm of each weight's gradient to twice its usual one,
        and the norm of all to `largest`; drops one that is no number.

        Returns:
            Share of the weights whose gradient was more than twice the usual one, shape (1,).
        """
        slopes = [w.grad for w in self._model.parameters() if w.grad is not None]
        norms = torch.stack([torch.linalg.vector_norm(slope) for slope in slopes])
        is_sound = torch.isfinite(norms)
        usual = torch.where(self.usual_norm > 0.0, self.usual_norm, norms)
        limited = torch.where(is_sound, torch.minimum(norms, BURST * usual), 0.0)
        whole = (largest / (torch.linalg.vector_norm(limited) + 1e-6)).clamp(max=1.0)
        scale = whole * limited / norms.clamp(min=1e-20)
        for slope, factor, sound in zip(slopes, scale, is_sound, strict=True):
            slope.mul_(factor).masked_fill_(~sound, 0.0)
        counted = torch.where(is_sound, limited, usual)
        self.usual_norm.copy_(usual.lerp(counted, NORM_SHARE).nan_to_num(0.0, 0.0, 0.0))
        return (~is_sound | (limited < norms)).float().mean()[None]

    def begin(self) -> None:
        """Remembers the weights to begin with; does nothing where some are remembered."""
        if not self._kept:
            self._keep()

    def judge(self, rounds: int, loss: float, inside: float) -> None:
        """Remembers the weights after so many rounds, or returns to those of before.

        Args:
            rounds: Made so far.
            loss: Mean of the last round.
            inside: Share of all heights within their half-widths in it.
        """
        if rounds > STARTS_IN and is_astray(loss, inside):
            self._return()
        else:
            self._keep()

    def _keep(self) -> None:
        self._kept.append([value.clone() for value in self._learned()])
        if len(self._kept) > KEPT:
            del self._kept[1]

    @torch.no_grad()
    def _return(self) -> None:
        """To weights of before the last good round, as it may have gone astray at its end."""
        self.returns += 1
        if len(self._kept) > 1:
            del self._kept[-1]
        values, kept = list(self._learned()), self._kept[-1]
        for mine, before in zip(values, kept, strict=False):
            mine.copy_(before)
        for mine in values[len(kept) :]:  # moments that were not there yet
            mine.zero_()

    def _learned(self) -> Iterable[Tensor]:
        """Everything that an update changes."""
        yield from (weight.detach() for weight in self._model.parameters())
        yield from (weight.detach() for weight in self._average.parameters())
        yield self.usual_norm
        for state in self._optimiser.state.values():
            yield from (value for value in state.values() if isinstance(value, Tensor))
