"""Motion to train on from a planner in the batched plant: what the robot will really do."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from saltus.config import DEFAULT_ROBOT, TerrainConfig, TerrainKind
from saltus.effects.profile import Profile
from saltus.heightmap.data.planner_randomisation import VARIATION, varied
from saltus.heightmap.data.rollouts import Trajectory
from saltus.heightmap.service.features import proprioception_of_states
from saltus.policy.evaluation.rollout import Rollout
from saltus.policy.scripted import ScriptedPlanner
from saltus.robots.loading import load_robot
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Trial

KINDS: tuple[TerrainKind, ...] = ("flat", "stairs", "stairs", "stepping_stones", "step", "gap")
MIN_TICKS = 150  # 1 s of standing and half a second of motion


@dataclass(frozen=True, kw_only=True)
class PlannedBounding:
    """Runs the scripted planner on true heights; every robot is one trial on a course of its own.

    Each robot has its own variant of the planner, so that the network does not learn one gait by heart.
    """

    hardest: float = 0.35
    """Courses go up to this difficulty; beyond it the planner only shows how to fall."""
    variation: float = VARIATION
    """Standard deviation of each of the planner's numbers, as a share of it."""
    robots: int = 64
    """At once."""
    time_limit_s: float = 8.0
    first_seed: int = 2_000_000
    """Of the trials; apart from those of evaluations."""
    profile: Profile | None = None
    """Hardware of the robots; as shipped where it is not given."""
    progress: Callable[[float], object] = lambda _: None
    """Is told after each step how long the robots of a batch have run, as a share of the time limit."""

    def trajectories(self, rng: np.random.Generator, count: int) -> Iterator[Trajectory]:
        """Yields `count` trajectories: each robot's first trial, from its start to its end, failures included."""
        done, batch = 0, 0
        while done < count:
            seeds = range(self.first_seed + batch * self.robots, self.first_seed + (batch + 1) * self.robots)
            batch += 1
            for trajectory in self._batch(rng, [Trial.draw(seed) for seed in seeds]):
                if done < count:
                    done += 1
                    yield trajectory

    def _batch(self, rng: np.random.Generator, trials: list[Trial]) -> Iterator[Trajectory]:
        terrains = [make_terrain(_course(rng, self.hardest)) for _ in trials]
        planner = ScriptedPlanner(varied(rng, self.variation, len(trials)))
        kind = load_robot(DEFAULT_ROBOT)
        rollout = Rollout(kind, terrains, trials, planner, profile=self.profile, time_limit_s=self.time_limit_s)
        steps = []
        for step in rollout.run():
            steps.append(step)
            self.progress(step.states.time_s / self.time_limit_s)
        running = np.array([step.running for step in steps])  # (ticks, robots)
        truth = [step.truth for step in steps]
        position = np.array([t.position_base_in_world for t in truth])
        quaternion = np.array([t.quaternion_base_in_world for t in truth])
        joints = np.array([t.joint_position for t in truth])
        proprioception = np.array([proprioception_of_states(step.states) for step in steps])
        for robot, terrain in enumerate(terrains):
            ticks = int(running[:, robot].sum())
            if ticks < MIN_TICKS:
                continue
            yield Trajectory(
                terrain=terrain,
                position_base_in_world=position[:ticks, robot],
                quaternion_base_in_world=quaternion[:ticks, robot],
                joint_position=joints[:ticks, robot],
                proprioception=proprioception[:ticks, robot],
            )


def _course(rng: np.random.Generator, hardest: float) -> TerrainConfig:
    kind = KINDS[rng.integers(len(KINDS))]
    if kind == "stairs":
        rise, run = rng.uniform(0.03, 0.05 + 0.25 * hardest), rng.uniform(0.2, 0.4)
        return TerrainConfig(terrain=kind, rise_m=float(rise), run_m=float(run), steps=int(rng.integers(5, 15)))
    return TerrainConfig(terrain=kind, difficulty=float(rng.uniform(0.0, hardest)))
