"""Interface of a robot for the leg controller, simulated or real."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.grid import HeightGrid
from saltus.joint_command import JointCommand
from saltus.states import SensorReadings
from saltus.terrain.terrain import Terrain
from saltus.wire.messages import GroundTruth


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotReading:
    """Measurements of a robot at one instant: joints, IMU, and the torque that its drives tell."""

    measurement: SensorReadings
    joint_torque: Floats
    """Torque that the drives believe they apply [Nm], shape (12,)."""


class RobotBackend(ABC):
    """The link to one robot. All calls come from one thread, every 2 ms."""

    @property
    def concern(self) -> str:
        """Reason for which the robot had better land and stand,
        in words; empty while it need not.
        """
        return ""

    @abstractmethod
    def reset(self) -> None:
        """Connects, or puts the simulated robot where its trial starts."""

    @abstractmethod
    def read(self) -> RobotReading:
        """The newest measurement; never waits for a new one."""

    @abstractmethod
    def write(self, command: JointCommand) -> None:
        """Hands the command to the drives. A simulated robot advances by 2 ms."""

    @abstractmethod
    def close(self) -> None:
        """Lets go of the robot; drives are left damped. May be called twice."""


class CourseRobot(RobotBackend):
    """A robot of a run: it is simulated, here or elsewhere,
    so that camera and judge know the truth.
    """

    @property
    def fault(self) -> str:
        """Reason for which the robot was given up and is damped, in words;
        empty while it is not.
        """
        return ""

    @abstractmethod
    def truth(self, time_ns: int, step: int) -> GroundTruth:
        """The true state and the true terrain ahead, dated as it is asked for."""

    @abstractmethod
    def pose(self) -> tuple[Floats, Floats]:
        """True place of the base in the world [m], shape (3,), and its quaternion (w, x, y, z)."""

    @abstractmethod
    def take_trunk_contact(self) -> bool:
        """True where the trunk touched anything since the last call."""

    @abstractmethod
    def push(self, force: float) -> None:
        """Pushes the trunk along the world's y from now on [N]; 0 ends it."""


def true_grid_heights(
    terrain: Terrain, grid: HeightGrid, position: Floats, quaternion: Floats
) -> Floats:
    """True heights of a grid around a robot, relative to its base [m], shape (points,)."""
    w, x, y, z = quaternion
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return terrain.height_at(*grid.points_in_world(position, yaw)) - position[2]
