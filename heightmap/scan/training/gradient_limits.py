"""Safeguard of a training: bursts of the gradient are clipped.

In a network without norms, what grows in one layer grows in all that follow: one burst moves every
weight by tens of learning rates, features grow by 10^20 within 50 updates, and no gradient brings
them back (docs/history.md, "Trainings of the scan from nothing"). First and last layer have nearly
all of the gradient's norm, and the burst moved the layers between them most. So each layer's
gradient is clipped by what is usual of it, not all of them by one norm.
"""

import torch
from torch import Tensor

from saltus.heightmap.scan.training.scan_model import ScanModel

BURST = 2.0
"""No layer's gradient counts for more than so many times its usual norm."""
NORM_SHARE = 0.02
"""Share of an update's norms in the usual ones."""


class GradientLimits:
    """Limits of the gradients of a network's weights;
    they work in place, as a recorded update asks.
    """

    def __init__(self, model: ScanModel) -> None:
        self._model = model
        weights = list(model.parameters())
        self.usual_norm = torch.zeros(len(weights), device=weights[0].device)
        """Running means of the norms of the weights' gradients; 0 before the first that is none.
        Shape (weights,)."""

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
