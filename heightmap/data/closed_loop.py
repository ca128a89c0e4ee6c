"""Training data with the predictor in the loop:
what a robot sees that steps where the predictor made it step.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Reals
from saltus.config import TerrainConfig
from saltus.controller.compensation import compensation_of
from saltus.depth import MODEL_CAMERA
from saltus.effects.camera import drawn_around
from saltus.effects.profile import SHIPPED
from saltus.effects.signal_chain import chosen_of
from saltus.grid import HeightGrid
from saltus.heightmap.data.delivery import TRAINING
from saltus.heightmap.data.episode import Episode, uninterrupted_spans
from saltus.heightmap.data.predicted import PredictedHeights
from saltus.heightmap.data.randomisation import RHYTHM, SPEED, random_mount, vary_planner
from saltus.heightmap.data.rollouts import RobotTrajectory, film_robots
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.proprioception_vector import proprioception_of_states
from saltus.heightmap.settings import ClosedLoop
from saltus.loop.loop import Loop, Moment
from saltus.loop.planner import Observation
from saltus.named_setup import named_setups
from saltus.plan import Plan
from saltus.policy.planner import make_planner
from saltus.policy.scripted import ScriptedPlanner
from saltus.render.camera import RobotCamera
from saltus.render.eyes import SAMPLED
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.setup import Setup
from saltus.terrain.course_batch import DITCH_M
from saltus.terrain.course_law import PAPER
from saltus.terrain.curriculum import FAMILIES, make_terrain
from saltus.terrain.terrain import Terrain
from saltus.trial import Trial
from saltus.workers import tell_progress


def closed_loop_episodes(
    loop: ClosedLoop, model: Path | None, key: Sequence[int], profile: str = SHIPPED
) -> list[Episode]:
    """Runs one batch of robots and returns their episodes.

    It follows from its key (seed, round, number), predictor and profile alone, wherever it is run.

    Without a predictor robots go by true heights, shifted as each trial says. Each of their steps
    is told, see `saltus.workers.tell_progress`.
    """
    rng = np.random.default_rng(key)
    kinds = loop.terrains
    some = [
        make_terrain(random_course(rng, loop.hardest, kinds[rng.integers(len(kinds))]))
        for _ in range(loop.courses)
    ]
    # Beyond the seeds of all evaluations and other rounds of data
    first = int(rng.integers(2**32, 2**62))
    robots = range(loop.robots)
    terrains, trials = (
        [some[i % loop.courses] for i in robots],
        [Trial.draw(first + i) for i in robots],
    )
    setups = named_setups(loop.robot, loop.grid, loop.camera, profile, terrains, trials)
    robot, camera, hardware = setups[0].robot, setups[0].camera, setups[0].profile
    trajectories = list(_cut(_moments(loop, model, rng, setups), terrains, LegKinematics(robot)))
    claimed = RobotCamera.on(robot, MODEL_CAMERA if camera.ideal else SAMPLED)
    views = [
        replace(claimed, mount=random_mount(robot, rng)).moved(hardware.view_chain)
        for _ in trajectories
    ]
    return film_robots(trajectories, views, camera, hardware, setups[0].grid, rng, loop.renderer)


def _moments(
    loop: ClosedLoop, model: Path | None, rng: np.random.Generator, setups: Sequence[Setup]
) -> list[Moment]:
    robot, profile = setups[0].robot, setups[0].profile
    planner = MixedPlanner(
        robot, setups[0].grid, rng, loop.robots, learned=loop.learned, variation=loop.variation
    )
    lossy = replace(
        profile, camera=drawn_around(profile.camera, loss=rng.uniform(0.0, TRAINING.loss))
    )
    # what a robot steps worse for the errors of matching is not worth their time
    ideal = replace(setups[0].camera, ideal=True)
    seen = [replace(each, camera=ideal, profile=lossy) for each in setups]
    heights = (
        None
        if model is None
        else PredictedHeights(HeightmapNetwork(robot, model, setups[0].grid), seen)
    )
    compensation = compensation_of(profile, robot)
    robots = Loop(setups, planner, heights=heights, compensation=compensation, time_limit_s=np.inf)
    moments = []
    for _ in range(loop.ticks):
        moments.append(robots.step())
        tell_progress(1)
    return moments


class MixedPlanner:
    """Drives a share `learned` of the robots by the learned policy, the others by rules, each in
    its own way.

    `variation` is that of the rules' numbers, see `saltus.heightmap.data.randomisation`.
    """

    def __init__(
        self,
        robot: Robot,
        grid: HeightGrid,
        rng: np.random.Generator,
        count: int,
        *,
        learned: float,
        variation: float,
    ) -> None:
        self._scripted = ScriptedPlanner(robot, grid, vary_planner(rng, variation, count))
        # Not every robot has one
        self._learned = make_planner("learned", robot, grid) if learned > 0.0 else None
        self._is_learned = rng.uniform(size=count) < learned
        self._speed = rng.uniform(*SPEED, count)
        self._frequency = rng.uniform(*RHYTHM, count)

    def step(
        self, observation: Observation, heights: Reals, fresh: NDArray[np.bool_] | bool = False
    ) -> Plan:
        """Plans the next 10 ms of all robots; see `saltus.policy.planner.Planner`."""
        rules = self._scripted.step(observation, heights)
        if self._learned is None:
            return rules
        policy = self._learned.step(observation, heights, fresh)
        policy = replace(
            policy,
            velocity_x=policy.velocity_x * self._speed,
            stepping_frequency_hz=policy.stepping_frequency_hz * self._frequency,
        )
        return chosen_of(self._is_learned, policy, rules)


def random_course(rng: np.random.Generator, hardest: float, kind: str) -> TerrainConfig:
    """A course of a family, of a difficulty up to `hardest`, which is from 0 to 1."""
    difficulty = float(rng.uniform(0.0, hardest))
    if kind in ("stairs", "stairs_down", "pyramid"):
        run, steps = float(rng.uniform(0.2, 0.4)), int(rng.integers(5, 15))
        return TerrainConfig(terrain=kind, difficulty=difficulty, run_m=run, steps=steps)
    if kind == "stepping_stones" and rng.uniform() < 0.5:
        # Gaps that differ, each up to what the difficulty would make of all.
        greatest = float(0.05 + 0.6 * difficulty)
        stone, layout = float(rng.uniform(0.3, 0.7)), int(rng.integers(2**31))
        return TerrainConfig(
            terrain=kind, stone_m=stone, gap_m=0.05, gap_max_m=greatest, layout_seed=layout
        )
    layout = 0 if kind in PAPER else int(rng.integers(2**31))
    course = TerrainConfig(terrain=kind, difficulty=difficulty, layout_seed=layout)
    if kind == "ditch":
        return replace(course, depth_m=DITCH_M[0], depth_max_m=DITCH_M[1])
    if kind == "irregular" and rng.uniform() < 0.5:
        up = FAMILIES[kind].sizes["rise_m"].resolve("rise_m", None, difficulty)
        return replace(course, rise_m=-up)
    return course


def _cut(
    moments: Sequence[Moment], terrains: Sequence[Terrain], legs: LegKinematics
) -> Iterator[RobotTrajectory]:
    """The runs of each robot from one start to the next; those that are too short are left out."""
    starts = np.array([moment.fresh for moment in moments])  # (ticks, robots)
    position = np.array([moment.truth.position_base_in_world for moment in moments])
    quaternion = np.array([moment.truth.quaternion_base_in_world for moment in moments])
    joints = np.array([moment.truth.joint_position for moment in moments])
    features = np.array([proprioception_of_states(moment.states, legs) for moment in moments])
    for robot, terrain in enumerate(terrains):
        for run in uninterrupted_spans(starts[:, robot]):
            yield RobotTrajectory(
                terrain=terrain,
                position_base_in_world=position[run, robot],
                quaternion_base_in_world=quaternion[run, robot],
                joint_position=joints[run, robot],
                proprioception=features[run, robot],
            )
