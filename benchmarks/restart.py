"""How long a network that has lost its memory in mid-run is worse than one that remembers.

    saltus heightmap collect --source policy --device cpu --episodes 128 --seed 4711 --out runs/unseen
    python -m benchmarks.restart runs/unseen models/heightmap.onnx [another.onnx ...] [--json]

Each episode that is long enough runs twice, images 30 to 60 ms late with jitter and losses: as it is, and with the
memory emptied in its middle. Prints the mean error over all 30 points of the first, and by how much more the second
errs in the 0.1 s that follow some times after the loss.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from saltus.heightmap.data.delivery import TICK_S, TRAINING
from saltus.heightmap.data.shards import Episode, read_dataset
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.training.validate import run_episode

AFTER_S = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8)
SPAN = round(0.1 / TICK_S)  # ticks that are averaged
LAST = round(AFTER_S[-1] / TICK_S) + SPAN  # ticks that must follow on the loss
EPISODES = 256


def measure(network: HeightmapNetwork, episodes: list[Episode]) -> dict[str, object]:
    """Errors [m] at each of `AFTER_S`, with and without the memory."""
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


def main() -> None:
    """Parses the command line, measures and prints a row for each model."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of a dataset that no model was trained on")
    parser.add_argument("models", type=Path, nargs="+", help="ONNX files")
    parser.add_argument("--episodes", type=int, default=EPISODES, help="at most")
    parser.add_argument("--json", action="store_true", help="print one JSON object on the last line")
    given = parser.parse_args()
    long_enough = [e for e in read_dataset(given.data) if len(e.height) >= 2 * LAST]
    if not long_enough:
        parser.error(f"no episode of {given.data} lasts {2 * LAST * TICK_S:g} s")
    rows = [measure(HeightmapNetwork(path), long_enough[: given.episodes]) for path in given.models]
    for row in rows:
        worse = ", ".join(f"{s} s {100 * share:+.1f} %" for s, share in row["worse_by"].items())
        print(f"{row['model_id']}: {1e3 * row['mae_m']:.1f} mm on {row['episodes']} episodes; after {worse}")
    if given.json:
        print(json.dumps({"models": rows}))


if __name__ == "__main__":
    main()
