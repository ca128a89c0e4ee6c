"""Rounds of the closed loop, which robots on processors add to a dataset."""

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

from saltus.depth_camera import load_camera
from saltus.effects.profile import SHIPPED
from saltus.heightmap.data.closed_loop import closed_loop_episodes
from saltus.heightmap.data.collecting import CollectionResult, collect_batches
from saltus.heightmap.data.delivery import hardware_table
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.settings import ClosedLoop, ProcessorCollection
from saltus.robots.loading import load_robot
from saltus.workers import WorkerListener, in_order

EpisodeKey = tuple[int, int, int]
"""Key of a batch: seed, round, number."""


def collect_shard(
    settings: ProcessorCollection,
    directory: Path,
    done: Callable[[int], object],
    *,
    processes: int | None = None,
    listener: WorkerListener | None = None,
) -> CollectionResult:
    """Adds a shard to a dataset.

    Arguments and errors as those of `collect_batches` and `closed_loop_batches`.
    """
    keys = [(settings.seed, 0, batch) for batch in range(settings.batches)]
    table = round_table(settings.loop, settings.batches, 0, settings.model)
    table |= hardware_table(
        settings.profile, settings.loop.robot, load_camera(settings.loop.camera)
    )
    made = closed_loop_batches(
        settings.loop, settings.model, keys, settings.profile, processes, listener
    )
    with closing(made):
        return collect_batches(
            [(directory, table)], ([batch] for batch in made), done, seed=settings.seed
        )


def closed_loop_batches(
    loop: ClosedLoop,
    model: Path | None,
    keys: Sequence[EpisodeKey],
    profile: str = SHIPPED,
    processes: int | None = None,
    listener: WorkerListener | None = None,
) -> Generator[list[Episode], None, None]:
    """The batch of each key, in the order of the keys.

    Batches follow from the keys alone, wherever they are made. Without a model robots go by true
    heights; the listener is told of steps while batches are made.
    """
    return in_order(
        partial(closed_loop_episodes, loop, model, profile=profile), keys, processes, listener
    )


def round_table(
    loop: ClosedLoop, batches: int, index: int, model: Path | None
) -> dict[str, object]:
    """Table of a round in the manifest; by it a dataset knows the episodes that it has."""
    camera = load_camera(loop.camera)
    robot = camera.mounted_on(load_robot(loop.robot))
    heights = "true" if model is None else HeightmapNetwork(robot, model).model_id
    table = {
        "source": "dagger",
        "round": index,
        "batches": batches,
        **loop.table,
        "heights": heights,
    }
    return {**table, "camera": camera.record}
