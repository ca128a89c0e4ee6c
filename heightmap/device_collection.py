"""Adds data from thousands of robots on one device to datasets."""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from saltus.depth_camera import load_camera
from saltus.heightmap.data.collecting import CollectionResult, collect_batches
from saltus.heightmap.data.delivery import hardware_table
from saltus.heightmap.data.device_rollouts import DeviceRollouts, checked_device
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.settings import DeviceCollection
from saltus.heightmap.training.train import load_checkpoint
from saltus.policy.training.export import read_policy
from saltus.used_networks import model_path


@dataclass(frozen=True, kw_only=True)
class DeviceSpeed:
    """How fast a collection on a GPU simulated its robots, without what came before the first
    batch.
    """

    ticks: int
    """Labelled steps of 10 ms."""
    moving_s: float
    """For all but writing."""
    seconds: float
    """With writing."""

    @property
    def table(self) -> dict[str, int]:
        """Labelled steps a second."""
        pairs = (("steps_per_s", self.moving_s), ("steps_per_s_with_writing", self.seconds))
        return {name: round(self.ticks / seconds) for name, seconds in pairs}


def collect_shards_on_device(
    settings: DeviceCollection,
    outputs: Mapping[str, Path],
    ticked: Callable[[], object],
    done: Callable[[DeviceSpeed, float], object],
    code: str | None = None,
) -> CollectionResult:
    """Adds one shard to each dataset, one for each of the loop's cameras; all show the same motion.

    `ticked` is called after each tick; `done` is told after each batch how fast it is, and the
    share of robots whose physics left out contacts for want of room. `code` and interruptions are
    as in `collect_batches`.

    Raises:
        SaltusError: there is no such device, or policy or predictor cannot be read.
    """
    device = checked_device(settings.device)
    loop = replace(settings.loop, robots=-(-settings.episodes // settings.batches))
    policy, predictor = settings.policy or model_path("policy"), settings.predictor
    model = None if predictor is None else load_checkpoint(predictor)[0]
    rollouts = DeviceRollouts(
        loop,
        read_policy(policy),
        model,
        device=device,
        seed=settings.seed,
        profile=settings.profile,
    )
    table: dict[str, object] = {
        "source": "device rollouts",
        "batches": settings.batches,
        **loop.table,
    }
    table |= {
        "policy": _sha16(policy),
        "heights": "true" if predictor is None else _sha16(predictor),
    }
    began, moving_s = time.perf_counter(), 0.0

    def batches() -> Iterator[list[Iterator[Episode]]]:
        nonlocal moving_s
        for _ in range(settings.batches):
            start = time.perf_counter()
            recorded = rollouts.batch(ticked)
            moving_s += time.perf_counter() - start
            yield [recorded.episodes(camera) for camera in outputs]

    def tell(ticks: int) -> None:
        speed = DeviceSpeed(ticks=ticks, moving_s=moving_s, seconds=time.perf_counter() - began)
        done(speed, rollouts.crowded_share())

    cameras = {folder: load_camera(camera) for camera, folder in outputs.items()}
    known = {
        folder: hardware_table(rollouts.profile, loop.robot, camera)
        for folder, camera in cameras.items()
    }
    datasets = [
        (folder, {**table, "camera": cameras[folder].record, **known[folder]}) for folder in cameras
    ]
    return collect_batches(datasets, batches(), tell, seed=settings.seed, code=code)


def _sha16(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
