"""Verdicts of real2sim on an effect that its library lacks:
each run's true effect is taken out before the search.

LOGS and TRUTH are folders of `saltus bench hidden_effects -- generate`. Runs with one effect of the
library at three times the one-sigma size or more are searched. Counted are "unexplained", "no gap",
and, where another effect is named instead of the true one, whether the finding is marked with a
remainder: more of the gap is left than two right simulations of one robot leave
(`saltus.real2sim.search.decide.REMAINDER_RMS`).

    saltus bench left_out -- LOGS TRUTH
"""

import json
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from benchmarks._command import Command, progress, tell
from saltus.arrays import Floats
from saltus.errors import SaltusError
from saltus.real2sim.pipeline import examine_logs, judge_logs
from saltus.real2sim.problem.log import load_rigs
from saltus.real2sim.problem.problem import Problem, WrappedProblem
from saltus.real2sim.results import LogExamination
from saltus.real2sim.search.decide import REMAINDER_RMS
from saltus.real2sim.sensors import SENSORS, Sensor


class NarrowedProblem(WrappedProblem):
    """`inner` without some of its effects, by name, which stay absent."""

    def __init__(self, inner: Problem, without: Collection[str]) -> None:
        super().__init__(inner)
        self.untestable = {
            name: why for name, why in inner.untestable.items() if name not in without
        }
        self.candidates = tuple(c for c in inner.candidates if c.effect not in without)
        is_kept = [c.effect not in without for c in inner.candidates for _ in c.unknowns]
        self._kept = np.flatnonzero(is_kept)
        self.likely = None if inner.likely is None else inner.likely[self._kept]

    def residuals(self, unknowns: Floats) -> Floats:
        """See `Problem`."""
        full = np.tile(self._inner.absent, (*unknowns.shape[:2], 1))
        full[:, :, self._kept] = unknowns
        return self._inner.residuals(full)


LARGE = 3.0
"""Times the size at which an effect's residual is one sigma: from here on it must be found."""


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    logs: Annotated[Path, tyro.conf.Positional]
    """Folder of run logs."""
    truth: Annotated[Path, tyro.conf.Positional]
    """Folder of what is true of them."""

    def measure(self) -> dict[str, Any]:
        truths = {
            path.stem: json.loads(path.read_text(encoding="utf-8"))
            for path in sorted(self.truth.glob("*.json"))
        }
        if not truths:
            raise SaltusError(
                f"'{self.truth}' holds no truths: write some with saltus bench hidden_effects"
            )
        results = []
        for name in progress([name for name, truth in truths.items() if _counts(truth)]):
            results.append(_searched(self.logs / name, str(truths[name]["effects"][0]["name"])))
            tell("{run}  without {without:20} {outcome:22} {named}".format(**results[-1]))
        return {"counts": dict(Counter(result["outcome"] for result in results)), "runs": results}


def _without(sensor: Sensor, effect: str) -> Sensor:
    """The sensor whose library lacks an effect."""
    return replace(sensor, problem=lambda log: NarrowedProblem(sensor.problem(log), (effect,)))


def _counts(truth: Any) -> bool:
    if not isinstance(truth, dict) or truth.get("category") != "one" or truth["quiet"]:
        return False
    return min(truth["multiples"]) >= LARGE - 1e-6


def _searched(log: Path, effect: str) -> dict[str, Any]:
    (examined,) = examine_logs(
        load_rigs([log]), sensors=[_without(sensor, effect) for sensor in SENSORS]
    )
    verdict = judge_logs((examined,), ()).verdict
    outcome: str = verdict.verdict
    if outcome in ("named", "set"):
        outcome = "false, with remainder" if _remains(examined) else "false and confident"
    return {
        "run": log.name,
        "without": effect,
        "outcome": outcome,
        "named": ", ".join(
            dict.fromkeys([e.name for e in verdict.effects] + [n for s in verdict.sets for n in s])
        ),
        "remainder_sigma": max(
            (each.findings.remainder for each in examined.comparisons), default=0.0
        ),
    }


def _remains(examined: LogExamination) -> bool:
    """True where a sensor whose gap was explained keeps structure
    above what right simulations differ by.
    """
    return any(
        each.findings.remainder > REMAINDER_RMS * each.problem.samples_per_residual**0.5
        for each in examined.comparisons
        if each.findings.verdict in ("named", "set")
    )
