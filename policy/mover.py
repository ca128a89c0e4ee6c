"""Movers make the planner's answer of what it has decided: a plan for jumps, or joint targets."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.loop.planner import Observation, Planner, observe
from saltus.plan import REST, plan_message
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.wire.messages import AnyPlan, CommandMode, MotionPlan, PlanStatus, RobotState

Velocity = tuple[float, float, float]
"""Ahead, to the left [m/s], turning to the left [rad/s]."""
AT_REST: Velocity = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Decision:
    """The planner's decision at a state of the robot, which a mover answers."""

    state: RobotState
    heights: Floats | None
    """On the grid of the run, relative to the base [m]; None unless the status is GO."""
    velocity: Velocity
    """As commanded."""
    status: PlanStatus = PlanStatus.GO
    reason: str = ""
    """Reason for which the status is not GO."""


class Mover(Protocol):
    """One way to move."""

    follows: CommandMode
    """The command that it obeys."""
    waits: bool
    """It does not move before the first command."""

    def plan(self, decision: Decision) -> AnyPlan:
        """Answers a state."""
        ...

    def slows(self, state: RobotState) -> bool:
        """True while a robot that is to rest is better led to a stand by GO at no velocity."""
        ...


class Jumper:
    """Jumps ahead by a planner.

    Args:
        robot: Which one.
        planner: Its planner.
        compiled: Observes in place of the law on numpy.
        places: Of the planner's heights among those of the run's grid; None: they are the same.
    """

    follows, waits = CommandMode.JUMP, False

    def __init__(
        self,
        robot: Robot,
        planner: Planner,
        compiled: Callable[[RobotState], Observation] | None = None,
        places: NDArray[np.intp] | None = None,
    ) -> None:
        self._observe = compiled or partial(observe, legs=LegKinematics(robot))
        self._planner, self._places = planner, slice(None) if places is None else places
        self._goes = False

    def plan(self, decision: Decision) -> MotionPlan:
        """See `Mover.plan`; it goes at a speed of its own."""
        state, status = decision.state, decision.status
        begins, plan = not self._goes, REST
        self._goes = status == PlanStatus.GO
        if decision.heights is not None:
            heights = decision.heights[self._places]
            plan = self._planner.step(self._observe(state), heights, begins)
        return plan_message(
            plan, status, time_ns=state.time_ns, step=state.step, reason=decision.reason
        )

    def slows(self, state: RobotState) -> bool:
        """Never: the controller lands it."""
        del state
        return False
