"""Scores of a predictor of heights, and whether it says so where it is worth nothing.

Runs on courses, each family by itself and with another policy; on the README's courses, for how
often the service says DEGRADED; in scenes unlike any course, of which nothing is trained on; and
two images of a real D435 that looks at a desk. Cameras are those of `saltus heightmap eval`, policy
and predictor are in the loop. Batches of runs go on where they were left when --out names a file
that was begun before.

    saltus bench heights -- --other-policy runs/other/policy.onnx --out runs/heights.jsonl
    saltus bench heights -- --sets desk --bag desk.bag
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from tqdm import tqdm

from benchmarks._command import Command
from benchmarks._scenes import SCENES, scene
from benchmarks.hard_courses import PAPER_COURSES
from saltus.arrays import Floats
from saltus.depth_camera import load_camera
from saltus.errors import ConfigError
from saltus.flags import flag_help
from saltus.folders import ask_for_room
from saltus.grid import DEFAULT_GRID
from saltus.heightmap.evaluation.held_out import HARD, NETWORK, HeldOutRun, HeldOutRuns
from saltus.heightmap.evaluation.visibility import UNSEEN, VIEWS
from saltus.heightmap.level_robot import LevelRobot
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.replay import replay_predictor
from saltus.heightmap.service.service import HeightmapService
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.terrain.curriculum import FAMILIES, make_terrain
from saltus.terrain.terrain import Terrain
from saltus.used_networks import model_id, model_path
from saltus.wire.messages import DepthFrame, HeightmapStatus
from saltus.wire.topics import CAMERA_LATENCY_S, CAMERA_PERIOD_S
from saltus.workers import in_order

POLICY, HEIGHTMAP = model_path("policy"), model_path("heightmap")
WIDTHS_M = np.geomspace(1e-4, 1.0, 401)
"""Ends of the bins in which halves of intervals are counted: their medians are right to 2.3 %."""
DESK_S = 2.0
PITCHES_DEG = (20.0, 30.0, 40.0)
DROP_M = 0.2
"""Below the ground that the robot stands on."""
SetName = Literal["courses", "other policy", "readme", "scenes", "desk"]


@dataclass(frozen=True, kw_only=True)
class ReadmeRuns(HeldOutRuns):
    """The README's courses in turn."""

    def courses(self, rng: np.random.Generator, count: int) -> list[tuple[str, Terrain]]:
        """See `HeldOutRuns`."""
        del rng  # all are given
        made = [replace(make_terrain(course), kind=name) for name, course in PAPER_COURSES.items()]
        return [(HARD, made[i % len(made)]) for i in range(count)]


@dataclass(frozen=True, kw_only=True)
class SceneRuns(HeldOutRuns):
    """Scenes in turn, each drawn anew."""

    def courses(self, rng: np.random.Generator, count: int) -> list[tuple[str, Terrain]]:
        """See `HeldOutRuns`."""
        names = list(SCENES)
        return [(HARD, scene(names[i % len(names)], rng)) for i in range(count)]


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    heightmap_model: Annotated[Path, flag_help("PATH", "the shipped model")] = HEIGHTMAP
    """ONNX file of the predictor."""
    policy_model: Annotated[Path, flag_help("PATH", "the shipped policy")] = POLICY
    """ONNX file of the policy that drives every other batch.

    The scripted planner drives the rest.
    """
    other_policy: Annotated[Path | None, flag_help("PATH", "none")] = None
    """ONNX file of a policy that the predictor has not met; it drives all batches of its set."""
    sets: tuple[SetName, ...] = ("courses", "other policy", "readme", "scenes", "desk")
    """Which runs."""
    runs: int = 200
    """In each set."""
    seed: int = 0
    """Seed of courses, trials and cameras."""
    bag: Annotated[Path | None, flag_help("FILE", "none")] = None
    """Recording of a RealSense camera that stands before a desk."""
    processes: Annotated[int | None, flag_help("INT", "one for each core")] = None
    """How many share the runs."""
    out: Annotated[Path | None, flag_help("FILE", "none")] = None
    """File that keeps the batches, one a line; those that it holds are not run again."""

    def __post_init__(self) -> None:
        super().__post_init__()
        robot = load_camera("d435i").mounted_on(load_robot(DEFAULT_ROBOT))
        HeightmapNetwork(robot, self.heightmap_model)  # what is wrong with it is said at once
        for path in (self.other_policy, self.bag):
            if path is not None and not path.is_file():
                raise ConfigError(f"there is no file {path}")
        if self.out is not None:
            ask_for_room(self.out.parent)

    def measure(self) -> dict[str, Any]:
        """Runs the batches that --out lacks, and makes the tables of all that were asked for."""
        known = {} if self.out is None or not self.out.exists() else _read(self.out)
        tasks = {key: task for name in self.sets for key, task in self._tasks(name).items()}
        missing = {key: task for key, task in tasks.items() if key not in known}
        with tqdm(total=sum(runs.work for runs, _ in missing.values()), disable=None) as bar:
            counts = in_order(
                partial(count, self.heightmap_model),
                list(missing.values()),
                self.processes,
                bar.update,
            )
            for key, found in zip(missing, counts, strict=True):
                known[key] = found
                if self.out is not None:
                    with self.out.open("a", encoding="utf-8") as file:
                        file.write(json.dumps({"key": key, "counts": found}) + "\n")
        tables: dict[str, Any] = {
            name: table([known[key] for key in tasks if key[0] == name])
            for name in self.sets
            if name != "desk"
        }
        if self.bag is not None and "desk" in self.sets:
            from saltus.recordings.realsense import read_realsense

            tables["desk"] = desk_rows(self.heightmap_model, list(read_realsense(self.bag)))
        return {"model": model_id(self.heightmap_model.read_bytes()), "seed": self.seed, **tables}

    def _tasks(self, name: SetName) -> dict[tuple[Any, ...], tuple[HeldOutRuns, tuple[int, int]]]:
        """Batches of a set, by what they follow from."""
        if name == "desk" or (name == "other policy" and self.other_policy is None):
            return {}
        policy = self.other_policy if name == "other policy" else self.policy_model
        kinds = {
            "courses": HeldOutRuns,
            "other policy": HeldOutRuns,
            "readme": ReadmeRuns,
            "scenes": SceneRuns,
        }
        runs = kinds[name](
            robot=DEFAULT_ROBOT, grid=DEFAULT_GRID, runs=self.runs, seed=self.seed, policy=policy,
            terrains=tuple(FAMILIES), baselines=(), statuses=name in ("readme", "scenes"),
        )  # fmt: skip
        # Policies drive the batches of even number.
        step = 2 if name in ("other policy", "readme") else 1
        ids = [
            model_id(path.read_bytes())
            for path in (self.heightmap_model, policy)
            if path is not None
        ]
        return {
            (name, *ids, self.seed, step * i, size): (runs, (step * i, size))
            for i, size in runs.batches
        }


def count(model: Path, task: tuple[HeldOutRuns, tuple[int, int]]) -> dict[str, Any]:
    """Runs a batch: of each terrain, in steps with which the service is content and in others,
    what `_counted` says.
    """
    runs, batch = task
    found: dict[str, Any] = {}
    for run in runs.measure(model, batch):
        of_terrain = found.setdefault(run.terrain, {"ok": _nothing(), "other": _nothing()})
        ok = (
            np.ones(len(run.view), np.bool_)
            if run.status is None
            else run.status == HeightmapStatus.OK
        )
        for name, chosen in (("ok", ok), ("other", ~ok)):
            of_terrain[name] = _added(of_terrain[name], _counted(run, chosen))
    return found


def table(batches: list[dict[str, Any]]) -> dict[str, Any]:
    """Table of each terrain and of all, the figures of this benchmark."""
    rows: dict[str, Any] = {}
    for batch in batches:
        for terrain, parts in batch.items():
            for name in (terrain, "all"):
                row = rows.setdefault(name, {"ok": _nothing(), "other": _nothing()})
                rows[name] = {part: _added(row[part], parts[part]) for part in row}
    return {
        name: _figures(rows[name]) for name in sorted(rows, key=lambda name: (name != "all", name))
    }


def _nothing() -> dict[str, Any]:
    views = [0.0] * len(VIEWS)
    return {
        "steps": 0,
        "points": views,
        "error_m": views,
        "covered": views,
        "widths": [0] * (len(WIDTHS_M) + 1),
    }


def _counted(run: HeldOutRun, chosen: Any) -> dict[str, Any]:
    """Sums over some steps of a run: of steps, by view of points,
    errors [m], points in their interval; widths.
    """
    said = run.predictions[NETWORK]
    error, width, view = (
        np.abs(said.height - run.true_height)[chosen],
        said.half_width_90[chosen],
        run.view[chosen],
    )

    def by_view(values: Floats) -> list[float]:
        return [float(values[view == number].sum()) for number in range(len(VIEWS))]

    return {
        "steps": int(chosen.sum()),
        "points": by_view(np.ones_like(error)),
        "error_m": by_view(error),
        "covered": by_view((error <= width).astype(np.float64)),
        "widths": np.bincount(
            np.searchsorted(WIDTHS_M, width.ravel()), minlength=len(WIDTHS_M) + 1
        ).tolist(),
    }


def _added(left: dict[str, Any], right: dict[str, Any]) -> dict[str, Any]:
    return {name: (np.array(left[name]) + right[name]).tolist() for name in left}


def _figures(parts: dict[str, Any]) -> dict[str, Any]:
    """Errors [mm] and shares [%] of all steps.

    Of those with which the service is content also the interval.
    """
    every, ok = _added(parts["ok"], parts["other"]), parts["ok"]
    seen = np.arange(len(VIEWS)) != UNSEEN
    points, error, covered = (np.array(every[name]) for name in ("points", "error_m", "covered"))
    return {
        "steps": every["steps"],
        "seen_mm": _share(1e3, error[seen], points[seen]),
        "unseen_mm": _share(1e3, error[~seen], points[~seen]),
        "covered_%": _share(1e2, covered, points),
        "covered_unseen_%": _share(1e2, covered[~seen], points[~seen]),
        "ok_%": _share(1e2, np.array(ok["steps"]), np.array(every["steps"])),
        "ok_covered_%": _share(1e2, np.array(ok["covered"]), np.array(ok["points"])),
        "ok_median_half_width_mm": _median_mm(np.array(ok["widths"])),
    }


def _share(factor: float, part: Floats, whole: Floats) -> float | None:
    return round(factor * float(part.sum() / whole.sum()), 2) if whole.sum() else None


def _median_mm(counts: Floats) -> float | None:
    """The end of the bin in which the median lies."""
    if not counts.sum():
        return None
    place = int(np.searchsorted(np.cumsum(counts), 0.5 * counts.sum()))
    return round(1e3 * float(WIDTHS_M[min(place, len(WIDTHS_M) - 1)]), 2)


def desk_rows(model: Path, frames: Sequence[DepthFrame]) -> dict[str, Any]:
    """Rows of images, repeated for `DESK_S`, by how far the camera is taken to look down:
    drops that are stated.

    Points that are stated to be over `DROP_M` below the robot's feet are counted from the model's
    warm-up on.
    """
    network = HeightmapNetwork(load_robot(DEFAULT_ROBOT), model)
    period_ns, tick_ns = round(1e9 * CAMERA_PERIOD_S), round(0.5e9 * CAMERA_PERIOD_S)
    images = [
        replace(frames[i % len(frames)], time_ns=i * period_ns, frame_id=i)
        for i in range(round(DESK_S / CAMERA_PERIOD_S))
    ]
    ticks = [replace(images[0], time_ns=i * tick_ns) for i in range(2 * len(images))]
    arrival_ns = [image.time_ns + round(1e9 * CAMERA_LATENCY_S) for image in images]
    rows = {}
    for pitch in PITCHES_DEG:
        states = LevelRobot(camera_pitch_deg=pitch).states(network.robot, ticks)
        answers = replay_predictor(HeightmapService(network), images, states, arrival_ns)
        settled = [answer for answer in answers if answer.status == HeightmapStatus.OK]
        height, width = (
            np.array([getattr(a, name) for a in settled]) for name in ("height", "half_width_90")
        )
        drops = width[height < -network.robot.stand_height - DROP_M] if settled else np.empty(0)
        rows[f"{pitch:g} deg"] = {
            "ok_%": round(100.0 * len(settled) / len(answers), 1),
            "points": int(height.size),
            "drops": len(drops),
            "least_half_width_mm": round(1e3 * float(drops.min()), 1) if len(drops) else None,
            "drops_over_0.1_m_%": round(100.0 * float((drops >= 0.1).mean()), 1)
            if len(drops)
            else None,
        }
    return rows


def _read(path: Path) -> dict[tuple[Any, ...], Any]:
    try:
        lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        return {tuple(line["key"]): line["counts"] for line in lines}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{path} holds no batches of this benchmark: name another file with --out"
        ) from error
