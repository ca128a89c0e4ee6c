"""From a checkpoint to a model that can be shipped: exported, compared, measured, described."""

from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from heightmap.delivery import TRAINING
from heightmap.export import Origin, export, parity
from heightmap.network import HeightmapNetwork
from heightmap.shards import DatasetError, Episode, ShardRecord, dataset_hash, read_dataset, read_manifest
from heightmap.train import load_checkpoint, split
from heightmap.validate import Accuracy, accuracy, episode_inputs, warmup_frames
from saltus.errors import ModelError

PARITY_STEPS = 1000
MAX_DIFFERENCE_M = 1e-5
MAX_BYTES = 3_000_000
REGIONS = (
    ("all 30 points", "mae_m"),
    ("ahead, x >= 0.45 m (in view)", "ahead_m"),
    ("between", "between_m"),
    ("under and behind, x <= 0.2 m", "under_m"),
)
"""Rows of the card and fields of `Accuracy`."""


@dataclass(frozen=True, kw_only=True)
class Release:
    """What was measured on a model file."""

    model_id: str
    warmup_frames: int
    parity: float
    """Greatest difference of an output from torch over 1,000 recurrent steps with resets [m]."""
    clean: Accuracy
    """Images 50 ms late, none lost."""
    faulty: Accuracy
    """Images 30 to 60 ms late with jitter and losses, as in training."""


def release(checkpoint: Path, data: Path, model_path: Path, unseen: Path | None = None) -> Release:
    """Exports a checkpoint, measures the file on held-out episodes and writes its card beside it.

    Args:
        checkpoint: Of `heightmap.train`.
        data: The dataset that it was trained on.
        model_path: ONNX file to write; the card goes beside it with the suffix .md.
        unseen: Dataset to measure on, none of whose episodes were trained on. Of `data` only the manifest is needed
            then: its shards may have stayed on the machine that made them. Without it, what training held out.

    Raises:
        DatasetError: `data` is not what the checkpoint was trained on, or shares a shard with `unseen`.
        ModelError: the file differs from the checkpoint, or is too large.
    """
    model, training = load_checkpoint(checkpoint)
    records = read_manifest(data)
    if dataset_hash(records) != training["dataset"]:
        raise DatasetError(f"{checkpoint} was trained on dataset {training['dataset']}, not on {data}")
    held_out = split(read_dataset(data))[1] if unseen is None else _unseen(unseen, records)
    seed = int(training["config"]["seed"])
    # The warm-up is measured on the file itself, so it is written twice.
    export(model, model_path, Origin(warmup_frames=1, dataset=dataset_hash(records), seed=seed))
    warmup = warmup_frames(model_path, held_out)
    export(model, model_path, Origin(warmup_frames=warmup, dataset=dataset_hash(records), seed=seed))
    inputs = (tick for episode in held_out for tick in episode_inputs(episode, TRAINING))
    difference = parity(model, model_path, islice(inputs, PARITY_STEPS))
    if difference > MAX_DIFFERENCE_M:
        raise ModelError(f"{model_path} differs from {checkpoint} by {difference:.2g}: more than {MAX_DIFFERENCE_M:g}")
    if model_path.stat().st_size > MAX_BYTES:
        raise ModelError(f"{model_path} has {model_path.stat().st_size} bytes: more than {MAX_BYTES}")
    result = Release(
        model_id=HeightmapNetwork(model_path).model_id,
        warmup_frames=warmup,
        parity=difference,
        clean=accuracy(model_path, held_out),
        faulty=accuracy(model_path, held_out, TRAINING),
    )
    model_path.with_suffix(".md").write_text(_card(result, training, records, len(held_out)))
    return result


def _unseen(folder: Path, trained_on: list[ShardRecord]) -> list[Episode]:
    """All episodes of a dataset that has no shard in common with another."""
    known = {record.sha256 for record in trained_on}
    for record in read_manifest(folder):
        if record.sha256 in known:
            raise DatasetError(f"{folder / record.file} was trained on: it cannot say what a model is worth")
    return read_dataset(folder)


def _card(result: Release, training: dict[str, Any], records: list[ShardRecord], held_out: int) -> str:
    config, sizes = training["config"], training["config"]["model"]
    shards = "\n".join(
        f"| {r.file} | {r.config.get('source', '?')} | {r.episodes} | {r.ticks} | {r.seed} | {r.commit} "
        f"| {r.sha256[:16]} |"
        for r in records
    )
    clean, faulty = result.clean, result.faulty
    rows = [(name, 1e3 * getattr(clean, field), 1e3 * getattr(faulty, field)) for name, field in REGIONS]
    rows += [(kind, 1e3 * value, 1e3 * faulty.terrain_mae_m[kind]) for kind, value in clean.terrain_mae_m.items()]
    errors = "\n".join(f"| {name} | {left:.1f} | {right:.1f} |" for name, left, right in rows)
    return f"""# Heightmap model {result.model_id}

Depth image (48 x 16, with its valid pixels and age) and proprioception in; 30 terrain heights from 0.4 m behind to
0.8 m ahead of the base, each with a standard deviation, out; 100 Hz. Convolutions with {sizes["channels"]} channels,
one GRU layer of {sizes["hidden"]}, hidden layers of {sizes["head"]}. Trained in simulation only.

Held-out episodes: {held_out}, {clean.ticks} ticks. Mean absolute error [mm]:

| | images 50 ms late | 30 to 60 ms late, jitter, up to 8 % lost |
|---|---|---|
{errors}

Share of errors within the 90 % interval: {clean.coverage90:.2f} and {faulty.coverage90:.2f}.
Warm-up after a loss of memory, until the error ahead is within 10 % of an undisturbed run's: {result.warmup_frames}
images. Greatest difference from torch over 1,000 recurrent steps: {result.parity:.1e} m.

Training: {training["update"]} updates of {config["batch"]} robots x {config["window"]} ticks, seed {config["seed"]},
dataset {training["dataset"]}:

| shard | source of motion | episodes | ticks | seed | commit | sha256 |
|---|---|---|---|---|---|---|
{shards}
"""
