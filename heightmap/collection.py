"""What robots on processors, or on the hosts of a cluster, add to a dataset: a round of the closed loop."""

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from saltus.effects.profile import SHIPPED
from saltus.heightmap.data.closed_loop import closed_loop_episodes
from saltus.heightmap.data.ray_workers import in_order_on_ray
from saltus.heightmap.data.shards import Episode, ShardRecord, open_shard
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.settings import ClosedLoop, ProcessorCollection
from saltus.workers import Listener, in_order

Key = tuple[int, int, int]
"""Of a batch: seed, round, number."""


def collect(
    settings: ProcessorCollection,
    directory: Path,
    batches: Callable[[int], object],
    *,
    processes: int | None = None,
    cluster: str | None = None,
    listener: Listener | None = None,
) -> ShardRecord:
    """Adds a shard to a dataset; of a collection that is interrupted the batches that are whole.

    Args:
        settings: What to collect.
        directory: The dataset.
        batches: Is told after each batch how many are in the dataset.
        processes: That collect, see `closed_loop_batches`.
        cluster: The same.
        listener: Is told of steps while batches are made, but not by a cluster.

    Raises:
        KeyboardInterrupt: it was interrupted before the first batch was whole.
        DatasetError: the dataset has these episodes, or cannot be written.
    """
    keys = [(settings.seed, 0, batch) for batch in range(settings.batches)]
    table = round_table(settings.loop, settings.batches, 0, settings.model)
    if settings.profile != SHIPPED:
        table["profile"] = settings.profile
    made = closed_loop_batches(settings.loop, settings.model, keys, settings.profile, processes, cluster, listener)
    with open_shard(directory, seed=settings.seed, config=table) as shard, closing(made):
        try:
            for done, episodes in enumerate(made, start=1):
                shard.append(episodes)
                batches(done)
        except KeyboardInterrupt:
            if not shard.ticks:
                raise
    return shard.record


def closed_loop_batches(
    loop: ClosedLoop,
    model: Path | None,
    keys: Sequence[Key],
    profile: str = SHIPPED,
    processes: int | None = None,
    cluster: str | None = None,
    listener: Listener | None = None,
) -> Generator[list[Episode], None, None]:
    """The batch of each key, in the order of the keys, from this machine or from a cluster.

    Args:
        loop: How robots are let run.
        model: ONNX file of the predictor in the loop; true heights where there is none.
        keys: Of the batches, from which everything is drawn.
        profile: Hardware of the robots, by name or file.
        processes: One for each core where it is not given. The batches do not depend on it.
        cluster: Address of a Ray cluster, see `saltus.heightmap.data.ray_workers`; nor do they depend on this.
        listener: Is told of steps while batches are made, but not by a cluster.
    """
    if cluster is not None:
        return in_order_on_ray(partial(closed_loop_episodes, loop, profile=profile), model, keys, cluster, processes)
    return in_order(partial(closed_loop_episodes, loop, model, profile=profile), keys, processes, listener)


def round_table(loop: ClosedLoop, batches: int, index: int, model: Path | None) -> dict[str, Any]:
    """What the manifest says of a round; by it a dataset knows the episodes that it has."""
    heights = "true" if model is None else HeightmapNetwork(model).model_id
    return {"source": "dagger", "round": index, "batches": batches, **asdict(loop), "heights": heights}
