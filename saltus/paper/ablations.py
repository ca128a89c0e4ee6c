"""The paper's ablations as they are measured: policies of `saltus.paper.training`, in simulation and on a stand-in."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from saltus.arrays import Floats
from saltus.config import DEFAULT_ROBOT
from saltus.effects.profile import SHIPPED, load_profile
from saltus.errors import SaltusError
from saltus.models import model_id
from saltus.paper.drawing import OTHER, OURS, subplots
from saltus.paper.motion import STAIRS, Made
from saltus.paper.runs import Effort, Ran, Setting, ran
from saltus.paper.stand_in import STAND_IN_SEED, stand_in
from saltus.paper.training import ABLATIONS, FULL, MODEL, TRAINED
from saltus.policy.evaluation.evaluate import success_interval
from saltus.policy.training.command import COMMIT, PROGRESS
from saltus.resources import resource
from saltus.robots.loading import load_robot
from saltus.terrain.curriculum import make_terrain

SIMULATION, STAND_IN = "simulation", "simulated stand-in"
PUBLISHED = "benchmarks/paper"
"""Results, and the policies that they are of, in the repository."""


def trainings_folder(given: Path | None) -> Path:
    """Where policies are read from; by default the published ones, of an installation without them `TRAINED`."""
    if given is not None:
        return given
    try:
        return resource(f"{PUBLISHED}/trainings")
    except SaltusError:
        return TRAINED


def models_of(name: str, trained: Path) -> list[Path]:
    """The policies that were trained, by seed.

    Raises:
        SaltusError: there are none; the message names the command that makes them.
    """
    found = sorted((trained / name).glob(f"seed-*/{MODEL}"))
    if not found:
        raise SaltusError(f"no results in {trained / name}: make them with saltus paper train {name} --seed 0 (GPU)")
    return found


def trained_systems(trained: Path) -> list[str]:
    """Of which systems there are policies."""
    return [name for name in ABLATIONS if any((trained / name).glob(f"seed-*/{MODEL}"))]


def training_of(model: Path) -> dict[str, Any]:
    """Seed, commit and name of a trained policy."""
    commit = model.parent / COMMIT
    return {
        "seed": int(model.parent.name.removeprefix("seed-")),
        "commit": commit.read_text().strip() if commit.exists() else "unknown",
        "policy": model_id(model.read_bytes()),
    }


def measure(name: str, effort: Effort, trained: Path) -> dict[str, Any]:
    """What a system came to on 14 stairs, by place: in simulation, and on the stand-in for the real robot."""
    terrain, feedback = make_terrain(STAIRS), ABLATIONS[name].feedback
    places = {SIMULATION: load_profile(SHIPPED, load_robot(DEFAULT_ROBOT)), STAND_IN: stand_in()}
    settings = [
        (where, Setting(terrain=terrain, feedback=feedback, policy=model, profile=profile))
        for where, profile in places.items()
        for model in models_of(name, trained)
    ]
    results = ran([setting for _, setting in settings], effort)
    return {
        where: _figures([runs for (at, _), runs in zip(settings, results, strict=True) if at == where])
        for where in places
    }


def compare(systems: Mapping[str, Mapping[str, Any]], trained: Path) -> Made:
    """Systems beside each other: what `measure` came to, by name; the full system first."""
    places = list(next(iter(systems.values())))
    figure, axes = subplots(1, len(places), 1.1 + 0.42 * len(systems), sharey=True, sharex=True, squeeze=False)
    for axis, where in zip(axes[0], places, strict=True):
        for row, (system, numbers) in enumerate(systems.items()):
            figures = numbers[where]
            axis.barh(row, figures["steps"], 0.6, color=OURS if system == FULL else OTHER, alpha=0.5)
            axis.plot(figures["steps_of_each_seed"], [row] * len(figures["success"]), "k.", markersize=4)
            axis.text(14.4, row, _share(figures), va="center", fontsize=8)
        axis.set_yticks(range(len(systems)), list(systems))
        axis.set_xlim(0.0, 21.0)
        axis.set_xticks(range(0, 15, 2))
        axis.set_title(where, loc="left", fontsize=10)
        axis.set_xlabel("steps before failure; a dot for each seed      all 14")
    axes[0][0].invert_yaxis()
    configuration = {
        "course": dict(make_terrain(STAIRS).params),
        "stand_in_seed": STAND_IN_SEED,
        "trainings": {system: [training_of(model) for model in models_of(system, trained)] for system in systems},
    }
    return Made(numbers={system: dict(numbers) for system, numbers in systems.items()}, figure=figure,
                configuration=configuration)  # fmt: skip


def learning_curves(_: Effort, trained: Path) -> Made:
    """What each training of the full system came to by experience."""
    columns = {"reward": "reward of an iteration", "stairs/level": "stairs", "stepping_stones/level": "stones"}
    columns |= {"step/level": "step", "gap/level": "gap"}
    models = models_of(FULL, trained)
    curves = [_progress(model.parent / PROGRESS) for model in models]
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
    configuration = {
        "band": "least to greatest of the seeds; line: mean",
        "trainings": {FULL: [training_of(model) for model in models]},
    }
    return Made(numbers=numbers, figure=figure, configuration=configuration)


def _progress(path: Path) -> dict[str, Floats]:
    """The columns of a training's table; `SaltusError` where there is none."""
    try:
        lines = path.read_text().splitlines()
    except OSError as error:
        raise SaltusError(f"cannot read {path}, the table of a training") from error
    rows = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    return dict(zip(lines[0].split(","), rows.T, strict=True))


def _figures(seeds: Sequence[Sequence[Ran]]) -> dict[str, Any]:
    """Of each seed's policy; the interval is that of the share of all their trials [%]."""
    success = [sum(run.outcome.success for run in runs) for runs in seeds]
    low, high = success_interval(sum(success), sum(map(len, seeds)))
    return {
        "success": success,
        "trials": len(seeds[0]),
        "interval95_percent": [round(100.0 * low, 1), round(100.0 * high, 1)],
        "steps": round(float(np.mean([run.edges_passed for runs in seeds for run in runs])), 2),
        "steps_of_each_seed": [round(float(np.mean([run.edges_passed for run in runs])), 2) for runs in seeds],
    }


def _share(figures: Mapping[str, Any]) -> str:
    count = figures["trials"] * len(figures["success"])
    low, high = figures["interval95_percent"]
    return f"{sum(figures['success'])} of {count} all 14\n({low:.0f} to {high:.0f} %)"
