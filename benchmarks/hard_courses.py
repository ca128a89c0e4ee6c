"""Success of policies on hard courses and on robots unlike the one they were trained on:
one table, several models.

The paper's courses; stairs of 0.20 m with late commands, on slippery ground, with soft feet, with
joints that resist, with a push from the side; ground that leads down, irregular stairs, ditches,
hurdles and ramps. Trials go on where they were left when --out names a file that was begun before.

    saltus bench hard_courses -- --models models/policy.onnx runs/mine/policy.onnx --trials 50 --out runs/hard.jsonl
"""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from tqdm import tqdm

from benchmarks._command import Command
from saltus.config import TerrainConfig
from saltus.depth_camera import load_camera
from saltus.effects.body import ContactCompliance, SoftFeet
from saltus.effects.delay_line import CommandDelay
from saltus.effects.effect import Effect
from saltus.effects.joint_loads import CoulombFriction, ViscousFriction
from saltus.effects.profile import SHIPPED, load_profile
from saltus.errors import ConfigError, nearest_hint
from saltus.flags import flag_help
from saltus.folders import ask_for_room
from saltus.grid import LINE
from saltus.loop.heights import HeightsFactory
from saltus.policy.evaluation.evaluate import BATCH, HEIGHTS, EvaluationSettings, run_batch
from saltus.policy.planner import make_planner
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.used_networks import model_id, model_path
from saltus.workers import in_order

RUBBER = (
    ContactCompliance(time_constant=0.02),
    SoftFeet(torsion=0.02, rolling=0.01, touch=0.015, depth=0.022),
)
"""As of the feet of MuJoCo Menagerie's Go1."""


@dataclass(frozen=True, kw_only=True)
class CourseRow:
    """One line of the table."""

    course: TerrainConfig
    effects: tuple[Effect, ...] = ()
    """Beyond those of the shipped profile."""
    friction: float | None = None
    push_ns: float = 0.0


PAPER_COURSES = {
    "stairs 0.20": TerrainConfig(terrain="stairs", rise_m=0.20),
    "stairs 0.25": TerrainConfig(terrain="stairs", rise_m=0.25),
    "stones 0.1 to 0.5": TerrainConfig(terrain="stepping_stones", gap_m=0.1, gap_max_m=0.5),
    "gap 0.8": TerrainConfig(terrain="gap", gap_m=0.8),
    "step 0.6": TerrainConfig(terrain="step", height_m=0.6),
}
"""Those of the README."""


def _rows() -> dict[str, CourseRow]:
    stairs = PAPER_COURSES["stairs 0.20"]
    others = {
        "stairs down 0.15": TerrainConfig(terrain="stairs_down", rise_m=0.15),
        "pyramid 0.15": TerrainConfig(terrain="pyramid", rise_m=0.15),
        **{
            f"step down {height}": TerrainConfig(terrain="step_down", height_m=height)
            for height in (0.2, 0.4, 0.6)
        },
        "irregular 0.12 to 0.22": TerrainConfig(terrain="irregular", rise_m=0.22),
        "ditch 0.5": TerrainConfig(terrain="ditch", gap_m=0.5, depth_m=0.15, depth_max_m=1.0),
        "hurdles 0.2": TerrainConfig(terrain="hurdles", height_m=0.2),
        "ramp up 20 deg": TerrainConfig(terrain="ramp_up", slope_deg=20.0),
        "ramp down 20 deg": TerrainConfig(terrain="ramp_down", slope_deg=20.0),
    }
    return {
        **{name: CourseRow(course=course) for name, course in PAPER_COURSES.items()},
        "stairs 0.20, commands 15 ms late": CourseRow(course=stairs,
            effects=(CommandDelay(delay=0.015),)),
        "stairs 0.20, friction 0.35": CourseRow(course=stairs, friction=0.35),
        "stairs 0.20, soft feet": CourseRow(course=stairs, effects=RUBBER),
        "stairs 0.20, joints resist": CourseRow(
            course=stairs, effects=(ViscousFriction(coefficient=0.25), CoulombFriction(torque=0.3))
        ),
        "stairs 0.20, push 15 Ns": CourseRow(course=stairs, push_ns=15.0),
        **{name: CourseRow(course=course) for name, course in others.items()},
    }  # fmt: skip


ROWS = _rows()
POLICY, HEIGHTMAP = model_path("policy"), model_path("heightmap")


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    models: Annotated[tuple[Path, ...], flag_help("PATH ...", "the shipped policy")] = (POLICY,)
    """ONNX files of policies, side by side in the table."""
    rows: tuple[str, ...] = tuple(ROWS)
    """Which rows, by their names."""
    trials: int = 20
    """Trials of each model in each row."""
    first_seed: int = 70_000
    """First seed of the first trial; the others have the next ones."""
    heightmap: Literal["true", "true-exact", "predicted"] = "true"
    """Heights that policies see, as in `saltus policy eval`; predicted: by the heightmap
    service."""
    heightmap_model: Annotated[Path, flag_help("PATH", "the shipped model")] = HEIGHTMAP
    """ONNX file of the heightmap service."""
    camera: str = "d435i"
    """Camera of the heightmap service: a name or a TOML file."""
    processes: Annotated[int | None, flag_help("INT", "one for each core")] = None
    """How many share the trials."""
    out: Annotated[Path | None, flag_help("FILE", "none")] = None
    """File that keeps the trials, one a line; those that it holds are not run again."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for row in self.rows:
            if row not in ROWS:
                raise ConfigError(f"there is no row '{row}': {nearest_hint(row, ROWS)}")
        robot = load_robot(DEFAULT_ROBOT)
        for model in self.models:
            make_planner("learned", robot, LINE, model)  # what is wrong with it is said at once
        if self.heightmap == "predicted":
            from saltus.heightmap.data.predicted import load_predictor  # needs a renderer

            load_predictor(self.heightmap_model, load_camera(self.camera).mounted_on(robot))
        if self.out is not None:
            ask_for_room(self.out.parent)

    def measure(self) -> dict[str, Any]:
        """Runs the trials that --out lacks, and makes the table of all that were asked for."""
        known = {} if self.out is None or not self.out.exists() else _read(self.out)
        seeds = range(self.first_seed, self.first_seed + self.trials)
        tasks = []
        for row in self.rows:
            for model in self.models:
                missing = [seed for seed in seeds if (*self._key(model, row), seed) not in known]
                tasks += [
                    (model, row, missing[i : i + BATCH]) for i in range(0, len(missing), BATCH)
                ]
        with tqdm(total=sum(len(some) for *_, some in tasks), unit="trial", disable=None) as bar:
            results = in_order(
                partial(run, self._heights(), self.camera), tasks, self.processes, bar.update
            )
            for (model, row, _), trials in zip(tasks, results, strict=True):
                known |= {(*self._key(model, row), seed): trial for seed, trial in trials.items()}
                if self.out is not None:
                    _append(self.out, self._key(model, row), trials)
        rows = {}
        for row in self.rows:
            of_models = [
                [known[*self._key(model, row), seed] for seed in seeds] for model in self.models
            ]
            rows[row] = _cells(of_models)
        return {
            "models": {str(i): f"{model} ({_id(model)})" for i, model in enumerate(self.models, 1)},
            "trials": self.trials,
            "first_seed": self.first_seed,
            "heightmap": self.heightmap,
            "rows": rows,
        }

    def _key(self, model: Path, row: str) -> tuple[str, ...]:
        predicted = (
            f" {_id(self.heightmap_model)} {self.camera}" if self.heightmap == "predicted" else ""
        )
        return _id(model), self.heightmap + predicted, row

    def _heights(self) -> HeightsFactory:
        if self.heightmap != "predicted":
            return HEIGHTS[self.heightmap]
        from saltus.heightmap.data.predicted import PredictedHeightsFactory  # needs a renderer

        return PredictedHeightsFactory(model=self.heightmap_model)


def run(
    heights: HeightsFactory, camera: str, task: tuple[Path, str, Sequence[int]]
) -> dict[int, dict[str, Any]]:
    """How trials of a model in a row went, by their seeds."""
    model, name, seeds = task
    row = ROWS[name]
    evaluation = EvaluationSettings(
        robot="go1",
        grid="line",
        camera=camera,
        course=row.course,
        profile=load_profile(SHIPPED, load_robot(DEFAULT_ROBOT)).having(*row.effects),
        friction=row.friction,
        push_ns=row.push_ns,
    )
    results = run_batch(evaluation, heights, partial(make_planner, "learned", model=model), seeds)
    return {seed: {"failure": r.failure, "time_s": r.outcome.time_s} for seed, r in results.items()}


def _cells(models: Sequence[Sequence[dict[str, Any]]]) -> dict[str, Any]:
    """Successes, median time over them [s] and causes of failure of each model."""
    cells: dict[str, Any] = {}
    for i, trials in enumerate(models, 1):
        times = [trial["time_s"] for trial in trials if not trial["failure"]]
        cells[f"success {i}"] = len(times)
        cells[f"time_s {i}"] = round(float(np.median(times)), 2) if times else None
        cells[f"failures {i}"] = dict(
            Counter(trial["failure"] for trial in trials if trial["failure"])
        )
    return cells


def _id(model: Path) -> str:
    return model_id(model.read_bytes())


def _append(path: Path, key: tuple[str, ...], trials: dict[int, dict[str, Any]]) -> None:
    lines = [json.dumps({"key": key, "seed": seed, **trial}) for seed, trial in trials.items()]
    with path.open("a", encoding="utf-8") as file:
        file.write("".join(f"{line}\n" for line in lines))


def _read(path: Path) -> dict[tuple[Any, ...], dict[str, Any]]:
    """Trials by policy, heights, row and seed."""
    try:
        lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        return {(*line.pop("key"), line.pop("seed")): line for line in lines}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(
            f"{path} holds no trials of this benchmark: name another file with --out"
        ) from error
