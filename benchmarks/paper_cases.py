"""The two effects that the paper found by hand,
hidden in the simulated robot and searched for in its run logs.

1. The dynamometer's table of torque, in large steps of a held robot. The fitted curve of the calf
   is compared with the table from 0 to 35 Nm commanded; then the patch is applied and the same log
   searched again.
2. 50 ms of latency in the camera: on heave and pitch chirps, and on one sine of body height.

    saltus bench paper_cases -- --seeds 0 1 2
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._command import Command, progress, tell
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.motors import TorqueSaturation
from saltus.effects.profile import IDEAL, SHIPPED, Profile, load_profile
from saltus.real2sim.experiments.menu import experiment_named
from saltus.real2sim.experiments.run import run_experiment
from saltus.real2sim.pipeline import find_in_logs
from saltus.real2sim.results import Judgement
from saltus.recordings.run_log import write_run_log
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT

ROBOT = load_robot(DEFAULT_ROBOT)
LATENCY_S = 0.050  # paper
FARTHEST_NM = 35.0
"""Commanded; the end of the table."""
NEAREST_NM = 0.5
"""Below it a share of the torque says nothing."""


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds of the sensors' noise."""

    def measure(self) -> dict[str, Any]:
        cases = (saturation, latency_in_chirps, latency_in_a_sine)
        results = []
        for case, seed in progress([(case, seed) for seed in self.seeds for case in cases]):
            start = time.process_time()
            with tempfile.TemporaryDirectory() as folder:
                result = {"case": case.__name__, "seed": seed, **case(Path(folder), seed)}
            tell(f"{case.__name__}, seed {seed}: {result.pop('in_words')}")
            results.append({**result, "cpu_s": round(time.process_time() - start, 1)})
        return {"cases": results}


def _table() -> TorqueSaturation:
    """The dynamometer's."""
    shipped = load_profile(SHIPPED, ROBOT)
    return next(effect for effect in shipped.actuator if isinstance(effect, TorqueSaturation))


def saturation(folder: Path, seed: int) -> dict[str, Any]:
    """The table of torque in large steps."""
    hidden = Profile(actuator=(_table(),))
    first = _search("large_steps", hidden, seed, folder)
    names = [effect.name for effect in first.verdict.effects]
    curves = [
        effect.curve
        for effect in first.verdict.effects
        if "FR_calf" in effect.where and effect.curve
    ]
    worst = _apart(curves[0]) if len(curves) == 1 else float("nan")
    again = find_in_logs(
        [folder / "log"],
        folder,
        profile=first.patch.applied_to(IDEAL, ROBOT),
        seed=seed,
        report=False,
    )
    result = {
        "verdict": first.verdict.verdict,
        "effects": sorted(set(names)),
        "worst_error_of_curve": round(worst, 4),
        "after_the_patch": again.verdict.verdict,
    }
    curve = f"the calf's curve is within {worst:.1%} of the table to {FARTHEST_NM:g} Nm"
    return result | {
        "in_words": f"{_said(first)}; {curve}; after the patch {again.verdict.verdict}"
    }


def latency_in_chirps(folder: Path, seed: int) -> dict[str, Any]:
    """50 ms in heave and pitch chirps."""
    found = _search(
        "heave_and_pitch", Profile(camera=(CameraLatency(latency=LATENCY_S),)), seed, folder
    )
    values = [e.params["latency"] for e in found.verdict.effects if e.name == CameraLatency.name]
    told = f"latency {1e3 * values[0].value:.2f} ms" if values else "no latency"
    result = {
        "verdict": found.verdict.verdict,
        "effects": [effect.name for effect in found.verdict.effects],
        "error_ms": round(1e3 * (values[0].value - LATENCY_S), 3) if values else None,
        "ci90_ms": [round(1e3 * end, 2) for end in values[0].ci90] if values else None,
    }
    return result | {"in_words": f"{_said(found)}; {told}"}


def latency_in_a_sine(folder: Path, seed: int) -> dict[str, Any]:
    """50 ms in one sine of 1 Hz."""
    found = _search("heave_sine", Profile(camera=(CameraLatency(latency=LATENCY_S),)), seed, folder)
    proposed = found.verdict.next_experiment
    name = "none" if proposed is None else proposed.name
    result = {
        "verdict": found.verdict.verdict,
        "sets": [list(names) for names in found.verdict.sets],
        "next_experiment": name,
    }
    return result | {"in_words": f"{_said(found)}; next experiment {name}"}


def _search(experiment: str, hidden: Profile, seed: int, folder: Path) -> Judgement:
    write_run_log(
        run_experiment(experiment_named(experiment), ROBOT, hidden, seed=seed), folder / "log"
    )
    return find_in_logs([folder / "log"], folder, seed=seed, report=False)


def _apart(curve: tuple[tuple[float, float], ...]) -> float:
    """Largest relative error of a curve against the table."""
    torque = np.linspace(NEAREST_NM, FARTHEST_NM, 500)
    fitted, table = (
        np.interp(torque, *np.array(((0.0, 0.0), *pairs)).T) for pairs in (curve, _table().curve)
    )
    return float(np.max(np.abs(fitted / table - 1.0)))


def _said(judgement: Judgement) -> str:
    verdict = judgement.verdict
    names = sorted({effect.name for effect in verdict.effects})
    sets = ["{" + ", ".join(each) + "}" for each in verdict.sets]
    return f"{verdict.verdict} {', '.join([*names, *sets])}".rstrip()
