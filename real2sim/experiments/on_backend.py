"""An experiment on a robot behind any backend, which hangs with its feet in the air."""

import numpy as np

from saltus.constants import PHYSICS_DT
from saltus.controller.robot.backend import RobotBackend
from saltus.errors import ConfigError
from saltus.joint_command import JointCommand
from saltus.real2sim.experiments.menu import EXPERIMENTS, Experiment, experiment_named
from saltus.robots.robot import Robot
from saltus.wire.messages import ControllerMode

LED_S = 2.0
"""Joints are led to where the motion begins in this, and held there for half of it."""


def held_experiment(name: str) -> Experiment:
    """An experiment of a robot that is held, by its name.

    Raises:
        ConfigError: there is none of this name, or it needs the ground.
    """
    experiment = experiment_named(name)
    if experiment.base != "fixed":
        held = ", ".join(each.name for each in EXPERIMENTS.values() if each.base == "fixed")
        raise ConfigError(f"{name} needs the ground; a robot that hangs can be moved by: {held}")
    return experiment


class ExperimentRun:
    """One experiment's motion on a robot, one call every 2 ms.

    Args:
        backend: The robot, which has been reset.
        robot: Its kind.
        experiment: One of a robot that is held.

    Raises:
        UnsafeMotionError: the motion would leave its limits; from `step`, too, where the robot has.
    """

    def __init__(self, backend: RobotBackend, robot: Robot, experiment: Experiment) -> None:
        self._backend, self._robot, self._limits = backend, robot, experiment.limits
        self._kp, self._kd = experiment.gains(robot)
        commands = [section.commands for section in experiment.sections(robot)]
        for each in commands:
            self._limits.check_commands(robot, each, self._kp)
        start, first = backend.read().measurement.joint_position, commands[0].q_des[0]
        led = np.linspace(0.0, 1.5, round(1.5 * LED_S / PHYSICS_DT))[:, None].clip(max=1.0)
        lead = start + (first - start) * 0.5 * (1.0 - np.cos(np.pi * led))
        still = np.zeros_like(lead)
        self._position = np.concatenate([lead, *(each.q_des for each in commands)])
        self._velocity = np.concatenate([still, *(each.dq_des for each in commands)])
        self._torque = np.concatenate([still, *(each.tau_ff for each in commands)])
        self._begins = len(lead)
        self._ticks = 0
        self._halted = False
        self.peak_power_w = 0.0
        """Greatest power of all joints together so far, by the drives' own torque [W]."""

    @property
    def mode(self) -> ControllerMode:
        """DAMP once it is halted."""
        return ControllerMode.DAMP if self._halted else ControllerMode.STAND

    @property
    def time_s(self) -> float:
        """Since the start [s]."""
        return self._ticks * PHYSICS_DT

    @property
    def duration_s(self) -> float:
        """Length of the whole motion, with the way to where it begins [s]."""
        return len(self._position) * PHYSICS_DT

    def step(self, *, halt: bool = False) -> None:
        """Senses and commands; with `halt`, and from then on, the joints are damped.

        Raises:
            StackError: another program commands the robot.
        """
        reading = self._backend.read()
        self._halted |= halt
        if self._halted:
            self._backend.write(self._damping())
            self._ticks += 1
            return
        measured = reading.measurement
        power_w = float(reading.joint_torque @ measured.joint_velocity)
        self.peak_power_w = max(self.peak_power_w, power_w)
        if self._ticks >= self._begins:
            self._limits.check_state(
                self._robot, self.time_s, measured.quaternion_base_in_world,
                measured.joint_position, measured.joint_velocity,
            )  # fmt: skip
        row, one = min(self._ticks, len(self._position) - 1), np.ones(12)
        self._backend.write(JointCommand(
            position=self._position[row], velocity=self._velocity[row], torque=self._torque[row],
            kp=self._kp * one, kd=self._kd * one,
        ))  # fmt: skip
        self._ticks += 1

    def _damping(self) -> JointCommand:
        zero = np.zeros(12)
        damping = np.full(12, self._robot.gains.damp_kd)
        return JointCommand(position=zero, velocity=zero, torque=zero, kp=zero, kd=damping)
