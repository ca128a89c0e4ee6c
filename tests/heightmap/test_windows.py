"""Windows of a dataset: the story of an episode in order,
empty hidden states, and noise of images.
"""

from pathlib import Path

import numpy as np
import pytest
import torch
from samples import ROBOT

from saltus.heightmap.data.delivery import TRAINING, ImageDeliveryModel
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.model import HeightmapModel
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.quantiles import INTERVAL90
from saltus.heightmap.training.dataset import (
    TRAINING_NOISE,
    EpisodeStore,
    ImageNoise,
    run_window,
    with_noise,
)
from saltus.heightmap.training.validate import run_episode


def found(store: EpisodeStore, heights: np.ndarray) -> tuple[Episode, int]:
    """The episode that holds a run of heights, and the tick at which the run begins."""
    for episode in store.episodes:
        for begin in np.flatnonzero((episode.height == heights[0]).all(-1)):
            if np.array_equal(episode.height[begin : begin + len(heights)], heights):
                return episode, int(begin)
    raise AssertionError("no episode holds these heights")


def test_windows_tell_the_story_of_an_episode_in_order(store: EpisodeStore) -> None:
    windows = store.windows(6, 20, TRAINING, ImageNoise(), np.random.default_rng(0))
    first, second = next(windows), next(windows)
    assert first.starts.all()
    entered = []
    for robot in np.flatnonzero(~second.starts.numpy()):
        whole = torch.cat(
            [w.height[:, robot][w.valid[:, robot] > 0] for w in (first, second)]
        ).numpy()
        entered.append(found(store, whole)[1])
    assert any(begin == 0 for begin in entered)
    assert any(begin > 0 for begin in entered)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_share_of_the_windows_begins_with_an_empty_state_and_goes_on_all_the_same(
    store: EpisodeStore, share: float
) -> None:
    windows = store.windows(
        200, 20, TRAINING, ImageNoise(), np.random.default_rng(0), forgets=share
    )
    first, second = next(windows), next(windows)
    forgot = []
    for robot, starts in enumerate(second.starts.tolist()):
        whole = torch.cat(
            [w.height[:, robot][w.valid[:, robot] > 0] for w in (first, second)]
        ).numpy()
        try:
            found(store, whole)
        except AssertionError:
            assert starts  # it is in another episode
        else:
            forgot.append(starts)
    assert len(forgot) > 100
    assert abs(np.mean(forgot) - share) <= (0.12 if 0.0 < share < 1.0 else 0.0)


def test_a_window_gives_what_the_file_gives_tick_by_tick(
    store: EpisodeStore, model: HeightmapModel, model_path: Path
) -> None:
    windows = store.windows(1, 150, ImageDeliveryModel(), ImageNoise(), np.random.default_rng(0))
    window = next(w for w in windows if w.valid.all())  # one that was entered at its beginning
    with torch.no_grad():
        estimate, _ = run_window(model, window, torch.zeros(1, 256))
    episode, _ = found(store, window.height[:, 0].numpy())
    height, half_width = run_episode(
        HeightmapNetwork(ROBOT, model_path), episode, ImageDeliveryModel()
    )
    np.testing.assert_allclose(estimate.height[:, 0].numpy(), height, atol=1e-4)
    np.testing.assert_allclose(
        INTERVAL90 * estimate.log_std[:, 0].exp().numpy(), half_width, atol=1e-4
    )


def test_noise_keeps_images_what_they_are(store: EpisodeStore) -> None:
    window = next(store.windows(8, 50, TRAINING, ImageNoise(), np.random.default_rng(0)))
    noisy = with_noise(window.image, TRAINING_NOISE, torch.Generator().manual_seed(0))
    assert noisy.shape == window.image.shape
    depth, valid = noisy[:, :, 0], noisy[:, :, 1]
    assert ((depth >= 0.0) & (depth <= 1.0)).all()
    assert ((valid == 0.0) | (valid == 1.0)).all()
    assert (depth[valid == 0.0] == 1.0).all()
    assert (valid <= window.image[:, :, 1]).all()
    lost = 1.0 - valid[:, 1:].mean() / window.image[:, 1:, 1].mean()
    assert 0.005 < lost < 0.15
    change = (depth - window.image[:, :, 0])[(valid > 0) & (window.image[:, :, 0] < 0.5)] * 3.0
    assert 0.001 < change.std() < 0.03


def test_images_with_errors_of_stereo_do_not_get_them_again(store: EpisodeStore) -> None:
    window = next(store.windows(4, 50, TRAINING, ImageNoise(), np.random.default_rng(0)))
    noise = ImageNoise(disparity=0.01, edge_loss=0.5)
    true_depth = torch.tensor([True, False, True, False])
    noisy = with_noise(window.image, noise, torch.Generator().manual_seed(0), true_depth)
    torch.testing.assert_close(noisy[~true_depth], window.image[~true_depth], atol=1e-6, rtol=0.0)
    assert all((noisy[i] - window.image[i]).abs().mean() > 1e-3 for i in np.flatnonzero(true_depth))


def test_no_noise_is_no_change(store: EpisodeStore) -> None:
    window = next(store.windows(4, 50, TRAINING, ImageNoise(), np.random.default_rng(0)))
    quiet = with_noise(window.image, ImageNoise(), torch.Generator().manual_seed(0))
    torch.testing.assert_close(quiet, window.image, atol=1e-6, rtol=0.0)
