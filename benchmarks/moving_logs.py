"""Verdicts of `find_in_logs` on logs of robots that jump, walk and turn,
all without effects, and how soon they come.

Jumps are runs of the whole stack over the terrains; walking and turning are trots of commanded
angles.

    saltus bench moving_logs -- --seeds 0 1 2
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._command import Command, progress, tell
from benchmarks._measuring import recorded_run
from saltus.config import RunConfig, TerrainConfig
from saltus.constants import PHYSICS_DT
from saltus.effects.profile import IDEAL
from saltus.real2sim.experiments.menu import Experiment
from saltus.real2sim.experiments.motions import ExperimentCommands, repeat_motion
from saltus.real2sim.experiments.run import run_experiment
from saltus.real2sim.experiments.safety import ExperimentLimits
from saltus.real2sim.pipeline import find_in_logs
from saltus.recordings.run_log import write_run_log
from saltus.recordings.run_log_export import export_run_log
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.robots.shipped import DEFAULT_ROBOT

TERRAINS: tuple[str, ...] = ("stairs", "stepping_stones", "gap")
PERIOD_S, STANCE, LIFT_M = 0.5, 0.6, 0.06
"""Period, stance and lift of the trot: two steps a second, of which a leg stands more than half, so
that the body never falls far."""
TURN_OF_LEG = np.array([0.0, 0.5, 0.5, 0.0])
"""Legs on a diagonal go together."""
START_S = 1.0
"""A step grows to its length over this time, and shrinks before the end."""


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds of the runs."""
    terrains: tuple[str, ...] = TERRAINS
    """Terrains that are jumped over."""
    logs: Path | None = None
    """Folder that keeps the logs; those that it holds already are not made again."""

    def measure(self) -> dict[str, Any]:
        cases: dict[str, Callable[[Path], object]] = {
            f"{terrain}_{seed}": partial(jumped, terrain, seed)
            for terrain in self.terrains
            for seed in self.seeds
        }
        cases |= {path.name: partial(made, path) for path in (WALK, TURN)}
        results = []
        with tempfile.TemporaryDirectory() as folder:
            for name, make in progress(list(cases.items())):
                log = (self.logs or Path(folder)) / name
                if not log.exists():
                    make(log)
                results.append({"log": name, **searched(log, Path(folder) / "found")})
                tell(f"{name}: {results[-1]}")
        return {"logs": results}


def jumped(terrain: str, seed: int, folder: Path, profile: str = "ideal") -> None:
    """Writes the log of a run; by default without effects."""
    config = RunConfig(
        robot="go1",
        grid="line",
        terrain=TerrainConfig(terrain=terrain),
        seed=seed,
        profile=profile,
        camera="ideal",
    )
    export_run_log(recorded_run(config), folder)


def made(path: Experiment, folder: Path) -> None:
    """Writes the log of a robot that follows a path."""
    write_run_log(run_experiment(path, load_robot(DEFAULT_ROBOT), IDEAL), folder)


def searched(log: Path, out: Path) -> dict[str, Any]:
    """Verdict of `find_in_logs` on a log, and how long it takes."""
    start_s, work_s = time.perf_counter(), time.process_time()
    judgement = find_in_logs([log], out, report=False)
    verdict = judgement.verdict
    return {
        "verdict": verdict.verdict,
        "effects": sorted({effect.name for effect in verdict.effects}),
        "sets": [list(members) for members in verdict.sets],
        "said": list(verdict.log_faults),
        "not_compared": sorted(judgement.not_compared),
        "seconds": round(time.perf_counter() - start_s, 1),
        "cpu_s": round(time.process_time() - work_s, 1),
    }


def trot(
    robot: Robot, duration_s: float, speed_m_s: float = 0.0, turn_rad_s: float = 0.0
) -> ExperimentCommands:
    """Angles of a robot that walks ahead, or turns to the left on the spot."""
    t = PHYSICS_DT * np.arange(round(duration_s / PHYSICS_DT))
    envelope = np.clip(np.minimum(t, duration_s - t) / START_S, 0.0, 1.0)[:, None]
    phase = (t[:, None] / PERIOD_S + TURN_OF_LEG) % 1.0
    swing = np.clip((phase - STANCE) / (1.0 - STANCE), 0.0, 1.0)
    # in parts of a step: from front to back while a leg stands, back to the front in the air
    along = envelope * np.where(phase < STANCE, 0.5 - phase / STANCE, -0.5 * np.cos(np.pi * swing))
    legs = LegKinematics(robot)
    feet = np.asarray(legs.position(robot.stand_pose))
    ahead = np.array([speed_m_s, 0.0, 0.0]) + turn_rad_s * np.stack(
        [-feet[:, 1], feet[:, 0], 0.0 * feet[:, 2]], axis=1
    )
    lift = envelope * LIFT_M * np.sin(np.pi * swing)
    path = (
        feet
        + along[..., None] * STANCE * PERIOD_S * ahead
        + lift[..., None] * np.array([0.0, 0.0, 1.0])
    )
    q_des = np.asarray(legs.inverse(path))
    return ExperimentCommands(
        q_des=q_des, dq_des=np.gradient(q_des, PHYSICS_DT, axis=0), tau_ff=np.zeros_like(q_des)
    )


def _path(name: str, **how: float) -> Experiment:
    return Experiment(
        name=name,
        how=f"a trot: {how}",
        shows=(),
        base="free",
        sections=lambda robot: repeat_motion(name, 2, trot(robot, 6.0, **how)),
        limits=ExperimentLimits(),
    )


WALK, TURN = _path("walk", speed_m_s=0.4), _path("turn", turn_rad_s=0.8)
