"""DAgger: rounds in which the newest predictor drives robots
and the next one is trained on everything collected.

A run of it is a folder:

    dagger.json      how it was begun; a run that goes on must be the same
    dataset/         one shard a round, after those that it began with
    start/           the predictor that it began with, if any
    round_000/       heightmap.pt,
    heightmap.onnx and heightmap.md: the predictor that was trained on rounds up to 0

Every file and folder appears whole or not at all, and each follows from the seed and what was there
before. So a run that was killed goes on with the round it was in, from the beginning of its
collection or of its training, and gives what it would have given.
"""

import hashlib
import json
import math
import shutil
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from saltus.config import from_table
from saltus.depth_camera import load_camera
from saltus.effects.profile import SHIPPED, load_profile
from saltus.errors import ConfigError
from saltus.files import whole_folder, write_whole
from saltus.grid import load_grid
from saltus.heightmap.collection import EpisodeKey, closed_loop_batches, round_table
from saltus.heightmap.data.delivery import hardware_table
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.inventory import merge_datasets, validate_dataset
from saltus.heightmap.data.shards import (
    DatasetError,
    dataset_hash,
    file_sha256,
    read_manifest,
    read_records,
    refuse_twice,
    write_shard,
)
from saltus.heightmap.settings import FURTHER_RATE, ClosedLoop, DaggerSettings, PredictorTraining
from saltus.heightmap.training.export import ModelOrigin, export_heightmap
from saltus.heightmap.training.release import release_model
from saltus.heightmap.training.train import TrainingProgress, load_checkpoint, train_heightmap
from saltus.heightmap.training.validate import MIN_WARMUP
from saltus.robots.loading import load_robot

CHECKPOINT, MODEL = "heightmap.pt", "heightmap.onnx"
BEGUN = "dagger.json"
_DIGESTS = ("start", "base", "profile_sha256")
"""Digests that it holds beside the settings."""

Batches = Callable[[Path | None, Sequence[EpisodeKey]], Generator[list[Episode], None, None]]
"""Makes batches from a predictor and their keys, in the order of the keys."""


@dataclass(frozen=True, kw_only=True)
class Observer:
    """Anything that listens to DAgger rounds while they go on."""

    collected: Callable[[int, int, int], None]
    """Gets the round, its batches that are done, and the labelled steps of 10 ms in them."""
    trained: Callable[[int, TrainingProgress], None]
    """Gets the round, too."""


def run_dagger(
    directory: Path,
    config: DaggerSettings,
    observer: Observer,
    *,
    start: Path | None = None,
    base: Path | None = None,
    processes: int | None = None,
) -> Path:
    """Runs rounds until there are `config.rounds` of them, going on where it was interrupted.

    Args:
        directory: Of the run.
        config: What to do.
        observer: Is told how far it is.
        start: Checkpoint of the predictor to begin with. Without it round 0 uses true heights and
            trains from nothing.
        base: Dataset whose shards stand before the first round's, and are trained on as well.
        processes: How many collect. The data do not depend on it.

    Returns:
        The newest predictor's ONNX file.

    Raises:
        DatasetError: the folder holds a run of another configuration, or a dataset is missing or
            damaged.
        ModelError: `start` is no checkpoint.
    """
    if start is not None:
        load_checkpoint(start)  # what is wrong is said before anything is written down
    elif base is not None and not (directory / BEGUN).exists():
        refuse_twice(
            base, read_records(base), config.seed, round_table(config.loop, config.batches, 0, None)
        )
    if (
        base is not None
        and not (directory / BEGUN).exists()
        and (damages := validate_dataset(base))
    ):
        raise DatasetError(damages[0])
    directory.mkdir(parents=True, exist_ok=True)
    _remember(directory, config, start, base)
    data = directory / "dataset"
    if base is not None and not read_manifest(data):
        merge_datasets([base], data)
    begun_with = 0 if base is None else len({record.sha256 for record in read_manifest(base)})
    before = None if start is None else _started(directory / "start", start, config.loop)
    for index in range(config.rounds):
        if index >= len(read_manifest(data)) - begun_with:
            _collect(
                data,
                index,
                before,
                config,
                observer,
                partial(
                    closed_loop_batches,
                    config.loop,
                    profile=config.profile,
                    processes=processes,
                ),
            )
        folder = directory / f"round_{index:03d}"
        if not folder.exists():
            _train(folder, index, before, config, observer)
        before = folder
    return folder / MODEL


def begun_settings(directory: Path) -> DaggerSettings:
    """The settings that a run was begun with; `DatasetError` where its file is damaged."""
    path = directory / BEGUN
    try:
        begun = json.loads(path.read_text(encoding="utf-8"))
        return from_table(
            DaggerSettings, {name: value for name, value in begun.items() if name not in _DIGESTS}
        )
    except (OSError, ValueError, AttributeError, ConfigError) as error:
        raise DatasetError(f"{path} is damaged: {error}") from error


def _remember(
    directory: Path, config: DaggerSettings, start: Path | None, base: Path | None
) -> None:
    """Writes down how a run began, or compares with how it did."""
    wanted = {
        **{name: value for name, value in asdict(config).items() if name != "rounds"},
        "loop": config.loop.table,
        "start": start and file_sha256(start),
        "base": base and dataset_hash(read_records(base)),
        "profile_sha256": _digest(config.profile, config.loop.robot),
    }
    path = directory / BEGUN
    if not path.exists():
        write_whole(path, json.dumps(wanted, indent=1) + "\n", synced=True)
        return
    try:
        # Runs that did not name it
        older = {
            "profile": SHIPPED,
            "profile_sha256": _digest(SHIPPED, config.loop.robot),
        }
        begun = older | json.loads(path.read_text(encoding="utf-8"))
        for name, value in wanted.items():
            if begun[name] != value:
                raise DatasetError(
                    f"{path}: this run was begun with {name} = {begun[name]}, not {value}"
                )
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise DatasetError(f"{path} is damaged: {error}") from error


def _digest(profile: str, robot: str) -> str:
    return hashlib.sha256(load_profile(profile, load_robot(robot)).to_toml().encode()).hexdigest()


def _started(folder: Path, start: Path, loop: ClosedLoop) -> Path:
    """A folder like that of a round, made of the checkpoint to begin with."""
    if not folder.exists():
        with whole_folder(folder) as partial_folder:
            shutil.copyfile(start, partial_folder / CHECKPOINT)
            model, training = load_checkpoint(start)
            # Its warm-up is the service's business: nothing reads it here, so it is not measured.
            origin = ModelOrigin(
                robot=loop.robot,
                grid=load_grid(loop.grid),
                camera=load_camera(loop.camera),
                warmup_frames=MIN_WARMUP,
                dataset=training["dataset"],
                seed=training["config"]["seed"],
            )
            export_heightmap(model, partial_folder / MODEL, origin)
    return folder


def _collect(
    data: Path,
    index: int,
    before: Path | None,
    config: DaggerSettings,
    observer: Observer,
    batches: Batches,
) -> None:
    model = None if before is None else before / MODEL
    keys = [(config.seed, index, batch) for batch in range(config.batches)]
    table = round_table(config.loop, config.batches, index, model)
    table |= hardware_table(config.profile, config.loop.robot, load_camera(config.loop.camera))
    # Whatever interrupts the writing, the workers end here and now, not when the iteration is
    # forgotten.
    with closing(batches(model, keys)) as made:
        write_shard(data, _watched(made, index, observer), seed=config.seed, config=table)


def _watched(batches: Iterable[list[Episode]], index: int, observer: Observer) -> Iterator[Episode]:
    ticks = 0
    for done, episodes in enumerate(batches, start=1):
        yield from episodes
        ticks += sum(len(episode.height) for episode in episodes)
        observer.collected(index, done, ticks)


def _train(
    folder: Path, index: int, before: Path | None, config: DaggerSettings, observer: Observer
) -> None:
    """Trains on all rounds so far, begins with the last predictor,
    and exports and measures the next.
    """
    further = PredictorTraining(
        updates=config.updates,
        batch=config.batch,
        seed=config.seed + index,
        # One that is resumed draws other windows: it would not give the same predictor
        save_every_s=math.inf,
    )
    if before is not None:
        further = replace(further, learning_rate=FURTHER_RATE)
    data = folder.parent / "dataset"
    with whole_folder(folder) as partial_folder:
        checkpoint = partial_folder / CHECKPOINT
        train_heightmap(
            data,
            checkpoint,
            further,
            partial(observer.trained, index),
            start=before and before / CHECKPOINT,
        )
        release_model(checkpoint, data, partial_folder / MODEL)
