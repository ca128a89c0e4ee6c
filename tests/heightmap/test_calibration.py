"""Intervals of a trained network are corrected until they hold what they should."""

import copy

import numpy as np
import pytest
import torch

from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.data.delivery import TRAINING
from saltus.heightmap.model import MAX_STD_M, MIN_STD_M, WIDTHS, HeightmapModel
from saltus.heightmap.service.quantiles import INTERVAL90
from saltus.heightmap.training import calibration
from saltus.heightmap.training.calibration import calibrate_intervals
from saltus.heightmap.training.dataset import EpisodeStore, ImageNoise, run_window


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("stated", "spread"), [(0.1, 0.0), (3.0, 0.0), (1.0, 10.0), (0.1, 40.0), (3.0, 40.0)]
)
def test_intervals_of_every_width_hold_nine_of_ten_errors(
    store: EpisodeStore,
    model: HeightmapModel,
    short_calibration: None,
    stated: float,
    spread: float,
) -> None:
    """However far off narrow and wide ones were; heights stay."""
    model = copy.deepcopy(model)
    with torch.no_grad():
        last = model.head[-1]
        last.get_parameter("weight")[len(HEIGHTMAP_X) :] *= (
            spread  # at first all intervals are nearly as wide
        )
        last.get_parameter("bias")[len(HEIGHTMAP_X) :] += np.log(stated)
    before = _held(model, store)
    calibrate_intervals(model, store, TRAINING, ImageNoise(), 0)
    after, correction = _held(model, store), model.correction.clone()
    assert (after[0] == before[0]).all()
    step = (MAX_STD_M / MIN_STD_M) ** (1.0 / (WIDTHS - 1))
    width = np.rint(np.log(before[2] / INTERVAL90 / MIN_STD_M) / np.log(step))
    for band in [
        width == i for i in np.unique(width) if np.count_nonzero(width == i) >= calibration.FEWEST
    ]:
        assert np.mean(after[1][band] < after[2][band]) == pytest.approx(0.9, abs=0.01)
    calibrate_intervals(model, store, TRAINING, ImageNoise(), 0)
    assert (model.correction == correction).all()


def _held(model: HeightmapModel, store: EpisodeStore) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heights, their errors and halves of their 90 % intervals [m],
    of the windows of a calibration.
    """
    windows = store.windows(
        calibration.BATCH, calibration.LENGTH, TRAINING, ImageNoise(), np.random.default_rng(0)
    )
    hidden, told = torch.zeros(calibration.BATCH, model.config.hidden), []
    with torch.no_grad():
        for _, window in zip(range(calibration.WINDOWS), windows, strict=False):
            estimate, hidden = run_window(model, window, hidden)
            error = (estimate.height - window.height).abs()
            valid = window.valid > 0
            told.append(
                [
                    of[valid].flatten()
                    for of in (estimate.height, error, INTERVAL90 * estimate.log_std.exp())
                ]
            )
    height, error, half = (torch.cat(of).numpy() for of in zip(*told, strict=True))
    return height, error, half
