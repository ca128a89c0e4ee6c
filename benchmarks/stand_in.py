"""Difficulty of the effects of the stand-in for the real robot:
each alone in the shipped profile, and all of them.

On 14 stairs of 0.20 m, as the ablations of `saltus paper`; by default the shipped policy, else
those that are named. With `--left-out` effects it is all of them, and all but each of these.

    saltus bench stand_in
    saltus bench stand_in -- runs/mine/policy.onnx --trials 24
    saltus bench stand_in -- --left-out viscous_friction coulomb_friction
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from tqdm import tqdm

from benchmarks._command import Command
from paper.run_figures import STAIRS
from paper.runs import Effort, Ran, Setting, ran
from paper.stand_in import stand_in
from saltus.effects.profile import SHIPPED, Profile, load_profile
from saltus.errors import SaltusError, nearest_hint
from saltus.flags import Flag
from saltus.grid import LINE
from saltus.policy.planner import make_planner
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.terrain.curriculum import make_terrain

NONE, ALL = "none", "all"


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    policies: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """ONNX files; by default the shipped policy."""
    left_out: tuple[str, ...] = ()
    """Effects of the stand-in: all others are there, in the place of each effect alone."""
    true_heights: Flag = False
    """Robots are told the ground as it is, and see nothing."""
    trials: int = 24
    """Trials of each policy with each effect."""
    seed: int = 140_000
    """Seed of the first trial."""
    time_limit_s: float = 20.0
    """Time limit of each trial."""

    def measure(self) -> dict[str, Any]:
        policies: dict[str, Path | None] = {str(path): path for path in self.policies} or {
            "shipped": None
        }
        for policy in policies.values():  # what is wrong with one is said before anything runs
            make_planner("learned", load_robot(DEFAULT_ROBOT), LINE, policy)
        cases = profiles(self.left_out)
        terrain = make_terrain(STAIRS)
        settings = [
            Setting(terrain=terrain, policy=policy, profile=profile, true_heights=self.true_heights)
            for policy in policies.values()
            for profile in cases.values()
        ]
        with tqdm(total=self.trials * len(settings), unit="trial", disable=None) as bar:
            effort = Effort(
                trials=self.trials,
                first_seed=self.seed,
                time_limit_s=self.time_limit_s,
                say=bar.update,
            )
            results = iter(ran(settings, effort))
        return {name: {case: summary(next(results)) for case in cases} for name in policies}


def profiles(left_out: Sequence[str] = ()) -> dict[str, Profile]:
    """The shipped profile, with each of the stand-in's effects that it does not have, and with all.

    Or all of them, and all but each that is left out.

    Raises:
        SaltusError: the stand-in does not have an effect of that name.
    """
    shipped, hard = load_profile(SHIPPED, load_robot(DEFAULT_ROBOT)), stand_in()
    known = shipped.effects
    alone = {
        name: shipped.having(effect)
        for name, effect in hard.effects.items()
        if known.get(name) != effect
    }
    for name in left_out:
        if name not in alone:
            raise SaltusError(
                f"the stand-in has no effect '{name}': {nearest_hint(name, list(alone))}"
            )
    if left_out:
        return {ALL: hard, **{f"{ALL} but {name}": _but(name, shipped, hard) for name in left_out}}
    return {NONE: shipped, **alone, ALL: hard}


def _but(name: str, shipped: Profile, hard: Profile) -> Profile:
    """The stand-in with what the shipped profile has of one effect."""
    own = shipped.effects.get(name)
    return hard.without(name) if own is None else hard.having(own)


def summary(runs: list[Ran]) -> dict[str, Any]:
    """Summary of the trials with one profile."""
    failures = Counter(run.failure for run in runs if not run.outcome.success)
    return {
        "success": sum(run.outcome.success for run in runs),
        "trials": len(runs),
        "mean steps of 14": round(float(np.mean([run.edges_passed for run in runs])), 1),
        "failures": dict(failures.most_common()),
    }
