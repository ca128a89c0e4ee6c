"""Tells whether logs in another unit or sign are told by channel and factor,
and right ones left alone.

Each of the logs, of the experiments of real2sim in turn, is screened as it is, and with one channel
in another unit or sign. Every third robot has drives of 0.7 to 1.3 times their strength. Of some
logs the whole of `find_in_logs` is asked. Logs go on where they were left when --out names a folder
that was begun before.

    saltus bench units -- --seed 1 --out runs/units
"""

import json
import re
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._command import Command, progress, tell
from saltus.effects.motors import TorqueGain
from saltus.effects.profile import IDEAL
from saltus.real2sim.experiments.menu import EXPERIMENTS
from saltus.real2sim.experiments.run import run_experiment
from saltus.real2sim.pipeline import find_in_logs
from saltus.real2sim.screening.screen import screen_log
from saltus.recordings.log_units import SIGNALS
from saltus.recordings.run_log import RunLog, write_run_log
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT

DEGREE, G, GEARS = 180.0 / np.pi, 1.0 / 9.80665, (6.33, 9.495, 1.0 / 6.33, 1.0 / 9.495)
OF_ANGLES = (DEGREE, 1.0 / DEGREE, 1000.0, *GEARS)
FACTORS: dict[str, tuple[float, ...]] = {
    "tau_est": (1.0 / 0.0980665, 1000.0, 8.85, G, 1e-3, -1.0, *GEARS),
    "q": OF_ANGLES,
    "dq": (30.0 / np.pi, -1.0, *OF_ANGLES),
    "q_des": OF_ANGLES,
    "tau_ff": (1.0 / 0.0980665, 1000.0, -1.0, *GEARS),
    "t": (1e3, 1e6, 1e9, 1e-3),
    "depth": (10.0, 4.0, 5.0, 8.0, 0.1, 1e-3),
    "gyro": (DEGREE, 30.0 / np.pi, 1.0 / DEGREE, -1.0),
    "acc": (G, 1000.0 * G, 1000.0, -1.0),
    "position": (1000.0, 100.0, 39.37),
    "velocity": (1000.0, 100.0, 3.6, -1.0),
}
"""Factors that a channel may be multiplied by: units, gears, signs."""
STRENGTH = (0.7, 1.3)
WEAK_EVERY = 3
NEAR = 0.06
"""Share by which a number of the told line may differ from the factor."""
MOVES = 0.05
"""RMS of a channel that tells its unit: of a base that does not move in a direction, its velocity
tells none."""


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    seed: int
    """Seed of robots, noise, channels and factors."""
    logs: int = 60
    """Number of logs; each is looked at right, and with one channel wrong."""
    whole: int = 6
    """Number of logs, spread over all, of which the whole of `find_in_logs` is asked for the wrong
    one, not the screen alone."""
    out: Path = Path("runs/units")
    """Folder that keeps what was found."""

    def measure(self) -> dict[str, Any]:
        self.out.mkdir(parents=True, exist_ok=True)
        asked = set(np.linspace(0, self.logs - 1, self.whole).astype(int).tolist())
        rows = []
        for number in progress(range(self.logs)):
            done = self.out / f"{self.seed}_{number}.json"
            if not done.exists():
                row = _looked_at(self.seed, number, number in asked)
                done.write_text(json.dumps(row), encoding="utf-8")
                tell(json.dumps(row))
            rows.append(json.loads(done.read_text(encoding="utf-8")))
        return {
            "logs": len(rows),
            "told_by_channel_and_factor": sum(row["is_told"] for row in rows),
            "outcomes": dict(Counter(row["outcome"] for row in rows)),
            "explained_by_an_effect": sum(bool(row["effects"]) for row in rows),
            "right_ones_accused": sum(bool(row["accused"]) for row in rows),
            "not_told": [row for row in rows if not row["is_told"] or row["accused"]],
        }


def _looked_at(seed: int, number: int, is_whole: bool) -> dict[str, Any]:
    rng = np.random.default_rng([seed, number])
    experiment = list(EXPERIMENTS.values())[number % len(EXPERIMENTS)]
    strength = round(float(rng.uniform(*STRENGTH)), 3) if number % WEAK_EVERY == 0 else 1.0
    profile = IDEAL if strength == 1.0 else IDEAL.having(TorqueGain(gain=strength))
    log = run_experiment(experiment, load_robot(DEFAULT_ROBOT), profile, seed=seed + number)
    names = [name for name in FACTORS if _is_there(log, name)]
    channel = names[int(rng.integers(len(names)))]
    factor = float(rng.choice(FACTORS[channel]))
    wrong = in_another_unit(log, channel, factor)
    lines = [fault.text for fault in screen_log(wrong) if fault.is_fatal]
    row: dict[str, Any] = {
        "experiment": experiment.name, "strength": strength, "channel": channel, "factor": factor,
        "accused": [fault.text for fault in screen_log(log) if fault.is_fatal],
        "outcome": "bad_log" if lines else "passed",
        "effects": [],
    }  # fmt: skip
    if is_whole:
        with tempfile.TemporaryDirectory() as folder:
            write_run_log(wrong, Path(folder) / "log")
            verdict = find_in_logs(
                [Path(folder) / "log"], Path(folder) / "out", report=False
            ).verdict
        row |= {"outcome": verdict.verdict, "effects": [effect.name for effect in verdict.effects]}
        lines = list(verdict.log_faults) if verdict.verdict == "bad_log" else []
    return {**row, "is_told": is_told(lines, channel, factor), "said": lines[:2]}


def is_told(lines: Sequence[str], channel: str, factor: float) -> bool:
    """True where the first line names a channel and its factor."""
    if not lines or not re.search(rf"\b{channel}\b", lines[0]):
        return False
    numbers = [float(number) for number in re.findall(r"-?\d+\.?\d*(?:e[-+]?\d+)?", lines[0])]
    return any(abs(number / factor - 1.0) < NEAR for number in numbers)


def _is_there(log: RunLog, channel: str) -> bool:
    """True where a log has a channel, and it moves."""
    if channel in ("t", "depth"):
        return channel == "t" or log.depth is not None
    signal = SIGNALS[channel]
    if signal.table == "joints":
        values = getattr(log.joints, channel)
        return values is not None and bool(np.std(values, axis=0).max() > MOVES)
    table = getattr(log, signal.table)
    return table is not None and bool(
        np.std(table.values[:, slice(*signal.columns)], axis=0).max() > MOVES
    )


def in_another_unit(log: RunLog, channel: str, factor: float) -> RunLog:
    """The log with all of a channel multiplied; depth is cut to what 16 bits hold."""
    if channel == "t":
        return replace(log, joints=replace(log.joints, time_s=factor * log.joints.time_s))
    if channel == "depth":
        assert log.depth is not None
        steps = np.clip(np.rint(factor * log.depth.depth_mm.astype(np.float64)), 0, 65535).astype(
            np.uint16
        )
        return replace(log, depth=replace(log.depth, depth_mm=steps))
    signal = SIGNALS[channel]
    if signal.table == "joints":
        return replace(
            log, joints=replace(log.joints, **{channel: factor * getattr(log.joints, channel)})
        )
    table = getattr(log, signal.table)
    values = table.values.copy()
    values[:, slice(*signal.columns)] *= factor
    return replace(log, **{signal.table: replace(table, values=values)})
