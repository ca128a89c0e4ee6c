"""Makes the intervals of a trained network hold what they should,
on episodes that it was not fitted to.
"""

import math

import numpy as np
import torch

from saltus.heightmap.data.delivery import ImageDeliveryModel
from saltus.heightmap.model import MAX_STD_M, MIN_STD_M, WIDTHS, HeightmapModel
from saltus.heightmap.service.quantiles import INTERVAL90
from saltus.heightmap.training.dataset import EpisodeStore, ImageNoise, run_window

BATCH, LENGTH, WINDOWS = 32, 100, 30
"""Robots, ticks, and windows of these to go by: 96,000 ticks, of which neighbours are alike."""
ROUNDS = 10
"""Rounds of corrections to the corrections: the last changes them by less than a thousandth."""
FEWEST = 1000
"""Points that a width is corrected by.

One that is stated less often is corrected as those next to it.
"""


def calibrate_intervals(
    model: HeightmapModel,
    store: EpisodeStore,
    delivery: ImageDeliveryModel,
    noise: ImageNoise,
    seed: int,
) -> None:
    """Sets the model's `correction` so that 90 % intervals of every width hold 90 % of the errors.

    A network states intervals for what it saw in training, and errs by a little more elsewhere:
        `store` holds episodes
    that it was not fitted to. One factor for all would be that of level ground, where half of the
    points are.
    """
    windows = store.windows(BATCH, LENGTH, delivery, noise, np.random.default_rng(seed))
    hidden = torch.zeros(BATCH, model.config.hidden, device=store.device)
    stated, beyond = [], []
    with torch.no_grad():
        model.correction.zero_()
        for _, window in zip(range(WINDOWS), windows, strict=False):
            estimate, hidden = run_window(model, window, hidden)
            error = (
                (estimate.height - window.height).abs().clamp(min=torch.finfo(torch.float32).tiny)
            )
            ratio = error.log() - math.log(INTERVAL90) - estimate.log_std
            stated.append(estimate.log_std[window.valid > 0].flatten().cpu().numpy())
            beyond.append(ratio[window.valid > 0].flatten().cpu().numpy())
        model.correction.copy_(
            torch.from_numpy(_corrections(np.concatenate(stated), np.concatenate(beyond)))
        )


def _corrections(stated: np.ndarray, beyond: np.ndarray) -> np.ndarray:
    """Corrections of each width, from logarithms of what was stated and of errors in intervals:
    shape (WIDTHS,).
    """
    widths = np.linspace(math.log(MIN_STD_M), math.log(MAX_STD_M), WIDTHS)
    nearest = np.rint((stated - widths[0]) / (widths[1] - widths[0])).astype(int)
    told = [i for i in range(WIDTHS) if np.count_nonzero(nearest == i) >= FEWEST] or [
        int(np.median(nearest))
    ]
    corrections = np.zeros(WIDTHS)
    for _ in range(ROUNDS):  # what is between two widths has a share in both
        left = beyond - np.interp(stated, widths, corrections)
        corrections += np.interp(
            range(WIDTHS), told, [np.quantile(left[nearest == i], 0.9) for i in told]
        )
    return corrections
