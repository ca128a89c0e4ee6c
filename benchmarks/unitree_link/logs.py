"""Logs of a simulated Go2 with one hidden effect, made and read as those of a real one: over DDS.

The robot, its recorder and the program that moves it are processes of their own: `robot simulate
--held --profile`, `robot log` and `robot run --stage joint_tour`, in lockstep; then `real2sim
import` and `find`. Nothing but the recording goes from one side to the other.
"""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from saltus.robots.robot import JOINTS

STAGE = "joint_tour"
KNEES = tuple(joint.endswith("calf") for joint in JOINTS)
HIDDEN = (
    ("command_delay", "delay", 0.003, 0.010),
    ("actuator_lag", "time_constant", 0.004, 0.012),
    ("velocity_filter", "time_constant", 0.004, 0.012),
    ("velocity_scale", "scale", 1.08, 1.25),
    ("torque_gain", "gain", 0.75, 0.90),
    ("torque_gain", "gain at the knees", 0.60, 0.85),
    ("viscous_friction", "coefficient", 0.15, 0.60),
    ("coulomb_friction", "torque", 0.20, 0.80),
    ("stiction", "breakaway", 0.60, 1.50),
    ("backlash", "width", 0.015, 0.040),
    ("armature", "added", 0.003, 0.010),
    ("encoder_bias", "bias", 0.015, 0.050),
)  # fmt: skip
"""Effect, its parameter, and between what its size is drawn: three to ten times what is usual of
hardware of this class (docs/reference/effects.md); smaller ones no log of 45 s shows."""
PATIENCE_S = 3600.0
TO_COME_S = 60.0


def hidden(number: int, seed: int) -> tuple[str, dict[str, Any]]:
    """Name and parameters of the effect of a log."""
    name, parameter, low, high = HIDDEN[number % len(HIDDEN)]
    size = float(np.random.default_rng([seed, number]).uniform(low, high))
    if parameter.endswith("knees"):
        return name, {parameter.split()[0]: [size if knee else 1.0 for knee in KNEES]}
    return name, {parameter: size}


def found(number: int, seed: int, out: Path, domain: int) -> dict[str, Any]:
    """Hides the effect of a log, makes the log where it is not there yet,
    and looks for the effect.
    """
    effect, parameters = hidden(number, seed)
    folder = out / f"{seed}_{number:02d}"
    log, names = folder / "log.mcap", folder / "run_log"
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "run.txt").exists():
        log.unlink(missing_ok=True)
        profile = folder / "hidden.toml"
        profile.write_text(tomli_w.dumps({"actuator": {effect: parameters}}), encoding="utf-8")
        told = _recorded(profile, log, domain, seed + number)
        (folder / "run.txt").write_text(told, encoding="utf-8")
    held = folder / "held.toml"
    held.write_text('[claims]\nbase = "fixed"\n', encoding="utf-8")
    _saltus(
        "real2sim", "import", str(log), "--robot", "go2", "--description", str(held),
        "--out", str(names),
    )  # fmt: skip
    verdict = _saltus(
        "real2sim", "find", str(names), "--out", str(folder / "found"), "--no-report", "--json",
        ends=(0, 1),  # 1 where the log contradicts itself
    )  # fmt: skip
    return {"effect": effect, **parameters, **_judged(effect, json.loads(verdict.splitlines()[-1]))}


def _judged(effect: str, verdict: dict[str, Any]) -> dict[str, Any]:
    named = sorted({each["name"] for each in verdict["effects"]})
    sets = [sorted(names) for names in verdict["sets"]]
    right = named == [effect] or (not named and len(sets) == 1 and effect in sets[0])
    wrong = any(name != effect for name in named) or any(effect not in names for names in sets)
    return {
        "outcome": "right" if right else "wrong" if wrong else "nothing",
        "verdict": verdict["verdict"], "named": named, "sets": sets,
        "nearest": [each["name"] for each in verdict["nearest"]],
        "closed": None if verdict["gap"] is None else round(verdict["gap"]["closed"], 3),
    }  # fmt: skip


def _recorded(profile: Path, log: Path, domain: int, seed: int) -> str:
    """Lets a robot with a profile make the motion, and records it; returns what the mover told."""
    where = ("--domain", str(domain))
    paced = (*where, "--pace", "lockstep")
    with (
        _running("simulate", *paced, "--held", "--profile", str(profile), "--seed", str(seed)),
        _running("log", *where, "--out", str(log)),
    ):
        return _saltus("robot", "run", *paced, "--stage", STAGE, "--begin")


@contextlib.contextmanager
def _running(*command: str) -> Iterator[None]:
    """A command of `saltus robot` that has said that it goes on."""
    with subprocess.Popen(
        _line("robot", *command), stdout=subprocess.PIPE, encoding="utf-8", env=_environment()
    ) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            yield
        finally:
            process.terminate()
            process.communicate(timeout=TO_COME_S)


def _saltus(*command: str, ends: tuple[int, ...] = (0,)) -> str:
    process = subprocess.run(
        _line(*command), stdout=subprocess.PIPE, encoding="utf-8", timeout=PATIENCE_S,
        env=_environment(), check=False,
    )  # fmt: skip
    if process.returncode not in ends:
        raise subprocess.CalledProcessError(process.returncode, command)
    return process.stdout


def _line(*command: str) -> list[str]:
    return [sys.executable, "-P", "-m", "saltus.cli.main", *command]


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONUTF8": "1"}
