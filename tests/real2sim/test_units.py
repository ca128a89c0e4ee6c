"""A channel in another unit or sign is told by name and factor; right logs are not accused; stated
units become SI."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from camera_logs import STEP, Recipe, camera_log, sine
from rig_logs import Rig, body_log, joints_logs
from ros_bag import write_bag
from samples import ROBOT

from saltus.cli.main import main
from saltus.effects.motors import TorqueGain
from saltus.effects.profile import IDEAL
from saltus.errors import RecordingError
from saltus.real2sim.experiments.menu import experiment_named
from saltus.real2sim.experiments.run import run_experiment
from saltus.real2sim.screening.base_faults import rig_faults
from saltus.real2sim.screening.causes import cause_faults, torque_causes
from saltus.real2sim.screening.channel_scales import LogFault
from saltus.real2sim.screening.gains import gain_faults
from saltus.real2sim.screening.gravity import feedforward_faults
from saltus.real2sim.screening.joint_faults import unit_faults
from saltus.real2sim.screening.screen import screen_log
from saltus.recordings.log_units import SIGNALS, LogUnits, in_si
from saltus.recordings.run_log import LogTable, RunLog, read_run_log, write_run_log

DEGREE, KGF_CM, G, RPM = 180.0 / np.pi, 1.0 / 0.0980665, 1.0 / 9.80665, 30.0 / np.pi
GEARS = (6.33, 9.495, 1.0 / 6.33, 1.0 / 9.495)
RIGS = (
    Rig(),
    Rig(gain=0.7),
    Rig(gain=1.3),
    Rig(delay_s=0.024),
    Rig(coulomb=0.8, viscous=0.4),
    Rig(play=0.0175),
    Rig(delay_s=0.016, gain=0.8, coulomb=0.8, bias=-0.1),
)
"""Right robots: ideal, weak, strong, late, with friction, play, and all of it."""
Change = Callable[[RunLog, float], RunLog]


@pytest.fixture(scope="module")
def held() -> list[RunLog]:
    """Logs of held robots whose feed-forward torque moves."""
    logs = joints_logs(RIGS, seconds=8.0)
    extra = np.sin(2 * np.pi * 0.9 * logs[0].joints.time_s[:, None] + np.arange(12))
    return [
        replace(
            log,
            joints=replace(
                log.joints, tau_ff=extra, tau_est=np.asarray(log.joints.tau_est) + extra
            ),
        )
        for log in logs
    ]


@pytest.fixture(scope="module")
def bodies() -> list[RunLog]:
    """Logs of a body with a camera over a floor, and of one before a step."""
    seen = camera_log(Recipe(duration_s=4.0, boxes=STEP, motion=sine))
    assert seen.base is not None
    poses = seen.base.values.copy()
    poses[:, 7:10] = np.gradient(poses[:, :3], seen.base.time_s, axis=0)
    seen = replace(
        seen,
        meta={**seen.meta, "control_dt": 0.002},
        base=LogTable(time_s=seen.base.time_s, values=poses),
    )
    return [body_log(seconds=4.0), seen]


def joints(*names: str, columns: slice = slice(None)) -> Change:
    """Signals of the joints in another unit."""

    def change(log: RunLog, factor: float) -> RunLog:
        signals = {name: getattr(log.joints, name).copy() for name in names}
        for values in signals.values():
            values[:, columns] *= factor
        return replace(log, joints=replace(log.joints, **signals))

    return change


def table(signal: str) -> Change:
    """A signal of IMU or base in another unit."""

    def change(log: RunLog, factor: float) -> RunLog:
        own = SIGNALS[signal]
        old = getattr(log, own.table)
        values = old.values.copy()
        values[:, slice(*own.columns)] *= factor
        return replace(log, **{own.table: replace(old, values=values)})

    return change


def images(log: RunLog, factor: float) -> RunLog:
    """Depth in another unit, cut to what 16 bits hold."""
    assert log.depth is not None
    steps = np.clip(np.rint(factor * log.depth.depth_mm.astype(np.float64)), 0, 65535)
    return replace(log, depth=replace(log.depth, depth_mm=steps.astype(np.uint16)))


def times(name: str) -> Change:
    """Times of one table in another unit."""

    def change(log: RunLog, factor: float) -> RunLog:
        if name == "depth":
            assert log.depth is not None
            return replace(
                log,
                depth=replace(log.depth, arrival_s=factor * log.depth.arrival_s, capture_s=None),
            )
        own = getattr(log, name)
        return replace(log, **{name: replace(own, time_s=factor * own.time_s)})

    return change


def told(faults: list[LogFault], channel: str, factor: float) -> bool:
    """Whether the first fault is fatal, one short line, and names a channel and its factor to
    within 6 %."""
    if not faults or not faults[0].is_fatal:
        return False
    text = faults[0].text
    numbers = [float(number) for number in re.findall(r"-?\d+\.?\d*(?:e[-+]?\d+)?", text)]
    is_factor = any(abs(number / factor - 1.0) < 0.06 for number in numbers)
    return (
        is_factor
        and bool(re.search(rf"\b{channel}\b", text))
        and "\n" not in text
        and len(text) < 400
    )


OF_TORQUE = (KGF_CM, 1000.0, 8.85, 3.0, 5.0, 1.0 / 9.80665, 1e-3, -1.0, *GEARS)
OF_ANGLE = (DEGREE, 1.0 / DEGREE, 1000.0, 1e-3, -1.0, *GEARS)
HELD: dict[str, tuple[Change, tuple[float, ...]]] = {
    "tau_est": (joints("tau_est"), OF_TORQUE),
    "tau_ff": (joints("tau_ff"), (KGF_CM, 1000.0, 1.0 / 9.80665, -1.0, *GEARS)),
    "tau_est of knees": (joints("tau_est", columns=slice(2, None, 3)), OF_TORQUE),
    "q": (joints("q"), OF_ANGLE),
    "q_des": (joints("q_des"), OF_ANGLE),
    "q of all": (joints("q", "q_des", "dq"), OF_ANGLE),
    "dq": (joints("dq"), (RPM, *OF_ANGLE)),
}


@pytest.mark.sample(2)
@pytest.mark.parametrize("channel", HELD)
def test_a_channel_of_the_joints_in_another_unit_is_told_by_name_and_factor(
    held: list[RunLog], channel: str
) -> None:
    change, factors = HELD[channel]
    name = channel.partition(" ")[0]
    for number, factor in enumerate(factors):
        faults = screen_log(change(held[number % len(held)], factor))
        assert told(faults, name, factor), (factor, [fault.text for fault in faults])


QUIET = {
    "slow_triangle": 0.7,
    "heave_and_pitch": 1.3,
    "pitch_rocking": 1.0,
    "heave_sine": 0.7,
    "torque_ladder": 1.3,
}
"""Experiments in which torques are hardly more than their noise, or rest, by the drives'
strength."""


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", QUIET)
def test_a_torque_that_hardly_moves_is_told_by_name_and_factor(name: str) -> None:
    log = run_experiment(
        experiment_named(name), ROBOT, IDEAL.having(TorqueGain(gain=QUIET[name])), seed=11
    )
    assert not list(gain_faults(log))
    for channel in ("tau_est", "tau_ff") if np.any(log.joints.tau_ff) else ("tau_est",):
        change, factors = HELD[channel]
        for factor in factors:
            faults = list(gain_faults(change(log, factor)))
            assert told(faults, channel, factor), (
                channel,
                factor,
                [fault.text for fault in faults],
            )


@pytest.mark.parametrize("noise", [0.01, 0.3, 1.0])
def test_the_factor_of_a_torque_depends_on_no_scale_and_no_noise(noise: float) -> None:
    rng = np.random.default_rng(3)
    time_s = np.arange(0.0, 20.0, 0.007)
    law = np.sin(2 * np.pi * 0.5 * time_s + np.arange(12)[:, None])
    seen = law + noise * rng.normal(size=law.shape)
    torque = 8.85 * (law + noise * rng.normal(size=law.shape))
    lines = set()
    for scale in (1e-6, 1.0, 1e6):
        drives = [
            torque_causes(scale * t, scale * e, np.zeros_like(e), None)
            for t, e in zip(torque, seen, strict=True)
        ]
        (fault,) = cause_faults([f"joint {k}" for k in range(12)], drives, (6.33, 9.495))
        assert told([fault], "tau_est", 8.85)
        lines.add(fault.text)
    assert len(lines) == 1


@pytest.fixture(scope="module")
def standing() -> list[RunLog]:
    """Logs of a body that rocks, and of a weak robot that squats and a strong one that is
    dropped.
    """
    names = {"squat": 0.7, "drop": 1.3}
    profiles = [IDEAL.having(TorqueGain(gain=gain)) for gain in names.values()]
    logs = [
        run_experiment(experiment_named(n), ROBOT, p, seed=5)
        for n, p in zip(names, profiles, strict=True)
    ]
    return [body_log(seconds=4.0), *logs]


@pytest.mark.parametrize("channel", ["q", "q_des"])
def test_the_one_of_angle_and_target_that_is_off_is_told_by_dq(
    standing: list[RunLog], channel: str
) -> None:
    for log in standing[1:]:
        for factor in (DEGREE, 1.0 / DEGREE, 1000.0, *GEARS):
            faults = list(unit_faults(joints(channel)(log, factor)))
            assert told(faults, channel, factor), (factor, [fault.text for fault in faults])


def in_order_xyzw(log: RunLog, name: str) -> RunLog:
    """The log with the quaternions of a table in another order."""
    own, first = getattr(log, name), {"imu": 0, "base": 3}[name]
    values = own.values.copy()
    values[:, first : first + 4] = np.roll(values[:, first : first + 4], -1, axis=1)
    return replace(log, **{name: replace(own, values=values)})


@pytest.mark.parametrize("name", ["imu", "base"])
def test_quaternions_in_another_order_are_told(standing: list[RunLog], name: str) -> None:
    for number, log in enumerate(standing):
        for has_imu in (True, False) if name == "base" and number > 0 else (True,):
            own = log if has_imu else replace(log, imu=None)
            assert not rig_faults(own)
            (fault,) = rig_faults(in_order_xyzw(own, name))
            assert fault.is_fatal
            assert fault.name == "quaternion_order"
            assert fault.text.startswith(f"{name}: ")


def test_angles_and_their_targets_in_another_unit_are_told_by_dq_and_kp(held: list[RunLog]) -> None:
    for number, factor in enumerate((0.5, 2.0 / 3.0, 0.8, 1.25, 1.5)):
        faults = screen_log(joints("q", "q_des")(held[number], factor))
        assert told(faults, "q_des", factor), (factor, [fault.text for fault in faults])


@pytest.mark.parametrize("scale", [0.75, 0.85, 1.16, 1.2, 1.3])
def test_angles_are_not_accused_where_dq_alone_reads_too_fast_or_too_slow(
    held: list[RunLog], scale: float
) -> None:
    for log in held:
        faults = screen_log(joints("dq")(log, scale))
        assert {fault.name for fault in faults if "q and q_des" in fault.text} == set()


def test_a_tau_ff_that_no_tau_est_stands_beside_is_told_by_the_weight(
    standing: list[RunLog],
) -> None:
    for log in standing[1:]:
        alone = replace(log, joints=replace(log.joints, tau_est=None))
        assert not list(feedforward_faults(alone))
        for factor in (KGF_CM, 1000.0, -1.0, *GEARS):
            (fault,) = feedforward_faults(joints("tau_ff")(alone, factor))
            said = float(re.findall(r"about (-?[\d.e+-]+) times", fault.text)[0])
            assert fault.text.startswith("tau_ff of all joints")
            assert 0.6 < said / factor < 1.6


BODY: dict[str, tuple[Change, tuple[float, ...]]] = {
    "gyro": (table("gyro"), (DEGREE, 1.0 / DEGREE, RPM, 1000.0, -1.0)),
    "acc": (table("acc"), (G, 1000.0 * G, 1000.0, 1e-3, 9.80665, -1.0)),
    "position": (table("position"), (1000.0, 100.0, 39.37, 3.281)),
    "velocity": (table("velocity"), (1000.0, 100.0, 3.6, 1e-3, -1.0)),
    "depth": (images, (10.0, 4.0, 5.0, 8.0, 2.0, 1e-3, 0.1, 1000.0)),
    "t": (times("joints"), (1e3, 1e6, 1e9, 1e-3)),
    "imu: t": (times("imu"), (1e3, 1e6, 1e9, 1e-3)),
    "base: t": (times("base"), (1e3, 1e6, 1e9, 1e-3)),
    "depth: t": (times("depth"), (1e3, 1e6, 1e9, 1e-3)),
}


@pytest.mark.parametrize("channel", BODY)
def test_a_channel_of_body_and_camera_in_another_unit_is_told(
    bodies: list[RunLog], channel: str
) -> None:
    change, factors = BODY[channel]
    for number, factor in enumerate(factors):
        whole = ("acc", "gyro", "imu: t")  # the second log has no IMU
        log = bodies[0 if channel in whole else number % 2]
        faults = screen_log(change(log, factor))
        assert told(faults, channel, factor), (factor, [fault.text for fault in faults])


def test_gains_in_another_unit_are_told_and_the_torque_is_not_blamed(held: list[RunLog]) -> None:
    for keys in (("kp",), ("kd",), ("kp", "kd")):
        meta = {**held[0].meta, **{key: held[0].meta[key] / DEGREE for key in keys}}
        faults = screen_log(replace(held[0], meta=meta))
        assert told(faults, " and ".join(keys), DEGREE), [fault.text for fault in faults]
        assert faults[0].name == "wrong_gains"


def test_right_logs_are_not_accused(held: list[RunLog], bodies: list[RunLog]) -> None:
    quiet = [
        replace(log, joints=replace(log.joints, q=q, dq=0.02 * dq, q_des=q_des, tau_est=None))
        for log in held[:2]
        for dq in (np.asarray(log.joints.dq),)
        for q, q_des in [
            [0.98 * v.mean(axis=0) + 0.02 * v for v in (log.joints.q, np.asarray(log.joints.q_des))]
        ]
    ]
    for log in (*held, *quiet, *bodies):
        assert screen_log(log) == []


STATED: dict[str, tuple[dict[str, object], Change, float]] = {
    "kgf cm": ({"torque_unit": "kgf cm"}, joints("tau_est", "tau_ff"), KGF_CM),
    "one signal": ({"signals": {"tau_est": "kgf cm"}}, joints("tau_est"), KGF_CM),
    "deg": ({"angle_unit": "deg"}, joints("q", "q_des"), DEGREE),
    "rpm": ({"speed_unit": "rpm"}, joints("dq", "dq_des"), RPM),
    "g": ({"acceleration_unit": "g"}, table("acc"), G),
    "deg/s": ({"gyro_unit": "deg/s"}, table("gyro"), DEGREE),
    "mm": ({"signals": {"position": "mm"}}, table("position"), 1000.0),
    "a flipped sign": ({"signals": {"dq": -1.0}}, joints("dq"), -1.0),
    "0.25 mm": ({"depth_unit_m": 0.00025}, images, 4.0),
}


@pytest.mark.parametrize("case", STATED)
def test_a_stated_unit_of_a_run_log_is_read_as_si(case: str, tmp_path: Path) -> None:
    units, change, factor = STATED[case]
    log = body_log(seconds=1.0)
    moved = joints_logs((Rig(),), seconds=1.0)[0].joints
    log = replace(log, joints=moved)
    other = change(log, factor)
    write_run_log(replace(other, meta={**other.meta, "units": units}), tmp_path / "log")
    read = read_run_log(tmp_path / "log")
    assert "units" not in read.meta
    for signal in ("q", "q_des", "dq", "tau_est", "tau_ff"):
        np.testing.assert_allclose(
            getattr(read.joints, signal), getattr(log.joints, signal), rtol=1e-12
        )
    for name in ("imu", "base"):
        np.testing.assert_allclose(
            getattr(read, name).values, getattr(log, name).values, rtol=1e-12
        )
    assert log.depth is not None
    assert read.depth is not None
    np.testing.assert_array_equal(read.depth.depth_mm, log.depth.depth_mm)
    meta = json.loads((tmp_path / "log" / "meta.json").read_text())
    (tmp_path / "log" / "meta.json").write_text(
        json.dumps(meta | {"units": {"torque_unit": "kgf"}})
    )
    with pytest.raises(RecordingError, match=r"torque_unit.*kgf cm"):
        read_run_log(tmp_path / "log")


def test_units_of_a_bag_are_stated_in_its_description(tmp_path: Path) -> None:
    log = replace(body_log(seconds=1.0), joints=joints_logs((Rig(),), seconds=1.0)[0].joints)
    assert log.depth is not None
    near = replace(log, depth=replace(log.depth, depth_mm=np.minimum(log.depth.depth_mm, 6000)))
    other = images(joints("tau_est", "tau_ff")(table("acc")(near, G), KGF_CM), 10.0)
    bag = write_bag(other, tmp_path / "bag")
    claims = {key: log.meta[key] for key in ("base", "kp", "kd", "terrain")}
    description = {
        "claims": claims
        | {"camera": {key: log.meta["camera"][key] for key in ("position", "pitch")}},
        "topics": {"joints": "/joint_states", "commands": "/joint_commands"},
        "units": {"torque_unit": "kgf cm", "acceleration_unit": "g", "depth_unit_m": 0.0001},
    }
    (tmp_path / "mine.toml").write_text(tomli_w.dumps(description))
    words = ["--description", str(tmp_path / "mine.toml"), "--out", str(tmp_path / "log")]
    assert main(["real2sim", "import", str(bag), *words]) == 0
    read = read_run_log(tmp_path / "log")
    assert near.depth is not None
    assert read.depth is not None
    assert near.imu is not None
    assert read.imu is not None
    np.testing.assert_allclose(
        np.asarray(read.joints.tau_est), np.asarray(near.joints.tau_est), rtol=1e-12
    )
    np.testing.assert_allclose(read.imu.values, near.imu.values, rtol=1e-12)
    np.testing.assert_array_equal(read.depth.depth_mm, near.depth.depth_mm)


def test_a_log_in_si_units_is_left_as_it_is() -> None:
    log = body_log(seconds=0.2)
    same = in_si(log, LogUnits())
    assert log.imu is not None
    assert same.imu is not None
    np.testing.assert_array_equal(same.imu.values, log.imu.values)
    np.testing.assert_array_equal(same.joints.q, log.joints.q)
