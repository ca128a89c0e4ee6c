"""Safety of a robot in an experiment: a motion is checked before it runs,
the robot while it moves.
"""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.errors import SaltusError
from saltus.real2sim.experiments.motions import ExperimentCommands
from saltus.robots.robot import JOINTS, Robot
from saltus.rotations import roll_pitch_yaw, rotation_matrix

RUNAWAY = 1.5
"""Share of a joint's published speed limit at which a robot is stopped: a drive that works cannot
exceed its limit by that much, one whose sign or gains are wrong does."""


class UnsafeMotionError(SaltusError):
    """A motion that would leave its limits, or a robot that has."""


@dataclass(frozen=True, kw_only=True)
class ExperimentLimits:
    """Limits of an experiment for a robot."""

    margin_rad: float = 0.05
    """Kept from the ends of every joint's range: 3 degrees, as the original keeps for swing
    legs."""
    speed_share: float = 1.0
    """Share of the published speed limits of the joints."""
    torque_share: float = 1.0
    """Share of the published torque limits, for the torque that the drives are asked for."""
    tilt_rad: float = 0.5
    """Roll and pitch of the base: half way to where a robot on four straight legs falls."""

    def in_words(self) -> str:
        """The limits in a line."""
        return (
            f"keeps {self.margin_rad:g} rad from the ends of joints, asks for at most "
            f"{self.speed_share:.0%} of their "
            f"speed and {self.torque_share:.0%} of their torque, stops beyond {self.tilt_rad:g} "
            "rad of tilt"
        )

    def check_commands(self, robot: Robot, commands: ExperimentCommands, kp: float) -> None:
        """Refuses commands that ask for angles, speeds or torques beyond the limits.

        With the stiffness `kp` [Nm/rad] a jump of the desired angle asks for a torque, too.

        Raises:
            UnsafeMotionError: names the joint, the value and what is allowed.
        """
        low, high = robot.joint_lower + self.margin_rad, robot.joint_upper - self.margin_rad
        excess = np.maximum(low - commands.q_des, commands.q_des - high).max(axis=0)
        self._refuse(
            excess,
            commands.q_des,
            "is asked for an angle [rad]",
            f"{self.margin_rad} rad inside its range",
        )
        speed = np.abs(commands.dq_des) - self.speed_share * robot.speed_limit
        self._refuse(
            speed.max(axis=0),
            commands.dq_des,
            "is asked for a speed [rad/s]",
            f"{self.speed_share:.0%} of its limit",
        )
        jump = np.abs(np.diff(commands.q_des, axis=0, prepend=commands.q_des[:1]))
        asked = np.abs(commands.tau_ff) + kp * jump
        torque = (asked - self.torque_share * robot.torque_limit).max(axis=0)
        self._refuse(
            torque, asked, "is asked for a torque [Nm]", f"{self.torque_share:.0%} of its limit"
        )

    def check_state(
        self, robot: Robot, time_s: float, quaternion: Floats, position: Floats, velocity: Floats
    ) -> None:
        """Stops a robot that leaves the limits.

        Args:
            robot: Whose limits these are.
            time_s: Of the experiment, for the message.
            quaternion: (w, x, y, z), base to world, shape (4,).
            position: Of the joints, measured [rad], shape (12,).
            velocity: The same [rad/s].

        Raises:
            UnsafeMotionError: names what was left, by how much, and when.
        """
        outside = np.maximum(robot.joint_lower - position, position - robot.joint_upper)
        joint = int(outside.argmax())
        if outside[joint] > 0.0:
            raise UnsafeMotionError(
                f"stopped at {time_s:.2f} s: {JOINTS[joint]} is at {position[joint]:.2f} rad, its "
                "range is "
                f"{robot.joint_lower[joint]:.2f} to {robot.joint_upper[joint]:.2f}"
            )
        fast = np.abs(velocity) / robot.speed_limit
        if fast.max() > RUNAWAY:
            joint = int(fast.argmax())
            raise UnsafeMotionError(
                f"stopped at {time_s:.2f} s: {JOINTS[joint]} moves at {velocity[joint]:.1f} rad/s, "
                f"more than {RUNAWAY:g} times its limit"
            )
        roll, pitch, _ = roll_pitch_yaw(rotation_matrix(quaternion))
        if max(abs(float(roll)), abs(float(pitch))) > self.tilt_rad:
            raise UnsafeMotionError(
                f"stopped at {time_s:.2f} s: the base tilts by {float(roll):.2f} rad (roll) and "
                f"{float(pitch):.2f} rad "
                f"(pitch); at most {self.tilt_rad} rad is allowed"
            )

    def _refuse(self, excess: Floats, values: Floats, what: str, allowed: str) -> None:
        if np.all(excess <= 0.0):
            return
        joint = int(excess.argmax())
        worst = values[np.abs(values[:, joint]).argmax(), joint]
        raise UnsafeMotionError(f"{JOINTS[joint]} {what} of {worst:.2f}; allowed is {allowed}")
