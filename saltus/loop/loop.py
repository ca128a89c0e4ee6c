"""The closed loop in one process, for many robots at once: body, heights, planner and judge.

Whoever records a run reads the moments that it goes through: evaluations, data, benchmarks.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.constants import POLICY_DT, PUSH_STEPS
from saltus.controller.compensation import Compensation
from saltus.loop.body import Body
from saltus.loop.heights import HeightSource, shifted_heights
from saltus.loop.planner import Planner, observe
from saltus.plan import Plan
from saltus.robots.legs import LegKinematics
from saltus.setup import Setup
from saltus.sim.plant_state import PlantState
from saltus.states import ProprioceptionArrays
from saltus.terrain.terrain import Terrain
from saltus.trial import TIME_LIMIT_S, Outcome, Trial, TrialMonitor, is_upright
from saltus.wire.messages import ControllerMode

_STREAM = 9  # of a trial's seed: other numbers than those of the trial itself


class Pushes:
    """Pushes on the robots of a loop from the left or the right, when the trunk first passes a
    place.

    It lies between where time begins to run and the last edge, or the end of flat ground: a robot
    that is pushed behind the last edge has arrived before it could fall. Place and side follow from
    the seed of each trial, so that all policies get the same pushes.

    Args:
        impulse_ns: Of each push [Ns].
        terrains: One for each trial.
        trials: Whose seeds draw.
    """

    def __init__(
        self, impulse_ns: float, terrains: Sequence[Terrain], trials: Sequence[Trial]
    ) -> None:
        rngs = [np.random.default_rng([trial.seed, _STREAM]) for trial in trials]
        ends = [(t.timing_x, t.edges_x[-1] if t.edges_x.size else t.finish_x) for t in terrains]
        self._x = np.array([rng.uniform(*each) for rng, each in zip(rngs, ends, strict=True)])
        self._force = (
            impulse_ns
            / (PUSH_STEPS * POLICY_DT)
            * np.array([rng.choice((-1.0, 1.0)) for rng in rngs])
        )
        self._left = np.full(len(trials), PUSH_STEPS)

    def step(self, trunk_x: Floats) -> Floats:
        """Force along the world's y over the next policy step [N], of trunks at these x [m].

        Shapes (trials,).
        """
        pushed = (self._left > 0) & ((self._left < PUSH_STEPS) | (trunk_x >= self._x))
        self._left -= pushed
        return np.where(pushed, self._force, 0.0)


STAND_STEPS = 100  # the controller stands for 1 s before it obeys its first plan


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """One policy step of a batch: what held at its start, and what was decided then."""

    states: ProprioceptionArrays
    truth: PlantState
    heights: Floats
    """Heights that the planner saw [m], shape (n, points)."""
    plan: Plan
    fresh: NDArray[np.bool_]
    """Robot starts from the beginning with this step, shape (n,)."""
    running: NDArray[np.bool_]
    """The robot's first trial goes on, shape (n,); robots whose trial is over start again and do
    not count."""


class Loop:
    """Runs a planner on many robots of one kind, one policy step at a time.

    Args:
        setups: One for each robot; they differ in terrain and trial alone.
        planner: Plans for all of them.
        heights: What they see; by default the true heights with each trial's shift.
        compensation: What the leg controller knows of the drives, by default nothing.
        time_limit_s: After which a trial has failed.
        stand_steps: Policy steps before the first plan is obeyed.
        plan_delay_s: See `saltus.loop.body.Body`.
        push_ns: Of one push from the side [Ns], see `saltus.loop.loop`.
    """

    def __init__(
        self,
        setups: Sequence[Setup],
        planner: Planner,
        *,
        heights: HeightSource | None = None,
        compensation: Compensation | None = None,
        time_limit_s: float = TIME_LIMIT_S,
        stand_steps: int = STAND_STEPS,
        plan_delay_s: float = 0.0,
        push_ns: float = 0.0,
    ) -> None:
        self.count, self._planner, self._stand_steps = len(setups), planner, stand_steps
        terrains = [setup.terrain for setup in setups]
        self._finish_x = np.array([terrain.finish_x for terrain in terrains])
        self._body = Body(setups, compensation=compensation, plan_delay_s=plan_delay_s)
        self._heights = heights or shifted_heights(setups)
        self._legs = LegKinematics(setups[0].robot)
        self._monitors = [TrialMonitor(terrain, time_limit_s) for terrain in terrains]
        self._pushes = Pushes(push_ns, terrains, [setup.trial for setup in setups])
        self._index, self._fresh = 0, np.ones(self.count, dtype=np.bool_)

    @property
    def outcomes(self) -> list[Outcome | None]:
        """How each robot's first trial ended; None where it goes on."""
        return [monitor.outcome for monitor in self._monitors]

    @property
    def running(self) -> NDArray[np.bool_]:
        """The first trial of each robot goes on, shape (n,)."""
        return np.array([outcome is None for outcome in self.outcomes])

    def run(self) -> Iterator[Moment]:
        """Steps until every trial is over."""
        while self.running.any():
            yield self.step()

    def step(self) -> Moment:
        """One policy step: sense, see, plan, and five times control and physics."""
        truth, states, fresh, running = (
            self._body.truth,
            self._body.states(self._index),
            self._fresh,
            self.running,
        )
        heights = self._heights.heights(states, truth, fresh)
        # The deployed planner begins when the robot may go
        begins = fresh | (self._index <= self._stand_steps)
        plan = self._planner.step(observe(states, self._legs), heights, begins)
        mode = ControllerMode.STAND if self._index < self._stand_steps else ControllerMode.RUN
        touched = self._body.step(plan, mode, self._pushes.step(truth.position_base_in_world[:, 0]))
        self._index += 1
        self._fresh = self._judge(touched, running)
        if self._fresh.any():
            self._body.restart(self._fresh)
        return Moment(
            states=states, truth=truth, heights=heights, plan=plan, fresh=fresh, running=running
        )

    def _judge(self, touched: NDArray[np.bool_], running: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Feeds the monitors of trials that are running; returns which robots are done."""
        now = self._body.truth
        position, quaternion = now.position_base_in_world, now.quaternion_base_in_world
        for i in np.flatnonzero(running):
            self._monitors[i].step(
                self._index * POLICY_DT, position[i], quaternion[i], bool(touched[i])
            )
        over = touched | ~is_upright(quaternion) | (position[:, 0] >= self._finish_x)
        return over | (running & ~self.running)
