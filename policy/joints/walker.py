"""Walking by a policy that commands joints: it gets up or catches a robot that jumps,
is asked at the policy's rate, and comes to a stand.
"""

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, smooth_step
from saltus.policy.joints.footing import Footing, is_slow
from saltus.policy.joints.observation import (
    ObservationMaker,
    WalkerReadings,
    gravity_in_base,
    joint_targets,
    standing_height,
)
from saltus.policy.joints.policy import JointPolicy
from saltus.policy.joints.stuck import StuckWatch
from saltus.policy.mover import PlanarVelocity, PlannerDecision
from saltus.robots.robot import JOINTS, Robot
from saltus.rotations import rotation_matrix
from saltus.states import standing_state
from saltus.wire.messages import CommandMode, ControllerMode, JointPlan, RobotState

RISE_NS = 600_000_000
"""Time from the standing pose of the controller to that of the policy, which for a Go1 is 4 cm
higher: trainings start there."""
STOP_NS = (200_000_000, 1_200_000_000)
"""Time for which the policy is asked to stand until the robot is slow, at least and at most. Asked
for longer, on stairs, policies turn the trunk until it tips over: their pose is that of level
ground."""
UNDER_WAY = (ControllerMode.WALK, ControllerMode.COAST)
"""Modes in which the policy goes on: of a Go1 at 1.2 m/s whose plans were missing for 60 ms none of
8 fell, and 7 when it began anew."""
CAUGHT_MPS, CAUGHT_NS = 0.3, (300_000_000, 900_000_000)
"""Way ahead for which the policy is asked when it catches a robot that jumps [m/s], as in trainings
that begin in a jump, until all feet surely stand, within these times. On stairs of 0.20 m 93 of 100
Go1 and 98 Go2 stop so within 1 m; led for 0.35 s, whatever stood, 7 of 20 Go2 did (docs/history.md,
"Catching a robot that jumps")."""
ON_TIME = 0.75
"""Share of the policy's period after which it is asked again: states may be dated a bit early."""


class Walker:
    """Moves one robot by joint targets of a policy; its errors are those of
    `JointPolicy.refuse_other`.

    `places` are those of the policy's heights among those of the run's grid; None: they are the
    same.
    """

    follows, waits = CommandMode.WALK, True

    def __init__(
        self, robot: Robot, policy: JointPolicy, places: NDArray[np.intp] | None = None
    ) -> None:
        policy.refuse_other(robot)
        described = policy.description
        self._robot, self._policy, self._described = robot, policy, described
        self._observer, self._places = (
            ObservationMaker(described),
            slice(None) if places is None else places,
        )
        self._pose, self._scale = described.pose, described.action_scale
        self._kp, self._kd = described.gains
        size = described.height_grid().size
        self._blind = np.full(size, -standing_height(robot, described.pose))
        self._period_ns = round(ON_TIME * 1e9 / described.rate_hz)
        self._begin(standing_state(robot))
        self._act(standing_state(robot), self._blind, np.zeros(3))  # the first call takes long
        self._stopping_ns: int | None = None
        self._footing: Footing | None = None

    def plan(self, decision: PlannerDecision) -> JointPlan:
        """See `saltus.policy.mover.Mover.plan`."""
        state = decision.state
        if any(decision.velocity):
            self._stopping_ns = self._footing = None
        if decision.heights is None or state.mode not in (*UNDER_WAY, ControllerMode.RUN):
            self._begin(state)
        else:
            if state.mode == ControllerMode.RUN:
                self._catch(state)
            self._move(state, decision.heights, self._led(state, decision.velocity))
        kp, kd = (self._kp, self._kd) if self._footing is None else self._footing.gains
        return JointPlan(
            time_ns=state.time_ns,
            step=state.step,
            status=decision.status,
            joint_position=self._targets,
            kp=kp,
            kd=kd,
            reason=decision.reason,
        )

    def slows(self, state: RobotState) -> bool:
        """True while it is led, until it is slow, within the times of `STOP_NS`, and until it rests
        over its feet; see `saltus.policy.mover.Mover.slows`.
        """
        if state.mode not in (*UNDER_WAY, ControllerMode.RUN):
            return False
        if self._stopping_ns is None:
            self._stopping_ns = state.time_ns
        since_ns, (least_ns, most_ns) = state.time_ns - self._stopping_ns, STOP_NS
        if self._footing is None:
            moves = self._caught_mps > 0.0 or (since_ns < most_ns and not is_slow(state))
            if moves or since_ns < least_ns:
                return True
            self._footing = Footing(self._robot, state)
        return not self._footing.is_over(state)

    def hands_over(self, state: RobotState) -> bool:
        """Never: robots begin to jump from a stand."""
        del state
        return False

    def _catch(self, state: RobotState) -> None:
        """Begins with a robot that jumps: the policy is asked at once."""
        self._begin(state)
        self._begun_ns -= RISE_NS
        self._caught_mps = min(CAUGHT_MPS, float(np.linalg.norm(state.velocity_base_in_world[:2])))

    def _led(self, state: RobotState, velocity: PlanarVelocity) -> PlanarVelocity:
        """The commanded velocity; of a robot that was just caught at least a slow walk ahead."""
        since_ns, (least_ns, most_ns) = state.time_ns - self._caught_ns, CAUGHT_NS
        if since_ns >= most_ns or (since_ns >= least_ns and state.leg_trusted.all()):
            self._caught_mps = 0.0
        is_led = self._caught_mps > 0.0
        return (max(velocity[0], self._caught_mps), *velocity[1:]) if is_led else velocity

    def _begin(self, state: RobotState) -> None:
        """Holds the joints where they are, by the torque that bears the robot now.

        All that the policy remembers is forgotten.
        """
        self._from = self._targets = state.joint_position + state.joint_torque / self._kp
        self._action = np.zeros(len(JOINTS))
        self._past: Floats | None = None
        self._begun_ns, self._acted_ns = state.time_ns, -1
        self._stuck = StuckWatch()
        self._caught_ns, self._caught_mps = state.time_ns, 0.0
        self._stopping_ns = self._footing = None

    def _move(self, state: RobotState, heights: Floats, velocity: PlanarVelocity) -> None:
        share = (state.time_ns - self._begun_ns) / RISE_NS
        if self._footing is not None:
            self._targets = self._footing.step(state)
        elif share < 1.0:
            risen = float(smooth_step(np.asarray(share)))
            self._targets = self._from + risen * (self._pose - self._from)
        elif self._acted_ns < 0 or state.time_ns - self._acted_ns >= self._period_ns:
            told = self._blind if self._described.blind else heights[self._places]
            self._act(state, told, self._stuck.lead(state, self._described.obeyed(velocity)))
            self._acted_ns = state.time_ns

    def _act(self, state: RobotState, heights: Floats, velocity: Floats) -> None:
        vector = self._observer.vector(self._sensed(state, heights, velocity))
        self._action = self._policy(self._with_history(vector)[None])[0].astype(np.float64)
        ours = np.zeros(len(JOINTS))
        ours[self._described.order] = self._action
        self._targets = joint_targets(self._pose, self._scale, ours)

    def _sensed(self, state: RobotState, heights: Floats, velocity: Floats) -> WalkerReadings:
        rotation = rotation_matrix(state.quaternion_base_in_world)
        return WalkerReadings(
            linear_velocity=state.velocity_base_in_world @ rotation,
            angular_velocity=state.angular_velocity_base,
            gravity=gravity_in_base(rotation),
            command=self._described.obeyed(velocity),
            joint_position=state.joint_position,
            joint_velocity=state.joint_velocity,
            action=self._action,
            heights=heights,
        )

    def _with_history(self, vector: Floats) -> Floats:
        """The last vectors in the description's order;
        before there were so many, the first one again.
        """
        count = self._described.history
        if count == 1:
            return vector
        if self._past is None:
            self._past = np.tile(vector, (count, 1))
        self._past = np.concatenate([self._past[1:], vector[None]])
        past = self._past[::-1] if self._described.newest_first else self._past
        if self._described.history_of == "vector":
            return past.reshape(-1)
        ends = np.cumsum(self._described.sizes)[:-1]
        return np.concatenate([part.reshape(-1) for part in np.split(past, ends, axis=1)])
