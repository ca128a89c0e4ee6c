"""Verdicts of `find` on logs of robots that jump,
each with one effect on all joints, and on the same without it.

Of each log, a run without the effect comes first: what `find` says it could have told there, times
1 to 3 as the seed has it, is the size that is hidden. Of latency that is 10 ms at least, the tick
in which images arrive, and of pitch 1 mrad: `find` leaves out pixels at edges, which promise more.
Logs go on where they were left when --out names a folder that was begun before.

    saltus bench jumping_logs -- --first-seed 100 --out runs/jumps
"""

import json
from collections import Counter
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._command import Command, progress, tell
from benchmarks.moving_logs import TERRAINS, jumped, searched
from saltus.constants import POLICY_DT
from saltus.effects.profile import EFFECTS, IDEAL

HIDDEN = (
    ("camera_latency", "latency"),
    ("camera_pitch", "offset"),
    ("actuator_lag", "time_constant"),
    ("torque_gain", "gain"),
    ("payload_mass", "mass"),
    ("coulomb_friction", "torque"),
    ("imu_bias", "gyro_x"),
    ("viscous_friction", "coefficient"),
)
"""Effects and the parameter that is hidden.

Friction of joints is dry in one round, viscous in the next.
"""
LEAST = {"camera_latency": POLICY_DT, "camera_pitch": 1e-3}
ROUNDS = 7
LARGEST = 3.0
"""Times what a log can tell."""


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    logs: int = 28
    """Number of logs with an effect."""
    first_seed: int = 0
    """First seed of the first run; each log has its own."""
    out: Path = Path("runs/jumping_logs")
    """Folder that keeps logs and what was found."""

    def measure(self) -> dict[str, Any]:
        rows = []
        for number in progress(range(self.logs)):
            done = self.out / f"{self.first_seed + number}.json"
            if not done.exists():
                row = self._found(number)
                done.write_text(json.dumps(row), encoding="utf-8")
                tell(json.dumps(row))
            rows.append(json.loads(done.read_text(encoding="utf-8")))
        ideal = Counter(row["ideal"] for row in rows)
        outcome = Counter(row["outcome"] for row in rows)
        return {
            "ideal": dict(ideal),
            "hidden": dict(outcome),
            "right_share": outcome["right"] / len(rows),
            "longest_s": max(row["seconds"] for row in rows),
            "not_right": [row for row in rows if row["outcome"] != "right"],
        }

    def _found(self, number: int) -> dict[str, Any]:
        seed, terrain = self.first_seed + number, TERRAINS[number % len(TERRAINS)]
        name, parameter = _hidden(number)
        ideal, log = self.out / f"{seed}_ideal", self.out / f"{seed}_{name}"
        if not ideal.exists():
            jumped(terrain, seed, ideal)
        before = searched(ideal, self.out / "found" / ideal.name)
        verdict = json.loads(
            (self.out / "found" / ideal.name / "verdict.json").read_text(encoding="utf-8")
        )
        value = _value(
            name,
            parameter,
            verdict["minimum_detectable"][name]["value"],
            np.random.default_rng(seed),
        )
        if not log.exists():
            _write(terrain, seed, log, name, {parameter: value})
        after = searched(log, self.out / "found" / log.name)
        return {
            "log": log.name,
            "terrain": terrain,
            "value": value,
            "ideal": before["verdict"],
            "outcome": _outcome(name, after),
            **after,
        }


def _hidden(number: int) -> tuple[str, str]:
    name, parameter = HIDDEN[number % ROUNDS]
    is_friction = name == "coulomb_friction"
    return HIDDEN[-1] if is_friction and (number // ROUNDS) % 2 else (name, parameter)


def _value(name: str, parameter: str, told: float, rng: np.random.Generator) -> float:
    """Returns what is hidden, where a log could tell `told`."""
    null = next(
        field.metadata["null"] for field in fields(EFFECTS[name]) if field.name == parameter
    )
    null = null if isinstance(null, int | float) and np.isfinite(null) else 0.0
    least = max(abs(told - null), LEAST.get(name, 0.0))
    signed = name in ("torque_gain", "camera_pitch", "imu_bias") and rng.random() < 0.5
    return float(null + (-1.0 if signed else 1.0) * least * rng.uniform(1.0, LARGEST))


def _write(terrain: str, seed: int, folder: Path, name: str, values: dict[str, float]) -> None:
    """Runs a robot with an effect, which its log does not claim."""
    effect = EFFECTS[name](**values)
    profile = folder.with_suffix(".toml")
    profile.write_text(IDEAL.having(effect).to_toml(), encoding="utf-8")
    part = folder.with_suffix(".part")
    jumped(terrain, seed, part, str(profile))
    meta = json.loads((part / "meta.json").read_text(encoding="utf-8"))
    meta["camera"]["latency"] = 0.0
    (part / "meta.json").write_text(json.dumps(meta), encoding="utf-8")
    part.rename(folder)


def _outcome(name: str, found: dict[str, Any]) -> str:
    """right: named, or in a set; wrong: something else is named; else the verdict."""
    named = set(found["effects"])
    in_set = any(name in members for members in found["sets"])
    if named - {name}:
        return "wrong"
    return "right" if named or in_set else found["verdict"]
