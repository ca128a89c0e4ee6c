"""Trainings of the paper's networks that see: the predictor,
one without delay, and one that imitates plans.

All of a seed learn from the same data, which the predictor's rounds make: robots that the full
system's policy drives, in the first round with true heights, then with the predictor of the round
before.
"""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor, nn
from tqdm import tqdm

from paper import training
from saltus.depth_camera import load_camera
from saltus.errors import SaltusError
from saltus.gpu import has_gpu
from saltus.grid import DEFAULT_GRID, load_grid
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.shards import dataset_hash, read_manifest, read_records
from saltus.heightmap.device_collection import collect_shards_on_device
from saltus.heightmap.model import IMAGE_SHAPE, HeightmapModel
from saltus.heightmap.settings import FURTHER_RATE, DeviceCollection, DeviceLoop, PredictorTraining
from saltus.heightmap.training.export import ModelOrigin, export_heightmap
from saltus.heightmap.training.train import TrainingProgress, train_heightmap
from saltus.heightmap.training.validate import MIN_WARMUP
from saltus.onnx_export import write_onnx
from saltus.policy.bounds import ACTIONS
from saltus.policy.csv_tables import append_table
from saltus.policy.env.settings import JumpTrainSettings as PolicyConfig
from saltus.policy.policy_features import PROPRIOCEPTION_SIZE
from saltus.policy.training.checkpoint import training_config
from saltus.policy.training.export import read_policy
from saltus.policy.training.files import COMMIT, PROGRESS
from saltus.provenance import current_commit as this_commit
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT

TERRAINS = ("flat", "stairs", "stairs", "stepping_stones", "step", "gap")
"""The paper's kinds."""


@dataclass(frozen=True, kw_only=True)
class NetworkEffort:
    """How much is collected and learned; the defaults are minutes of an H200."""

    updates: int = 1500
    """Gradient steps of a round, as in the original.

    The other networks take those of all rounds.
    """
    batch: int = 512
    """Windows in a gradient step."""
    loop: DeviceLoop = field(
        default_factory=lambda: DeviceLoop(
            robot=DEFAULT_ROBOT, grid=DEFAULT_GRID, terrains=TERRAINS, plans=True
        )
    )
    """Loop of a round."""


@dataclass(frozen=True, kw_only=True)
class _Work:
    """Folders in which the networks of a seed are made."""

    data: Path
    own: Path
    """Folder of the network."""
    seed: int
    teacher: Path
    commit: str | None
    effort: NetworkEffort

    def settings(self, rounds: int) -> PredictorTraining:
        """Settings of a training with the updates of so many rounds."""
        return PredictorTraining(
            updates=rounds * self.effort.updates, batch=self.effort.batch, seed=self.seed
        )


def train_network(
    name: str,
    seed: int,
    trained: Path,
    commit: str | None = None,
    effort: NetworkEffort | None = None,
) -> Path:
    """Trains one of `NETWORKS`, or goes on.

    Returns its ONNX file, beside which the predictor leaves one of each round.

    The policy that drives and is imitated is the full system's of the least seed that is trained;
    where none is in `trained`, the published one.

    Args:
        name: Which one.
        seed: Of robots, courses, cameras, weights and windows.
        trained: Folder of all trainings; data of a seed go to data/seed-N within it.
        commit: Which code trains, where this machine cannot tell.
        effort: How much.

    Raises:
        SaltusError: there is no GPU for the usual effort; there is no policy, or no data of this
            seed: the message says what makes them. Or what the trainings say.
    """
    if effort is None and not has_gpu():
        raise SaltusError(
            f"training '{name}' needs a GPU: {NetworkEffort().loop.robots} robots that see"
        )
    teachers = _trained_policies(trained) or _trained_policies(training.PUBLISHED_TRAININGS)
    if not teachers:
        raise SaltusError(
            f"no policy of {training.FULL} in {trained}: saltus paper train {training.FULL} --seed "
            f"0 makes one, or {training.BRING_BACK}"
        )
    work = _Work(data=trained / "data" / f"seed-{seed}", own=trained / name / f"seed-{seed}",
        seed=seed,
                 teacher=teachers[0], commit=commit, effort=effort or NetworkEffort())  # fmt: skip
    work.own.mkdir(parents=True, exist_ok=True)
    (work.own / COMMIT).write_text(f"{commit or this_commit()}\n", encoding="utf-8")
    if name == training.PREDICTOR:
        return _rounds(work)
    if len(read_manifest(work.data)) < training.ROUNDS:
        raise SaltusError(
            f"{work.data} lacks rounds: saltus paper train {training.PREDICTOR} --seed "
            f"{seed} makes them"
        )
    settings = work.settings(training.ROUNDS)
    if name == training.NO_LATENCY:
        return _exported(
            _trained(work, replace(settings, delivery="at-once")),
            work.own / training.PREDICTED,
            work,
        )
    model = _trained(work, settings, shown=for_imitation)
    return write_imitator(
        model,
        training_config(read_policy(work.teacher)),
        work.own / training.IMITATOR,
        seed,
        commit,
    )


def for_imitation(episode: Episode) -> Episode:
    """An episode as an imitator gets it: it is shown the policy's own state,
    and is to tell the plan.

    Raises:
        SaltusError: plans were not kept.
    """
    if episode.state is None or episode.plan is None:
        raise SaltusError("the dataset keeps no plans: collect it with --loop.plans")
    return replace(
        episode, proprioception=episode.state, height=episode.plan, state=None, plan=None
    )


def write_imitator(
    model: HeightmapModel, config: PolicyConfig, path: Path, seed: int, commit: str | None
) -> Path:
    """Writes the network as ONNX: normalised plans within [-1, 1]; see `paper.imitation`."""
    shapes = (IMAGE_SHAPE, (), (), (PROPRIOCEPTION_SIZE,), (model.config.hidden,))
    example = tuple(torch.zeros(2, *shape) for shape in shapes)
    robot, bounds = load_robot(DEFAULT_ROBOT), config.env.bounds
    metadata = {
        "format": training.IMITATOR_FORMAT, "robot": robot.name, "actions": list(ACTIONS),
        "low": list(bounds.low),
        "high": list(bounds.high), "seed": seed, "commit": commit,
    }  # fmt: skip
    write_onnx(
        _Plan(model),
        example,
        path,
        inputs=training.IMITATOR_INPUTS,
        outputs=training.IMITATOR_OUTPUTS,
        metadata=metadata,
    )
    return path


class _Plan(nn.Module):
    """One tick with plain tensors in and out."""

    def __init__(self, model: HeightmapModel) -> None:
        super().__init__()
        self.model = model.cpu().eval()

    def forward(
        self, image: Tensor, age: Tensor, new: Tensor, state: Tensor, hidden: Tensor
    ) -> tuple[Tensor, Tensor]:
        estimate, hidden = self.model.step(image, age, new, state, hidden)
        return estimate.height.clamp(-1.0, 1.0), hidden


def _trained_policies(trained: Path) -> list[Path]:
    return sorted((trained / training.FULL).glob(f"seed-*/{training.MODEL}"))


def _rounds(work: "_Work") -> Path:
    before: Path | None = None
    for index in range(training.ROUNDS):
        checkpoint = work.own / f"round-{index}.pt"
        if len(read_manifest(work.data)) <= index:
            _collect(work, index, before)
        file = checkpoint.with_suffix(".onnx")
        if not file.exists():
            settings = replace(work.settings(1), seed=work.seed + index)
            if before is not None:
                settings = replace(settings, learning_rate=FURTHER_RATE)
            _exported(_trained(work, settings, checkpoint, before), file, work)
        before = checkpoint
    return Path(shutil.copyfile(file, work.own / training.PREDICTED))


def _collect(work: "_Work", index: int, predictor: Path | None) -> None:
    loop = work.effort.loop
    collection = DeviceCollection(
        episodes=loop.robots,
        seed=training.ROUNDS * work.seed + index,
        policy=work.teacher,
        predictor=predictor,
        device=_device(),
        loop=loop,
    )
    with tqdm(total=loop.ticks, desc=f"round {index}: robots run", unit="tick") as bar:
        collect_shards_on_device(
            collection, {training.CAMERA: work.data}, bar.update, lambda *_: None, work.commit
        )


def _trained(
    work: "_Work",
    settings: PredictorTraining,
    checkpoint: Path | None = None,
    start: Path | None = None,
    shown: Callable[[Episode], Episode] = lambda episode: episode,
) -> HeightmapModel:
    """Trains with a bar, and leaves loss and error over the updates in a table."""
    checkpoint = checkpoint or work.own / "network.pt"
    with tqdm(total=settings.updates, desc=checkpoint.stem, unit="update") as bar:

        def tell(progress: TrainingProgress) -> None:
            bar.update(progress.update - bar.n)
            bar.set_postfix(loss=f"{progress.loss:.4f}", error=f"{progress.mae_m:.4f}")
            row = {
                "network": checkpoint.stem,
                "update": progress.update,
                "loss": progress.loss,
                "error": progress.mae_m,
            }
            append_table(work.own / PROGRESS, [row])

        return train_heightmap(
            work.data, checkpoint, replace(settings, device=_device()), tell, start, shown
        )


def _exported(model: HeightmapModel, path: Path, work: "_Work") -> Path:
    """Writes it as a predictor.

    Its warm-up is the service's business, no roll-out reads it: it is not measured.
    """
    records = read_records(work.data)
    origin = ModelOrigin(
        robot=DEFAULT_ROBOT,
        grid=load_grid(DEFAULT_GRID),
        camera=load_camera(training.CAMERA),
        latency_s=float(records[0].latency.latency),
        warmup_frames=MIN_WARMUP,
        dataset=dataset_hash(records),
        seed=work.seed,
    )
    export_heightmap(model, path, origin)
    return path


def _device() -> Literal["cuda", "cpu"]:
    return "cuda" if has_gpu() else "cpu"
