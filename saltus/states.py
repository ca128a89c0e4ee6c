"""States that robots know of themselves, with one set of names for all who know or read them.

Consumers take a protocol and name what they read: the estimator a `SensorReadings`; leg controller,
planner and heightmap network a `Proprioception`. Frames are in the names: base_in_world turns or
moves from base to world, base is in the base frame. Arrays are numpy or torch with any leading
batch dimensions (...); legs FR, FL, RR, RL, joints in the order of `saltus.robots.robot`.
"""

from dataclasses import dataclass
from types import EllipsisType
from typing import Protocol

import numpy as np

from saltus.arrays import Counts, Floats, Joints, LegFlags, PerLeg, Quaternions, Scalars, Vectors
from saltus.constants import GRAVITY, POLICY_DT
from saltus.robots.robot import Robot
from saltus.wire.messages import ControllerMode, RobotState

STILL_MPS, STILL_RAD_S = 0.05, 0.1
"""Slower than this a robot stands still of which nobody knows what it is told to do.

Noise of odometry is less, any gait is faster.
"""


class SensorReadings(Protocol):
    """Readings of IMU and encoders."""

    @property
    def quaternion_base_in_world(self) -> Quaternions:
        """(w, x, y, z), shape (..., 4)."""

    @property
    def angular_velocity_base(self) -> Vectors:
        """[rad/s], shape (..., 3)."""

    @property
    def acceleration_base(self) -> Vectors:
        """Specific force [m/s^2], shape (..., 3)."""

    @property
    def joint_position(self) -> Joints:
        """[rad], shape (..., 12)."""

    @property
    def joint_velocity(self) -> Joints:
        """[rad/s], shape (..., 12)."""


class StateEstimate(Protocol):
    """Quantities that an estimator makes of measurements."""

    @property
    def velocity_base_in_world(self) -> Vectors:
        """[m/s], shape (..., 3)."""

    @property
    def base_height(self) -> Scalars:
        """Height of the base above the feet in stance [m], shape (...)."""


class GaitSchedule(Protocol):
    """The schedule of the legs, as the gait says it."""

    @property
    def contact(self) -> LegFlags:
        """The leg is to stand, bool, shape (..., 4)."""

    @property
    def progress(self) -> PerLeg:
        """Progress of the present stance or swing, [0, 1], shape (..., 4)."""

    @property
    def trusted(self) -> LegFlags:
        """The foot may be taken to be on the ground, bool, shape (..., 4)."""

    @property
    def cycle(self) -> Counts:
        """Completed gait cycles, shape (...)."""


class Proprioception(SensorReadings, StateEstimate, Protocol):
    """All that robots know of themselves; `saltus.wire.messages.RobotState` is it for one robot."""

    @property
    def leg_contact(self) -> LegFlags:
        """See `GaitSchedule.contact`."""

    @property
    def leg_progress(self) -> PerLeg:
        """See `GaitSchedule.progress`."""

    @property
    def leg_trusted(self) -> LegFlags:
        """See `GaitSchedule.trusted`."""

    @property
    def cycle(self) -> Counts:
        """See `GaitSchedule.cycle`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorArrays:
    """A `SensorReadings` as plain arrays."""

    quaternion_base_in_world: Quaternions
    angular_velocity_base: Vectors
    acceleration_base: Vectors
    joint_position: Joints
    joint_velocity: Joints


@dataclass(frozen=True, kw_only=True, eq=False)
class ProprioceptionArrays(SensorArrays):
    """A `Proprioception` as plain arrays, at one instant of a run."""

    velocity_base_in_world: Vectors
    base_height: Scalars
    leg_contact: LegFlags
    leg_progress: PerLeg
    leg_trusted: LegFlags
    cycle: Counts
    step: int = 0
    """Policy step since the start of the run."""

    @property
    def time_s(self) -> float:
        """Since the start of the run."""
        return self.step * POLICY_DT


ANY_STATES = ProprioceptionArrays(
    quaternion_base_in_world=np.zeros(4), angular_velocity_base=np.zeros(3),
    acceleration_base=np.zeros(3), joint_position=np.zeros(12), joint_velocity=np.zeros(12),
    velocity_base_in_world=np.zeros(3), base_height=0.0, leg_contact=np.zeros(4, np.bool_),
    leg_progress=np.zeros(4), leg_trusted=np.zeros(4, np.bool_), cycle=0.0,
)  # fmt: skip
"""States of one robot, for laws that are compiled by an example (`saltus.straight_line`)."""


def states_of(
    measurement: SensorReadings, estimate: StateEstimate, schedule: GaitSchedule, step: int = 0
) -> ProprioceptionArrays:
    """Puts together what sensors, estimator and gait know
    of the same robots at the same instant.
    """
    return ProprioceptionArrays(
        quaternion_base_in_world=measurement.quaternion_base_in_world,
        angular_velocity_base=measurement.angular_velocity_base,
        acceleration_base=measurement.acceleration_base,
        joint_position=measurement.joint_position,
        joint_velocity=measurement.joint_velocity,
        velocity_base_in_world=estimate.velocity_base_in_world,
        base_height=estimate.base_height,
        leg_contact=schedule.contact,
        leg_progress=schedule.progress,
        leg_trusted=schedule.trusted,
        cycle=schedule.cycle,
        step=step,
    )


def robot_state_message(
    states: Proprioception,
    robot: int | EllipsisType = ...,
    *,
    time_ns: int,
    step: int,
    mode: ControllerMode,
    joint_torque: Floats | None = None,
    depth_due: int = -1,
) -> RobotState:
    """Message of one robot of a batch, or of the only one, at a policy step.

    Times are as in `RobotState`.

    Drives believe in `joint_torque` [Nm], shape (12,), zero where nobody asks. `depth_due` is the
    newest image that is due.
    """
    return RobotState(
        time_ns=time_ns,
        step=step,
        quaternion_base_in_world=states.quaternion_base_in_world[robot],
        angular_velocity_base=states.angular_velocity_base[robot],
        acceleration_base=states.acceleration_base[robot],
        joint_position=states.joint_position[robot],
        joint_velocity=states.joint_velocity[robot],
        joint_torque=np.zeros(12) if joint_torque is None else joint_torque,
        velocity_base_in_world=states.velocity_base_in_world[robot],
        base_height=float(states.base_height[robot]),
        leg_contact=states.leg_contact[robot],
        leg_progress=states.leg_progress[robot],
        leg_trusted=states.leg_trusted[robot],
        cycle=int(states.cycle[robot]),
        mode=mode,
        depth_due=depth_due,
    )


def is_still(velocity: Vectors, angular_velocity: Vectors) -> bool:
    """True where the base of one robot rests.

    Args:
        velocity: Of the base, in any frame [m/s], shape (3,).
        angular_velocity: The same, turning [rad/s].
    """
    turning = float(np.linalg.norm(angular_velocity))
    return float(np.linalg.norm(velocity)) < STILL_MPS and turning < STILL_RAD_S


def standing_state(robot: Robot) -> RobotState:
    """A robot that stands still on level ground, at step 0."""
    return RobotState(
        time_ns=0,
        step=0,
        quaternion_base_in_world=np.array([1.0, 0.0, 0.0, 0.0]),
        angular_velocity_base=np.zeros(3),
        acceleration_base=np.array([0.0, 0.0, GRAVITY]),
        joint_position=robot.stand_pose,
        joint_velocity=np.zeros(12),
        joint_torque=np.zeros(12),
        velocity_base_in_world=np.zeros(3),
        base_height=robot.stand_height,
        leg_contact=np.ones(4, dtype=np.bool_),
        leg_progress=np.zeros(4),
        leg_trusted=np.ones(4, dtype=np.bool_),
        cycle=0,
        mode=ControllerMode.STAND,
        depth_due=-1,
    )
