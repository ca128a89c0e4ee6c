"""Adds a round of data from robots on a GPU to datasets.

    python -m saltus.heightmap.training.gpu_rollouts --out FOLDER

Prints a line for each batch, and at the end one JSON object: labelled steps of 10 ms a second with and without
writing, rendering, noise and the predictor in the loop included.
"""

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from saltus.config import Camera
from saltus.errors import SaltusError
from saltus.heightmap.data.device_rollouts import DeviceLoop, DeviceRollouts, checked_device
from saltus.heightmap.data.shards import ShardRecord, open_shard
from saltus.heightmap.training.train import load_checkpoint
from saltus.policy.training.checkpoint import read_checkpoint

POLICY = Path("models/checkpoints/policy.pt")


@dataclass(frozen=True, kw_only=True)
class BatchProgress:
    """Where the collection is."""

    batches: int
    ticks: int
    """Labelled steps of 10 ms so far."""
    moving_s: float
    """Time so far for all but writing, without what came before the first batch."""
    seconds: float
    """With writing."""
    crowded: float
    """Share of the robots of the batch whose physics left out contacts for want of room."""


def collect(
    outputs: dict[Camera, Path],
    loop: DeviceLoop,
    *,
    policy: Path,
    predictor: Path | None,
    batches: int,
    seed: int,
    device: str,
    done: Callable[[BatchProgress], None],
    code: str | None = None,
) -> dict[Camera, ShardRecord]:
    """Adds one shard to each dataset; all show the same motion.

    Args:
        outputs: Dataset for the images of each of the loop's cameras.
        loop: How robots are let run.
        policy: Checkpoint of the policy that leads.
        predictor: Checkpoint of the predictor in the loop; without it the policy sees true heights, a little off.
        batches: How many.
        seed: Of everything that is drawn.
        device: "cuda" or "cpu".
        done: Is told after each batch.
        code: Which code collects, where this machine cannot tell.

    Raises:
        SaltusError: there is no such device, or a checkpoint cannot be read.
    """
    device = checked_device(device)
    model = None if predictor is None else load_checkpoint(predictor)[0]
    rollouts = DeviceRollouts(loop, read_checkpoint(policy), model, device=device, seed=seed)
    table: dict[str, Any] = {"source": "device rollouts", "batches": batches, **asdict(loop)}
    table |= {"policy": _sha16(policy), "heights": "true" if predictor is None else _sha16(predictor)}
    began, moving_s, labelled = time.perf_counter(), 0.0, 0
    with ExitStack() as stack:
        shards = {
            camera: stack.enter_context(open_shard(folder, seed=seed, config={**table, "camera": camera}, code=code))
            for camera, folder in outputs.items()
        }
        for batch in range(batches):
            start = time.perf_counter()
            recorded = rollouts.batch()
            moving_s += time.perf_counter() - start
            for camera, shard in shards.items():
                shard.append(recorded.episodes(camera))
                labelled = shard.ticks
            now = time.perf_counter()
            done(
                BatchProgress(
                    batches=batch + 1, ticks=labelled, moving_s=moving_s, seconds=now - began,
                    crowded=rollouts.crowded_share(),
                )
            )  # fmt: skip
    return {camera: shard.record for camera, shard in shards.items()}


def _sha16(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def main(arguments: Sequence[str] | None = None) -> None:
    """Parses the command line and collects."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="dataset that gets a shard")
    parser.add_argument("--also-ideal", type=Path, help="dataset for the true depth of the same motion")
    parser.add_argument("--robots", type=int, default=4096, help="in a batch")
    parser.add_argument("--ticks", type=int, default=600, help="of each robot")
    parser.add_argument("--batches", type=int, default=4)
    parser.add_argument("--policy", type=Path, default=POLICY, help="checkpoint")
    parser.add_argument("--predictor", type=Path, help="checkpoint; true heights where it is not given")
    parser.add_argument("--camera", choices=("d435i", "ideal"), default="d435i", help="images in --out")
    parser.add_argument("--hardest", type=float, default=1.0, help="courses go up to this difficulty, at most 1.2")
    parser.add_argument(
        "--learned", type=float, default=1.0, help="share of robots that the policy leads; others: the scripted planner"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", choices=("cuda", "cpu"), default="cuda")
    parser.add_argument("--commit", help="which code this is, where the machine has no repository")
    given = parser.parse_args(arguments)
    outputs: dict[Camera, Path] = {given.camera: given.out}
    if given.also_ideal is not None:
        if given.camera == "ideal":
            parser.error("--also-ideal is for another camera than --camera ideal")
        outputs["ideal"] = given.also_ideal
    told: list[BatchProgress] = []

    def tell(batch: BatchProgress) -> None:
        told.append(batch)
        _say(
            f"batch {batch.batches}: {batch.ticks} steps, {batch.ticks / batch.moving_s:.0f} /s, "
            f"{batch.ticks / batch.seconds:.0f} /s with writing, {100 * batch.crowded:.2f} % of robots crowded"
        )

    loop = DeviceLoop(
        robots=given.robots, ticks=given.ticks, hardest=given.hardest, learned=given.learned, cameras=tuple(outputs)
    )
    records = collect(
        outputs, loop, policy=given.policy, predictor=given.predictor, batches=given.batches, seed=given.seed,
        device=given.device, done=tell, code=given.commit,
    )  # fmt: skip
    for camera, record in records.items():
        _say(f"{outputs[camera] / record.file}: {record.episodes} episodes, {record.ticks} steps, camera {camera}")
    last = told[-1]
    speed = {"steps_per_s": last.ticks / last.moving_s, "steps_per_s_with_writing": last.ticks / last.seconds}
    _say(json.dumps({name: round(value) for name, value in speed.items()}))


def _say(line: str) -> None:
    print(line, flush=True)  # noqa: T201


if __name__ == "__main__":
    try:
        main()
    except SaltusError as error:
        sys.exit(str(error))
