"""Sensors of a simulated robot: the truth, and noise."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.effects.imu import ImuReading
from saltus.real2sim.experiments.motions import Commands
from saltus.real2sim.problem.rotations import turned
from saltus.recordings.run_log import JointTable, Table
from saltus.sim.state import PlantState


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """Standard deviations of white noise, as of small quadrupeds whose base is tracked by motion capture."""

    q_rad: float = 1e-3
    dq_rad_s: float = 0.05
    tau_nm: float = 0.2
    gyro_rad_s: float = 0.01
    acc_m_s2: float = 0.1
    orientation_rad: float = 0.002
    base_position_m: float = 0.0003
    base_orientation_rad: float = 0.0005
    velocity_m_s: float = 0.02
    foot_n: float = 2.0


class Instruments:
    """Sensors with noise."""

    def __init__(self, noise: SensorNoise, rng: np.random.Generator) -> None:
        self._noise = noise
        self._rng = rng

    def joints(
        self,
        time_s: Floats,
        states: Sequence[PlantState],
        sent: Sequence[tuple[Commands, int]],
        believed: Sequence[Floats],
    ) -> JointTable:
        """Returns what encoders measured, and what commands were sent and what drives believed.

        Args:
            time_s: Of the rows, shape (n,).
            states: Of the robot.
            sent: Commands and the tick of them that was sent.
            believed: Torque by the drives' own law [Nm], each of shape (12,).
        """
        return JointTable(
            time_s=time_s,
            q=self._noisy(_stacked(states, "joint_position"), self._noise.q_rad),
            dq=self._noisy(_stacked(states, "joint_velocity"), self._noise.dq_rad_s),
            q_des=np.array([commands.q_des[tick] for commands, tick in sent]),
            dq_des=np.array([commands.dq_des[tick] for commands, tick in sent]),
            tau_ff=np.array([commands.tau_ff[tick] for commands, tick in sent]),
            tau_est=self._noisy(np.array(believed), self._noise.tau_nm),
        )

    def imu(self, time_s: Floats, readings: Sequence[ImuReading]) -> Table:
        """The table `imu` of a run log."""
        noise = self._noise
        columns = [
            self._tilted(_stacked(readings, "quaternion_base_in_world"), noise.orientation_rad),
            self._noisy(_stacked(readings, "angular_velocity_base"), noise.gyro_rad_s),
            self._noisy(_stacked(readings, "acceleration_base"), noise.acc_m_s2),
        ]
        return Table(time_s=time_s, values=np.concatenate(columns, axis=1))

    def base(self, time_s: Floats, states: Sequence[PlantState]) -> Table:
        """The table `base` of a run log: motion capture."""
        noise = self._noise
        columns = [
            self._noisy(_stacked(states, "position_base_in_world"), noise.base_position_m),
            self._tilted(_stacked(states, "quaternion_base_in_world"), noise.base_orientation_rad),
            self._noisy(_stacked(states, "velocity_base_in_world"), noise.velocity_m_s),
        ]
        return Table(time_s=time_s, values=np.concatenate(columns, axis=1))

    def feet(self, time_s: Floats, states: Sequence[PlantState]) -> Table:
        """The table `feet` of a run log."""
        return Table(time_s=time_s, values=self._noisy(_stacked(states, "foot_force"), self._noise.foot_n))

    def _noisy(self, values: Floats, sigma: float) -> Floats:
        return values + sigma * self._rng.standard_normal(values.shape)

    def _tilted(self, quaternion: Floats, sigma_rad: float) -> Floats:
        """Quaternions (n, 4) turned by small random rotations."""
        return turned(quaternion, sigma_rad * self._rng.standard_normal((len(quaternion), 3)))


def _stacked(samples: Sequence[PlantState] | Sequence[ImuReading], name: str) -> Floats:
    return np.array([getattr(sample, name) for sample in samples], dtype=np.float64)
