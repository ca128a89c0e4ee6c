"""A predictor of heights that needs no Saltus:
reads the inputs of the benchmark, writes a file that can be scored.

    saltus bench depth_to_heights make
    python examples/own_predictor.py runs/depth_to_heights/inputs.parquet mine.parquet
    saltus bench depth_to_heights score mine.parquet

It takes all ground to be as high as the feet that stand. Yours may look at the images
(`observation.depth`) and keep a memory within a run; docs/benchmark.md says what the columns hold.
Needs numpy and pyarrow.
"""

import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

POINTS = 30  # evenly from 0.4 m behind the base to 0.8 m ahead of it, along its yaw
HALF_WIDTH_90_M = (
    0.8  # 90 % of the heights are within this: how high the ground is ahead nobody knows here
)


def predict(run: pa.Table) -> tuple[np.ndarray, np.ndarray]:
    """Heights relative to the base and halves of their 90 % intervals [m],
    shape (steps, 30) each, of one run.
    """
    base_height = run["observation.base_height"].to_numpy()
    height = np.repeat(-base_height[:, None], POINTS, axis=1)
    return height, np.full_like(height, HALF_WIDTH_90_M)


def main(inputs: str, out: str) -> None:
    """Predicts run by run: each is a row group of the file."""
    file, runs = pq.ParquetFile(inputs), []
    for number in range(file.num_row_groups):
        run = file.read_row_group(number)
        height, half_width_90 = predict(run)
        columns = {name: run[name] for name in ("episode_index", "frame_index")}
        runs.append(
            pa.table({**columns, "height": list(height), "half_width_90": list(half_width_90)})
        )
    pq.write_table(pa.concat_tables(runs), out)


if __name__ == "__main__":
    main(*sys.argv[1:])
