"""Trains the heightmap network: truncated back-propagation through windows
with a hidden state that is carried on.
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar, cast
from zipfile import is_zipfile

import numpy as np
import torch
from torch import Tensor

from saltus.errors import ConfigError, ModelError
from saltus.files import atomic_write, check_archive
from saltus.folders import ask_for_room, setting_differences
from saltus.gpu import has_gpu
from saltus.heightmap.data.delivery import DELIVERIES, ImageDeliveryModel
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.shards import (
    DatasetError,
    ShardRecord,
    dataset_hash,
    file_sha256,
    read_dataset,
    read_records,
)
from saltus.heightmap.model import WIDTHS, HeightEstimate, HeightmapModel, Normalisation
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.heightmap.service.quantiles import INTERVAL90
from saltus.heightmap.settings import ModelSettings, PredictorTraining
from saltus.heightmap.training.calibration import calibrate_intervals
from saltus.heightmap.training.dataset import (
    NO_NOISE,
    TRAINING_NOISE,
    EpisodeStore,
    ImageNoise,
    TrainingWindow,
    run_window,
)
from saltus.heightmap.training.exported import CheckpointTable, TrainingOrigin, read_exported

Item = TypeVar("Item")
_SMALLEST_M = (
    1e-4  # keeps the logarithm of an error finite: a tenth of the depth unit of the camera
)
_USUAL_M = 0.1  # spread of heights: an error in it is of the size that the network itself works in
HELD_OUT = 10  # every tenth episode is for validation


@dataclass(frozen=True, kw_only=True)
class TrainingProgress:
    """How far a training of the line's network is, and its errors so far."""

    update: int
    updates: int
    loss: float
    mae_m: float
    """Over the last batch, noise and faults included."""
    seconds: float
    calibrates: bool = False
    """All updates are done.

    The intervals are now fitted to held-out episodes, which takes a while.
    """


def train_heightmap(
    data: Path,
    checkpoint: Path,
    config: PredictorTraining,
    progress: Callable[[TrainingProgress], None] | None = None,
    start: Path | None = None,
    shown: Callable[[Episode], Episode] = lambda episode: episode,
) -> HeightmapModel:
    """Trains on a dataset until `config.updates`, then calibrates the intervals on held-out
    episodes; goes on from `checkpoint`, which it writes, where that is from the same training.

    Args:
        data: Directory of the dataset.
        checkpoint: Written every `save_every_s`, at the end, and where it is interrupted: weights,
            optimiser, and what they were made from.
        config: How to train.
        progress: Called about once a second, and before the calibration.
        start: Checkpoint or exported model whose network to begin with, its normalisation included:
            for a further round of data.
        shown: What the network is shown of an episode, as its proprioception, and is to tell, as
            heights: for networks that are to tell something else.

    Returns:
        The trained network, on the CPU.

    Raises:
        ConfigError: there is no such device.
        DatasetError: the dataset is missing, damaged, or has too few episodes to hold any out.
        ModelError: `start` is no network of heights, or `checkpoint` is of another training (the
            message says what differs).
        SaltusError: `checkpoint` cannot be written.
    """
    records, device = read_records(data), _device(config.device)
    known = load_checkpoint(start) if start else None
    ask_for_room(checkpoint.parent)
    settings = {**asdict(config), "model": asdict(known[0].config if known else config.model)}
    origin: TrainingOrigin = {
        "config": settings,
        "dataset": dataset_hash(records),
        "start": None,
    }
    if start and known:
        origin["start"] = {
            "sha256": file_sha256(start),
            "dataset": known[1]["dataset"],
            "update": known[1]["update"],
        }
    begun = _begun(checkpoint, origin)
    store, held_out = _stores(data, records, device, shown)
    torch.manual_seed(config.seed)
    model = known[0] if known else HeightmapModel(config.model, store.normalisation())
    model.to(store.device).train()
    optimiser = torch.optim.AdamW(
        model.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
    )
    first = 0
    if begun is not None:
        model.load_state_dict(_weights(begun))
        optimiser.load_state_dict(begun["optimiser"])
        first = int(begun["update"])
    delivery = DELIVERIES[config.delivery]
    updates = _updates(model, optimiser, store, config, delivery, first)
    began = saved = told = time.monotonic()
    update = kept = first
    try:
        for update, (loss, error) in enumerate(updates, start=first + 1):
            now, last = time.monotonic(), update == config.updates
            if progress is not None and (now - told > 1.0 or last):
                told = now
                state = TrainingProgress(
                    update=update, updates=config.updates, loss=float(loss), mae_m=float(error),
                    seconds=now - began,
                    calibrates=last,
                )  # fmt: skip
                progress(state)
            if last:
                calibrate_intervals(model, held_out, delivery, _noise(config), config.seed)
            if now - saved > config.save_every_s or last:
                _save(checkpoint, origin, update, model, optimiser)
                saved, kept = now, update
    except KeyboardInterrupt:
        done = min(update, config.updates - 1)  # with the last one the calibration is still to come
        if done > kept:
            _save(checkpoint, origin, done, model, optimiser)
        raise
    return model.cpu().eval()


def _stores(
    data: Path,
    records: list[ShardRecord],
    device: torch.device,
    shown: Callable[[Episode], Episode],
) -> tuple[EpisodeStore, EpisodeStore]:
    """Episodes to fit, and those held out."""
    # Every round of the dataset is drawn equally often, however many episodes it has.
    weights = split_episodes(
        [1.0 / record.episodes for record in records for _ in range(record.episodes)]
    )
    true_depth = split_episodes(
        [record.camera.ideal for record in records for _ in range(record.episodes)]
    )
    parts = zip(
        split_episodes([shown(episode) for episode in read_dataset(data)]),
        weights,
        true_depth,
        strict=True,
    )
    fitted, held_out = (
        EpisodeStore(episodes, device, weight, true) for episodes, weight, true in parts
    )
    return fitted, held_out


def _updates(
    model: HeightmapModel,
    optimiser: torch.optim.Optimizer,
    store: EpisodeStore,
    config: PredictorTraining,
    delivery: ImageDeliveryModel,
    first: int,
) -> Iterator[tuple[Tensor, Tensor]]:
    """Makes the updates from `first` on; yields loss and mean absolute error [m] after each."""
    # A resumed training draws other windows than before the interruption.
    rng = np.random.default_rng([config.seed, first])
    windows = store.windows(
        config.batch, config.window, delivery, _noise(config), rng, forgets=config.forgets
    )
    hidden = torch.zeros(config.batch, model.config.hidden, device=store.device)
    for update, window in zip(range(first, config.updates), windows, strict=False):
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * _schedule(update / config.updates)
        estimate, hidden = run_window(model, window, hidden.detach())
        loss = _loss(estimate, window)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), config.gradient_norm)
        optimiser.step()
        error = (estimate.height.detach() - window.height).abs().mean(-1)
        yield loss.detach(), _masked_mean(error, window.valid)


def split_episodes(episodes: list[Item]) -> tuple[list[Item], list[Item]]:
    """Episodes to fit and episodes to validate on; always the same ones of a dataset."""
    fitted = [e for i, e in enumerate(episodes) if i % HELD_OUT != HELD_OUT - 1]
    held_out = episodes[HELD_OUT - 1 :: HELD_OUT]
    if not held_out:
        raise DatasetError(
            f"{len(episodes)} episodes are too few: at least {HELD_OUT} are needed to hold one out"
        )
    return fitted, held_out


def load_checkpoint(checkpoint: Path) -> tuple[HeightmapModel, TrainingOrigin]:
    """The network of a checkpoint or of an exported model, on the CPU, and what it was made from.

    An ONNX file holds the same weights; of its training it tells the dataset and the seed alone.

    Raises:
        ModelError: the file is missing, or is no checkpoint of this network.
    """
    table = _read(checkpoint) if is_zipfile(checkpoint) else read_exported(checkpoint)
    try:
        sizes = table["origin"]["config"]["model"]
        shapes = {name: table["model"][name] for name in Normalisation._fields}
        config = ModelSettings(
            channels=tuple(sizes["channels"]), hidden=sizes["hidden"], head=tuple(sizes["head"])
        )
        model = HeightmapModel(config, Normalisation(**shapes))
        model.load_state_dict(_weights(table))
        if len(model.proprioception_mean) != len(PROPRIOCEPTION):
            raise KeyError(checkpoint)  # a network that tells something else
        return model.eval(), {**table["origin"], "update": table["update"]}
    except (KeyError, TypeError, AttributeError, RuntimeError) as error:
        raise ModelError(
            f"{checkpoint} is no checkpoint of the heightmap network, or damaged"
        ) from error


def checkpoint_settings(checkpoint: Path) -> PredictorTraining:
    """The settings of the training that wrote a checkpoint.

    Raises:
        ModelError: the file is no checkpoint of this network, or was written by another version.
    """
    _, training = load_checkpoint(checkpoint)
    try:
        return PredictorTraining(
            **{**training["config"], "model": ModelSettings(**training["config"]["model"])}
        )
    except (TypeError, ConfigError) as error:
        raise ModelError(
            f"{checkpoint} is of a training by another version: name another folder with --out"
        ) from error


def _loss(estimate: HeightEstimate, window: TrainingWindow) -> Tensor:
    """The absolute error, and how far the stated interval is
    from holding the share of errors that it should.

    The first makes heights medians: where an edge may be here or there, a median is on one side of
    it and a mean is in the air. The second is the quantile loss of the logarithm of the error, so
    that it asks the same of flat ground, where errors are a millimetre, and of trenches. It leaves
    the heights alone.
    """
    error = (estimate.height - window.height).abs()
    beyond = (error.detach() + _SMALLEST_M).log() - estimate.log_std - math.log(INTERVAL90)
    quantile = torch.maximum(0.9 * beyond, -0.1 * beyond)
    return _masked_mean((error / _USUAL_M + quantile).mean(-1), window.valid)


def _noise(config: PredictorTraining) -> ImageNoise:
    return TRAINING_NOISE if config.noise else NO_NOISE


def _masked_mean(value: Tensor, mask: Tensor) -> Tensor:
    return (value * mask).sum() / mask.sum().clamp(min=1.0)


def _schedule(share: float) -> float:
    """Cosine from 1 to 0, after a short warm-up."""
    return min(1.0, (share + 1e-3) / 0.02) * 0.5 * (1.0 + math.cos(math.pi * share))


def _device(name: str) -> torch.device:
    if name == "auto":
        name = "cuda" if has_gpu() else "cpu"
    if name == "cuda" and not has_gpu():
        raise ConfigError("device = cuda: no GPU found")
    return torch.device(name)


def _read(checkpoint: Path) -> CheckpointTable:
    try:
        check_archive(checkpoint, checksums=True)  # torch loads flipped weights without complaint
        table = torch.load(checkpoint, map_location="cpu", weights_only=True)
    except OSError as error:
        raise ModelError(f"cannot read checkpoint {checkpoint}: {error.strerror}") from error
    except Exception as error:  # what a file that is something else makes of its unpickling
        raise ModelError(f"{checkpoint} is no checkpoint: torch cannot read it") from error
    known = isinstance(table, dict) and {"origin", "update", "model", "optimiser"} <= table.keys()
    if not known or not isinstance(table["origin"], dict):
        raise ModelError(f"{checkpoint} is no checkpoint of the heightmap network")
    return cast(CheckpointTable, table)


def _weights(table: CheckpointTable) -> dict[str, Tensor]:
    """Weights of the network.

    An older checkpoint has and needs no correction of intervals by width.
    """
    return {"correction": torch.zeros(WIDTHS), **table["model"]}


def _begun(checkpoint: Path, origin: TrainingOrigin) -> CheckpointTable | None:
    """Reads what there is of this training; refuses what there is of another one."""
    if not checkpoint.exists():
        return None
    table = _read(checkpoint)
    found = setting_differences(_compared(table["origin"]), _compared(origin))
    if differs := ", ".join(f"{d.name} = {d.before}, not {d.now}" for d in found):
        raise ModelError(
            f"{checkpoint} is of another training ({differs}): name another folder with --out"
        )
    return table


def _compared(origin: TrainingOrigin) -> dict[str, object]:
    """Parts of an origin that make it another training:
    not where it runs, nor how often it is saved.
    """
    config = {
        name: value
        for name, value in origin.get("config", {}).items()
        if name not in ("device", "save_every_s")
    }
    return {**origin, "config": config}


def _save(
    checkpoint: Path,
    origin: TrainingOrigin,
    update: int,
    model: HeightmapModel,
    optimiser: torch.optim.Optimizer,
) -> None:
    table = {
        "origin": origin,
        "update": update,
        "model": model.state_dict(),
        "optimiser": optimiser.state_dict(),
    }
    try:
        with atomic_write(checkpoint) as partial:
            torch.save(table, partial)
    except (OSError, RuntimeError) as error:  # torch says RuntimeError where a disk is full
        reason = error.strerror if isinstance(error, OSError) else "the disk may be full"
        raise ModelError(f"cannot write {checkpoint}: {reason}") from error
