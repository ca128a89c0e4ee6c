"""A robot over its own protocol rises, stands, bounds over level ground, and stands again."""

import numpy as np
import pytest
from unitree_processes import saltus, simulated

from benchmarks.unitree_link.command import own_domain
from benchmarks.unitree_link.in_memory import ROBOT, Bounding, Wire
from benchmarks.unitree_link.in_memory import simulated as simulated_here
from benchmarks.unitree_link.planted import DAMPED_S, run_with
from saltus.controller.rising import RISE_S
from saltus.controller.robot.unitree.faults import KINDS
from saltus.controller.robot.unitree.limits import STAGES, StageLimits
from saltus.controller.robot.unitree.messages import LOW_COMMAND, MOTORS
from saltus.controller.robot.unitree.robot import UnitreeRobot
from saltus.errors import ConfigError
from saltus.real2sim.experiments import motions
from saltus.real2sim.experiments.menu import Experiment
from saltus.real2sim.experiments.motions import repeat_motion
from saltus.real2sim.experiments.on_backend import ExperimentRun, held_experiment
from saltus.real2sim.experiments.safety import ExperimentLimits, UnsafeMotionError
from saltus.wire.messages import ControllerMode

PATIENCE_S = 100.0
STANDS_S = RISE_S + 1.0
DAMPS = (
    "silent", "frozen", "stuck", "crc", "tick", "sign", "offset", "imu", "button",
)  # fmt: skip
"""Faults after which nothing that a robot says of itself can be believed, or a person ends it."""
BOUND_S = 0.29
"""A bound by rules lasts so long; each leg stands once in it."""


@pytest.mark.sample(1)
@pytest.mark.parametrize("seed", range(2))
def test_a_robot_bounds_ahead_and_stands_again(seed: int) -> None:
    bounding = Bounding(seed=seed)
    bounding.until(STANDS_S - 0.1)
    start = bounding.wire.robot.position
    assert bounding.run.mode == ControllerMode.STAND
    bounding.until(STANDS_S + 1.5)
    assert bounding.run.mode == ControllerMode.RUN
    bounding.until(STANDS_S + 4.0, halt=True)
    assert bounding.run.mode == ControllerMode.STAND
    assert not bounding.robot.fault
    moved = bounding.wire.robot.position - start
    assert moved[0] > 1.0
    assert abs(moved[1]) < 0.3
    assert bounding.wire.robot.position[2] == pytest.approx(ROBOT.stand_height, abs=0.03)
    assert 100.0 < bounding.run.peak_power_w < 5000.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_robot_that_is_lost_in_midair_is_damped(seed: int) -> None:
    start_s = STANDS_S + float(np.random.default_rng(seed).uniform(0.5, 0.8))
    bounding = Bounding(f"silent@{start_s:.3f}", seed=seed)
    bounding.until(start_s + 0.11)
    assert "no new state" in bounding.robot.fault
    motors = LOW_COMMAND.read([bounding.wire.sent[-1]])[0]["motor_cmd"][:MOTORS]
    assert not motors["kp"].any()
    assert not motors["tau"].any()


@pytest.mark.sample(1)
@pytest.mark.parametrize("seed", range(11, 15))
@pytest.mark.parametrize("kind", KINDS)
def test_whatever_fails_while_a_robot_bounds_is_named_and_the_robot_brought_to_rest(
    kind: str, seed: int
) -> None:
    """Damped, or landing, within 110 ms; or told nothing more where others move it.

    A hip near its zero counts the same both ways: what shows it is the next stance of its leg.
    """
    ran = run_with(kind, seed)
    assert ran["sent_beside_others"] == 0
    if kind in ("foreign", "mode", "kept"):
        assert "nothing is sent" in ran["said"]
        return
    assert ran["said"]
    assert ran["how"] == ("damped" if kind in DAMPS else "landed")
    leapt_s = 0.2 if kind == "tick" else 0.0  # it leaps five times a second
    stance_s = BOUND_S if "counted the other way" in ran["said"] else 0.0
    assert ran["took_s"] <= leapt_s + stance_s + DAMPED_S
    assert ran["upright"] or kind == "dead"


def test_a_robot_is_led_softly_to_its_stand_pose() -> None:
    """Its commands begin where its joints are, and never leap."""
    bounding = Bounding(seed=3)
    first = bounding.robot.read().measurement.joint_position
    bounding.until(RISE_S)
    motors = LOW_COMMAND.read(bounding.wire.sent)["motor_cmd"][:, :MOTORS]
    np.testing.assert_allclose(motors["q"][0], first, atol=1e-6)
    assert np.abs(np.diff(motors["q"], axis=0)).max() < 0.01
    assert np.abs(np.diff(motors["kp"], axis=0)).max() < 0.2
    np.testing.assert_allclose(motors["q"][-1], ROBOT.stand_pose, atol=1e-3)


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("limits", "told"),
    [
        (StageLimits(torque_share=0.5, speed_share=9.0, power_w=1e9), "Nm; this stage allows"),
        (StageLimits(torque_share=9.0, speed_share=0.5, power_w=1e9), "rad/s; this stage allows"),
        (StageLimits(torque_share=9.0, speed_share=9.0, power_w=300.0), "this stage allows 300 W"),
        (STAGES["stand"], "this stage allows"),
    ],
    ids=["torque", "speed", "power", "stand"],
)
def test_a_robot_beyond_the_limits_of_its_stage_is_named_and_damped(
    limits: StageLimits, told: str
) -> None:
    """Each limit by itself, at what the robot does when it bounds."""
    bounding = Bounding(limits=limits)
    bounding.until(STANDS_S - 0.1)
    assert not bounding.robot.fault
    bounding.until(STANDS_S + 0.7)
    assert told in bounding.robot.fault
    motors = LOW_COMMAND.read([bounding.wire.sent[-1]])[0]["motor_cmd"][:MOTORS]
    assert not motors["kp"].any()


def sine(speed_share: float = 1.0) -> Experiment:
    return Experiment(
        name="sine", how="", shows=(), base="fixed",
        limits=ExperimentLimits(tilt_rad=3.2, speed_share=speed_share),
        sections=lambda robot: repeat_motion("sine", 1, motions.sine(robot, 1.0, 1.0, 0.2)),
    )  # fmt: skip


def hanging(*faults: str) -> tuple[Wire, UnitreeRobot]:
    wire = Wire(simulated_here(*faults, held=True))
    wire.tick()
    robot = UnitreeRobot(wire, ROBOT, wire)  # type: ignore[arg-type]
    robot.reset()
    return wire, robot


def to_the_end(run: ExperimentRun, wire: Wire) -> None:
    while run.time_s < run.duration_s:
        run.step()
        wire.tick()


def test_a_hanging_robot_makes_an_experiments_motion_and_is_damped() -> None:
    wire, robot = hanging()
    run, wanted = ExperimentRun(robot, ROBOT, sine()), sine().sections(ROBOT)[0].commands
    to_the_end(run, wire)
    motors = LOW_COMMAND.read(wire.sent)["motor_cmd"][:, :MOTORS]
    np.testing.assert_allclose(motors["q"][-len(wanted.q_des) :], wanted.q_des, rtol=1e-6)
    assert np.abs(np.diff(motors["q"][: -len(wanted.q_des)], axis=0)).max() < 0.01
    run.step(halt=True)
    run.step()
    last = LOW_COMMAND.read([wire.sent[-1]])[0]["motor_cmd"][:MOTORS]
    assert run.mode == ControllerMode.DAMP
    assert not last["kp"].any()
    assert last["kd"].all()


def test_a_motion_or_a_robot_outside_of_its_limits_is_refused() -> None:
    wire, robot = hanging("sign:FL_calf@3.5")
    with pytest.raises(UnsafeMotionError, match="is asked for a speed"):
        ExperimentRun(robot, ROBOT, sine(speed_share=0.01))
    run = ExperimentRun(robot, ROBOT, sine())
    with pytest.raises(UnsafeMotionError, match="FL_calf is at"):
        to_the_end(run, wire)
    with pytest.raises(ConfigError, match="heave_and_pitch needs the ground"):
        held_experiment("heave_and_pitch")


@pytest.mark.slow
def test_the_command_stands_a_robot_in_another_process() -> None:
    where = ("--domain", str(own_domain()), "--pace", "lockstep")
    with (
        simulated(own_domain(), "--pace", "lockstep"),
        saltus("robot", "run", *where, "--seconds", "0.2", "--begin") as process,
    ):
        told, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert told.startswith("STAND after 5.7 s; 0 of ")


@pytest.mark.slow
def test_the_command_refuses_a_robot_that_another_program_commands() -> None:
    where = ("--domain", str(own_domain()), "--speed", "0.2")
    with simulated(own_domain(), "--speed", "0.2", "--fault", "foreign") as robot:
        with saltus("robot", "run", *where, "--begin") as process:
            assert process.wait(PATIENCE_S) == 2
        robot.terminate()
        told, _ = robot.communicate(timeout=PATIENCE_S)
    assert "refused; its base is at" in told
