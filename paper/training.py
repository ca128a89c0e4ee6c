"""The paper's ablations as values: what the training of each policy differs in,
and how it is trained.

All begin with the defaults of one GPU: the paper's terrains and its randomisation, without what
Saltus draws beyond it. The shipped policy is another one, trained wider and longer. Machines that
only train need no camera.
"""

import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from saltus.config import with_changes
from saltus.effects.profile import SHIPPED, load_profile
from saltus.errors import SaltusError
from saltus.gpu import has_gpu
from saltus.grid import DEFAULT_GRID
from saltus.policy.env.settings import JumpTrainSettings, for_gpu
from saltus.policy.training.command import TrainPolicyCommand
from saltus.policy.training.files import CHECKPOINT
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT, SUPPLEMENT_FILE, shipped_folder

FULL = "full-system"
TRAINED = Path("runs/paper-train")
"""Folder of trainings: NAME/seed-N/ holds checkpoint.pt and policy.onnx."""
PUBLISHED = Path(__file__).resolve().parents[1] / "benchmarks" / "paper"
"""Folder of the results that the repository holds."""
PUBLISHED_TRAININGS = PUBLISHED / "trainings"
"""Folder of the trainings that they are of, without their weights."""
BRING_BACK = "git restore --source=a1142b1 'benchmarks/paper/trainings/*.onnx'"
"""Brings back their weights, which the commit named held last: the repository keeps their checksums
alone."""
STEPS = 250e6
"""Environment steps of each training: 7 minutes of an H200."""
MODEL = "policy.onnx"
CAMERA = "d435i"
"""Camera of all robots that see."""
PREDICTOR, NO_LATENCY, IMITATION = "predictor", "no-latency", "imitation"
NETWORKS = (PREDICTOR, NO_LATENCY, IMITATION)
"""Networks that see, see `paper.networks`: those of a seed learn from the same data, which the
first one makes."""
ROUNDS = 3
"""Rounds of a predictor; in the first, robots are driven with true heights."""
PREDICTED, IMITATOR = "heightmap.onnx", "imitator.onnx"
IMITATOR_FORMAT = "saltus-imitation-1"
IMITATOR_INPUTS, IMITATOR_OUTPUTS = (
    ("image", "age", "new", "state", "hidden"),
    ("plan", "hidden_out"),
)
_FEEDBACK = "\nstance_kd = "


@dataclass(frozen=True, kw_only=True)
class Ablation:
    """Differences of a policy's training from that of the full system."""

    changes: dict[str, Any] = field(default_factory=dict)
    """Changes of `JumpTrainSettings`, by its tables."""
    without: tuple[str, ...] = ()
    """Effects of the robot's profile that its simulator lacks."""
    feedback: bool = True
    """True where legs that stand track velocities by feedback, in training and after it."""


ABLATIONS = {
    FULL: Ablation(),
    "no-height-randomisation": Ablation(
        changes={"env": {"randomisation": {"height_shift_m": [0.0, 0.0], "height_noise_m": 0.0}}}
    ),
    "no-feedback": Ablation(feedback=False),
    "no-tracking-reward": Ablation(changes={"env": {"reward": {"tracking_cost": 0.0}}}),
    "no-saturation": Ablation(without=("torque_saturation",)),
}


def find_ablation(name: str) -> Ablation:
    """The ablation of that name; `SaltusError` where there is none."""
    if name not in ABLATIONS:
        known = ", ".join((*ABLATIONS, *NETWORKS))
        raise SaltusError(f"there is no ablation '{name}' to train: choose one of {known}")
    return ABLATIONS[name]


def config_of(name: str, seed: int, folder: Path) -> JumpTrainSettings:
    """Returns what `saltus policy train` is given.

    Writes a profile or a robot that it needs into a folder.
    """
    ablation, config = find_ablation(name), replace(for_gpu(DEFAULT_ROBOT, DEFAULT_GRID), seed=seed)
    changes = dict(ablation.changes)
    if ablation.without:
        changes["env"] = {**changes.get("env", {}), "profile": str(_profile(ablation, folder))}
    if not ablation.feedback:
        changes["robot"] = str(_without_feedback(folder))
    return with_changes(config, changes)


def train(name: str, seed: int, trained: Path, minutes: float, commit: str | None = None) -> Path:
    """Trains a policy, or goes on with one that was interrupted.

    Returns its ONNX file, made when all is trained.

    `commit` says which code trains, where this machine cannot tell.

    Raises:
        SaltusError: what `saltus policy train` says; there is no GPU, or the time is over before
            all is trained.
    """
    find_ablation(name)
    folder = trained / name / f"seed-{seed}"
    if not has_gpu():
        raise SaltusError(
            f"training '{name}' needs a GPU: 16384 robots, {STEPS / 1e6:.0f} million steps"
        )
    folder.mkdir(parents=True, exist_ok=True)
    config, checkpoint = config_of(name, seed, folder), folder / CHECKPOINT
    iterations = int(np.ceil(STEPS / (config.robots * config.learning.horizon)))
    TrainPolicyCommand(
        out=folder,
        minutes=minutes,
        iterations=iterations,
        resume=checkpoint if checkpoint.exists() else None,
        training=config,
        commit=commit,
    ).run()
    from saltus.policy.training.checkpoint import read_policy_checkpoint
    from saltus.policy.training.export import export_policy

    done = int(read_policy_checkpoint(checkpoint)["steps"])
    if done < STEPS:
        raise SaltusError(
            f"{done / 1e6:.0f} of {STEPS / 1e6:.0f} million steps are trained: run the command "
            "again"
        )
    export_policy(checkpoint, folder / MODEL)
    return folder / MODEL


def _profile(ablation: Ablation, folder: Path) -> Path:
    shipped = load_profile(SHIPPED, load_robot(DEFAULT_ROBOT))
    path = folder / "profile.toml"
    path.write_text(shipped.without(*ablation.without).to_toml(), encoding="utf-8")
    return path


def _without_feedback(folder: Path) -> Path:
    """The robot, with a gain of 0 where the paper has 1."""
    robot = folder / "robot"
    shutil.copytree(shipped_folder(DEFAULT_ROBOT), robot, dirs_exist_ok=True)
    supplement = robot / SUPPLEMENT_FILE
    head, tail = supplement.read_text(encoding="utf-8").split(_FEEDBACK)
    supplement.write_text(f"{head}{_FEEDBACK}0.0 #{tail}", encoding="utf-8")
    return robot
