"""The paper's ablations as values: what the training of each policy differs in, how it is trained, what is measured.

All begin with the defaults of one GPU: the paper's terrains and its randomisation, without what Saltus draws beyond
it. The shipped policy is another one, trained wider and longer.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from saltus.arrays import Floats
from saltus.config import DEFAULT_ROBOT, changed
from saltus.effects.profile import SHIPPED, Profile, load_profile, profile_to_toml
from saltus.errors import SaltusError
from saltus.models import model_id
from saltus.paper.drawing import OTHER, OURS, legend, subplots
from saltus.paper.motion import STAIRS, Made
from saltus.paper.runs import Effort, Ran, Setting, ran
from saltus.paper.stand_in import STAND_IN_SEED, stand_in
from saltus.policy.env.settings import TrainConfig, for_gpu
from saltus.policy.evaluation.evaluate import success_interval
from saltus.policy.training.command import CHECKPOINT, Train
from saltus.robots.loading import load_robot
from saltus.robots.shipped import SUPPLEMENT_FILE, shipped_folder
from saltus.terrain.curriculum import make_terrain

FULL = "full-system"
TRAINED = Path("runs/paper-train")
"""Folder of trainings: NAME/seed-N/ holds checkpoint.pt and policy.onnx."""
STEPS = 250e6
"""Environment steps of each training: 7 minutes of an H200."""
MODEL = "policy.onnx"
PROGRESS = "progress.csv"
STAND_IN = "simulated stand-in"
_FEEDBACK = "\nstance_kd = "


@dataclass(frozen=True, kw_only=True)
class Ablation:
    """What the training of a policy differs in from that of the full system."""

    changes: dict[str, Any] = field(default_factory=dict)
    """Of `TrainConfig`, by its tables."""
    without: tuple[str, ...] = ()
    """Effects of the robot's profile that its simulator lacks."""
    feedback: bool = True
    """Whether legs that stand track velocities by feedback, in training and after it."""


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
        raise SaltusError(f"there is no ablation '{name}' to train: choose one of {', '.join(ABLATIONS)}")
    return ABLATIONS[name]


def config_of(name: str, seed: int, folder: Path) -> TrainConfig:
    """What `saltus policy train` is given; writes a profile or a robot that it needs into a folder."""
    ablation, config = find_ablation(name), replace(for_gpu(), seed=seed)
    changes = dict(ablation.changes)
    if ablation.without:
        changes["env"] = {**changes.get("env", {}), "profile": str(_profile(ablation, folder))}
    if not ablation.feedback:
        changes["robot"] = str(_without_feedback(folder))
    return changed(config, changes)


def train(name: str, seed: int, trained: Path, minutes: float, commit: str | None = None) -> Path:
    """Trains a policy, or goes on with one that was interrupted; returns its ONNX file, made when all is trained.

    `commit` says which code trains, where this machine cannot tell.

    Raises:
        SaltusError: what `saltus policy train` says; there is no GPU, or the time is over before all is trained.
    """
    folder = trained / name / f"seed-{seed}"
    from saltus.policy.training.train import has_gpu  # with torch

    find_ablation(name)
    if not has_gpu():
        raise SaltusError(f"training '{name}' needs a GPU: 16384 robots, {STEPS / 1e6:.0f} million steps")
    folder.mkdir(parents=True, exist_ok=True)
    config, checkpoint = config_of(name, seed, folder), folder / CHECKPOINT
    iterations = int(np.ceil(STEPS / (config.robots * config.learning.horizon)))
    Train(
        out=folder,
        minutes=minutes,
        iterations=iterations,
        resume=checkpoint if checkpoint.exists() else None,
        training=config,
        commit=commit,
    ).run()
    from saltus.policy.training.checkpoint import read_checkpoint
    from saltus.policy.training.export import export

    done = int(read_checkpoint(checkpoint)["steps"])
    if done < STEPS:
        raise SaltusError(f"{done / 1e6:.0f} of {STEPS / 1e6:.0f} million steps are trained: run the command again")
    export(checkpoint, folder / MODEL)
    return folder / MODEL


def models_of(name: str, trained: Path) -> list[Path]:
    """The policies that were trained, by seed.

    Raises:
        SaltusError: there are none; the message names the command that makes them.
    """
    found = sorted((trained / name).glob(f"seed-*/{MODEL}"))
    if not found:
        raise SaltusError(f"no results in {trained / name}: make them with saltus paper train {name} --seed 0 (GPU)")
    return found


def measure(name: str, effort: Effort, trained: Path) -> Made:
    """An ablation beside the full system on 14 stairs, in simulation and on the stand-in for the real robot."""
    return _measured(tuple(dict.fromkeys((FULL, name))), _places(), effort, trained)


def transfer(effort: Effort, trained: Path) -> Made:
    """All systems of which a policy is trained, on the stand-in for the real robot."""
    systems = tuple(name for name in ABLATIONS if name == FULL or (trained / name).is_dir())
    return _measured(systems, {STAND_IN: stand_in()}, effort, trained)


def learning_curves(_: Effort, trained: Path) -> Made:
    """What each training of the full system came to by experience."""
    columns = {"reward": "reward of an iteration", "stairs/level": "stairs", "stepping_stones/level": "stones"}
    columns |= {"step/level": "step", "gap/level": "gap"}
    curves = [_progress(model.parent / PROGRESS) for model in models_of(FULL, trained)]
    figure, axes = subplots(1, len(columns), 2.6, sharex=True)
    shortest = min(curves, key=lambda curve: len(curve["steps"]))
    million = 1e-6 * shortest["steps"]
    for axis, (column, title) in zip(axes, columns.items(), strict=True):
        values = np.array([np.interp(shortest["steps"], curve["steps"], curve[column]) for curve in curves])
        axis.fill_between(million, values.min(axis=0), values.max(axis=0), color=OURS, alpha=0.3, linewidth=0)
        axis.plot(million, values.mean(axis=0), color=OURS)
        axis.set_title(f"{title}{', level' if column.endswith('level') else ''}", loc="left", fontsize=9)
        axis.set_xlabel("million steps")
    numbers = {
        "seeds": len(curves),
        "million_steps": [round(float(1e-6 * curve["steps"][-1]), 1) for curve in curves],
        "minutes": [round(float(curve["seconds"][-1]) / 60.0, 1) for curve in curves],
        "at_the_end": {column: [round(float(curve[column][-1]), 2) for curve in curves] for column in columns},
    }
    return Made(numbers=numbers, figure=figure, configuration={"band": "least to greatest of the seeds; line: mean"})


def _progress(path: Path) -> dict[str, Floats]:
    """The columns of a training's table; `SaltusError` where there is none."""
    try:
        lines = path.read_text().splitlines()
    except OSError as error:
        raise SaltusError(f"cannot read {path}, the table of a training") from error
    rows = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    return dict(zip(lines[0].split(","), rows.T, strict=True))


def _measured(systems: Sequence[str], places: Mapping[str, Profile], effort: Effort, trained: Path) -> Made:
    """Systems beside each other on 14 stairs."""
    terrain = make_terrain(STAIRS)
    numbers: dict[str, Any] = {}
    figure, axes = subplots(1, len(places), 3.2, sharey=True, squeeze=False)
    axes = axes[0]
    for place, system in enumerate(systems):
        models = models_of(system, trained)
        colour = OURS if system == FULL else OTHER if len(systems) <= 2 else f"C{place + 1}"
        for axis, (where, profile) in zip(axes, places.items(), strict=True):
            settings = [
                Setting(terrain=terrain, feedback=ABLATIONS[system].feedback, policy=model, profile=profile)
                for model in models
            ]
            seeds = ran(settings, effort)
            numbers.setdefault(system, {})[where] = _figures(seeds)
            steps = [run.edges_passed for runs in seeds for run in runs]
            axis.bar(place, np.mean(steps), 0.6, color=colour, label=f"{system}, seeds: {len(models)}")
            axis.plot(np.linspace(place - 0.2, place + 0.2, len(steps)), steps, "k.", markersize=3)
            axis.set_title(where, loc="left", fontsize=10)
            axis.set_xticks([])
    axes[0].set_ylabel("steps before failure (14: all)")
    legend(axes[0], fontsize=8)
    policies = {system: [model_id(model.read_bytes()) for model in models_of(system, trained)] for system in systems}
    configuration = {"course": dict(terrain.params), "stand_in_seed": STAND_IN_SEED, "policies": policies}
    return Made(numbers=numbers, figure=figure, configuration=configuration)


def _places() -> dict[str, Profile]:
    return {"simulation": load_profile(SHIPPED, load_robot(DEFAULT_ROBOT)), STAND_IN: stand_in()}


def _figures(seeds: Sequence[Sequence[Ran]]) -> dict[str, Any]:
    """Of each seed's policy; the interval is that of the share of all their trials [%]."""
    success = [sum(run.outcome.success for run in runs) for runs in seeds]
    low, high = success_interval(sum(success), sum(map(len, seeds)))
    return {
        "success": success,
        "trials": len(seeds[0]),
        "interval95_percent": [round(100.0 * low, 1), round(100.0 * high, 1)],
        "mean_steps": [round(float(np.mean([run.edges_passed for run in runs])), 2) for runs in seeds],
    }


def _profile(ablation: Ablation, folder: Path) -> Path:
    shipped = load_profile(SHIPPED, load_robot(DEFAULT_ROBOT))
    known = {
        part: tuple(e for e in effects if e.name not in ablation.without) for part, effects in vars(shipped).items()
    }
    path = folder / "profile.toml"
    path.write_text(profile_to_toml(Profile(**known)))
    return path


def _without_feedback(folder: Path) -> Path:
    """The robot, with a gain of 0 where the paper has 1."""
    robot = folder / "robot"
    shutil.copytree(shipped_folder(DEFAULT_ROBOT), robot, dirs_exist_ok=True)
    supplement = robot / SUPPLEMENT_FILE
    head, tail = supplement.read_text().split(_FEEDBACK)
    supplement.write_text(f"{head}{_FEEDBACK}0.0 #{tail}")
    return robot
