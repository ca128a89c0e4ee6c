"""Laws of a robot on DDS: what is taken over and told, and what happens when something is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.unitree_link.in_memory import ROBOT, Run, Wire, simulated
from saltus.controller.robot.unitree.drives import (
    command_message,
    reading_of,
    unitree_command,
    unitree_state_message,
)
from saltus.controller.robot.unitree.faults import AT_A_JOINT, KINDS, PlantedFault
from saltus.controller.robot.unitree.messages import (
    LOW_COMMAND,
    LOW_STATE,
    MOTORS,
    SERVO,
    UnitreeMessage,
)
from saltus.controller.robot.unitree.robot import UnitreeRobot
from saltus.controller.robot.unitree.states import StateWatch
from saltus.errors import ConfigError, StackError
from saltus.joint_command import JointCommand
from saltus.robots.robot import JOINTS, Robot
from saltus.states import SensorArrays

DAMPED_S = 0.110
"""A fault may take so long until the robot is damped."""
LOSSES = {
    "silent": "no new state has come", "frozen": "no new state has come",
    "crc": "no new state has come", "stuck": "states say the same", "tick": "clock has leapt",
    "button": "a button of the remote",
}  # fmt: skip
"""Faults after which a robot is given up, and the words in which it is said."""
BORNE = {
    "lost": "missing at 4 places", "slow": "missing at 4 places", "late": "states come",
    "hot": "the motor of FR_hip is at 95 degrees", "battery": "its battery is at 4 %",
    "dead": "the motor of FR_hip says that it is off",
}  # fmt: skip
"""Faults with which a robot can still land and stand, and the words in which they are said."""
LEAPS = {"sign": " leaps by ", "offset": " leaps by ", "imu": "its attitude leaps by 20 degrees"}
"""Faults that make what a robot says of itself leap."""


def turned(signs: int) -> Robot:
    """A robot whose joints count as the bits say."""
    sign = np.where(signs >> np.arange(12) & 1, 1.0, -1.0)
    return replace(ROBOT, joint_sign=sign)


@pytest.mark.parametrize("seed", range(20))
def test_commands_and_states_come_out_as_they_went_in(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = turned(int(rng.integers(1 << 12)))
    names = ("position", "velocity", "kp", "kd", "torque")
    command = JointCommand(**{name: rng.normal(size=12) for name in names})
    sent = LOW_COMMAND.read([LOW_COMMAND.sealed(command_message(command, robot))])[0]
    assert (sent["motor_cmd"]["mode"] == [SERVO] * MOTORS + [0] * 8).all()
    for name in names:
        np.testing.assert_allclose(
            getattr(unitree_command(sent, robot), name), getattr(command, name), rtol=1e-6
        )
    np.testing.assert_allclose(
        sent["motor_cmd"]["q"][:12], robot.joint_sign * command.position, rtol=1e-6
    )
    shapes = {"quaternion_base_in_world": 4, "angular_velocity_base": 3, "acceleration_base": 3}
    sensed = SensorArrays(
        **{name: rng.normal(size=size) for name, size in shapes.items()},
        joint_position=rng.normal(size=12), joint_velocity=rng.normal(size=12),
    )  # fmt: skip
    torque = rng.normal(size=12)
    said = LOW_STATE.read([LOW_STATE.sealed(unitree_state_message(sensed, torque, robot))])[0]
    reading = reading_of(said, robot)
    for name, value in vars(sensed).items():
        np.testing.assert_allclose(getattr(reading.measurement, name), value, rtol=1e-6)
    np.testing.assert_allclose(reading.joint_torque, torque, rtol=1e-6)


def test_a_healthy_robot_stands_and_nothing_is_missed() -> None:
    run = Run()
    run.until(2.0)
    measured = run.robot.read().measurement
    np.testing.assert_allclose(measured.joint_position, ROBOT.stand_pose, atol=0.1)
    assert not run.robot.fault
    assert run.robot.health.lost == 0
    assert run.robot.health.bad == {}
    assert run.wire.robot.commands == len(run.wire.sent)


@pytest.mark.sample(7)
@pytest.mark.parametrize("kind", LOSSES)
@pytest.mark.parametrize("seed", range(4))
def test_a_lost_robot_is_damped_within_110_ms_at_any_phase(kind: str, seed: int) -> None:
    start_s = float(np.random.default_rng([seed, 5]).uniform(0.3, 0.7))
    run = Run(f"{kind}@{start_s:.4f}")
    run.until(start_s - 0.004)
    assert not run.robot.fault
    run.until(start_s + DAMPED_S)
    if kind == "tick":  # it leaps five times a second
        run.until(start_s + 0.2 + DAMPED_S)
    assert LOSSES[kind] in run.robot.fault
    motors = LOW_COMMAND.read([run.wire.sent[-1]])[0]["motor_cmd"][:MOTORS]
    assert not motors["kp"].any()
    assert not motors["tau"].any()
    np.testing.assert_allclose(motors["kd"], ROBOT.gains.damp_kd)
    run.until(start_s + 0.5)
    later = LOW_COMMAND.read([run.wire.sent[-1]])[0]["motor_cmd"][:MOTORS]
    assert not later["kp"].any()


@pytest.mark.sample(2)
@pytest.mark.parametrize("kind", BORNE)
def test_a_robot_with_a_lesser_fault_stands_on(kind: str) -> None:
    run = Run(f"{kind}@0.5", seed=3)
    run.until(1.5)
    assert not run.robot.fault
    assert BORNE[kind] in run.robot.concern
    measured = run.robot.read().measurement
    if kind != "dead":
        np.testing.assert_allclose(measured.joint_position, ROBOT.stand_pose, atol=0.15)
    lost = {"lost": (90, 220), "slow": (240, 260)}.get(kind, (0, 0))
    assert lost[0] <= run.robot.health.lost <= lost[1]
    assert run.robot.health.late_s == pytest.approx(0.030 if kind == "late" else 0.0, abs=0.005)


@pytest.mark.sample(6)
@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.parametrize("kind", LEAPS)
def test_what_leaps_is_named_in_the_next_state(kind: str, joint: str) -> None:
    at = f":{joint}" if kind in AT_A_JOINT else ""
    run = Run(f"{kind}{at}@0.5")
    run.until(0.494)
    assert not run.robot.fault
    run.until(0.504)
    told = LEAPS[kind] if kind == "imu" else f"{joint}{LEAPS[kind]}"
    # A joint that stands at nothing counts the same both ways
    moved = 2.0 * abs(float(ROBOT.stand_pose[JOINTS.index(joint)]))
    assert told in run.robot.fault or (kind == "sign" and moved < 0.06)


@pytest.mark.parametrize("states", [1, 5, 20])
def test_a_busy_moment_is_no_concern(states: int) -> None:
    """Some states that are lost at once, twice."""
    robot, watch = simulated(), StateWatch(ROBOT)
    for tick in range(300):
        said = robot.step()
        if not any(begin <= tick < begin + states for begin in (100, 200)):
            watch.take(said, robot.time_s)
        watch.judge(robot.time_s)
    assert watch.health.lost == 2 * states
    assert not watch.concern
    assert not watch.fault


def moving_states(late_ms: list[int]) -> list[UnitreeMessage]:
    """States of joints that swing about their stand pose, each late by so much by its clock."""
    swing = 0.05 * np.arange(len(late_ms))[:, None] + np.arange(12)
    sensed = SensorArrays(
        quaternion_base_in_world=np.tile([1.0, 0.0, 0.0, 0.0], (len(late_ms), 1)),
        angular_velocity_base=np.random.default_rng(0).normal(0.0, 0.01, (len(late_ms), 3)),
        acceleration_base=np.tile([0.0, 0.0, 9.81], (len(late_ms), 1)),
        joint_position=ROBOT.stand_pose + 0.05 * np.sin(swing),
        joint_velocity=0.05 * 25.0 * np.cos(swing),
    )
    states = []
    for row, late in enumerate(late_ms):
        one = SensorArrays(**{name: values[row] for name, values in vars(sensed).items()})
        states.append(unitree_state_message(one, np.zeros(12), ROBOT))
        states[-1]["tick"] = 2 * (row + 1) + late
        states[-1]["bms_state"]["soc"] = 80
    return states


@pytest.mark.parametrize("share", [0.05, 0.5, 1.0])
def test_a_clock_that_is_read_a_millisecond_late_leaves_no_gap(share: float) -> None:
    late_ms = (np.random.default_rng(1).random(500) < share).astype(int).tolist()
    watch = StateWatch()
    for row, state in enumerate(moving_states(late_ms)):
        assert watch.take([LOW_STATE.sealed(state)], 2e-3 * row)
        watch.judge(2e-3 * row)
    assert (watch.concern, watch.fault, watch.health.lost) == ("", "", 0)


@pytest.mark.parametrize("joints", [[2], [0, 1, 2], list(range(12))])
def test_a_leg_that_says_zero_from_one_state_on_is_named_and_nothing_breaks(
    joints: list[int],
) -> None:
    """As of motors that answer no more: a straight leg has no force on its foot to compute."""
    watch = StateWatch(ROBOT)
    for row, state in enumerate(moving_states([0] * 80)):
        if row >= 30:
            for part in ("q", "dq", "tau_est"):
                state["motor_state"][part][joints] = 0.0
        watch.take([LOW_STATE.sealed(state)], 2e-3 * row)
        watch.judge(2e-3 * row)
        assert bool(watch.fault) == (row >= 30)
    assert "leaps by" in watch.fault


def test_nothing_is_sent_while_another_program_commands_the_robot() -> None:
    wire = Wire(simulated(), ["sport (process 1 on go2)"])
    robot = UnitreeRobot(wire, ROBOT, wire)  # type: ignore[arg-type]
    wire.tick()
    with pytest.raises(StackError, match=r"commanded by sport \(process 1 on go2\)"):
        robot.reset()
    run = Run()
    run.until(0.1)
    sent = len(run.wire.sent)
    run.wire.strangers = ("sport",)
    with pytest.raises(StackError, match="nothing is sent"):
        run.step()
    run.robot.close()
    assert len(run.wire.sent) == sent


@pytest.mark.parametrize("field", ["position", "velocity", "kp", "kd", "torque"])
def test_a_command_that_is_not_finite_never_leaves(field: str) -> None:
    run = Run()
    run.until(0.1)
    run.robot.read()
    values = {name: np.zeros(12) for name in ("position", "velocity", "kp", "kd", "torque")}
    values[field][7] = np.nan
    run.robot.write(JointCommand(**values))
    assert run.robot.fault == "the command is not finite"
    motors = LOW_COMMAND.read([run.wire.sent[-1]])[0]["motor_cmd"][:MOTORS]
    assert all(np.isfinite(motors[name]).all() for name in ("q", "dq", "kp", "kd", "tau"))


def test_a_robot_that_was_commanded_is_left_damped() -> None:
    run = Run()
    run.until(0.1)
    run.robot.close()
    motors = LOW_COMMAND.read([run.wire.sent[-1]])[0]["motor_cmd"][:MOTORS]
    assert not motors["kp"].any()
    assert motors["kd"].all()


def test_a_simulated_robot_obeys_intact_commands_only() -> None:
    robot = simulated()
    message = LOW_COMMAND.sealed(LOW_COMMAND.blank())
    for payload in (
        message[:-1] + b"\x01",
        message[:-4],
        b"",
        message[:100] + b"\x07" + message[101:],
    ):
        robot.hear(payload)
    assert (robot.commands, robot.refused) == (0, 4)
    robot.hear(message)
    assert robot.commands == 1


def test_faults_are_named_with_joint_and_start() -> None:
    for kind in KINDS:
        assert PlantedFault.parse(f"{kind}@2.5") == PlantedFault(kind=kind, start_s=2.5)
    for kind in AT_A_JOINT:
        for joint in JOINTS:
            assert PlantedFault.parse(f"{kind}:{joint}") == PlantedFault(kind=kind, joint=joint)
    for wrong in ("hott", "hot:knee", "crc:FR_calf", "hot@x", ""):
        with pytest.raises(ConfigError, match="fault"):
            PlantedFault.parse(wrong)
