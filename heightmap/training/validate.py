"""Quality of a model file on episodes that it was not fitted to:
errors by region and terrain, and its warm-up.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats, Singles
from saltus.depth import model_image
from saltus.heightmap.data.delivery import FRAME_TICKS, ImageDeliveryModel, draw_delivery
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.sight import NetworkInputs

# Standing, the camera sees the ground from 0.485 m on (derived from its pose and field of view)
AHEAD_X = 0.45
UNDER_X = 0.2  # up to the front hips: seen some time ago, or known by the feet
SETTLED_TICKS = 50  # the first 0.5 s count for the warm-up, not for the accuracy
WARM = 1.1  # warm: the error is at most 10 % above that of a network that saw all images before
EDGE_M = 0.03  # a smaller change of height the feet do not mind: the swing clears 6 cm
LEAST_SHARE = 0.5  # of the episodes: in fewer the median robot met nothing but level ground
FLAT = "flat"  # family without edges
MIN_WARMUP = 5  # images: a few more than one bad one could decide for


@dataclass(frozen=True, kw_only=True)
class HeightAccuracy:
    """Mean absolute errors of heights [m] in validation, and how well the stated intervals hold."""

    mae_m: float
    ahead_m: float
    """Points that the camera can see: x >= 0.45 m."""
    between_m: float
    under_m: float
    """Points below and behind the base: x <= 0.2 m."""
    coverage90: float
    """Share of errors within the 90 % interval, see `saltus.heightmap.service.quantiles`."""
    terrain_mae_m: dict[str, float]
    ticks: int
    uneven: int
    """Episodes in which the ground below the robot was not level at some tick."""
    courses: int
    """Episodes on other ground than flat."""

    @property
    def warning(self) -> str:
        """Why these errors are not to be taken for good.

        Empty where most robots came to an edge.
        """
        if self.uneven >= LEAST_SHARE * self.courses:
            return ""
        return (
            f"these errors say little: robots came to an edge in {self.uneven} of {self.courses} "
            "episodes off flat ground, and level ground is easy to predict; collect longer "
            "episodes "
            "(--loop.ticks 600)"
        )


def height_accuracy(
    network: HeightmapNetwork,
    episodes: Sequence[Episode],
    delivery: ImageDeliveryModel | None = None,
) -> HeightAccuracy:
    """Errors of a model file over whole episodes, images without noise.

    Args:
        network: A model file.
        episodes: Held out of the training.
        delivery: How images travel; by default 50 ms late and none lost.
    """
    errors: list[Singles] = []
    covered: list[float] = []
    by_terrain: dict[str, list[float]] = {}
    for episode in episodes:
        height, half_width_90 = run_episode(network, episode, delivery or ImageDeliveryModel())
        error = np.abs(height - episode.height)[SETTLED_TICKS:]
        errors.append(error)
        covered.append(float((error <= half_width_90[SETTLED_TICKS:]).mean()))
        by_terrain.setdefault(episode.terrain, []).append(float(error.mean()))
    every, x = np.concatenate(errors), network.x
    ahead, under = x >= AHEAD_X, x <= UNDER_X
    return HeightAccuracy(
        mae_m=float(every.mean()),
        ahead_m=float(every[:, ahead].mean()),
        between_m=float(every[:, ~ahead & ~under].mean()),
        under_m=float(every[:, under].mean()),
        coverage90=float(np.mean(covered)),
        terrain_mae_m={kind: float(np.mean(values)) for kind, values in sorted(by_terrain.items())},
        ticks=len(every),
        uneven=sum(_is_uneven(episode, x) for episode in episodes if episode.terrain != FLAT),
        courses=sum(episode.terrain != FLAT for episode in episodes),
    )


def _is_uneven(episode: Episode, x: Floats) -> bool:
    below = episode.height[:, x <= 0.0]
    return bool((np.ptp(below, axis=1) > EDGE_M).any())


def warmup_frames(network: HeightmapNetwork, episodes: Sequence[Episode], limit: int = 50) -> int:
    """Images after the hidden state was emptied until the visible part is as good as without that:
    5 to `limit`.

    Each episode runs once undisturbed and once with its hidden state emptied in the middle; errors
    ahead are compared image by image, averaged over the episodes. `limit` where none of them lasts
    long enough to tell.
    """
    ticks = limit * FRAME_TICKS
    warm, cold, ahead = np.zeros(limit), np.zeros(limit), network.x >= AHEAD_X
    for episode in episodes:
        lost_at = len(episode.height) // 2
        span = slice(lost_at, lost_at + ticks)
        truth = episode.height[span][:, ahead]
        if len(truth) < ticks:
            continue
        for total, forget_at in ((warm, None), (cold, lost_at)):
            height, _ = run_episode(network, episode, ImageDeliveryModel(), forget_at)
            total += (
                np.abs(height[span][:, ahead] - truth).mean(-1).reshape(limit, FRAME_TICKS).mean(-1)
            )
    if not warm.any():
        return limit
    late = np.flatnonzero(cold > WARM * warm)
    return int(np.clip(late[-1] + 2 if len(late) else 1, MIN_WARMUP, limit))


def run_episode(
    network: HeightmapNetwork,
    episode: Episode,
    delivery: ImageDeliveryModel,
    forget_at: int | None = None,
) -> tuple[Singles, Singles]:
    """Heights and half of their 90 % intervals [m] at every tick, each of shape (ticks, 30).

    Args:
        network: Runs tick by tick, as in the service.
        episode: What it gets.
        delivery: How images travel; drawn from a seed of its own, so always the same.
        forget_at: Tick before which the hidden state is emptied once.
    """
    height, half_width_90 = np.empty_like(episode.height), np.empty_like(episode.height)
    hidden = np.zeros((1, network.hidden_size), np.float32)
    for i, inputs in enumerate(episode_inputs(episode, delivery)):
        if i == forget_at:
            hidden = np.zeros_like(hidden)
        tick = network.tick(*inputs._replace(hidden=hidden))
        height[i], half_width_90[i], hidden = tick.height[0], tick.half_width_90[0], tick.hidden
    return height, half_width_90


def episode_inputs(episode: Episode, delivery: ImageDeliveryModel) -> Iterator[NetworkInputs]:
    """Returns what the network gets at each tick of an episode but for its hidden state,
    images without noise.
    """
    images, blank = model_image(episode.depth), model_image(np.zeros_like(episode.depth[0]))
    delivered = draw_delivery([episode], delivery, np.random.default_rng(0))
    ((frames, ages_s, news),) = zip(*delivered, strict=True)
    for features, frame, age_s, new in zip(
        episode.proprioception, frames, ages_s, news, strict=True
    ):
        image, hidden = images[frame] if frame >= 0 else blank, np.empty((1, 0), np.float32)
        yield NetworkInputs(image[None], np.array([age_s]), np.array([new]), features[None], hidden)
