"""Movers make the planner's answer of what it has decided: a plan for jumps, or joint targets."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from saltus.arrays import Floats
from saltus.grid import HeightGrid
from saltus.loop.planner import Observation, Planner, observe
from saltus.loop.shadows import deepen_shadows
from saltus.plan import REST, plan_message
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.wire.messages import (
    AnyPlan,
    CommandMode,
    ControllerMode,
    MotionPlan,
    PlanStatus,
    RobotState,
)

PlanarVelocity = tuple[float, float, float]
"""Ahead, to the left [m/s], turning to the left [rad/s]."""
AT_REST: PlanarVelocity = (0.0, 0.0, 0.0)
ASIDE_M = 0.1
"""Distance of the lines beside that on which a robot jumps: the scan's spacing. Its feet are 0.13
m aside."""
HOLE_M = 0.3
"""Ground so much lower beside the way is a hole: stairs that robots jump have 0.25 m a step."""

REAR_LEGS = slice(2, 4)
"""Places of the rear legs among FR, FL, RR, RL."""
MOST_TURN_RPS = 0.5
"""Fastest turning of a robot that jumps: trials of led jumps turn as fast. A faster one was not
tried."""


@dataclass(frozen=True, kw_only=True)
class PlannerDecision:
    """The planner's decision at a state of the robot, which a mover answers."""

    state: RobotState
    heights: Floats | None
    """On the grid of the run, relative to the base [m]; None unless the status is GO."""
    velocity: PlanarVelocity
    """As commanded."""
    half_width: Floats | None = None
    """Half of the 90 % interval of each height [m]; None: they are sure."""
    status: PlanStatus = PlanStatus.GO
    reason: str = ""
    """Reason for which the status is not GO."""


class Mover(Protocol):
    """One way in which the planner moves a robot: by jumps, or by joint targets."""

    follows: CommandMode
    """The command that it obeys."""
    waits: bool
    """It does not move before the first command."""

    def plan(self, decision: PlannerDecision) -> AnyPlan:
        """Answers a state."""
        ...

    def slows(self, state: RobotState) -> bool:
        """True while a robot that is to rest is better led to a stand by GO at no velocity."""
        ...

    def hands_over(self, state: RobotState) -> bool:
        """Gives up a robot in motion where a mover that walks can catch it; True then."""
        ...


class Jumper:
    """Moves a robot by jumps ahead, as a planner plans them.

    Args:
        robot: Which one.
        planner: Its planner.
        compiled: Observes in place of the law on numpy.
        lines: What it makes of the heights of a run's grid for the planner; None: nothing.
    """

    follows, waits = CommandMode.JUMP, False

    def __init__(
        self,
        robot: Robot,
        planner: Planner,
        compiled: Callable[[RobotState], Observation] | None = None,
        lines: "FeetLines | None" = None,
    ) -> None:
        self._observe = compiled or partial(observe, legs=LegKinematics(robot))
        self._planner, self._lines = planner, lines
        self._goes = False

    def plan(self, decision: PlannerDecision) -> MotionPlan:
        """See `Mover.plan`; it goes at a speed of its own, and turns as commanded."""
        state, status = decision.state, decision.status
        begins, plan = not self._goes, REST
        self._goes = status == PlanStatus.GO
        if decision.heights is not None:
            heights = decision.heights
            if self._lines is not None:
                heights = self._lines(heights, decision.half_width)
            plan = self._planner.step(self._observe(state), heights, begins)
        return plan_message(
            plan, status, time_ns=state.time_ns, step=state.step, reason=decision.reason,
            yaw_rate=float(np.clip(decision.velocity[2], -MOST_TURN_RPS, MOST_TURN_RPS)),
        )  # fmt: skip

    def slows(self, state: RobotState) -> bool:
        """Never: the controller lands it."""
        del state
        return False

    def hands_over(self, state: RobotState) -> bool:
        """True while both rear feet surely stand; see `Mover.hands_over`."""
        stands = state.mode == ControllerMode.RUN and bool(state.leg_trusted[REAR_LEGS].all())
        self._goes = self._goes and not stands
        return stands


class FeetLines:
    """The line ahead on which a robot jumps, made of it and of the ground `ASIDE_M` beside it.

    What edges hide is lowered, as services do for planners that jump alone (`saltus.loop.shadows`);
    where a robot walks by the same heights, they do not.

    Args:
        grid: Of the run.
        line: Of the planner.

    Raises:
        ConfigError: the grid has no such points.
    """

    def __init__(self, grid: HeightGrid, line: HeightGrid) -> None:
        self._lines = replace(line, y=(-ASIDE_M, 0.0, ASIDE_M))
        self._places = grid.places_of(self._lines)

    def __call__(self, heights: Floats, half_width: Floats | None = None) -> Floats:
        """Heights of the line [m], shape (points,), of those of the grid and of their half-widths.

        Where a hole begins beside the middle, as at a trench that lies askew, it has begun: feet of
        one side would step into it.
        """
        given = heights[self._places]
        if half_width is not None:
            given, _ = deepen_shadows(given, half_width[self._places], self._lines)
        right, middle, left = given.reshape(self._lines.shape).T
        lowest = np.minimum(right, left)
        return np.where(lowest < middle - HOLE_M, lowest, middle)
