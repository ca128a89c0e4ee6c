"""Interface of a robot for the leg controller, simulated or real."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from saltus.arrays import Floats
from saltus.joint_command import JointCommand
from saltus.states import Measurement


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """Measurements of a robot at one instant."""

    measurement: Measurement
    joint_torque: Floats
    """Torque that the drives believe they apply [Nm], shape (12,)."""


class RobotBackend(ABC):
    """The link to one robot. All calls come from one thread, every 2 ms."""

    @abstractmethod
    def reset(self) -> None:
        """Connects, or puts the simulated robot where its trial starts."""

    @abstractmethod
    def read(self) -> Reading:
        """The newest measurement; never waits for a new one."""

    @abstractmethod
    def write(self, command: JointCommand) -> None:
        """Hands the command to the drives. A simulated robot advances by 2 ms."""

    @abstractmethod
    def close(self) -> None:
        """Lets go of the robot; drives are left damped. May be called twice."""
