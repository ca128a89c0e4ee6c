"""A Go2 over DDS, behind the interface of a robot:
what it says is checked, and what it is told, too.
"""

import time

import numpy as np

from saltus.clock import RunClock
from saltus.controller.robot.backend import RobotBackend, RobotReading
from saltus.controller.robot.unitree.drives import command_message, reading_of
from saltus.controller.robot.unitree.limits import StageLimits
from saltus.controller.robot.unitree.link import COMMANDS, STATES, UnitreeLink
from saltus.controller.robot.unitree.messages import LOW_COMMAND, UnitreeMessage
from saltus.controller.robot.unitree.states import LinkHealth, StateWatch
from saltus.errors import StackError
from saltus.joint_command import JointCommand
from saltus.robots.robot import Robot

CONNECT_S = 10.0
"""Participants of DDS find each other within a second; a busy computer takes several."""
ANSWER_S = 20.0  # lockstep: longer than anything but a simulation that has died
WAIT_S = 0.1  # how often a wait looks at the clock


class UnitreeRobot(RobotBackend):
    """One Unitree robot on DDS: the backend that commands it and reads its states.

    From a loss of its states on it is told to damp, whatever it should do; while another program
    commands it, it is told nothing at all. A loss holds until `reset`.

    Args:
        link: To the robot; it sends commands and takes states.
        robot: Its kind.
        clock: The run's: ages are judged in it.
        limits: Limits on what it does; beyond them it is damped, too.
        lockstep: Waits for the answer to each command, of a simulated robot that waits, too.
        trusting: Takes what states say as it is, of a peer that only echoes commands: no angle that
            leaps, motor that is hot or empty battery ends the run.
    """

    def __init__(
        self,
        link: UnitreeLink,
        robot: Robot,
        clock: RunClock | None = None,
        *,
        limits: StageLimits | None = None,
        lockstep: bool = False,
        trusting: bool = False,
    ) -> None:
        self._link, self._robot, self._clock = link, robot, clock or RunClock()
        self._limits, self._lockstep = limits, lockstep
        self._judged = None if trusting else robot
        self._watch = StateWatch(self._judged)
        self._told = self._awaited = False

    @property
    def fault(self) -> str:
        """Why the robot is damped, in words; empty while it is not."""
        return self._watch.fault

    @property
    def concern(self) -> str:
        """See `RobotBackend.concern`."""
        return self._watch.concern

    @property
    def health(self) -> LinkHealth:
        """Counts so far."""
        return self._watch.health

    @property
    def message(self) -> UnitreeMessage:
        """The newest state, shape ().

        Raises:
            StackError: none has come.
        """
        if self._watch.message is None:
            raise StackError("no state has come from the robot: `reset` connects to it")
        return self._watch.message

    def reset(self) -> None:
        """Waits until the robot says states.

        Raises:
            StackError: none come, or another program commands the robot.
        """
        self._watch, self._awaited = StateWatch(self._judged), False
        begin_s = time.monotonic()
        while self._watch.message is None or not self._link.has_met_all:
            if time.monotonic() > begin_s + CONNECT_S:
                bad = self.health.bad
                seen = f", only {sum(bad.values())} that are damaged" if bad else ""
                raise StackError(
                    f"no states (rt/lowstate) came from the robot in {CONNECT_S:g} s{seen}: is it "
                    "on, and --interface the one that it hangs on?"
                )
            self._link.wait(STATES, WAIT_S)
            self._take()
        self._refuse_others()

    def read(self) -> RobotReading:
        """The newest measurement; in lockstep that after the last command."""
        self._take()
        if self._lockstep:
            self._await()
        else:
            self._watch.judge(self._clock.elapsed_s())
        reading = reading_of(self.message, self._robot)
        if self._limits is not None and (beyond := self._limits.exceeded(reading, self._robot)):
            self._watch.lose(beyond)
        return reading

    def write(self, command: JointCommand) -> None:
        """Sends the command, or damping after a fault.

        Raises:
            StackError: another program commands the robot. Nothing is sent then.
        """
        self._refuse_others()
        if not all(np.isfinite(values).all() for values in vars(command).values()):
            self._watch.lose("the command is not finite")
        self._tell(self._damping() if self.fault else command)
        self._told = self._awaited = True

    def relax(self) -> None:
        """Leaves the robot damped, if it was commanded and no other program does it now."""
        if self._told and not self._link.others(COMMANDS):
            self._tell(self._damping())
        self._told = False

    def close(self) -> None:
        """Leaves the robot damped, as `relax`, and its domain."""
        self.relax()
        self._link.close()

    def _take(self) -> None:
        payloads = [arrived.payload for arrived in self._link.take(STATES)]
        if self._watch.take(payloads, self._clock.elapsed_s()):
            self._awaited = False

    def _await(self) -> None:
        until_s = time.monotonic() + ANSWER_S
        while self._awaited:
            if time.monotonic() > until_s:
                raise StackError(
                    f"the simulated robot has not answered for {ANSWER_S:g} s: does it run with "
                    "--pace lockstep, too?"
                )
            self._link.wait(STATES, WAIT_S)
            self._take()

    def _tell(self, command: JointCommand) -> None:
        self._link.send(COMMANDS, LOW_COMMAND.sealed(command_message(command, self._robot)))

    def _refuse_others(self) -> None:
        if others := self._link.others(COMMANDS):
            raise StackError(
                f"the robot is commanded by {' and '.join(others)}: nothing is sent to it; end "
                "that program; the robot's own motion service is released by `saltus robot run`"
            )

    def _damping(self) -> JointCommand:
        zero = np.zeros(12)
        damping = np.full(12, self._robot.gains.damp_kd)
        return JointCommand(position=zero, velocity=zero, kp=zero, kd=damping, torque=zero)
