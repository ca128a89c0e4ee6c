"""Adds data from thousands of robots on one device to datasets."""

import hashlib
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from saltus.config import Camera
from saltus.errors import SaltusError
from saltus.heightmap.data.device_rollouts import DeviceRollouts, checked_device
from saltus.heightmap.data.shards import ShardRecord, ShardWriter, open_shard, uninterrupted
from saltus.heightmap.settings import DeviceCollection
from saltus.heightmap.training.train import load_checkpoint
from saltus.policy.training.checkpoint import read_checkpoint
from saltus.resources import resource

POLICY = "models/checkpoints/policy.pt"


@dataclass(frozen=True, kw_only=True)
class DeviceProgress:
    """Where a collection is, at the end of each tick of its robots."""

    ticks: int
    """Of all batches so far."""
    labelled: int = 0
    """Steps of all robots that are in the dataset."""
    moving_s: float = 0.0
    """Time for all but writing, without what came before the first batch."""
    seconds: float = 0.0
    """With writing."""
    crowded: float = 0.0
    """Share of the robots of the batch whose physics left out contacts for want of room."""

    @property
    def speed(self) -> dict[str, float]:
        """Labelled steps a second."""
        return {
            "steps_per_s": round(self.labelled / self.moving_s),
            "steps_per_s_with_writing": round(self.labelled / self.seconds),
        }


@dataclass(frozen=True, kw_only=True)
class CollectedShards:
    """What was collected."""

    records: dict[Camera, ShardRecord]
    """Of the shard in each dataset."""
    progress: DeviceProgress
    """At the end."""
    whole: bool
    """Whether it was not interrupted."""


def collect(
    settings: DeviceCollection,
    outputs: Mapping[Camera, Path],
    progress: Callable[[DeviceProgress], None],
    code: str | None = None,
) -> CollectedShards:
    """Adds one shard to each dataset; all show the same motion.

    Where it is interrupted, the batches that are whole are kept; the shards then have fewer ticks than were asked for.

    Args:
        settings: What to collect.
        outputs: Dataset for the images of each of the loop's cameras.
        progress: Called after each tick.
        code: Which code collects, where this machine cannot tell.

    Raises:
        SaltusError: there is no such device, or a checkpoint cannot be read.
        KeyboardInterrupt: it was interrupted before the first batch was whole.
    """
    device = checked_device(settings.device)
    loop = replace(settings.loop, robots=-(-settings.episodes // settings.batches))
    policy, predictor = settings.policy or _shipped_policy(), settings.predictor
    model = None if predictor is None else load_checkpoint(predictor)[0]
    rollouts = DeviceRollouts(loop, read_checkpoint(policy), model, device=device, seed=settings.seed)
    table: dict[str, Any] = {"source": "device rollouts", "batches": settings.batches, **asdict(loop)}
    table |= {"policy": _sha16(policy), "heights": "true" if predictor is None else _sha16(predictor)}
    with ExitStack() as stack:
        shards = {
            camera: stack.enter_context(
                open_shard(folder, seed=settings.seed, config={**table, "camera": camera}, code=code)
            )
            for camera, folder in outputs.items()
        }
        now, whole = _run(rollouts, settings.batches, shards, progress)
    records = {camera: shard.record for camera, shard in shards.items()}
    return CollectedShards(records=records, progress=now, whole=whole)


def _run(
    rollouts: DeviceRollouts,
    batches: int,
    shards: Mapping[Camera, ShardWriter],
    progress: Callable[[DeviceProgress], None],
) -> tuple[DeviceProgress, bool]:
    """Runs all batches, or until it is interrupted; returns how far it came, and whether to the end."""
    now, began = DeviceProgress(ticks=0), time.perf_counter()

    def tell() -> None:
        nonlocal now
        now = replace(now, ticks=now.ticks + 1)
        progress(now)

    try:
        for _ in range(batches):
            start = time.perf_counter()
            recorded = rollouts.batch(tell)
            moving_s = now.moving_s + time.perf_counter() - start
            with uninterrupted():
                for camera, shard in shards.items():
                    shard.append(recorded.episodes(camera))
            now = replace(
                now, labelled=shard.ticks, moving_s=moving_s, seconds=time.perf_counter() - began,
                crowded=rollouts.crowded_share(),
            )  # fmt: skip
            progress(now)
    except KeyboardInterrupt:
        if not any(shard.ticks for shard in shards.values()):
            raise
        return now, False
    return now, True


def _shipped_policy() -> Path:
    try:
        return resource(POLICY)
    except SaltusError as error:
        raise SaltusError("only a checkout has a checkpoint of the policy: name one with --policy") from error


def _sha16(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
