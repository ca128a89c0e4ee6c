"""Logs of robots that stand, walk, turn and jump:
healthy ones are no damage, damage is named, and a search ends.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import ROBOT

from benchmarks.moving_logs import trot
from saltus.cli.main import main
from saltus.effects.profile import IDEAL
from saltus.real2sim.experiments.menu import Experiment, experiment_named
from saltus.real2sim.experiments.motions import ExperimentSection, rest
from saltus.real2sim.experiments.run import run_experiment
from saltus.real2sim.experiments.safety import ExperimentLimits
from saltus.real2sim.pipeline import examine_logs, judge_logs
from saltus.real2sim.problem.camera.problem import CameraProblem
from saltus.real2sim.problem.camera.rays import BaseMotion
from saltus.real2sim.screening.screen import screen_log
from saltus.real2sim.search.search import search_effects
from saltus.recordings.run_log import RunLog, write_run_log
from saltus.rotations import quaternion_from_roll_pitch_yaw, quaternion_product, rotation_matrix

PATHS: dict[str, dict[str, float]] = {"walk": {"speed_m_s": 0.4}, "turn": {"turn_rad_s": 0.8}}
FAMILIES = ("held", "stand", "walk", "turn", "jump")
MOVING = ("walk", "turn", "jump")


@pytest.fixture(scope="module")
def logs(jumps: tuple[RunLog, Path]) -> dict[str, RunLog]:
    commands = {name: trot(ROBOT, 4.0, **how) for name, how in PATHS.items()} | {
        "stand": rest(ROBOT, 4.0)
    }
    free = {
        name: Experiment(
            name=name,
            how="",
            shows=(),
            base="free",
            sections=lambda _, c=moves, n=name: (
                ExperimentSection(name=n, condition=n, commands=c),
            ),
            # type: ignore[misc]
            limits=ExperimentLimits(),
        )
        for name, moves in commands.items()
    }
    made = {name: run_experiment(experiment, ROBOT, IDEAL) for name, experiment in free.items()}
    held = run_experiment(experiment_named("single_sine"), ROBOT, IDEAL)
    return {**made, "held": held, "jump": jumps[0]}


@pytest.mark.parametrize("family", FAMILIES)
def test_a_healthy_log_is_not_called_damaged(logs: dict[str, RunLog], family: str) -> None:
    assert screen_log(logs[family]) == []


def test_a_robot_jumps_in_the_log_of_one_that_jumps(logs: dict[str, RunLog]) -> None:
    log = logs["jump"]
    assert log.feet is not None
    assert log.base is not None
    assert np.mean(log.feet.values[100:].max(axis=1) == 0.0) > 0.05  # all feet in the air
    assert log.base.values[-1, 0] - log.base.values[0, 0] > 1.5
    assert log.joints.kp is not None
    assert set(np.unique(log.joints.kp)) >= {0.0, 30.0, 100.0}


def test_a_bias_of_a_gyroscope_is_no_damage_however_the_robot_turns(
    logs: dict[str, RunLog],
) -> None:
    for family in ("stand", *MOVING):
        for bias in (-0.05, 0.05):
            assert (
                screen_log(_table("imu", slice(4, 7), lambda v, b=bias: v + b)(logs[family])) == []
            )  # type: ignore[misc]


Damage = Callable[[RunLog], RunLog]


def _table(name: str, columns: Any, change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    def damage(log: RunLog) -> RunLog:
        table = getattr(log, name)
        values = table.values.copy()
        values[:, columns] = change(values[:, columns])
        return replace(log, **{name: replace(table, values=values)})

    return damage


def _joints(
    change: Callable[[np.ndarray], np.ndarray], *names: str, columns: Any = slice(None)
) -> Damage:
    def damage(log: RunLog) -> RunLog:
        changed = {name: getattr(log.joints, name).copy() for name in names}
        for values in changed.values():
            values[:, columns] = change(values[:, columns])
        return replace(log, joints=replace(log.joints, **changed))

    return damage


def _stiffer(log: RunLog) -> RunLog:
    """Half as stiff again as claimed."""
    if log.joints.kp is not None:
        return _joints(lambda kp: kp / 1.5, "kp")(log)
    return replace(log, meta={**log.meta, "kp": log.meta["kp"] / 1.5})


DAMAGES: dict[str, tuple[Damage, str]] = {
    "gyroscope in degrees": (_table("imu", slice(4, 7), np.rad2deg), "wrong_rate"),
    "acceleration in g": (_table("imu", slice(7, 10), lambda a: a / 9.81), "acceleration_unit"),
    "acceleration upside down": (_table("imu", 9, np.negative), "imu_axes"),
    "quaternions of the IMU twice": (
        _table("imu", slice(0, 4), lambda q: 2 * q),
        "quaternion_norm",
    ),
    "base in millimetres": (_table("base", slice(0, 3), lambda p: 1e3 * p), "base_unit"),
    "angles in degrees": (_joints(np.rad2deg, "q"), "degrees"),
    "rates in degrees": (_joints(np.rad2deg, "dq"), "wrong_rate"),
    "a rate the other way": (_joints(np.negative, "dq", columns=4), "wrong_rate"),
    "an angle the other way": (
        _joints(np.negative, "q", "dq", columns=5),
        "flipped_sign|swapped_joints|out_of_range",
    ),
    "thigh and calf swapped": (
        _joints(lambda q: q[:, ::-1], "q", "dq", columns=[1, 2]),
        "swapped_joints|out_of_range",
    ),
    "front and rear swapped": (
        _joints(lambda q: np.roll(q, 6, axis=1), "q", "dq"),
        "swapped_joints|torque_unexplained|wrong_gains|flipped_sign",
    ),
    "torque the other way": (_joints(np.negative, "tau_est", columns=5), "flipped_sign"),
    "stiffer than claimed": (_stiffer, "wrong_gains"),
    "rows lost": (
        lambda log: _rows(log, np.flatnonzero(np.arange(len(log.joints.q)) % 40)),
        "lost_rows",
    ),
    "rows repeated": (
        lambda log: _rows(log, np.arange(len(log.joints.q)) // 5 * 5, keeps_time=True),
        "repeated_rows",
    ),
}


def _rows(log: RunLog, rows: np.ndarray, keeps_time: bool = False) -> RunLog:
    columns = {
        name: values[rows] for name, values in vars(log.joints).items() if values is not None
    }
    if keeps_time:
        columns["time_s"] = log.joints.time_s
    return replace(log, joints=replace(log.joints, **columns))


@pytest.mark.sample(10)
@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("family", MOVING)
def test_damage_of_the_log_of_a_moving_robot_is_named(
    logs: dict[str, RunLog], family: str, damage: str
) -> None:
    change, names = DAMAGES[damage]
    faults = screen_log(change(logs[family]))
    assert faults
    assert faults[0].is_fatal, faults[0].text
    assert faults[0].name in names.split("|"), faults[0].text


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    ("family", "damage"),
    [
        ("walk", _table("base", 7, np.negative)),
        ("walk", _table("base", slice(7, 10), lambda v: 1e3 * v)),
        ("jump", _table("base", 7, np.negative)),
        ("jump", _table("base", 9, np.negative)),
        ("turn", _table("imu", 6, np.negative)),
        ("turn", _table("imu", slice(4, 7), lambda v: 0 * v)),
        ("jump", _table("imu", 5, np.negative)),
    ],
)
def test_a_rate_that_is_not_that_of_the_pose_is_named(
    logs: dict[str, RunLog], family: str, damage: Damage
) -> None:
    faults = screen_log(damage(logs[family]))
    assert [fault.name for fault in faults if fault.is_fatal][:1] == ["wrong_rate"]


@pytest.mark.slow
def test_what_a_jumping_log_tells_is_compared_and_what_it_cannot_is_said(
    logs: dict[str, RunLog],
) -> None:
    examinations = examine_logs([logs["jump"]])
    assert [each.findings.problem for each in examinations[0].comparisons] == [
        "camera",
        "body",
        "imu",
    ]
    assert examinations[0].failures == ()
    judgement = judge_logs(examinations, ())
    assert judgement.verdict.verdict == "no_gap"
    assert set(judgement.not_compared) == {"joints"}
    assert "drop" in judgement.verdict.untestable["contact_compliance"]
    assert {
        "torque_gain",
        "payload_mass",
        "camera_latency",
        "imu_bias",
    } <= judgement.verdict.minimum_detectable.keys()


@pytest.mark.slow
def test_find_says_in_one_line_what_was_not_compared(
    logs: dict[str, RunLog], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run_log(logs["jump"], tmp_path / "log")
    log, out = str(tmp_path / "log"), str(tmp_path / "out")
    assert main(["real2sim", "find", log, "--out", out, "--no-report"]) == 0
    said = [
        line for line in capsys.readouterr().out.splitlines() if line.startswith("not compared: ")
    ]
    assert len(said) == 1
    assert "joints (the base is not held: see body)" in said[0]


def test_a_landing_is_not_smoothed_out_of_the_motion_of_a_camera(logs: dict[str, RunLog]) -> None:
    log = logs["jump"]
    assert log.base is not None
    position, rotation = BaseMotion(log).at(log.base.time_s)
    np.testing.assert_allclose(position, log.base.values[:, :3], atol=1e-9)
    np.testing.assert_allclose(rotation, rotation_matrix(log.base.values[:, 3:7]), atol=1e-9)
    still = logs["stand"]
    assert still.base is not None
    left = BaseMotion(still).at(still.base.time_s)[0] - still.base.values[:, :3]
    assert np.std(left, axis=0).min() > 1e-4  # noise is taken away from a robot that stands


@pytest.mark.slow
def test_errors_of_the_pose_that_far_pixels_multiply_are_noise_of_a_camera(
    logs: dict[str, RunLog],
) -> None:
    """Images are good to a third of a millimetre.

    Half a milliradian moves the ground at 2.5 m by fifty times that.
    """
    log = logs["jump"]
    assert log.base is not None
    rng, values = np.random.default_rng(402), log.base.values.copy()
    values[:, :3] += 5e-4 * rng.standard_normal((len(values), 3))
    turned = quaternion_from_roll_pitch_yaw(*(5e-4 * rng.standard_normal((3, len(values)))))
    values[:, 3:7] = quaternion_product(values[:, 3:7], turned)
    log = replace(log, base=replace(log.base, values=values))
    problem = CameraProblem(log)
    residuals = problem.residuals(problem.absent[None, None])[0, 0]
    assert np.mean(residuals[problem.signal == problem.signals.index("depth")] ** 2) < 1.2
    findings = search_effects(problem)
    assert findings.verdict == "no_gap"
    told = findings.minimum_detectable["camera_pitch"].value
    off = search_effects(
        CameraProblem(_camera(log, pitch=log.meta["camera"]["pitch"] - 1.5 * told))
    )
    assert [(effect.name, off.verdict) for effect in off.effects] == [("camera_pitch", "named")]


def _camera(log: RunLog, **claims: object) -> RunLog:
    return replace(log, meta={**log.meta, "camera": {**log.meta["camera"], **claims}})


def _late_imu(log: RunLog) -> RunLog:
    assert log.imu is not None
    values = log.imu.values
    return replace(log, imu=replace(log.imu, values=np.concatenate([values[:1], values[:-1]])))


def _late_images(log: RunLog) -> RunLog:
    assert log.depth is not None
    return replace(log, depth=replace(log.depth, arrival_s=log.depth.arrival_s + 0.03))


def _claims(log: RunLog, **claims: object) -> RunLog:
    return replace(log, meta={**log.meta, **claims})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hide", "effect", "parameter", "value"),
    [
        (
            lambda log: _claims(log, motor_strength=log.meta["motor_strength"] / 0.95),
            "torque_gain",
            "gain",
            0.95,
        ),
        (
            lambda log: _camera(log, pitch=log.meta["camera"]["pitch"] - 0.03),
            "camera_pitch",
            "offset",
            0.03,
        ),
        (_late_images, "camera_latency", "latency", 0.03),
        (_late_imu, "imu_latency", "delay", 0.01),
        (_table("imu", 4, lambda rate: rate + 0.05), "imu_bias", "gyro_x", 0.05),
        (
            lambda log: _claims(log, payload_kg=log.meta["payload_kg"] - 0.3),
            "payload_mass",
            "mass",
            0.3,
        ),
    ],
)
def test_what_a_jumping_log_shows_is_named(
    logs: dict[str, RunLog], hide: Damage, effect: str, parameter: str, value: float
) -> None:
    verdict = judge_logs(examine_logs([hide(logs["jump"])]), ()).verdict
    assert [found.name for found in verdict.effects] == [effect]
    assert verdict.effects[0].params[parameter].value == pytest.approx(value, rel=0.05)
