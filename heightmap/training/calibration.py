"""Makes the intervals of a trained network hold what they should, on episodes that it was not fitted to."""

import math

import numpy as np
import torch

from saltus.heightmap.data.delivery import DeliveryModel
from saltus.heightmap.model import HeightmapModel
from saltus.heightmap.service.quantiles import INTERVAL90
from saltus.heightmap.training.dataset import EpisodeStore, ImageNoise, run_window

BATCH, LENGTH, WINDOWS = 32, 100, 30
"""Robots, ticks, and windows of these to go by: 96,000 ticks, of which neighbours are alike."""


def calibrate(
    model: HeightmapModel, store: EpisodeStore, delivery: DeliveryModel, noise: ImageNoise, seed: int
) -> float:
    """Scales all stated intervals in place so that the 90 % intervals hold 90 % of the errors; returns the factor.

    A network states intervals for what it saw in training, and errs by a little more elsewhere: `store` holds episodes
    that it was not fitted to. The factor goes into the last layer.
    """
    windows = store.windows(BATCH, LENGTH, delivery, noise, np.random.default_rng(seed))
    hidden = torch.zeros(BATCH, model.config.hidden, device=store.device)
    ratios = []
    with torch.no_grad():
        for _, window in zip(range(WINDOWS), windows, strict=False):
            estimate, hidden = run_window(model, window, hidden)
            ratio = (estimate.height - window.height).abs() / (INTERVAL90 * estimate.log_std.exp())
            ratios.append(ratio[window.valid > 0].flatten().cpu().numpy())
        factor = float(np.quantile(np.concatenate(ratios), 0.9))
        model.head[-1].get_parameter("bias")[len(model.height_mean) :] += math.log(factor)
    return factor
