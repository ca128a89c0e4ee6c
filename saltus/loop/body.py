"""Bodies of robots: physics, drives, sensors, estimator and leg law of a batch."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT, POLICY_STEPS
from saltus.controller.compensation import Compensation
from saltus.controller.estimator import Estimator, EstimatorState
from saltus.controller.gait import GaitSignal, standing_gait
from saltus.controller.leg_controller import LawState, LegController
from saltus.controller.yaw_frame import CentroidalReference, reference_of
from saltus.effects.chain import ActuatorChain
from saltus.effects.signal_chain import chosen_of
from saltus.plan import Plan
from saltus.setup import Setup
from saltus.sim.batch_plant import BatchPlant
from saltus.sim.plant_state import PlantState
from saltus.states import ProprioceptionArrays, states_of
from saltus.trial import strengthen_drives
from saltus.wire.messages import ControllerMode


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyState:
    """Memory of a batch of robots' estimators and leg laws; the engine has that of the physics."""

    law: LawState
    estimate: EstimatorState
    gait: GaitSignal


class Body:
    """Bodies of robots of one kind, at rest at the start of their trials.

    The order within a step is that of the deployed stack in lockstep: the plan that is computed on
    a state is obeyed from then on, for five physics steps, or, as in real time, that much later.

    Args:
        setups: One for each robot; they differ in terrain and trial alone.
        compensation: What the leg law knows of the drives; nothing by default.
        plan_delay_s: From a state to its plan being obeyed, in whole physics steps.
        threads: Of the physics.
    """

    def __init__(
        self,
        setups: Sequence[Setup],
        *,
        compensation: Compensation | None = None,
        plan_delay_s: float = 0.0,
        threads: int = 1,
    ) -> None:
        robot, profile = setups[0].robot, setups[0].profile
        trials = [setup.trial for setup in setups]
        self._start_x, self._heading, strength, friction, payload = np.array(
            [(t.position_x, t.yaw, t.motor_strength, t.friction, t.payload_kg) for t in trials]
        ).T
        delay = round(plan_delay_s / PHYSICS_DT)
        # How many plans ago the one was made that is obeyed at each physics step of a policy step.
        ago = [max(0, math.ceil((delay - tick) / POLICY_STEPS)) for tick in range(POLICY_STEPS)]
        self._plans_ago, self._references = ago, deque[CentroidalReference](maxlen=max(ago) + 1)
        self._plant = BatchPlant(
            robot,
            [setup.terrain for setup in setups],
            len(setups),
            friction=friction,
            payload_kg=payload,
            chain=ActuatorChain(strengthen_drives(profile.actuator, strength[:, None])),
            body=profile.body_chain,
            imu=profile.imu_chain,
            threads=threads,
        )
        self._law, self._estimator = (
            LegController(robot, compensation=compensation),
            Estimator(robot),
        )
        batch, zero = (len(setups),), np.zeros(1)
        self._blank = self.state = BodyState(
            law=self._law.init(batch, zero),
            estimate=self._estimator.init(batch, zero),
            gait=standing_gait(batch, zero),
        )
        """Memory besides that of the physics."""
        self.restart(np.ones(batch, dtype=np.bool_))

    @property
    def truth(self) -> PlantState:
        """The robots as they are."""
        return self._plant.state

    def states(self, step: int = 0) -> ProprioceptionArrays:
        """The robots as they know themselves, at a policy step of their run."""
        return states_of(self._plant.sensed, self.state.estimate, self.state.gait, step)

    def step(
        self, plan: Plan, mode: ControllerMode, push_n: Floats | float = 0.0
    ) -> NDArray[np.bool_]:
        """Ten milliseconds: five times control and physics.

        Args:
            plan: On the states of now.
            mode: Of the leg law.
            push_n: Force on the trunks along the world's y [N], shape (n,).

        Returns:
            Whose trunk touched the ground meanwhile, shape (n,).
        """
        self._references.appendleft(reference_of(plan, self._heading))
        self._plant.push(np.asarray(push_n))
        touched = np.zeros(len(self._heading), dtype=np.bool_)
        for ago in self._plans_ago:
            reference = self._references[min(ago, len(self._references) - 1)]
            command, law, seen = self._law.step(reference, self.states(), self.state.law, mode)
            touched |= self._plant.step(command).trunk_contact
            estimate = self._estimator.step(
                self._plant.sensed, seen.gait.trusted, self.state.estimate
            )
            self.state = BodyState(law=law, estimate=estimate, gait=seen.gait)
        return touched

    def restart(self, robots: NDArray[np.bool_]) -> None:
        """Puts some robots, bool, shape (n,), back to the start of their trial;
        they sense at once.
        """
        self._plant.reset(
            np.flatnonzero(robots), position_x=self._start_x[robots], yaw=self._heading[robots]
        )
        blank, law = self._blank, self.state.law
        estimate = self._estimator.step(self._plant.sensed, blank.gait.trusted, blank.estimate)
        begun = BodyState(
            law=replace(blank.law, mode=law.mode, mode_time_s=law.mode_time_s),
            estimate=estimate,
            gait=blank.gait,
        )
        self.state = chosen_of(robots, begun, self.state)
