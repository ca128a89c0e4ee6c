"""How long a network that has lost its hidden state in mid-run is worse than one that has kept it.

Each episode that is long enough runs twice, images late, with jitter and losses, as in training: as
it is, and with the hidden state emptied in its middle. The mean error over all 30 points of the
first, and by how much more the second errs in the 0.1 s that follow some times after the loss.

    saltus heightmap collect gpu --device cpu --episodes 128 --seed 4711 --out runs/unseen
    saltus bench restart -- runs/unseen models/heightmap.onnx
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from benchmarks._command import Command, progress
from saltus.errors import SaltusError
from saltus.heightmap.data.delivery import TICK_S, TRAINING
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.shards import read_dataset
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.training.validate import run_episode
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT

AFTER_S = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8)
SPAN = round(0.1 / TICK_S)  # ticks that are averaged
LAST = round(AFTER_S[-1] / TICK_S) + SPAN  # ticks that must follow on the loss


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    data: Annotated[Path, tyro.conf.Positional]
    """Folder of a dataset that no model was trained on."""
    models: Annotated[tuple[Path, ...], tyro.conf.Positional] = (Path("models/heightmap.onnx"),)
    """ONNX files."""
    episodes: int = 256
    """At most."""

    def measure(self) -> dict[str, Any]:
        long_enough = [e for e in read_dataset(self.data) if len(e.height) >= 2 * LAST]
        if not long_enough:
            raise SaltusError(f"no episode of {self.data} lasts {2 * LAST * TICK_S:g} s")
        networks = [HeightmapNetwork(load_robot(DEFAULT_ROBOT), path) for path in self.models]
        return {
            "models": [
                measure(network, long_enough[: self.episodes]) for network in progress(networks)
            ]
        }


def measure(network: HeightmapNetwork, episodes: list[Episode]) -> dict[str, object]:
    """Errors [m] at each of `AFTER_S`, with and without the hidden state."""
    remembers, forgot = np.zeros(LAST), np.zeros(LAST)
    for episode in episodes:
        lost_at = len(episode.height) // 2
        span = slice(lost_at, lost_at + LAST)
        for total, forget_at in ((remembers, None), (forgot, lost_at)):
            height, _ = run_episode(network, episode, TRAINING, forget_at)
            total += np.abs(height[span] - episode.height[span]).mean(-1) / len(episodes)
    parts = [slice(round(s / TICK_S), round(s / TICK_S) + SPAN) for s in AFTER_S]
    return {
        "model_id": network.model_id,
        "episodes": len(episodes),
        "mae_m": float(remembers.mean()),
        "worse_by": {
            f"{s:g}": float(forgot[part].mean() / remembers[part].mean() - 1.0)
            for s, part in zip(AFTER_S, parts, strict=True)
        },
    }
