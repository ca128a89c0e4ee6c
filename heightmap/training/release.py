"""From a checkpoint to a model that can be shipped: exported, compared, measured, described."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from saltus.depth_camera import DepthCamera
from saltus.errors import ModelError
from saltus.heightmap.data.delivery import TRAINING
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.shards import (
    DatasetError,
    ShardRecord,
    camera_of,
    dataset_hash,
    motion_text,
    read_dataset,
    read_records,
)
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.training.export import ModelOrigin, export_heightmap, parity
from saltus.heightmap.training.exported import TrainingOrigin
from saltus.heightmap.training.interface import model_interface
from saltus.heightmap.training.train import load_checkpoint, split_episodes
from saltus.heightmap.training.validate import (
    HeightAccuracy,
    episode_inputs,
    height_accuracy,
    warmup_frames,
)
from saltus.model_file import put_model
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.robots.shipped import robot_name_in

PARITY_STEPS = 1000
# In a tick, see `ModelRelease.parity`; single precision is up to 4e-6 off on held-out episodes
MAX_DIFFERENCE = 1e-5
MAX_BYTES = 10_000_000
MEASURED = 300
"""Held-out episodes at most, spread over all of them: three minutes, and a mean error is known to
some percent."""
REGIONS = (
    ("all 30 points", "mae_m"),
    ("ahead, x >= 0.45 m (in view)", "ahead_m"),
    ("between", "between_m"),
    ("under and behind, x <= 0.2 m", "under_m"),
)
"""Rows of the card and fields of `HeightAccuracy`."""


@dataclass(frozen=True, kw_only=True)
class ModelRelease:
    """A model file and what was measured on it."""

    model_id: str
    warmup_frames: int
    parity: float
    """Greatest difference in a tick from torch in double precision, of 1,000 recurrent steps with
    resets: heights, halves of intervals [m] and hidden state (no unit), see
    `saltus.heightmap.training.export.parity`."""
    clean: HeightAccuracy
    """Images as late as the camera makes them, none lost."""
    faulty: HeightAccuracy
    """Images as in training: later or sooner, with jitter and losses."""


def release_model(
    checkpoint: Path,
    data: Path,
    model_path: Path,
    unseen: Path | None = None,
    begun: Callable[[], object] = lambda: None,
) -> ModelRelease:
    """Exports a checkpoint, measures the file on held-out episodes and writes its card beside it.

    Args:
        checkpoint: Of `saltus.heightmap.training.train`.
        data: The dataset that it was trained on.
        model_path: ONNX file to write; the card goes beside it with the suffix .md.
        unseen: Dataset to measure on, none of whose episodes were trained on; those of the last
            training and of the one that it began with are refused. Of `data` only the manifest is
            needed then: its shards may have stayed on the machine that made them. Without it, what
            training held out.
        begun: Called when all files are read and the work begins.

    Raises:
        DatasetError: `data` is not what the checkpoint was trained on, or `unseen` is known to have
            been.
        ModelError: the checkpoint cannot be read, or its file differs from it or is too large. What
            lay at `model_path` is still there then.
    """
    model, training = load_checkpoint(checkpoint)
    records = read_records(data)
    if "updates" not in training["config"]:
        raise ModelError(
            f"{checkpoint} is a model already: --checkpoint takes what saltus heightmap train wrote"
        )
    if dataset_hash(records) != training["dataset"]:
        raise DatasetError(
            f"{checkpoint} was trained on dataset {training['dataset']}, not on {data}"
        )
    measured_on = (
        "the tenth of it that training held out"
        if unseen is None
        else _unseen(unseen, training, records)
    )
    held_out = (
        _spread(split_episodes(read_dataset(data))[1]) if unseen is None else read_dataset(unseen)
    )
    begun()
    camera = camera_of(data, records)
    name, grid = robot_name_in(records[0].config), records[0].grid
    robot = camera.mounted_on(load_robot(name))
    origin = ModelOrigin(
        robot=name, grid=grid, camera=camera, latency_s=float(records[0].latency.latency),
        warmup_frames=1,
        dataset=dataset_hash(records), seed=int(training["config"]["seed"]),
    )  # fmt: skip
    model_path.parent.mkdir(parents=True, exist_ok=True)
    # Until all is measured the model that may be there stays.
    with TemporaryDirectory(dir=model_path.parent, prefix=".export-") as folder:
        candidate = Path(folder) / model_path.name
        # The warm-up is measured on the file itself, so it is written twice.
        export_heightmap(model, candidate, origin)
        warmup = warmup_frames(HeightmapNetwork(robot, candidate, grid), held_out)
        export_heightmap(model, candidate, replace(origin, warmup_frames=warmup))
        network = HeightmapNetwork(robot, candidate, grid)
        inputs = (tick for episode in held_out for tick in episode_inputs(episode, TRAINING))
        difference = parity(model, network, islice(inputs, PARITY_STEPS))
        if not difference <= MAX_DIFFERENCE:
            raise ModelError(
                f"its ONNX file differs from {checkpoint} by {difference:.2g}: more than "
                f"{MAX_DIFFERENCE:g}"
            )
        if candidate.stat().st_size > MAX_BYTES:
            raise ModelError(
                f"{checkpoint} gives a file of {candidate.stat().st_size} bytes: more than "
                f"{MAX_BYTES}"
            )
        result = ModelRelease(
            model_id=network.model_id,
            warmup_frames=warmup,
            parity=difference,
            clean=height_accuracy(network, held_out),
            faulty=height_accuracy(network, held_out, TRAINING),
        )
        put_model(candidate, model_path)
    card_path(model_path).write_text(
        _card(robot, camera, result, training, records, f"{len(held_out)} of {measured_on}"),
        encoding="utf-8",
    )
    return result


def _spread(episodes: Sequence[Episode]) -> list[Episode]:
    """As many as are measured, from the first to the last; all of a small dataset."""
    return [
        episodes[int(i)] for i in np.unique(np.linspace(0, len(episodes) - 1, MEASURED).round())
    ]


def card_path(model_path: Path) -> Path:
    """Where the card of a model lies."""
    return model_path.with_suffix(".md")


def _unseen(folder: Path, training: TrainingOrigin, trained_on: list[ShardRecord]) -> str:
    """Names a dataset that is not known to have been trained on.

    Raises:
        DatasetError: it has a shard, or the motion of one, that the last training saw, or is what
            the one before saw.
    """
    records = read_records(folder)
    known = {motion_text(record.seed, record.config) for record in trained_on}
    whole = training["start"] is not None and training["start"]["dataset"] == dataset_hash(records)
    for record in records:
        if whole or motion_text(record.seed, record.config) in known:
            raise DatasetError(
                f"{folder / record.file} was trained on: it cannot say what a model is worth"
            )
    return (
        f"dataset {dataset_hash(records)}, seeds "
        f"{', '.join(str(record.seed) for record in records)}"
    )


def _card(
    robot: Robot,
    camera: DepthCamera,
    result: ModelRelease,
    training: TrainingOrigin,
    records: list[ShardRecord],
    held_out: str,
) -> str:
    config, sizes, grid = training["config"], training["config"]["model"], records[0].grid
    shards = "\n".join(
        f"| {r.file} | {r.config.get('source', '?')} | {r.episodes} | {r.ticks} | {r.seed} | "
        f"{r.commit} "
        f"| {r.sha256[:16]} |"
        for r in records
    )
    late = records[0].latency
    latency, soonest, latest = (
        1e3 * seconds for seconds in (late.latency, *TRAINING.range_s(late))
    )
    start = training["start"]
    begun = (
        f"with a network of {start['update']} updates on dataset {start['dataset']}"
        if start
        else "from nothing"
    )
    forgets = 100 * config.get("forgets", 0.0)  # older checkpoints do not name it
    clean, faulty = result.clean, result.faulty
    rows = [
        (name, 1e3 * getattr(clean, field), 1e3 * getattr(faulty, field)) for name, field in REGIONS
    ]
    rows += [
        (kind, 1e3 * value, 1e3 * faulty.terrain_mae_m[kind])
        for kind, value in clean.terrain_mae_m.items()
    ]
    errors = "\n".join(f"| {name} | {left:.1f} | {right:.1f} |" for name, left, right in rows)
    return f"""# Heightmap model {result.model_id}

Depth image (48 x 16, with its valid pixels and age) and proprioception in; {grid.size} terrain heights from \
{-grid.x[0]:g} m behind to
{grid.x[-1]:g} m ahead of the base, each with half of its 90 % interval (1.645 times the output `std`), out; 100 Hz. \
Convolutions
with {sizes["channels"]} channels, one GRU layer of {sizes["hidden"]}, hidden layers of {sizes["head"]}. Trained in
simulation only. For the robot {robot.name} and its camera: it is refused for others.

{model_interface(robot, grid, camera, late, sizes["hidden"])}
## Errors and training

Held-out episodes: {held_out}, {clean.ticks} ticks. Mean absolute error of all points, seen or not [mm]:

| | images {latency:.0f} ms late | {soonest:.0f} to {latest:.0f} ms late, jitter, up to 8 % lost |
|---|---|---|
{errors}

Robots came to an edge in {clean.uneven} of {clean.courses} episodes off flat ground. {clean.warning}

Share of errors within the 90 % interval: {clean.coverage90:.2f} and {faulty.coverage90:.2f}.
Warm-up after the hidden state was emptied, until the error ahead is within 10 % of an undisturbed run's:
{result.warmup_frames} images. Greatest difference from torch in double precision in one of 1,000 recurrent steps, from
the same hidden state, of heights and halves of intervals [m] and of that state: {result.parity:.1e}.

Training: {training["update"]} updates of {config["batch"]} robots x {config["window"]} ticks, seed {config["seed"]},
rate {config["learning_rate"]:g}, {forgets:.0f} % of the windows with an empty hidden state, begun {begun}, dataset
{training["dataset"]}:

| shard | source of motion | episodes | ticks | seed | commit | sha256 |
|---|---|---|---|---|---|---|
{shards}
"""
