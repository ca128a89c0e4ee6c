"""Hips that count the other way are named by the robot's motion; none of a healthy robot is."""

import numpy as np
import pytest

from benchmarks.unitree_link.in_memory import ROBOT, Bounding, Wire, simulated
from saltus.constants import PHYSICS_DT
from saltus.controller.rising import RISE_S
from saltus.controller.robot.backend import RobotReading
from saltus.controller.robot.mujoco import MujocoRobot
from saltus.controller.robot.unitree import states
from saltus.controller.robot.unitree.drives import unitree_state_message
from saltus.controller.robot.unitree.hips import ENOUGH, HipWatch
from saltus.controller.robot.unitree.robot import UnitreeRobot
from saltus.grid import WALKING_GRID
from saltus.policy.evaluation.walking_trials import (
    WalkTrialKind,
    WalkTrials,
    run_tasks,
    trial_tasks,
)
from saltus.policy.evaluation.walks import TrueHeightSource
from saltus.real2sim.experiments.on_backend import ExperimentRun, held_experiment
from saltus.robots.robot import JOINTS
from saltus.states import SensorArrays
from saltus.used_networks import walking_path

BOUNDS_S = RISE_S + 1.0


@pytest.mark.sample(1)
@pytest.mark.parametrize("joint", JOINTS[::3])
@pytest.mark.parametrize("phase", range(3))
def test_a_hip_is_named_whose_angle_does_not_leap(
    joint: str, phase: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing leaps where a hip is at zero, so leaps are not looked at here."""
    monkeypatch.setattr(states, "state_contradiction", lambda *_: "")
    start_s = BOUNDS_S + float(np.random.default_rng(phase).uniform(0.3, 1.0))
    bounding = Bounding(f"sign:{joint}@{start_s:.3f}", seed=phase)
    bounding.until(start_s)
    assert not bounding.robot.fault
    while not bounding.robot.fault and bounding.run.time_s < start_s + 0.5:
        bounding.until(bounding.run.time_s + PHYSICS_DT)
    assert bounding.robot.fault == f"{joint} moves the robot as if it counted the other way"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "ground", "seed"),
    [
        ("cross", "rubble", 700),
        ("cross", "stairs", 700),
        ("cross", "hurdles", 700),
        ("drill", "rubble", 784),  # stands for long after a turn, its feet twisted
        ("drill", "rubble", 789),  # stops with legs at the ends of their joints
    ],
)
def test_no_hip_of_a_healthy_robot_is_named(
    kind: WalkTrialKind, ground: str, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Evidence against them stays below two thirds of what names one."""
    watch, most = HipWatch(ROBOT), [0.0]
    read = MujocoRobot.read

    def heard(robot: MujocoRobot) -> RobotReading:
        reading = read(robot)
        assert isinstance(reading.measurement, SensorArrays)
        message = unitree_state_message(reading.measurement, reading.joint_torque, ROBOT)
        message["tick"] = 2 * len(most)
        watch.take(message)
        most.append(watch.evidence)
        return reading

    monkeypatch.setattr(MujocoRobot, "read", heard)
    trials = WalkTrials(robot="go2", grid=WALKING_GRID, model=walking_path("go2"), camera="d435i")
    [[result]] = run_tasks(trials, trial_tasks(kind, [ground], TrueHeightSource, [seed]), 1)
    assert not result.cause
    assert len(most) > 1000
    assert max(most) < 2.0 / 3.0 * ENOUGH


@pytest.mark.slow
def test_no_hip_of_a_robot_that_hangs_is_named() -> None:
    """Something other than its feet holds it."""
    wire = Wire(simulated(held=True))
    wire.tick()
    robot = UnitreeRobot(wire, ROBOT, wire)  # type: ignore[arg-type]
    robot.reset()
    run = ExperimentRun(robot, ROBOT, held_experiment("joint_tour"))
    while run.time_s < run.duration_s:
        run.step()
        wire.tick()
        assert not robot.fault
