"""Measures a predictor in runs that no training saw, with policy and predictor in the loop.

Half of the courses have sizes that both planners master, half are drawn as in training, up to the
paper's, on which the scripted planner falls. Cameras have errors of different strength. Steps count
from the first that is not standing to the end of the run, however it ends.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Reals
from saltus.config import PlannerName, TerrainConfig, check_between
from saltus.depth import MODEL_CAMERA, depth_frame
from saltus.effects.camera import drawn_around
from saltus.effects.profile import SHIPPED
from saltus.errors import ConfigError, check_known
from saltus.heightmap.data.closed_loop import random_course
from saltus.heightmap.data.delivery import TICK_S, TRAINING
from saltus.heightmap.data.predicted import PredictedHeights, predicted_heights
from saltus.heightmap.data.scan_heights import ScanHeights
from saltus.heightmap.evaluation.comparison import BASELINES
from saltus.heightmap.evaluation.distance_travelled import DistanceTravelled
from saltus.heightmap.evaluation.geometric import GeometricHeightmap
from saltus.heightmap.evaluation.visibility import visibility
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.replay import HeightPredictor, replay_predictor
from saltus.heightmap.service.service import HeightmapService
from saltus.loop.heights import true_heights
from saltus.loop.loop import STAND_STEPS, Loop, Moment
from saltus.named_setup import named_setups
from saltus.policy.planner import make_planner
from saltus.render.randomisation import drawn_cameras
from saltus.render.stereo.camera import StereoConfig
from saltus.robots.mount import Mount
from saltus.setup import Setup
from saltus.states import robot_state_message
from saltus.terrain.course_law import PAPER
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain
from saltus.trial import Trial
from saltus.wire.messages import ControllerMode, Heightmap
from saltus.workers import tell_progress

MASTERED, HARD = "mastered", "hard"
HARDEST = 0.8  # as in training: stairs of 0.25 m, a step of 0.64 m, a gap of 0.89 m
ROBOTS = 20  # in a batch
FIRST_SEED = (
    3_000_000_000  # above those of policy evaluations, below those that data are drawn from (2**32)
)
LAST_SEED = 6000  # of the runs: each has 200,000 seeds of trials
ROBOT_WORK = 50
"""Steps of a batch that take as long as measuring one robot of it."""
NETWORK = "network"
_NS = 1e9


@dataclass(frozen=True, kw_only=True)
class HeldOutRuns:
    """Which held-out runs a predictor is measured in: terrains, seeds and their number.

    Raises:
        ConfigError: no runs, none that counts, or a baseline that is not known.
    """

    robot: str
    """Their kind: a robot that Saltus ships, or a path."""
    grid: str
    """Grid of the heights: a name, or a path."""
    runs: int = 200
    seed: int = 0
    camera: str = "d435i"
    """Name or TOML file; the errors of a stereo camera have another strength in each run."""
    terrains: tuple[str, ...] = PAPER
    """Families of the courses in turn, mastered and hard.

    Those that the paper does not have are all called hard.
    """
    policy: Path | None = None
    """ONNX file of the learned policy; by default the shipped one."""
    baselines: tuple[str, ...] = tuple(BASELINES)
    """Predictors that are shown the same images."""
    time_limit_s: float = 10.0
    """Time limit of a run: at 1.2 m/s any course is behind a robot that still runs."""
    statuses: bool = False
    """True to ask the heightmap service of each robot for its status, too: it takes twice as
    long."""

    def __post_init__(self) -> None:
        stands_s = STAND_STEPS * TICK_S
        if not self.time_limit_s > stands_s:
            raise ConfigError(
                f"time_limit_s = {self.time_limit_s:g}: a robot only stands for the first "
                f"{stands_s:g} s"
            )
        check_between(self, runs=(1, 10**6), seed=(0, LAST_SEED), time_limit_s=(stands_s, 3600.0))
        for name in self.baselines:
            check_known("unknown baseline", name, BASELINES)

    @property
    def batches(self) -> list[tuple[int, int]]:
        """Number and size of each batch."""
        return [
            (i, min(ROBOTS, self.runs - first))
            for i, first in enumerate(range(0, self.runs, ROBOTS))
        ]

    @property
    def work(self) -> int:
        """Work that `measure` tells of a batch, see `saltus.workers.tell_progress`:
        steps, then robots that are measured.
        """
        return math.ceil(self.time_limit_s / TICK_S) + 1 + ROBOTS * ROBOT_WORK

    def courses(self, rng: np.random.Generator, count: int) -> list[tuple[str, Terrain]]:
        """Level and course of each robot of a batch."""
        some = [
            held_out_course(rng, i, self.terrains)
            for i in range(min(2 * len(self.terrains), count))
        ]
        terrains = [make_terrain(some[i % len(some)][1]) for i in range(count)]
        return [(some[i % len(some)][0], terrain) for i, terrain in enumerate(terrains)]

    def measure(self, model: Path, batch: tuple[int, int]) -> list["HeldOutRun"]:
        """Runs one of `batches`; it follows from the seed and the model alone."""
        number, count = batch
        rng = np.random.default_rng([self.seed, number])
        levels, terrains = zip(*self.courses(rng, count), strict=True)
        planner: PlannerName = "learned" if number % 2 == 0 else "scripted"
        seeds = FIRST_SEED + ROBOTS * (10_000 * self.seed + number) + np.arange(count)
        trials = [Trial.draw(int(seed)) for seed in seeds]
        setups = named_setups(self.robot, self.grid, self.camera, SHIPPED, terrains, trials)
        robot, ticks = setups[0].robot, list[_Tick]()
        source = _source(model, rng, setups)
        loop = Loop(
            setups,
            make_planner(
                planner, robot, setups[0].grid, self.policy if planner == "learned" else None
            ),
            heights=source,
            time_limit_s=self.time_limit_s,
        )
        for moment in loop.run():
            depth = None if source.given is None else source.given.depth
            said = {"height": moment.heights, "half_width_90": source.half_width_90}
            ticks.append(_Tick(moment=moment, depth=depth, captured_s=source.captured_s, **said))
            tell_progress(1)
        tell_progress(self.work - ROBOTS * ROBOT_WORK - len(ticks))
        measured = []
        for i, setup in enumerate(setups):
            measured.append(_measured(self, model, ticks, i, setup, levels[i]))
            tell_progress(ROBOT_WORK)
        tell_progress(ROBOT_WORK * (ROBOTS - count))
        return measured


def _source(
    model: Path, rng: np.random.Generator, setups: Sequence[Setup]
) -> PredictedHeights | ScanHeights:
    """Heights of robots whose cameras lose images and,
    where they are not ideal, have errors of different strength.
    """
    camera, profile = setups[0].camera, setups[0].profile
    profile = replace(
        profile, camera=drawn_around(profile.camera, loss=rng.uniform(0.0, TRAINING.loss))
    )
    errors = None if camera.ideal else drawn_cameras(len(setups), rng, StereoConfig.of(camera))
    rngs = None if camera.ideal else rng.spawn(len(setups))
    # No effect of the evaluation moves the camera: it sits where the service is told that it does
    placed = replace(camera, mount_error=0.0)
    return predicted_heights(
        model, [replace(setup, profile=profile, camera=placed) for setup in setups], errors, rngs
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class HeldOutPrediction:
    """Prediction of one predictor in one run, at each step that counts."""

    height: Floats
    """[m], shape (n, 30)."""
    half_width_90: Floats
    """Half of the 90 % interval [m], shape (n, 30)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeldOutRun:
    """One held-out run and its true heights, n steps of which count."""

    terrain: str
    level: str
    """`MASTERED` or `HARD`."""
    x: Floats
    """Place of each point ahead of the base [m], shape (30,)."""
    true_height: Floats
    """[m], shape (n, 30)."""
    view: NDArray[np.int8]
    """See `saltus.heightmap.evaluation.visibility`, shape (n, 30)."""
    predictions: dict[str, HeldOutPrediction]
    way: DistanceTravelled
    status: NDArray[np.int8] | None = None
    """Status that the heightmap service gives the network's heights, a `HeightmapStatus` each,
    shape (n,); None where it was not asked."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Tick(HeldOutPrediction):
    """Inputs and answers of the services of all robots at one step, shape (robots, 30)."""

    moment: Moment
    captured_s: Floats
    depth: NDArray[np.uint16] | None
    """Taken at this step [mm], shape (robots, 48, 16)."""


def _measured(
    config: HeldOutRuns,
    model: Path,
    ticks: Sequence[_Tick],
    robot: int,
    setup: Setup,
    level: str,
) -> HeldOutRun:
    """Steps that count of one robot's first trial."""
    ticks, terrain = [tick for tick in ticks if tick.moment.running[robot]], setup.terrain
    position = np.array([tick.moment.truth.position_base_in_world[robot] for tick in ticks])
    quaternion = np.array([tick.moment.truth.quaternion_base_in_world[robot] for tick in ticks])
    captured_s = np.array([tick.captured_s[robot] for tick in ticks])
    counted, status = slice(STAND_STEPS, None), None
    replayed = [
        (
            name,
            _replayed(
                GeometricHeightmap(setup.robot, setup.grid, foot_gain=BASELINES[name]), ticks, robot
            ),
        )
        for name in config.baselines
    ]
    if config.statuses:
        network = HeightmapNetwork(setup.robot, model, setup.grid)
        answers = _replayed(HeightmapService(network), ticks, robot)[counted]
        status = np.array([answer.status for answer in answers], np.int8)
    return HeldOutRun(
        terrain=terrain.kind,
        level=level,
        x=setup.grid.points[:, 0],
        true_height=true_heights(terrain, position, quaternion, setup.grid)[counted],
        view=visibility(
            terrain, Mount.of(setup.robot), setup.grid, position, quaternion, captured_s
        )[counted],
        predictions={
            NETWORK: _prediction(
                [tick.height[robot] for tick in ticks],
                [tick.half_width_90[robot] for tick in ticks],
            ),
            **{
                name: _prediction([m.height for m in maps], [m.half_width_90 for m in maps])
                for name, maps in replayed
            },
        },
        way=DistanceTravelled.of(terrain, position),
        status=status,
    )


def _replayed(predictor: HeightPredictor, ticks: Sequence[_Tick], robot: int) -> list[Heightmap]:
    """Answers of a predictor to the images that the robot's network got, when it got them."""
    known = [tick.moment.states for tick in ticks]
    taken: dict[int, NDArray[np.uint16]] = {}
    arrived: dict[int, int] = {}  # step of capture: step of arrival
    for states, tick in zip(known, ticks, strict=True):
        if tick.depth is not None:
            taken[states.step] = tick.depth[robot]
        if np.isfinite(tick.captured_s[robot]):
            arrived.setdefault(round(float(tick.captured_s[robot]) / TICK_S), states.step)
    number = {step: i for i, step in enumerate(taken)}
    frames = [
        depth_frame(MODEL_CAMERA, taken[step], time_ns=step_ns(step), frame_id=number[step])
        for step in arrived
    ]
    messages = [
        robot_state_message(
            states, robot, time_ns=step_ns(states.step), step=states.step, mode=ControllerMode.RUN
        )
        for states in known
    ]
    return replay_predictor(
        predictor, frames, messages, [step_ns(step) for step in arrived.values()]
    )


def _prediction(height: Sequence[Reals], half_width_90: Sequence[Reals]) -> HeldOutPrediction:
    """The prediction of the steps that count, by what was said at every step."""
    said = np.array([height, half_width_90], np.float64)[:, STAND_STEPS:]
    return HeldOutPrediction(height=said[0], half_width_90=said[1])


def step_ns(step: int) -> int:
    """Time of a step of 10 ms since the start of the run [ns]."""
    return round(step * TICK_S * _NS)


def held_out_course(
    rng: np.random.Generator, index: int, kinds: Sequence[str]
) -> tuple[str, TerrainConfig]:
    """Kinds in turn, each at first of a size that is mastered."""
    kind = kinds[index % len(kinds)]
    if index >= len(kinds) or kind not in PAPER:
        return HARD, random_course(rng, HARDEST, kind)
    if kind == "stairs":
        rise, run = float(rng.uniform(0.05, 0.10)), float(rng.uniform(0.25, 0.3))
        return MASTERED, TerrainConfig(terrain=kind, rise_m=rise, run_m=run, steps=14)
    if kind == "stepping_stones":
        return MASTERED, TerrainConfig(
            terrain=kind, stone_m=0.5, gap_m=float(rng.uniform(0.10, 0.20)), steps=8
        )
    if kind == "step":
        return MASTERED, TerrainConfig(terrain=kind, height_m=float(rng.uniform(0.10, 0.22)))
    if kind == "gap":
        return MASTERED, TerrainConfig(terrain=kind, gap_m=float(rng.uniform(0.20, 0.36)))
    return MASTERED, TerrainConfig(terrain=kind)
