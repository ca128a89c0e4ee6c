"""Our side and robots in processes of their own, over DDS on the loopback interface."""

import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from unitree_processes import simulated

from benchmarks.unitree_link.command import LOOPBACK, compiled, own_domain
from benchmarks.unitree_link.in_memory import ROBOT, tick
from saltus.clock import RunClock
from saltus.controller.control_loop import ControlLoop
from saltus.controller.robot.unitree.link import COMMANDS, STATES, TRUTHS, UnitreeLink
from saltus.controller.robot.unitree.robot import UnitreeRobot
from saltus.controller.robot.unitree.serving import OtherCommander
from saltus.errors import StackError
from saltus.joint_command import JointCommand

PATIENCE_S = 60.0
SLOW = 0.02  # seconds of the robot for each of the computer, which others may keep busy


@pytest.fixture
def link() -> Iterator[UnitreeLink]:
    takes = [STATES, TRUTHS]
    made = UnitreeLink(own_domain(), "lo", sends=[COMMANDS], takes=takes, reliable=True)
    yield made
    made.close()


def random_command(rng: np.random.Generator) -> JointCommand:
    return JointCommand(**{
        name: rng.normal(size=12) for name in ("position", "velocity", "kp", "kd", "torque")
    })  # fmt: skip


def test_a_peer_on_cyclone_0_10_takes_every_command_and_survives(
    link: UnitreeLink, tmp_path: Path
) -> None:
    """A type of Cyclone 11's own would end it, and another checksum or layout would be refused."""
    count, rng = 500, np.random.default_rng(4)
    peer = [str(compiled(tmp_path, "peer")), str(own_domain()), str(count)]
    environment = os.environ | {"CYCLONEDDS_URI": LOOPBACK}
    robot = UnitreeRobot(link, ROBOT, lockstep=True, trusting=True)
    with subprocess.Popen(peer, stdout=subprocess.PIPE, text=True, env=environment) as other:
        robot.reset()
        for _ in range(count):
            command = random_command(rng)
            robot.write(command)
            reading = robot.read()
            np.testing.assert_allclose(
                reading.measurement.joint_position, command.position, rtol=1e-6
            )
            np.testing.assert_allclose(reading.joint_torque, command.torque, rtol=1e-6)
        told, _ = other.communicate(timeout=PATIENCE_S)
        assert other.returncode == 0
    assert told.split() == ["812", "1180", str(count), "0"]
    assert robot.health.lost == 0
    assert set(robot.health.bad) <= {"old"}  # what it said before it was spoken to


def test_a_simulated_robot_stands_in_step_with_commands(link: UnitreeLink) -> None:
    with simulated(own_domain(), "--pace", "lockstep", "--seconds", "0.6") as process:
        robot, loop = UnitreeRobot(link, ROBOT, lockstep=True), ControlLoop(ROBOT, tick())
        robot.reset()
        for _ in range(300):
            loop.sense(robot.read())
            robot.write(loop.act(None, np.inf))
        reading = robot.read()
        told, _ = process.communicate(timeout=PATIENCE_S)
    assert told.startswith("0.6 s, 300 commands, 0 refused; its base is at (")
    np.testing.assert_allclose(reading.measurement.joint_position, ROBOT.stand_pose, atol=0.1)
    assert int(robot.message["tick"]) == 600
    assert robot.health.lost == 0


@pytest.mark.slow
def test_a_robot_that_falls_silent_is_damped_in_the_runs_clock() -> None:
    link = UnitreeLink(own_domain(), "lo", sends=[COMMANDS], takes=[STATES])
    with simulated(own_domain(), "--speed", str(SLOW), "--fault", "silent@0.1"):
        clock = RunClock(speed=SLOW)
        robot = UnitreeRobot(link, ROBOT, clock)
        robot.reset()
        zero = np.zeros(12)
        until_s = time.monotonic() + PATIENCE_S
        while not robot.fault and time.monotonic() < until_s:
            time.sleep(0.02)  # as many commands as it can be sent keep the other process busy
            before_s = clock.elapsed_s()
            reading = robot.read()
            robot.write(JointCommand(
                position=reading.measurement.joint_position, velocity=zero, torque=zero,
                kp=zero + 20.0, kd=zero + 1.0,
            ))  # fmt: skip
        assert "no new state has come" in robot.fault
        waited_ms = float(robot.fault.split()[-2])
        assert waited_ms < 50 + 1000 * (clock.elapsed_s() - before_s) + 2
        assert (
            int(robot.message["tick"]) <= 98
        )  # the last before it; a busy computer is silent sooner
    robot.close()


def test_a_stranger_is_named_and_nothing_is_sent(link: UnitreeLink) -> None:
    """The stranger is in the process of the simulated robot,
    which tells how many commands came, and whose.
    """
    with simulated(own_domain(), "--speed", "0.5", "--fault", "foreign") as process:
        listener = UnitreeLink(own_domain(), "lo", takes=[COMMANDS])
        robot = UnitreeRobot(link, ROBOT)
        until_s = time.monotonic() + PATIENCE_S
        while not link.others(COMMANDS) and time.monotonic() < until_s:
            time.sleep(0.01)
        with pytest.raises(StackError, match=rf"commanded by python.*process {process.pid} on"):
            robot.reset()
        with pytest.raises(StackError, match="nothing is sent"):
            robot.write(random_command(np.random.default_rng(0)))
        own = OtherCommander(ROBOT, own_domain(), "lo").payload
        heard: list[bytes] = []
        while len(heard) < 50 and time.monotonic() < until_s:
            heard += [arrived.payload for arrived in listener.take(COMMANDS)]
        listener.close()
    assert len(heard) >= 50
    assert set(heard) == {own}


def test_a_wrong_place_is_told() -> None:
    with pytest.raises(StackError, match="domain 233: allowed is 0 to 232"):
        UnitreeLink(233)
    for wrong in ("", "lo'/><x", "a-name-of-too-many-letters"):
        with pytest.raises(StackError, match="network interface"):
            UnitreeLink(own_domain(), wrong)
    with pytest.raises(StackError, match="over nowhere0"):
        UnitreeLink(own_domain(), "nowhere0")
