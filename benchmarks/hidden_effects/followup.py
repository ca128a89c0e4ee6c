"""The same hidden robots once more, in the experiments that were proposed for them."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.hidden_effects.cases import Case
from benchmarks.hidden_effects.plan import Run
from benchmarks.hidden_effects.scene import Setting
from benchmarks.hidden_effects.stage import make_stage
from benchmarks.hidden_effects.tables import write

SEED = 11
"""Added to a run's own: another start, other noise."""
STANDING = ("body", "imu")
"""Robots that can be hung up: their drives are as claimed, and what is hidden in body, ground or
IMU does not move a joint then."""


def followup(cases: list[Case], logs: Path) -> int:
    """Writes a second log for each set that holds the truth and comes with an experiment,
    where none is there yet.

    Returns:
        How many of the robots could do what was proposed.
    """
    proposed = [case for case in cases if case.proposal]
    count = 0
    for number, case in enumerate(proposed, start=1):
        done = follow(case, logs)
        count += done
        print(
            f"{number}/{len(proposed)} {case.truth['name']}: "
            f"{case.proposal}{'' if done else ' cannot be done'}"
        )
    return count


def follow(case: Case, logs: Path) -> bool:
    """Writes the second log of one run; whether its rig can do the experiment."""
    run = Run(
        **{
            **case.truth["run"],
            **{k: tuple(case.truth["run"][k]) for k in ("effects", "multiples")},
        }
    )
    out = logs / run.name
    if (out / "meta.json").exists():
        return True
    stage = make_stage(run, case.truth["tuning"])
    rng = np.random.default_rng(run.seed + SEED)
    settings = tuple(
        Setting(**{**one, "where": tuple(one["where"])}) for one in case.truth["settings"]
    )
    if not stage.follow(case.proposal, rng):
        if run.kind not in STANDING:
            return False
        stage, settings = make_stage(replace(run, kind="joints"), case.truth["tuning"]), ()
        if not stage.follow(case.proposal, rng):
            return False
    write(stage.record(settings, rng), out)
    return True
