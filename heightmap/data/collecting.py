"""Collecting: batches of episodes become a shard of each dataset,
also where Ctrl-C ends it early.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.shards import ShardRecord, open_shard, without_interrupts


@dataclass(frozen=True, kw_only=True)
class CollectionResult:
    """Shards that a collection of episodes has made, and whether it is whole."""

    records: list[ShardRecord]
    """Records of the shard in each dataset."""
    whole: bool
    """True where it was not interrupted."""


def collect_batches(
    datasets: Sequence[tuple[Path, dict[str, object]]],
    batches: Iterable[Sequence[Iterable[Episode]]],
    done: Callable[[int], object],
    *,
    seed: int,
    code: str | None = None,
) -> CollectionResult:
    """Adds a shard to each of some datasets.

    Where it is interrupted, of the batches that are whole by then.

    Args:
        datasets: Folder and configuration of each, see `open_shard`.
        batches: Episodes of each batch, for each dataset.
        done: Is told after each batch how many ticks a dataset has got.
        seed: From which the episodes are drawn.
        code: See `open_shard`.

    Raises:
        KeyboardInterrupt: it was interrupted before the first batch was whole.
    """
    whole = True
    with ExitStack() as stack:
        shards = [
            stack.enter_context(open_shard(folder, seed=seed, config=config, code=code))
            for folder, config in datasets
        ]
        try:
            for batch in batches:
                with without_interrupts():
                    for shard, episodes in zip(shards, batch, strict=True):
                        shard.append(episodes)
                done(shards[0].ticks)
        except KeyboardInterrupt:
            if not shards[0].ticks:
                raise
            whole = False
    return CollectionResult(records=[shard.record for shard in shards], whole=whole)
