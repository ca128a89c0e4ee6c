"""Experiments: every motion of the menu is within its limits,
and a log of it is a run log of the robot's motion.
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from samples import ROBOT

from saltus.constants import PHYSICS_DT
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.joint_loads import CoulombFriction
from saltus.effects.profile import EFFECTS, IDEAL, Profile
from saltus.errors import ConfigError
from saltus.real2sim.experiments import motions
from saltus.real2sim.experiments.footage import FootageCamera
from saltus.real2sim.experiments.menu import EXPERIMENTS, experiment_named
from saltus.real2sim.experiments.run import SensorNoise, run_experiment
from saltus.real2sim.experiments.safety import ExperimentLimits, UnsafeMotionError
from saltus.real2sim.problem.log import load_rigs, robot_of
from saltus.real2sim.screening.screen import screen_log
from saltus.real2sim.sensors import SENSORS
from saltus.recordings.run_log import read_run_log, write_run_log

BRIEF = {
    "fixed": dataclasses.replace(
        EXPERIMENTS["joint_chirp"],
        sections=lambda robot: motions.repeat_motion(
            "chirp", 2, motions.sweep(robot, 1.0, 1.0, 5.0, 0.3)
        ),
    ),
    "free": dataclasses.replace(
        EXPERIMENTS["heave_and_pitch"],
        sections=lambda robot: motions.repeat_motion(
            "rock", 2, motions.body_sine(robot, 1.5, 2.0, 0.02, 0.08)
        ),
    ),
}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_motion_begins_and_ends_where_it_can_be_repeated_and_stays_within_its_limits(
    name: str,
) -> None:
    experiment = EXPERIMENTS[name]
    sections = experiment.sections(ROBOT)
    assert set(experiment.shows) <= set(EFFECTS)
    assert experiment.duration_s(ROBOT) == pytest.approx(
        sum(len(s.commands.q_des) for s in sections) * PHYSICS_DT
    )
    for section in sections:
        experiment.limits.check_commands(ROBOT, section.commands, experiment.gains(ROBOT)[0])
        for values in vars(section.commands).values():
            assert values.shape == (len(section.commands.q_des), 12)
            assert np.isfinite(values).all()
        ends = section.commands.q_des[[0, -1]]
        np.testing.assert_allclose(ends, np.tile(ROBOT.stand_pose, (2, 1)), atol=0.01)
    repeats = [section.condition for section in sections]
    assert len(set(repeats)) < len(repeats), (
        "nothing is repeated: noise cannot be told from what is missing"
    )


@pytest.mark.parametrize(
    ("change", "what"),
    [({"q_des": 3.0}, "angle"), ({"dq_des": 35.0}, "speed"), ({"tau_ff": 40.0}, "torque")],
    ids=str,
)
def test_commands_beyond_limits_are_refused_before_anything_moves(
    change: dict[str, float], what: str
) -> None:
    commands = motions.rest(ROBOT, 0.1)
    for name, value in change.items():
        getattr(commands, name)[20, 5] = value
    with pytest.raises(
        UnsafeMotionError, match=f"FL_calf is asked for a {what}|FL_calf is asked for an {what}"
    ):
        ExperimentLimits().check_commands(ROBOT, commands, kp=1.0)


def test_a_jump_of_the_desired_angle_counts_as_torque() -> None:
    commands = motions.steps(ROBOT, 2.0, 0.5, 0.5)
    ExperimentLimits().check_commands(ROBOT, commands, kp=20.0)
    with pytest.raises(UnsafeMotionError, match="torque"):
        ExperimentLimits().check_commands(ROBOT, commands, kp=40.0)


def test_a_robot_that_leaves_its_limits_is_stopped() -> None:
    careful = dataclasses.replace(BRIEF["free"], limits=ExperimentLimits(tilt_rad=0.04))
    with pytest.raises(UnsafeMotionError, match="the base tilts"):
        run_experiment(careful, ROBOT, IDEAL)
    with pytest.raises(UnsafeMotionError, match="FR_thigh moves at"):
        ExperimentLimits().check_state(
            ROBOT, 0.0, np.array([1.0, 0.0, 0.0, 0.0]), ROBOT.stand_pose, 50.0 * np.eye(12)[1]
        )
    with pytest.raises(UnsafeMotionError, match="RL_calf is at"):
        ExperimentLimits().check_state(
            ROBOT,
            0.0,
            np.array([1.0, 0.0, 0.0, 0.0]),
            ROBOT.stand_pose + 2.0 * np.eye(12)[11],
            np.zeros(12),
        )


@pytest.mark.parametrize("base", BRIEF)
def test_a_log_survives_writing_and_screening(base: str, tmp_path: Path) -> None:
    log = run_experiment(BRIEF[base], ROBOT, IDEAL, seed=1)
    directory = tmp_path / "log"
    write_run_log(log, directory)
    read = read_run_log(directory)
    assert read.meta == log.meta
    np.testing.assert_array_equal(read.joints.q, log.joints.q)
    assert not [fault.text for fault in screen_log(read) if fault.is_fatal]
    assert (read.depth is not None) == BRIEF[base].camera
    assert (read.base is not None) == (base == "free")


def test_a_held_robot_moves_by_the_law_of_its_drives() -> None:
    silent = SensorNoise(q_rad=0.0, dq_rad_s=0.0, tau_nm=0.0)
    experiment = BRIEF["fixed"]
    joints = run_experiment(experiment, ROBOT, IDEAL, noise=silent).joints
    assert joints.dq is not None
    assert joints.dq_des is not None
    kp, kd = experiment.gains(ROBOT)
    law = kp * (joints.q_des - joints.q) + kd * (joints.dq_des - joints.dq)
    np.testing.assert_allclose(joints.tau_est, law, atol=1e-9)
    np.testing.assert_allclose(np.diff(joints.q, axis=0), PHYSICS_DT * joints.dq[:-1], atol=2e-3)
    stuck = run_experiment(
        experiment, ROBOT, Profile(actuator=(CoulombFriction(torque=20.0),)), noise=silent
    ).joints
    assert np.ptp(stuck.q, axis=0).max() < 0.02, "friction above every torque must hold the joints"


def test_the_same_seed_makes_the_same_log_and_another_seed_another() -> None:
    first, same, other = (
        run_experiment(BRIEF["free"], ROBOT, IDEAL, seed=seed) for seed in (3, 3, 4)
    )
    assert first.depth is not None
    assert same.depth is not None
    np.testing.assert_array_equal(first.joints.q, same.joints.q)
    np.testing.assert_array_equal(first.depth.depth_mm, same.depth.depth_mm)
    assert np.any(first.joints.q != other.joints.q)


def test_the_camera_is_late_by_the_latency_of_its_profile_not_by_its_claim() -> None:
    late = run_experiment(
        BRIEF["free"],
        ROBOT,
        Profile(camera=(CameraLatency(latency=0.04),)),
        camera=FootageCamera.on(ROBOT, 0.01),
    )
    assert late.depth is not None
    assert late.meta["camera"]["latency"] == 0.01
    np.testing.assert_allclose(late.depth.arrival_s, 0.02 * late.depth.frame_id + 0.04, atol=1e-9)


def test_a_robot_that_saltus_does_not_ship_comes_with_its_model_and_is_replayed_with_it(
    tmp_path: Path,
) -> None:
    """Its log names the model beside it.

    From there it has its own mass, and positive angles are those of the log.
    """
    heavy = dataclasses.replace(
        ROBOT, name="heavy", mjcf=ROBOT.mjcf.replace("mass='5.204'", "mass='9'")
    )
    experiment = dataclasses.replace(BRIEF["free"], camera=False)
    write_run_log(run_experiment(experiment, heavy, IDEAL), tmp_path / "log", heavy)
    (log,) = load_rigs([tmp_path / "log"])
    assert log.meta["robot"] == str(tmp_path / "log" / "heavy.xml")
    assert robot_of(log).mass == pytest.approx(ROBOT.mass + 9.0 - 5.204)
    body = next(sensor for sensor in SENSORS if sensor.name == "body")
    assert not body.lacks(log)
    reversed_legs = {**log.meta, "joints": log.meta["joints"][::-1]}
    assert "in this order" in body.lacks(dataclasses.replace(log, meta=reversed_legs))
    (tmp_path / "box.xml").write_text(
        "<mujoco><worldbody><body><geom size='1'/></body></worldbody></mujoco>"
    )
    assert "no quadruped" in body.lacks(
        dataclasses.replace(log, meta={**log.meta, "robot": str(tmp_path / "box.xml")})
    )


def test_an_unknown_experiment_is_told_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="joint_chirp"):
        experiment_named("joint_chrip")
