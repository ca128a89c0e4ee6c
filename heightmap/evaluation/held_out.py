"""Measures a predictor in runs that no training saw, with policy and predictor in the loop.

Half of the courses have sizes that both planners master, half are drawn as in training, up to the paper's, on which
the scripted planner falls. Cameras have errors of different strength. Steps count from the first that is not standing
to the end of the run, however it ends.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.config import PlannerName, TerrainConfig, check_between
from saltus.depth import MODEL_CAMERA, depth_frame
from saltus.depth_camera import load_camera
from saltus.effects.camera import drawn_around
from saltus.effects.profile import SHIPPED, load_profile
from saltus.errors import ConfigError, nearest_hint
from saltus.grid import load_grid
from saltus.heightmap.data.closed_loop import random_course
from saltus.heightmap.data.delivery import TICK_S, TRAINING
from saltus.heightmap.data.predicted import PredictedHeights
from saltus.heightmap.data.robot_cameras import robot_cameras
from saltus.heightmap.data.rollouts import true_heights
from saltus.heightmap.evaluation.comparison import BASELINES
from saltus.heightmap.evaluation.geometric import GeometricHeightmap
from saltus.heightmap.evaluation.visibility import visibility
from saltus.heightmap.evaluation.way import Way
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.replay import Predictor, replay_predictor
from saltus.heightmap.service.service import HeightmapService
from saltus.policy.evaluation.rollout import STAND_STEPS, Rollout, RolloutStep, batch_of
from saltus.policy.planner import make_planner
from saltus.render.randomisation import drawn_cameras
from saltus.render.stereo.camera import StereoConfig
from saltus.robots.loading import load_robot
from saltus.robots.mount import Mount
from saltus.setup import Setup
from saltus.sim.state import PlantState
from saltus.states import RobotStates, state_message
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.law import PAPER
from saltus.terrain.terrain import Terrain
from saltus.trial import Trial
from saltus.wire.messages import ControllerMode, Heightmap
from saltus.workers import tell

MASTERED, HARD = "mastered", "hard"
HARDEST = 0.8  # as in training: stairs of 0.25 m, a step of 0.64 m, a gap of 0.89 m
ROBOTS = 20  # in a batch
FIRST_SEED = 3_000_000_000  # above those of policy evaluations, below those that data are drawn from (2**32)
LAST_SEED = 6000  # of the runs: each has 200,000 seeds of trials
ROBOT_WORK = 50
"""Steps of a batch that take as long as measuring one robot of it."""
NETWORK = "network"
_NS = 1e9


@dataclass(frozen=True, kw_only=True)
class HeldOutRuns:
    """Which runs.

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
    """Families of the courses in turn, mastered and hard; those that the paper does not have are all called hard."""
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
            raise ConfigError(f"time_limit_s = {self.time_limit_s:g}: a robot only stands for the first {stands_s:g} s")
        check_between(self, runs=(1, 10**6), seed=(0, LAST_SEED), time_limit_s=(stands_s, 3600.0))
        for name in self.baselines:
            if name not in BASELINES:
                raise ConfigError(f"unknown baseline '{name}': {nearest_hint(name, BASELINES)}")

    @property
    def batches(self) -> list[tuple[int, int]]:
        """Number and size of each batch."""
        return [(i, min(ROBOTS, self.runs - first)) for i, first in enumerate(range(0, self.runs, ROBOTS))]

    @property
    def work(self) -> int:
        """Work that `measure` tells of a batch, see `saltus.workers.tell`: steps, then robots that are measured."""
        return math.ceil(self.time_limit_s / TICK_S) + 1 + ROBOTS * ROBOT_WORK

    def courses(self, rng: np.random.Generator, count: int) -> list[tuple[str, Terrain]]:
        """Level and course of each robot of a batch."""
        some = [course(rng, i, self.terrains) for i in range(min(2 * len(self.terrains), count))]
        terrains = [make_terrain(some[i % len(some)][1]) for i in range(count)]
        return [(some[i % len(some)][0], terrain) for i, terrain in enumerate(terrains)]

    def measure(self, model: Path, batch: tuple[int, int]) -> list["HeldOutRun"]:
        """Runs one of `batches`; it follows from the seed and the model alone."""
        number, count = batch
        rng = np.random.default_rng([self.seed, number])
        levels, terrains = zip(*self.courses(rng, count), strict=True)
        planner: PlannerName = "learned" if number % 2 == 0 else "scripted"
        seeds = FIRST_SEED + ROBOTS * (10_000 * self.seed + number) + np.arange(count)
        camera, grid, ticks = load_camera(self.camera), load_grid(self.grid), list[_Tick]()
        kind = camera.mounted_on(load_robot(self.robot))
        network, trials = HeightmapNetwork(kind, model), [Trial.draw(int(seed)) for seed in seeds]
        setup = Setup(
            robot=kind, grid=grid, terrain=terrains[0], profile=camera.delivered(load_profile(SHIPPED, kind)),
            camera=camera, trial=trials[0],
        )  # fmt: skip
        rollout = Rollout(
            batch_of(setup, terrains, trials),
            make_planner(planner, kind, grid, self.policy if planner == "learned" else None),
            heights=partial(self._source, network, rng, ticks),
            time_limit_s=self.time_limit_s,
        )
        steps = []
        for step in rollout.run():
            steps.append(step)
            tell(1)
        tell(self.work - ROBOTS * ROBOT_WORK - len(steps))
        measured = []
        for robot, terrain in enumerate(terrains):
            measured.append(_measured(self, network, steps, ticks, robot, terrain, levels[robot]))
            tell(ROBOT_WORK)
        tell(ROBOT_WORK * (ROBOTS - count))
        return measured

    def _source(
        self,
        network: HeightmapNetwork,
        rng: np.random.Generator,
        ticks: list["_Tick"],
        setups: Sequence[Setup],
    ) -> "_RecordedSource":
        camera, profile = setups[0].camera, setups[0].profile
        lossy = drawn_around(profile.camera, loss=rng.uniform(0.0, TRAINING.loss))
        profile = dataclasses.replace(profile, camera=lossy)
        errors, rngs = None, None
        if not camera.ideal:
            errors = drawn_cameras(len(setups), rng, StereoConfig.of(camera))
            rngs = rng.spawn(len(setups))
        seen = [dataclasses.replace(setup, profile=profile) for setup in setups]
        cameras = robot_cameras(seen, errors, rngs)
        return _RecordedSource(PredictedHeights(network, cameras, profile), ticks)


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """Prediction of one predictor in one run, at each step that counts."""

    height: Floats
    """[m], shape (n, 30)."""
    half_width_90: Floats
    """Half of the 90 % interval [m], shape (n, 30)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeldOutRun:
    """One run, n steps of which count."""

    terrain: str
    level: str
    """`MASTERED` or `HARD`."""
    true_height: Floats
    """[m], shape (n, 30)."""
    view: NDArray[np.int8]
    """See `saltus.heightmap.evaluation.visibility`, shape (n, 30)."""
    predictions: dict[str, Prediction]
    way: Way
    status: NDArray[np.int8] | None = None
    """Status that the heightmap service gives the network's heights, a `HeightmapStatus` each,
    shape (n,); None where it was not asked."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Tick(Prediction):
    """Inputs and answers of the services of all robots at one step, shape (robots, 30)."""

    captured_s: Floats
    depth: NDArray[np.uint16] | None
    """Taken at this step [mm], shape (robots, 48, 16)."""


class _RecordedSource:
    """A `saltus.policy.evaluation.heights.HeightSource` that records its answers."""

    def __init__(self, source: PredictedHeights, ticks: list[_Tick]) -> None:
        self._source = source
        self._ticks = ticks

    def heights(self, states: RobotStates, truth: PlantState, fresh: NDArray[np.bool_]) -> Floats:
        """See `saltus.policy.evaluation.heights.HeightSource`."""
        source = self._source
        height = source.heights(states, truth, fresh)
        given = source.cameras.given
        self._ticks.append(
            _Tick(
                height=height,
                half_width_90=source.half_width_90.copy(),
                captured_s=source.captured_s.copy(),
                depth=None if given is None else given.depth,
            )
        )
        return height


def _measured(
    config: HeldOutRuns,
    model: HeightmapNetwork,
    steps: Sequence[RolloutStep],
    ticks: Sequence[_Tick],
    robot: int,
    terrain: Terrain,
    level: str,
) -> HeldOutRun:
    """Steps that count of one robot's first trial."""
    kind = model.robot
    count = sum(bool(step.running[robot]) for step in steps)
    steps, ticks = steps[:count], ticks[:count]
    position = np.array([step.truth.position_base_in_world[robot] for step in steps])
    quaternion = np.array([step.truth.quaternion_base_in_world[robot] for step in steps])
    captured_s = np.array([tick.captured_s[robot] for tick in ticks])
    network = Prediction(
        height=np.array([tick.height[robot] for tick in ticks], np.float64),
        half_width_90=np.array([tick.half_width_90[robot] for tick in ticks], np.float64),
    )
    others = {
        name: _prediction(_replayed(GeometricHeightmap(kind, foot_gain=BASELINES[name]), steps, ticks, robot))
        for name in config.baselines
    }
    counted, status = slice(STAND_STEPS, None), None
    if config.statuses:
        answers = _replayed(HeightmapService(model), steps, ticks, robot)[counted]
        status = np.array([answer.status for answer in answers], np.int8)
    return HeldOutRun(
        terrain=terrain.kind,
        level=level,
        true_height=true_heights(terrain, position, quaternion)[counted],
        view=visibility(terrain, Mount.of(kind), load_grid(config.grid), position, quaternion, captured_s)[counted],
        predictions={
            name: Prediction(height=said.height[counted], half_width_90=said.half_width_90[counted])
            for name, said in {NETWORK: network, **others}.items()
        },
        way=Way.of(terrain, position),
        status=status,
    )


def _replayed(
    predictor: Predictor, steps: Sequence[RolloutStep], ticks: Sequence[_Tick], robot: int
) -> list[Heightmap]:
    """Answers of a predictor to the images that the robot's network got, when it got them."""
    taken = {
        step.states.step: tick.depth[robot] for step, tick in zip(steps, ticks, strict=True) if tick.depth is not None
    }
    arrived: dict[int, int] = {}  # step of capture: step of arrival
    for step, tick in zip(steps, ticks, strict=True):
        if np.isfinite(tick.captured_s[robot]):
            arrived.setdefault(round(float(tick.captured_s[robot]) / TICK_S), step.states.step)
    number = {step: i for i, step in enumerate(taken)}
    frames = [depth_frame(MODEL_CAMERA, taken[step], time_ns=step_ns(step), frame_id=number[step]) for step in arrived]
    states = [
        state_message(states, robot, time_ns=step_ns(states.step), step=states.step, mode=ControllerMode.RUN)
        for states in (step.states for step in steps)
    ]
    arrival_ns = [step_ns(step) for step in arrived.values()]
    return replay_predictor(predictor, frames, states, arrival_ns)


def _prediction(maps: Sequence[Heightmap]) -> Prediction:
    return Prediction(
        height=np.array([heightmap.height for heightmap in maps], np.float64),
        half_width_90=np.array([heightmap.half_width_90 for heightmap in maps], np.float64),
    )


def step_ns(step: int) -> int:
    """Time of a step of 10 ms since the start of the run [ns]."""
    return round(step * TICK_S * _NS)


def course(rng: np.random.Generator, index: int, kinds: Sequence[str]) -> tuple[str, TerrainConfig]:
    """Kinds in turn, each at first of a size that is mastered."""
    kind = kinds[index % len(kinds)]
    if index >= len(kinds) or kind not in PAPER:
        return HARD, random_course(rng, HARDEST, kind)
    if kind == "stairs":
        rise, run = float(rng.uniform(0.05, 0.10)), float(rng.uniform(0.25, 0.3))
        return MASTERED, TerrainConfig(terrain=kind, rise_m=rise, run_m=run, steps=14)
    if kind == "stepping_stones":
        return MASTERED, TerrainConfig(terrain=kind, stone_m=0.5, gap_m=float(rng.uniform(0.10, 0.20)), steps=8)
    if kind == "step":
        return MASTERED, TerrainConfig(terrain=kind, height_m=float(rng.uniform(0.10, 0.22)))
    if kind == "gap":
        return MASTERED, TerrainConfig(terrain=kind, gap_m=float(rng.uniform(0.20, 0.36)))
    return MASTERED, TerrainConfig(terrain=kind)
