"""The closed loop in one process, for many robots at once: plant, estimator, planner, leg controller.

The order within a step is that of the deployed stack in lockstep: the plan that is computed on the state of step k is
applied from step k on, for exactly five physics steps, or, as in real time, that much later. Each robot has its own
trial and its own terrain.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT, POLICY_DT, POLICY_STEPS
from saltus.controller.compensation import Compensation
from saltus.controller.estimator import Estimator, EstimatorState
from saltus.controller.gait import GaitSignal, standing
from saltus.controller.law import LawState, LegController
from saltus.controller.signals import Reference, reference_of
from saltus.effects.chain import ActuatorChain
from saltus.effects.heightmap_shift import refuse_shift
from saltus.plan import Plan
from saltus.policy.evaluation.heights import HeightSource, TrueHeights
from saltus.policy.evaluation.pushes import Pushes
from saltus.policy.observation import observe
from saltus.policy.planner import Planner
from saltus.robots.legs import LegKinematics
from saltus.setup import Setup
from saltus.sim.batch import BatchPlant
from saltus.sim.state import PlantState
from saltus.states import RobotStates, states_of
from saltus.terrain.stack import TerrainStack
from saltus.terrain.terrain import Terrain
from saltus.trial import TIME_LIMIT_S, Outcome, Trial, TrialMonitor, is_upright, strengthened
from saltus.wire.messages import ControllerMode

STAND_STEPS = 100  # the controller stands for 1 s before it obeys its first plan


HeightsFactory = Callable[[Sequence[Setup]], HeightSource]
"""Makes a source of heights for a batch of robots of one kind, see `Rollout`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RolloutStep:
    """One policy step of a batch: what held at its start, and what was decided then."""

    states: RobotStates
    truth: PlantState
    heights: Floats
    """Heights that the planner saw [m], shape (n, points)."""
    plan: Plan
    fresh: NDArray[np.bool_]
    """Robot starts from the beginning with this step, shape (n,)."""
    running: NDArray[np.bool_]
    """The robot's first trial goes on, shape (n,); robots whose trial is over start again and do not count."""


class Rollout:
    """Runs a planner on many robots of one kind, one policy step at a time.

    Args:
        setups: One for each robot; they differ in terrain and trial alone.
        planner: Plans for all of them.
        compensation: What the leg controller knows of the drives, by default nothing.
        heights: Makes the source of heights; by default the true ones with each trial's shift.
        time_limit_s: After which a trial has failed.
        stand_steps: Policy steps before the first plan is obeyed.
        plan_delay_s: From a state to its plan being obeyed, in whole physics steps.
        push_ns: Of one push from the side [Ns], see `saltus.policy.evaluation.pushes`.
        threads: Of the physics.
    """

    def __init__(
        self,
        setups: Sequence[Setup],
        planner: Planner,
        *,
        compensation: Compensation | None = None,
        heights: HeightsFactory | None = None,
        time_limit_s: float = TIME_LIMIT_S,
        stand_steps: int = STAND_STEPS,
        plan_delay_s: float = 0.0,
        push_ns: float = 0.0,
        threads: int = 1,
    ) -> None:
        robot, profile = setups[0].robot, setups[0].profile
        self.trials = trials = tuple(setup.trial for setup in setups)
        terrains = [setup.terrain for setup in setups]
        self.count = len(self.trials)
        self.planner = planner
        self._stand_steps = stand_steps
        delay = round(plan_delay_s / PHYSICS_DT)
        # How many plans ago the one was made that is obeyed at each physics step of a policy step.
        self._plans_ago = [max(0, math.ceil((delay - tick) / POLICY_STEPS)) for tick in range(POLICY_STEPS)]
        self._references: deque[Reference] = deque(maxlen=max(self._plans_ago) + 1)
        strength = np.array([[trial.motor_strength] for trial in trials])
        self._plant = BatchPlant(
            robot,
            terrains,
            self.count,
            friction=np.array([trial.friction for trial in trials]),
            payload_kg=np.array([trial.payload_kg for trial in trials]),
            chain=ActuatorChain(strengthened(profile.actuator, strength)),
            body=profile.body_chain,
            imu=profile.imu_chain,
            threads=threads,
        )
        self._heights = (heights or shifted_heights)(setups)
        self._law, self._legs = LegController(robot, compensation=compensation), LegKinematics(robot)
        self._estimator = Estimator(robot)
        self._monitors = [TrialMonitor(terrain, time_limit_s) for terrain in terrains]
        self._pushes = Pushes(push_ns, terrains, trials)
        self._index = 0
        self._fresh = np.ones(self.count, dtype=np.bool_)
        self._first_running = self._fresh.copy()
        self._law_state: LawState = self._law.init((self.count,), np.zeros(1))
        self._estimate: EstimatorState = self._estimator.init((self.count,), np.zeros(1))
        self._gait: GaitSignal = standing((self.count,), np.zeros(1))
        self._heading = np.array([trial.yaw for trial in trials])
        self._restart(self._fresh)

    @property
    def outcomes(self) -> list[Outcome | None]:
        """How each robot's first trial ended; None where it goes on."""
        return [monitor.outcome for monitor in self._monitors]

    def run(self) -> Iterator[RolloutStep]:
        """Steps until every trial is over."""
        while any(outcome is None for outcome in self.outcomes):
            yield self.step()

    def step(self) -> RolloutStep:
        """One policy step: sense, see, plan, and five times control and physics."""
        # 1. what the robots know and see
        truth, states = self._plant.state, self._states()
        fresh = self._fresh
        heights = self._heights.heights(states, truth, fresh)

        # 2. plan
        begins = fresh | (self._index <= self._stand_steps)  # the deployed planner begins when the robot may go
        plan = self.planner.step(observe(states, self._legs), heights, begins)
        self._references.appendleft(reference_of(plan, self._heading))
        running = np.array([outcome is None for outcome in self.outcomes])

        # 3. track it
        mode = ControllerMode.STAND if self._index < self._stand_steps else ControllerMode.RUN
        touched = np.zeros(self.count, dtype=np.bool_)
        self._plant.push(self._pushes.step(truth.position_base_in_world[:, 0]))
        for ago in self._plans_ago:
            touched |= self._substep(self._references[min(ago, len(self._references) - 1)], mode)
        self._index += 1

        # 4. judge; robots that are done start again
        self._fresh = self._judge(touched)
        if self._fresh.any():
            self._restart(self._fresh)
        return RolloutStep(states=states, truth=truth, heights=heights, plan=plan, fresh=fresh, running=running)

    def _substep(self, reference: Reference, mode: ControllerMode) -> NDArray[np.bool_]:
        """2 ms of control and physics; returns which trunks touched the ground."""
        command, self._law_state, diagnostics = self._law.step(reference, self._states(), self._law_state, mode)
        self._gait = diagnostics.gait
        now = self._plant.step(command)
        self._estimate = self._estimator.step(self._plant.sensed, self._gait.trusted, self._estimate)
        return np.asarray(now.trunk_contact, dtype=np.bool_)

    def _judge(self, touched: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Feeds the monitors; returns which robots are done."""
        now = self._plant.state
        position, quaternion = now.position_base_in_world, now.quaternion_base_in_world
        time_s = self._index * POLICY_DT
        for i, monitor in enumerate(self._monitors):
            if monitor.outcome is None:
                monitor.step(time_s, position[i], quaternion[i], bool(touched[i]))
        first_ended = self._first_running & np.array([outcome is not None for outcome in self.outcomes])
        self._first_running &= ~first_ended
        over = touched | ~is_upright(quaternion) | (position[:, 0] >= self._plant.terrains.finish_x)
        return first_ended | over

    def _restart(self, mask: NDArray[np.bool_]) -> None:
        """Puts some robots back to the start of their trial."""
        indices = np.flatnonzero(mask)
        self._plant.reset(
            indices,
            position_x=np.array([self.trials[i].position_x for i in indices]),
            yaw=self._heading[indices],
        )
        self._law_state = self._law.reset(self._law_state, mask)
        blank = self._estimator.init((self.count,), np.zeros(1))
        self._estimate = EstimatorState(
            mean=np.where(mask[:, None], blank.mean, self._estimate.mean),
            variance=np.where(mask[:, None], blank.variance, self._estimate.variance),
        )

    def _states(self) -> RobotStates:
        return states_of(self._plant.sensed, self._estimate, self._gait, self._index)


def batch_of(setup: Setup, terrains: Sequence[Terrain], trials: Sequence[Trial]) -> list[Setup]:
    """A setup for each robot of a batch, which have a terrain and a trial of their own."""
    return [replace(setup, terrain=each, trial=trial) for each, trial in zip(terrains, trials, strict=True)]


def shifted_heights(setups: Sequence[Setup]) -> HeightSource:
    """True heights with the shift of each trial."""
    x, z = np.array([setup.trial.height_shift(setup.profile) for setup in setups]).T
    return TrueHeights(terrains_of(setups), setups[0].grid, x, z)


def exact_heights(setups: Sequence[Setup]) -> HeightSource:
    """True heights as they are; `ConfigError` for a profile that shifts them."""
    refuse_shift(setups[0].profile.heightmap, "a planner that is given them as they are")
    return TrueHeights(terrains_of(setups), setups[0].grid)


def terrains_of(setups: Sequence[Setup]) -> TerrainStack:
    """The terrains of a batch."""
    return TerrainStack([setup.terrain for setup in setups])
