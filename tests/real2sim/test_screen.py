"""Screening: damage is named, and no strong effect of a healthy robot is taken for damage."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rig_logs import Rig, body_log, joints_logs

from saltus.arrays import Floats
from saltus.real2sim.screening.angles import rate_slopes
from saltus.real2sim.screening.channel_scales import is_off
from saltus.real2sim.screening.screen import screen_log
from saltus.recordings.run_log import JointTable, LogTable, RunLog

Damage = Callable[[RunLog], RunLog]


STRONG = (
    Rig(delay_s=0.024),
    Rig(gain=0.8),
    Rig(gain=1.2),
    Rig(viscous=0.4),
    Rig(coulomb=0.8),
    Rig(bias=0.1),
    Rig(play=0.0175),
    Rig(delay_s=0.016, gain=0.8, coulomb=0.8, bias=-0.1),
)
LATE = Rig(delay_s=0.011, viscous=0.4, kp=40.0, kd=1.5)


@pytest.fixture(scope="module")
def logs() -> dict[Rig, RunLog]:
    rigs = (Rig(), *STRONG, LATE)
    return dict(zip(rigs, joints_logs(rigs), strict=True))


@pytest.fixture(scope="module")
def log(logs: dict[Rig, RunLog]) -> RunLog:
    return logs[Rig()]


@pytest.fixture(scope="module")
def body() -> RunLog:
    return body_log()


@pytest.mark.parametrize("step", [0.0, 0.005, 0.01, 0.025])
@pytest.mark.parametrize("factor", [1.0, 57.3, 6.33, 0.1, -1.0])
def test_a_rate_is_judged_beside_the_steps_of_a_coarse_encoder(
    log: RunLog, step: float, factor: float
) -> None:
    """A log of a robot that hardly moves, whose readings have noise beside their steps."""
    rng, joints = np.random.default_rng(1), log.joints
    q, dq = 0.05 * (joints.q - joints.q.mean(axis=0)), 0.05 * np.asarray(joints.dq)
    coarse = np.round(q / step) * step if step else q
    slopes = rate_slopes(joints.time_s, coarse + 1e-4 * rng.standard_normal(q.shape), factor * dq)
    assert slopes is not None
    assert np.isfinite(slopes).all()
    assert [is_off(float(slope)) for slope in slopes] == 12 * [factor != 1.0]


@pytest.mark.parametrize("rig", STRONG)
def test_strong_effects_are_no_damage(logs: dict[Rig, RunLog], rig: Rig) -> None:
    log = logs[rig]
    assert screen_log(log) == []
    coarse = replace(log.joints, q=np.round(log.joints.q / 1.5e-3) * 1.5e-3)
    assert screen_log(replace(log, joints=coarse)) == []
    bare = replace(log.joints, dq=None, dq_des=None, tau_ff=None, tau_est=None)
    assert screen_log(replace(log, joints=bare)) == []


def test_a_command_that_arrives_within_a_step_is_not_taken_for_another_gain(
    logs: dict[Rig, RunLog],
) -> None:
    log = logs[LATE]
    assert screen_log(replace(log, meta={**log.meta, "kp": LATE.kp, "kd": LATE.kd})) == []


@pytest.mark.parametrize("row_s", [0.002, 0.02, 0.1])
@pytest.mark.parametrize("factor", [1e-3, 1e3])
@pytest.mark.parametrize("has_dq", [True, False], ids=["with dq", "without dq"])
def test_times_in_another_unit_are_named_however_far_apart_rows_are(
    log: RunLog, row_s: float, factor: float, has_dq: bool
) -> None:
    every = round(row_s / 0.002)
    slow = _rows(log.joints, np.arange(0, len(log.joints.q), every))
    joints = replace(slow, time_s=factor * slow.time_s, **({} if has_dq else {"dq": None}))
    claims = {**log.meta, "control_dt": factor * row_s, "segments": []}
    said = {fault.name: fault.is_fatal for fault in screen_log(RunLog(meta=claims, joints=joints))}
    assert said["time_unit"] == (has_dq or factor < 1.0)
    right = RunLog(meta={**claims, "control_dt": row_s}, joints=replace(joints, time_s=slow.time_s))
    assert "time_unit" not in {fault.name for fault in screen_log(right)}


def test_a_slower_log_a_log_of_one_posture_and_a_log_of_images_are_healthy(
    log: RunLog, body: RunLog
) -> None:
    meta = {**log.meta, "control_dt": 0.004}
    assert (
        screen_log(RunLog(meta=meta, joints=_rows(log.joints, np.arange(0, len(log.joints.q), 2))))
        == []
    )
    still = replace(
        log.joints, q_des=log.joints.q_des[:1] + 0 * log.joints.q_des, q=0 * log.joints.q + 0.9
    )
    still = replace(still, dq=0 * still.q, tau_est=0 * still.q)
    assert not any(fault.name == "dead_channel" for fault in screen_log(replace(log, joints=still)))
    assert screen_log(body) == []


def _rows(joints: JointTable, rows: np.ndarray) -> JointTable:
    names = ("time_s", "q", "q_des", "dq", "dq_des", "tau_ff", "tau_est")
    return replace(joints, **{name: getattr(joints, name)[rows] for name in names})


def _scaled(factor: float, *names: str, columns: Any = slice(None)) -> Damage:
    def damage(log: RunLog) -> RunLog:
        changed = {}
        for name in names:
            changed[name] = getattr(log.joints, name).copy()
            changed[name][:, columns] *= factor
        return replace(log, joints=replace(log.joints, **changed))

    return damage


def _swapped(a: int, b: int, *names: str) -> Damage:
    order = list(range(12))
    order[a], order[b] = b, a
    return lambda log: replace(
        log,
        joints=replace(log.joints, **{name: getattr(log.joints, name)[:, order] for name in names}),
    )


def _kept(rows: Callable[[int], Any]) -> Damage:
    return lambda log: replace(log, joints=_rows(log.joints, np.asarray(rows(len(log.joints.q)))))


def _claimed(**claims: Any) -> Damage:
    return lambda log: replace(log, meta={**log.meta, **claims})


def _mirrored(log: RunLog) -> RunLog:
    """Left legs under the names of right ones."""
    legs = [log.meta["joints"][3 * leg : 3 * leg + 3] for leg in (1, 0, 3, 2)]
    return replace(log, meta={**log.meta, "joints": [joint for leg in legs for joint in leg]})


def _late_half_steps_back(log: RunLog) -> RunLog:
    time_s = log.joints.time_s.copy()
    time_s[len(time_s) // 2 :] -= 0.3
    return replace(log, joints=replace(log.joints, time_s=time_s))


def _stale(log: RunLog) -> RunLog:
    """Every fifth row repeats the state before it."""
    rows = np.arange(len(log.joints.q))
    rows[5::5] -= 1
    return replace(log, joints=replace(_rows(log.joints, rows), time_s=log.joints.time_s))


def _closed_up(log: RunLog) -> RunLog:
    """Three times a quarter of a second is gone, and the rows are numbered as if it were not."""
    rows = np.delete(np.arange(len(log.joints.q)), np.r_[500:625, 1000:1125, 1400:1525])
    return replace(
        log, joints=replace(_rows(log.joints, rows), time_s=log.joints.time_s[: len(rows)])
    )


def _stuck(log: RunLog) -> RunLog:
    q = log.joints.q.copy()
    q[2000:3500, 4] = q[2000, 4]
    return replace(log, joints=replace(log.joints, q=q))


def _hole(log: RunLog) -> RunLog:
    q = log.joints.q.copy()
    q[100, 3] = np.nan
    return replace(log, joints=replace(log.joints, q=q))


@pytest.mark.parametrize(
    ("damage", "name"),
    [
        (_scaled(180 / np.pi, "q", "q_des", "dq"), "degrees"),
        (_scaled(180 / np.pi, "q"), "degrees"),
        (_scaled(180 / np.pi, "q_des"), "degrees"),
        (_scaled(180 / np.pi, "dq"), "wrong_rate"),
        (_scaled(-1, "dq", columns=4), "wrong_rate"),
        (_scaled(-1, "q", "dq", columns=3), "flipped_sign"),
        (
            _scaled(-1, "q_des", columns=9),
            "flipped_sign|swapped_joints",
        ),  # hips of both sides are mirror images
        (_scaled(-1, "tau_est", columns=5), "flipped_sign"),
        (_scaled(-1, "q", "dq", "q_des", "tau_est", columns=5), "out_of_range"),
        (_scaled(0, "q", columns=7), "dead_channel"),
        (_scaled(0, "dq"), "dead_channel"),
        (_scaled(0, "tau_est", columns=2), "dead_channel"),
        (_scaled(1.5, "q", "dq", columns=[2, 5, 8, 11]), "swapped_joints|wrong_ratio|out_of_range"),
        (_swapped(0, 3, "q", "dq", "tau_est"), "swapped_joints"),
        (_swapped(1, 2, "q", "dq"), "swapped_joints"),
        (_swapped(4, 10, "q"), "swapped_joints"),
        (_swapped(4, 10, "dq"), "wrong_rate"),
        (_swapped(1, 4, "tau_est"), "torque_unexplained"),
        (_swapped(1, 2, "q", "dq", "q_des", "tau_est"), "out_of_range"),
        (_swapped(0, 1, "q", "dq", "q_des", "tau_est"), "swapped_joints"),
        (_scaled(-1, "q", "dq", "q_des", "tau_est", columns=3), "against_gravity"),
        (_mirrored, "against_gravity"),
        (_claimed(kp=30.0), "wrong_gains"),
        (
            lambda log: _claimed(kp=40.0)(replace(log, joints=replace(log.joints, tau_est=None))),
            "wrong_gains",
        ),
        (_claimed(kp=[20.0] * 11 + [14.0]), "wrong_gains"),
        (_claimed(kd=1.0), "wrong_gains"),
        (_claimed(control_dt=0.001), "control_dt"),
        (_claimed(control_dt=0.01), "control_dt"),
        (_kept(lambda rows: np.arange(rows)[::-1]), "time_backwards"),
        (_late_half_steps_back, "time_backwards"),
        (_kept(lambda rows: np.flatnonzero(np.arange(rows) % 40)), "lost_rows"),
        (_kept(lambda rows: np.r_[0:1000, 1100:rows]), "lost_rows"),
        (_kept(lambda rows: np.sort(np.r_[0:rows, 0:rows:20])), "repeated_rows"),
        (_stale, "repeated_rows"),
        (_closed_up, "hidden_gaps"),
        (_stuck, "dead_channel"),
        (_hole, "not_a_number"),
    ],
)
def test_damage_of_joints_is_named(log: RunLog, damage: Damage, name: str) -> None:
    faults = screen_log(damage(log))
    assert faults
    assert faults[0].is_fatal
    assert faults[0].name in name.split("|"), faults[0].text
    assert len(faults[0].text) < 400
    assert "\n" not in faults[0].text


def test_gains_are_not_read_where_the_drive_follows_what_is_not_logged(log: RunLog) -> None:
    """Wide backlash takes as much from the weight of the feed-forward torque as from kp.

    Wrong gains take nothing.
    """
    rng = np.random.default_rng(0)
    tau_ff = 3.0 * np.sin(2 * np.pi * 0.9 * log.joints.time_s[:, None] + np.arange(12))
    torque = np.asarray(log.joints.tau_est) + tau_ff

    def faults(tau_est: Floats, **claims: float) -> set[str]:
        joints = replace(log.joints, tau_ff=tau_ff, tau_est=tau_est)
        return {
            fault.name
            for fault in screen_log(replace(log, joints=joints, meta={**log.meta, **claims}))
        }

    assert faults(torque) == set()
    assert faults(torque, kp=30.0) == {"wrong_gains"}
    assert faults(0.75 * torque) == {"wrong_gains"}  # in another unit
    assert faults(0.75 * torque + rng.normal(0.0, 0.3 * torque.std(axis=0), torque.shape)) == set()


def test_one_lost_row_is_told_but_not_fatal(log: RunLog) -> None:
    faults = screen_log(_kept(lambda rows: np.r_[0:1000, 1001:rows])(log))
    assert [(fault.name, fault.is_fatal) for fault in faults] == [("lost_rows", False)]


def test_velocities_that_read_too_fast_are_told_but_not_fatal(log: RunLog) -> None:
    faults = screen_log(_scaled(1.14, "dq")(replace(log, joints=replace(log.joints, tau_est=None))))
    assert [(fault.name, fault.is_fatal) for fault in faults] == [("fast_rate", False)]
    assert "1.14" in faults[0].text


def test_pauses_between_segments_are_no_lost_rows(log: RunLog) -> None:
    named = [{"name": f"{i}", "t0": 4.0 * i, "t1": 4.0 * i + 3, "condition": "a"} for i in range(3)]
    kept = np.flatnonzero(np.mod(log.joints.time_s, 4.0) < 3)
    assert (
        screen_log(RunLog(meta={**log.meta, "segments": named}, joints=_rows(log.joints, kept)))
        == []
    )


def _values(name: str, columns: Any, change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    def damage(log: RunLog) -> RunLog:
        table: LogTable = getattr(log, name)
        values = table.values.copy()
        values[:, columns] = change(values[:, columns])
        return replace(log, **{name: LogTable(time_s=table.time_s, values=values)})

    return damage


def _images(change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    def damage(log: RunLog) -> RunLog:
        assert log.depth is not None
        return replace(
            log, depth=replace(log.depth, depth_mm=change(log.depth.depth_mm).astype(np.uint16))
        )

    return damage


def _two_clocks(log: RunLog) -> RunLog:
    assert log.depth is not None
    return replace(log, depth=replace(log.depth, capture_s=log.depth.arrival_s + 100))


@pytest.mark.parametrize(
    ("damage", "name"),
    [
        (_values("imu", slice(0, 4), lambda q: 2 * q), "quaternion_norm"),
        (_values("base", 3, lambda w: 0 * w), "quaternion_norm"),
        (_values("imu", slice(4, 7), np.rad2deg), "wrong_rate"),
        (_values("imu", 5, np.negative), "wrong_rate"),
        (_values("imu", slice(7, 10), lambda a: a / 9.81), "acceleration_unit"),
        (_values("imu", 9, np.negative), "imu_axes"),
        (_values("base", slice(0, 3), lambda p: 1e3 * p), "base_unit"),
        (_values("base", 9, np.negative), "wrong_rate"),
        (_images(lambda d: d // 10), "depth_unit"),
        (_images(lambda d: np.minimum(4 * d.astype(int), 65535)), "depth_unit"),
        (_images(lambda d: d[:, ::-1]), "upside_down"),
        (_images(lambda d: 0 * d), "blind"),
        (_images(lambda d: 0 * d + d[:1]), "dead_channel"),
        (_images(lambda d: d[:, :20]), "image_size"),
        (_two_clocks, "two_clocks"),
    ],
)
def test_damage_of_body_and_camera_is_named(body: RunLog, damage: Damage, name: str) -> None:
    faults = screen_log(damage(body))
    assert faults
    assert faults[0].is_fatal
    assert faults[0].name == name, faults[0].text


def test_a_strong_effect_of_the_camera_is_no_damage(body: RunLog) -> None:
    for change in (
        lambda d: np.where(d > 0, 1.05 * d + 50, 0),
        lambda d: np.minimum(d, 800),
        lambda d: np.repeat(d[::4], 4, axis=0)[: len(d)],
    ):
        assert screen_log(_images(change)(body)) == []


def test_a_log_without_commands_is_screened_by_what_it_has(log: RunLog, body: RunLog) -> None:
    for whole in (log, body):
        meta = {key: value for key, value in whole.meta.items() if key not in ("kp", "kd")}
        bare = replace(
            whole, meta=meta, joints=replace(whole.joints, q_des=None, dq_des=None, tau_ff=None)
        )
        assert not screen_log(bare)
        in_degrees = replace(
            bare, joints=replace(bare.joints, q=np.rad2deg(log.joints.q[: len(bare.joints.q)]))
        )
        assert {fault.name for fault in screen_log(in_degrees)} >= {"degrees"}
