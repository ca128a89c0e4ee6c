"""How good a network is on episodes that it was not fitted to: errors by region and terrain, and its warm-up."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from heightmap.dataset import EpisodeStore
from heightmap.delivery import DeliveryModel
from heightmap.model import Estimate, HeightmapModel
from heightmap.shards import Episode
from heightmap.train import run_window
from saltus.grid import HEIGHTMAP_X

AHEAD_X = 0.45  # standing, the camera sees the ground from 0.485 m on (derived from its pose and field of view)
UNDER_X = 0.2  # in front of the hips: seen some time ago, or felt
SETTLED_TICKS = 50  # the first 0.5 s count for the warm-up, not for the accuracy
_WARM = 1.1  # warm: the error is at most 10 % above that of a network with a long memory
_FRAME_TICKS = 2


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Mean absolute errors [m] and how honest the standard deviation is."""

    mae_m: float
    ahead_m: float
    """Points that the camera can see: x >= 0.45 m."""
    between_m: float
    under_m: float
    """Points below and behind the base: x <= 0.2 m."""
    within_one_std: float
    """Share of errors below the standard deviation; 0.68 where it is right and errors are Gaussian."""
    terrain_mae_m: dict[str, float]
    ticks: int


def accuracy(model: HeightmapModel, episodes: list[Episode], delivery: DeliveryModel) -> Accuracy:
    """Errors over whole episodes without image noise."""
    errors: list[Tensor] = []
    covered: list[Tensor] = []
    by_terrain: dict[str, list[float]] = {}
    for episode, estimate, truth in _runs(model, episodes, delivery):
        error = (estimate.height - truth).abs()[SETTLED_TICKS:]
        errors.append(error)
        covered.append((error < estimate.log_std[SETTLED_TICKS:].exp()).float())
        by_terrain.setdefault(episode.terrain, []).append(float(error.mean()))
    error = torch.cat(errors)
    ahead, under = torch.from_numpy(HEIGHTMAP_X >= AHEAD_X), torch.from_numpy(HEIGHTMAP_X <= UNDER_X)
    return Accuracy(
        mae_m=float(error.mean()),
        ahead_m=float(error[:, ahead].mean()),
        between_m=float(error[:, ~ahead & ~under].mean()),
        under_m=float(error[:, under].mean()),
        within_one_std=float(torch.cat(covered).mean()),
        terrain_mae_m={kind: float(np.mean(values)) for kind, values in sorted(by_terrain.items())},
        ticks=len(error),
    )


def warmup_frames(model: HeightmapModel, episodes: list[Episode], delivery: DeliveryModel, limit: int = 100) -> int:
    """Images after a loss of memory until the visible part is as good as with memory: within 10 %.

    Each episode runs once undisturbed and once with its memory lost in the middle; their errors are compared tick by
    tick, averaged over the episodes.
    """
    ahead = torch.from_numpy(HEIGHTMAP_X >= AHEAD_X)
    with_memory, without = [], []
    for episode, estimate, truth in _runs(model, episodes, delivery):
        lost_at = len(episode.height) // 2
        if len(episode.height) - lost_at < 2 * limit:
            continue
        window = EpisodeStore([episode], torch.device("cpu")).whole(0, delivery, np.random.default_rng(0))
        late = window._replace(
            **{name: getattr(window, name)[lost_at:] for name in ("in_use", "age", "new", "proprioception", "height")}
        )
        with torch.no_grad():
            cold, _ = run_window(model, late, torch.zeros(1, model.config.hidden))
        span = slice(lost_at, lost_at + 2 * limit)
        with_memory.append((estimate.height - truth).abs()[span][:, ahead].mean(-1))
        without.append((cold.height[:, 0] - truth[lost_at:]).abs()[: 2 * limit][:, ahead].mean(-1))
    warm, cold_error = torch.stack(with_memory).mean(0), torch.stack(without).mean(0)
    bad = torch.nonzero(cold_error > _WARM * warm)
    return 1 + (int(bad.max()) // _FRAME_TICKS if len(bad) else 0)


def _runs(
    model: HeightmapModel, episodes: list[Episode], delivery: DeliveryModel
) -> Iterator[tuple[Episode, Estimate, Tensor]]:
    """Each episode with its estimates and truth, without batch axis."""
    store = EpisodeStore(episodes, torch.device("cpu"))
    for i, episode in enumerate(episodes):
        window = store.whole(i, delivery, np.random.default_rng(0))
        with torch.no_grad():
            estimate, _ = run_window(model, window, torch.zeros(1, model.config.hidden))
        yield episode, Estimate(estimate.height[:, 0], estimate.log_std[:, 0]), window.height[:, 0]
