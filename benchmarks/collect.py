"""How fast data for the heightmap predictor are collected with the shipped predictor in the loop.

    OMP_NUM_THREADS=1 python -m benchmarks.collect [--processes N] [--batches N]
    python -m benchmarks.collect --gpu [--batches N]

Prints one JSON object: labelled steps of 10 ms a second, with rendering, late and lost images, network, planners,
physics, and the images that are kept; by the clock, by the clock after the processes have started, and by a second of
one core's work, which other programs on the machine disturb less. With --gpu batches of 8,192 robots are led by the
learned policy on a GPU, stereo images and predictor included. Shards are written to a temporary folder.
"""

import argparse
import json
import resource
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from saltus.heightmap.data.closed_loop import ClosedLoop
from saltus.heightmap.data.shards import Episode, write_shard
from saltus.resources import resource as shipped
from saltus.workers import in_order


def main() -> None:
    """Measures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--batches", type=int, default=6)
    parser.add_argument("--gpu", action="store_true", help="on a GPU instead")
    given = parser.parse_args()
    if given.gpu:
        from saltus.heightmap.training.gpu_rollouts import main as on_gpu

        with tempfile.TemporaryDirectory() as folder:
            size = ["--robots", "8192", "--batches", str(given.batches)]
            on_gpu(["--out", folder, "--predictor", "models/checkpoints/heightmap.pt", *size])
        return
    marks: list[tuple[float, int]] = [(time.perf_counter(), 0)]
    work = partial(ClosedLoop().episodes, shipped("models/heightmap.onnx"))
    keys = [(0, 0, batch) for batch in range(given.batches)]

    def episodes() -> Iterator[Episode]:
        for batch in in_order(work, keys, given.processes):
            yield from batch
            marks.append((time.perf_counter(), sum(len(episode.height) for episode in batch)))

    with tempfile.TemporaryDirectory() as folder:
        ticks = write_shard(Path(folder), episodes(), seed=0, config={}).ticks
    began, first, last = marks[0][0], marks[given.processes][0], marks[-1][0]
    later = sum(count for _, count in marks[given.processes + 1 :])
    table = {
        "processes": given.processes,
        "labelled_steps": ticks,
        "steps_per_s": ticks / (time.perf_counter() - began),
        "steps_per_s_when_started": later / (last - first),
        "steps_per_core_s": ticks / _cpu_s(),
    }
    print(json.dumps({name: round(value) for name, value in table.items()}))


def _cpu_s() -> float:
    """Work of this process and of those that it has started, their start included [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


if __name__ == "__main__":
    main()
