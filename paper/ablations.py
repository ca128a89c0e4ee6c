"""The paper's ablations as they are measured:
systems of what was trained, in simulation and on a stand-in.
"""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from paper import training
from paper.drawing import OTHER, OURS, subplots
from paper.run_figures import STAIRS, Made
from paper.runs import Effort, Ran, Setting, ran
from paper.stand_in import STAND_IN_SEED, stand_in
from saltus.effects.profile import SHIPPED, load_profile
from saltus.errors import SaltusError
from saltus.model_file import checksum_path
from saltus.policy.evaluation.evaluate import success_interval
from saltus.policy.training.files import COMMIT
from saltus.provenance import current_commit
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.terrain.curriculum import make_terrain
from saltus.used_networks import MODEL_ID_DIGITS, ModelKind, model_id

SIMULATION, STAND_IN = "simulation", "simulated stand-in"
TRANSFER, ROUNDS_ROW = "transfer", "predictor-rounds"


def trainings_folder(given: Path | None) -> Path:
    """Folder that policies are read from, by default the published one."""
    return training.PUBLISHED_TRAININGS if given is None else given


Figures = dict[str, Any]
"""Figures of a training: successes of how many trials, mean steps, first and last seed of the
trials, the code."""
Places = dict[str, Figures]
"""By where it was measured."""


@dataclass(frozen=True, kw_only=True)
class System:
    """A system that runs: trainings by their names, those of one seed together."""

    policy: str = training.FULL
    predictor: str | None = None
    """The training, and the name of its file; by default the shipped one."""
    file: str = training.PREDICTED


SYSTEMS = {
    **{name: System(policy=name) for name in training.ABLATIONS},
    **{
        f"round {i + 1}": System(predictor=training.PREDICTOR, file=f"round-{i}.onnx")
        for i in range(training.ROUNDS)
    },
    training.NO_LATENCY: System(predictor=training.NO_LATENCY),
    "no-sysid": System(policy="no-saturation", predictor=training.NO_LATENCY),
    training.IMITATION: System(policy=training.IMITATION),
}
"""By name. A predictor's last round is that which others of the same data stand beside."""
LAST = f"round {training.ROUNDS}"
WHOLE = (training.FULL, LAST)
"""Systems that others are held against: the full system with the shipped predictor, and with one of
the same data."""


def shipped_in(system: str) -> tuple[ModelKind, ...]:
    """The shipped networks that run in a system; what imitates plans from images itself."""
    return () if system == training.IMITATION or SYSTEMS[system].predictor else ("heightmap",)


def shown_in(row: str, trained: Path) -> tuple[str, ...]:
    """The systems that a row sets beside each other; the last is its own, if it has one."""
    if row == TRANSFER:
        return tuple(trained_systems(trained))
    if row == ROUNDS_ROW:
        return tuple(name for name in SYSTEMS if name.startswith("round "))
    beside = LAST if row in (training.NO_LATENCY, "no-sysid", training.IMITATION) else training.FULL
    return tuple(dict.fromkeys((beside, row)))


def files_of(name: str, trained: Path) -> list[tuple[Path, ...]]:
    """Files of what was trained for a system, by seed: its policy,
    and its predictor where that is not the shipped one.

    A file may be missing where its checksum is there: see `check_weights`.

    Raises:
        SaltusError: there is none; the message names the command that makes what is missing.
    """
    system = SYSTEMS[name]
    parts = {
        system.policy: training.IMITATOR if system.policy == training.IMITATION else training.MODEL
    }
    if system.predictor is not None:
        parts[system.predictor] = system.file
    found = {
        part: sorted({path.parent.name for path in (trained / part).glob(f"seed-*/{file}*")})
        for part, file in parts.items()
    }
    for part, seeds in found.items():
        if not seeds:
            raise SaltusError(
                f"no results in {trained / part}: make them with saltus paper train {part} --seed "
                "0 (GPU)"
            )
    common = [
        seed for seed in found[system.policy] if all(seed in seeds for seeds in found.values())
    ]
    if not common:
        raise SaltusError(f"no seed of which {' and '.join(parts)} are trained, in {trained}")
    return [tuple(trained / part / seed / file for part, file in parts.items()) for seed in common]


def trained_systems(trained: Path) -> list[str]:
    """Which systems can be run."""
    there = []
    for name in SYSTEMS:
        with contextlib.suppress(SaltusError):
            files_of(name, trained)
            there.append(name)
    return there


def trainings_of(name: str, trained: Path) -> list[dict[str, Any]]:
    """Seed, commit and names of what runs in a system, for each of its seeds."""
    return [_training(files) for files in files_of(name, trained)]


def _training(files: tuple[Path, ...]) -> dict[str, Any]:
    told: dict[str, Any] = {"seed": int(files[0].parent.name.removeprefix("seed-"))}
    for kind, before, path in zip(("policy", "predictor"), ("", "predictor_"), files, strict=False):
        code = path.parent / COMMIT
        told[f"{before}commit"] = (
            code.read_text(encoding="utf-8").strip() if code.exists() else "unknown"
        )
        told[kind] = model_id(path.read_bytes()) if path.exists() else _recorded_id(path)
    return told


def _recorded_id(path: Path) -> str:
    """Name of a model whose checksum alone is there."""
    return checksum_path(path).read_text(encoding="utf-8").split()[0][:MODEL_ID_DIGITS]


def check_weights(name: str, trained: Path, known: Sequence[Places | None]) -> None:
    """Looks for the weights of a system's trainings that are to be run.

    Args:
        name: Of `SYSTEMS`.
        trained: Folder of trainings.
        known: As of `measure`.

    Raises:
        SaltusError: they are not there; the message says how they come back.
    """
    for files, there in zip_longest(files_of(name, trained), known):
        missing = [path for path in files if not (there or path.exists())]
        if missing:
            raise SaltusError(
                f"the weights {missing[0]} are not kept here: {training.BRING_BACK}, "
                "or train them again"
            )


def measure(
    name: str, effort: Effort, trained: Path, known: Sequence[Places | None] = ()
) -> dict[str, Any]:
    """Returns what a system came to on 14 stairs, by place:
    in simulation, and on the stand-in for the real robot.

    Args:
        name: Of `SYSTEMS`.
        effort: How much is run.
        trained: Folder of trainings.
        known: What its trainings came to, in the order of `trainings_of`; those of which nothing is
            known are run.
    """
    policy = SYSTEMS[name].policy
    feedback = policy not in training.ABLATIONS or training.ABLATIONS[policy].feedback
    profiles = {SIMULATION: load_profile(SHIPPED, load_robot(DEFAULT_ROBOT)), STAND_IN: stand_in()}
    files = files_of(name, trained)
    known = known or [None] * len(files)
    new = [
        replace(_setting(each), feedback=feedback)
        for each, there in zip(files, known, strict=True)
        if not there
    ]
    settings = [
        replace(setting, profile=profile) for setting in new for profile in profiles.values()
    ]
    results = iter(ran(settings, effort) if settings else ())
    return together(
        [there or {where: _figures(next(results)) for where in profiles} for there in known]
    )


def _setting(files: tuple[Path, ...]) -> Setting:
    """With what was trained, on 14 stairs."""
    terrain = make_terrain(STAIRS)
    if files[0].name == training.IMITATOR:
        return Setting(terrain=terrain, imitator=files[0])
    return Setting(terrain=terrain, policy=files[0], predictor=files[1] if len(files) > 1 else None)


def compare(systems: Mapping[str, Mapping[str, Any]], trained: Path) -> Made:
    """Systems beside each other: what `measure` came to, by name."""
    places = list(next(iter(systems.values())))
    figure, axes = subplots(
        1, len(places), 1.1 + 0.42 * len(systems), sharey=True, sharex=True, squeeze=False
    )
    for axis, where in zip(axes[0], places, strict=True):
        for row, (name, numbers) in enumerate(systems.items()):
            figures = numbers[where]
            axis.barh(row, figures["steps"], 0.6, color=OURS if name in WHOLE else OTHER, alpha=0.5)
            axis.plot(
                figures["steps_of_each_seed"], [row] * len(figures["success"]), "k.", markersize=4
            )
            axis.text(14.5, row, _share(figures), va="center", fontsize=8)
        axis.set_yticks(range(len(systems)), list(systems))
        axis.set_xlim(0.0, 19.5)
        axis.set_xticks(range(0, 15, 2))
        axis.set_title(where, loc="left", fontsize=10)
        axis.set_title("successes", loc="right", fontsize=9)
        axis.set_xlabel("steps of 14 before failure: mean, and of each seed")
    axes[0][0].invert_yaxis()
    configuration = {
        "course": dict(make_terrain(STAIRS).params),
        "stand_in_seed": STAND_IN_SEED,
        "trainings": {system: trainings_of(system, trained) for system in systems},
    }
    return Made(numbers={system: dict(numbers) for system, numbers in systems.items()},
        figure=figure,
                configuration=configuration)  # fmt: skip


def _figures(runs: Sequence[Ran]) -> Figures:
    """Figures of one training in one place."""
    return {
        "success": sum(run.outcome.success for run in runs),
        "trials": len(runs),
        "steps": round(float(np.mean([run.edges_passed for run in runs])), 2),
        "trial_seeds": [runs[0].seed, runs[-1].seed],
        "commit": current_commit(),
    }


def together(trainings: Sequence[Places]) -> dict[str, Any]:
    """Returns what trainings came to that differ in their seed alone, by place.

    All ran the same trials.

    The interval is that of the share of all their trials [%]. For each training it says which code
    ran.
    """
    return {where: _together([places[where] for places in trainings]) for where in trainings[0]}


def _together(each: Sequence[Figures]) -> dict[str, Any]:
    success, steps = (
        [figures["success"] for figures in each],
        [figures["steps"] for figures in each],
    )
    trials = each[0]["trials"]
    low, high = success_interval(sum(success), trials * len(each))
    return {
        "success": success,
        "trials": trials,
        "interval95_percent": [round(100.0 * low, 1), round(100.0 * high, 1)],
        "steps": round(float(np.mean(steps)), 2),
        "steps_of_each_seed": steps,
        "trial_seeds": each[0]["trial_seeds"],
        "commits": [figures["commit"] for figures in each],
    }


def apart(numbers: Mapping[str, Any]) -> list[Places]:
    """The trainings that `together` has put together."""
    places: list[Places] = [{} for _ in next(iter(numbers.values()))["success"]]
    for where, all_ in numbers.items():
        rows = zip(all_["success"], all_["steps_of_each_seed"], all_["commits"], strict=True)
        for into, (success, steps, code) in zip(places, rows, strict=True):
            into[where] = {"success": success, "trials": all_["trials"], "steps": steps,
                           "trial_seeds": all_["trial_seeds"], "commit": code}  # fmt: skip
    return places


def _share(figures: Mapping[str, Any]) -> str:
    count = figures["trials"] * len(figures["success"])
    low, high = figures["interval95_percent"]
    return f"{sum(figures['success'])} of {count}\n({low:.0f} to {high:.0f} %)"
