"""Where feet in swing are to stand next: Raibert's heuristic,
as the leg controller follows it and viewers draw it.

Source: paper ("Gait Generation and Swing Leg Control"); numbers: original.
"""

import numpy as np

from saltus.arrays import Array, Constant, Floats, Reals, namespace
from saltus.robots.robot import SIDE, Robot
from saltus.rotations import roll_pitch_yaw, rotation_matrix, skew, yaw_rotation
from saltus.wire.messages import ControllerMode, Heightmap, MotionPlan, RobotState

SWING_RATIO = 0.6
"""Share of the cycle that a leg swings; original."""
GOING = (ControllerMode.RUN, ControllerMode.COAST)


class Footholds:
    """The neutral points of the feet of one kind of robot."""

    def __init__(self, robot: Robot) -> None:
        x, y = robot.neutral_foot
        self._hip = Constant([[x, -y, 0.0], [x, y, 0.0], [-x, -y, 0.0], [-x, y, 0.0]])
        self._limit = Constant([*robot.landing_reach, 0.0])
        self._horizontal = Constant([1.0, 1.0, 0.0])
        self._down = Constant([0.0, 0.0, -1.0])

    def middle_and_step(
        self,
        base_in_yaw: Array,
        velocity: Array,
        angular_velocity: Array,
        stance_duration: Array,
        base_height: Array,
    ) -> tuple[Array, Array]:
        """Where a swing is at half time, under the hip,
        and how far it lands from there; (..., 4, 3) each [m].

        Both on the ground, relative to the base, in the yaw frame.

        Args:
            base_in_yaw: Rotation from the base to the yaw frame, shape (..., 3, 3).
            velocity: Of the base, yaw frame [m/s], shape (..., 3).
            angular_velocity: Yaw frame [rad/s], shape (..., 3).
            stance_duration: [s], shape (...).
            base_height: Base over terrain [m], shape (...).
        """
        xp = namespace(velocity)
        hip = self._hip.like(velocity) @ base_in_yaw.mT
        hip_velocity = velocity[..., None, :] + hip @ skew(angular_velocity).mT
        limit = self._limit.like(velocity)
        step = xp.clip(hip_velocity * (0.5 * stance_duration)[..., None, None], -limit, limit)
        middle = (
            hip * self._horizontal.like(velocity)
            + (base_height[..., None] * self._down.like(velocity))[..., None, :]
        )
        return middle, step

    def planned(self, state: RobotState, plan: MotionPlan, heightmap: Heightmap | None) -> Floats:
        """Where the feet of one robot that swing end, with the plan's residual;
        NaN for those that stand.

        Relative to the base, yaw frame [m], shape (4, 3); on the predicted heights where there are
        any.
        """
        if state.mode not in GOING or plan.stepping_frequency_hz <= 0.0:
            return np.full((4, 3), np.nan)
        rotation = rotation_matrix(np.asarray(state.quaternion_base_in_world, dtype=np.float64))
        yaw_in_world = yaw_rotation(np.asarray(roll_pitch_yaw(rotation)[2]))
        base_in_yaw = yaw_in_world.T @ rotation
        middle, step = self.middle_and_step(
            base_in_yaw,
            np.asarray(state.velocity_base_in_world, dtype=np.float64) @ yaw_in_world,
            base_in_yaw @ np.asarray(state.angular_velocity_base, dtype=np.float64),
            np.asarray((1.0 - SWING_RATIO) / plan.stepping_frequency_hz),
            np.asarray(state.base_height),
        )
        front, rear = (
            np.array(foot, dtype=np.float64)
            for foot in (plan.foot_residual_front, plan.foot_residual_rear)
        )
        residual = np.stack([front, front, rear, rear])
        residual[:, 1] *= SIDE  # y of a plan is outward
        target = middle + step + residual
        if heightmap is not None:  # the target itself is as high as the swing goes
            target[:, 2] = np.interp(target[:, 0], heightmap.x, _along_the_axis(heightmap))
        return np.asarray(np.where(np.asarray(state.leg_contact)[:, None], np.nan, target))


def _along_the_axis(heightmap: Heightmap) -> Reals:
    """Heights of the column nearest to the axis ahead [m], shape (rows,)."""
    column = int(np.argmin(np.abs(heightmap.y)))
    return np.asarray(heightmap.height).reshape(len(heightmap.x), len(heightmap.y))[:, column]
