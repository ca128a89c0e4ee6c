"""Limits of a stage: what a robot may do before it is given up and damped."""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.controller.robot.backend import RobotReading
from saltus.robots.robot import JOINTS, Robot


@dataclass(frozen=True, kw_only=True)
class StageLimits:
    """Limits of one stage (stand, bound, course) on torque, speed and power of a robot that is
    commanded over DDS.
    """

    torque_share: float
    """Share of a joint's torque limit, for the torque in the drive's own belief, which does not
    know that it saturates."""
    speed_share: float
    """Share of a joint's speed limit."""
    power_w: float
    """Power of all joints together [W]."""

    def exceeded(self, reading: RobotReading, robot: Robot) -> str:
        """Says what is beyond its limit; empty if nothing is."""
        speed = reading.measurement.joint_velocity
        return (
            _beyond(reading.joint_torque, self.torque_share * robot.torque_limit, "Nm")
            or _beyond(speed, self.speed_share * robot.speed_limit, "rad/s")
            or self._power(float(reading.joint_torque @ speed))
        )

    def _power(self, power_w: float) -> str:
        if power_w <= self.power_w:
            return ""
        return f"the joints take {power_w:.0f} W; this stage allows {self.power_w:.0f} W"


STAGES = {
    "stand": StageLimits(torque_share=0.6, speed_share=0.5, power_w=200.0),
    "bound": StageLimits(torque_share=2.0, speed_share=1.5, power_w=2000.0),
}
"""Limits by stage: about twice what the simulated Go2 needs (docs/robot.md), and of speeds half as
much again as the joints can do: a drive whose sign or gains are wrong exceeds that."""
COURSE = StageLimits(torque_share=4.0, speed_share=2.0, power_w=2800.0)
"""Limits for a robot that walks and jumps on a course: where it lands behind a gap of 0.80 m the
ground turns its knees at 1.5 times their rated speed, and they are told to resist it."""


def _beyond(values: Floats, limits: Floats, unit: str) -> str:
    joint = int(np.argmax(np.abs(values) / limits))
    if abs(values[joint]) <= limits[joint]:
        return ""
    return (
        f"{JOINTS[joint]} is at {values[joint]:+.1f} {unit}; this stage allows "
        f"{limits[joint]:.1f} {unit}"
    )
