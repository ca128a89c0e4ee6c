"""Offsets of clocks: shifts that are put in are found, within their intervals."""

from dataclasses import replace

import numpy as np
import pytest
from rig_logs import Rig, body_log, joints_log

from saltus.real2sim.screening.align import ClockOffset, MotionSamples, clock_offsets, fit_offset
from saltus.recordings.run_log import RunLog


@pytest.fixture(scope="module")
def body() -> RunLog:
    return body_log()


def _named(log: RunLog, stream: str) -> ClockOffset:
    return next(offset for offset in clock_offsets(log) if offset.stream == stream)


@pytest.mark.parametrize("rows", [0, 3, 12])
def test_the_delay_of_commands_is_found_to_a_row(rows: int) -> None:
    offset = _named(joints_log(Rig(delay_s=0.002 * rows)), "tau_est")
    assert offset.ci90_s[0] <= 0.002 * rows <= offset.ci90_s[1] + 1e-4
    assert offset.ci90_s[1] - offset.ci90_s[0] < 0.003
    assert not offset.is_relative


@pytest.mark.parametrize(
    ("shift_s", "drift"), [(0.0, 0.0), (0.012, 0.0), (-0.02, 0.0), (0.007, 1e-3)]
)
def test_late_and_drifting_clocks_are_found(body: RunLog, shift_s: float, drift: float) -> None:
    assert body.imu is not None
    assert body.depth is not None
    imu = replace(body.imu, time_s=body.imu.time_s * (1 + drift) + shift_s)
    depth = replace(
        body.depth, arrival_s=body.depth.arrival_s * (1 + drift) + shift_s, capture_s=None
    )
    log = replace(body, imu=imu, depth=depth)
    for stream, late in (("gyro", 0.0), ("images by arrival", 0.05)):
        found = _named(log, stream)
        assert found.offset_s == pytest.approx(late + shift_s + 4.0 * drift, abs=5e-4)
        assert found.drift == pytest.approx(drift, abs=1e-4)
        assert found.is_relative
        assert "cannot be told apart" in found.text


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    time_s = np.arange(0.0, 20.0, 0.005)
    reference = MotionSamples(
        name="command", time_s=time_s, values=np.sin(2 * np.pi * 0.8 * time_s)[:, None]
    )
    held = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        late = np.sin(2 * np.pi * 0.8 * (time_s - 0.013))[:, None] + rng.normal(
            0, 0.2, (len(time_s), 1)
        )
        found = fit_offset(
            MotionSamples(name="q", time_s=time_s, values=late), reference, is_relative=True
        )
        assert found is not None
        held += found.ci90_s[0] < 0.013 < found.ci90_s[1]
    assert 46 <= held <= 59  # 54 of 60 expected; 3.5 sigma either way


def test_streams_that_show_different_motions_or_none_have_no_offset() -> None:
    rng = np.random.default_rng(0)
    time_s = np.arange(0.0, 20.0, 0.01)
    a, b = (
        MotionSamples(name=n, time_s=time_s, values=rng.normal(size=(len(time_s), 1))) for n in "ab"
    )
    assert fit_offset(a, b, is_relative=True) is None
    still = MotionSamples(name="c", time_s=time_s, values=np.ones((len(time_s), 1)))
    assert fit_offset(still, still, is_relative=True) is None
