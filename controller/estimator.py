"""Velocity and height of the base from IMU and stance legs: the Kalman filter of the original.

The state is the velocity of the base in the world and the height of its centre over the feet in
stance; the input is the rotated accelerometer; the measurement is the mean over trusted legs of
what a foot at rest says about the base. All matrices of the original are diagonal, so the filter
falls apart into four scalar filters: no inverse is needed. Yaw and attitude come from the IMU's
quaternion as they are.
"""

from dataclasses import dataclass

from saltus.arrays import (
    Array,
    Constant,
    LegFlags,
    MotionEstimates,
    Rotations,
    Scalars,
    Vectors,
    namespace,
)
from saltus.constants import GRAVITY, PHYSICS_DT
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.rotations import rotation_matrix, skew
from saltus.states import SensorReadings

_TINY = 1e-12
_GRAVITY = Constant([0.0, 0.0, -GRAVITY])


_PROCESS_VARIANCE = Constant([1.42e-5, 1.58e-5, 8.75e-5, 2e-5])
"""Noise that each 2 ms tick adds to vx, vy, vz, height [(m/s)^2, m^2]; original."""
_MEASUREMENT_VARIANCE = Constant([0.337 * 0.03, 0.1486 * 0.03, 0.684 * 0.03, 0.68 * 0.03])
"""Noise of what legs say of them, in the same order; original."""
_REST_SPEED_MPS = 0.3
"""A trusted foot that moves in the world by the prediction is believed less: half at this speed
(Cauchy weight). Not in the original. Feet slip and land late; measured over bounding at 1 m/s, in
most of three runs the error of forward velocity fell from 0.10-0.21 to 0.05-0.10 m/s (RMS)."""
_INITIAL_VARIANCE = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimatorState:
    """State of the velocity and height estimator (a Kalman filter) between ticks."""

    mean: MotionEstimates
    """Velocity in the world [m/s] and height [m], shape (..., 4)."""
    variance: MotionEstimates
    """Shape (..., 4)."""

    @property
    def velocity_base_in_world(self) -> Vectors:
        """[m/s], shape (..., 3)."""
        return self.mean[..., :3]

    @property
    def base_height(self) -> Scalars:
        """Over the feet in stance [m], shape (...)."""
        return self.mean[..., 3]


class Estimator:
    """Kalman filter over IMU and stance legs."""

    def __init__(self, robot: Robot) -> None:
        self._kinematics, self._foot_radius = LegKinematics(robot), robot.foot_radius
        self._start = Constant([0.0, 0.0, 0.0, robot.stand_height])

    def init(self, batch: tuple[int, ...], like: Array) -> EstimatorState:
        """State of robots that stand still; arrays of the kind of `like`."""
        xp = namespace(like)
        zeros = xp.zeros((*batch, 4), dtype=like.dtype, device=like.device)
        return EstimatorState(
            mean=zeros + self._start.like(like), variance=zeros + _INITIAL_VARIANCE
        )

    def step(
        self, measured: SensorReadings, trusted: LegFlags, state: EstimatorState
    ) -> EstimatorState:
        """One tick of 2 ms.

        Legs that are `trusted`, bool, shape (..., 4), are known to stand (as the gait says).
        """
        xp = namespace(state.mean)
        rotation = rotation_matrix(measured.quaternion_base_in_world)
        acceleration = (rotation @ measured.acceleration_base[..., None])[..., 0] + _GRAVITY.like(
            state.mean
        )
        change = xp.concat([acceleration, state.mean[..., 2:3]], axis=-1) * PHYSICS_DT
        mean, variance = state.mean + change, state.variance + _PROCESS_VARIANCE.like(state.mean)

        measurement, weight = self._legs(measured, rotation, trusted, mean[..., :3])
        noise = _MEASUREMENT_VARIANCE.like(mean)
        # Noise / weight is the variance of what legs say
        gain = variance * weight / (variance * weight + noise)
        return EstimatorState(
            mean=mean + gain * (measurement - mean), variance=variance * (1.0 - gain)
        )

    def _legs(
        self, measured: SensorReadings, rotation: Rotations, trusted: LegFlags, velocity: Vectors
    ) -> tuple[MotionEstimates, Array]:
        """Velocity and height of the base by the trusted feet,
        (..., 4), and how far to believe them, (..., 1).
        """
        xp = namespace(rotation)
        foot, jacobian = self._kinematics.position_and_jacobian(measured.joint_position)
        joint = measured.joint_velocity.reshape((*foot.shape, 1))
        relative = (jacobian @ joint)[..., 0] + foot @ skew(measured.angular_velocity_base).mT
        by_foot = -(relative @ rotation.mT)
        height = self._foot_radius - foot @ rotation[..., 2, :, None]
        slip = (by_foot - velocity[..., None, :]) * (1.0 / _REST_SPEED_MPS)
        rest = 1.0 / (1.0 + xp.sum(slip * slip, axis=-1, keepdims=True))
        weight = xp.where(trusted[..., None], rest, xp.zeros_like(rest))
        total = xp.clip(xp.sum(weight, axis=-2), _TINY, None)
        count = xp.sum(
            xp.where(trusted[..., None], xp.ones_like(rest), xp.zeros_like(rest)), axis=-2
        )
        mean = xp.sum(xp.concat([by_foot, height], axis=-1) * weight, axis=-2) / total
        return mean, xp.sum(weight, axis=-2) / xp.clip(count, 1.0, None)
