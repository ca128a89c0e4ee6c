"""Run logs for the search: segments that are named or found, and several runs as one."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rig_logs import body_log, joints_log

from saltus.errors import RecordingError
from saltus.real2sim.problem.log import PAUSE_S, load_rigs, segments_of
from saltus.recordings.run_log import JointTable, RunLog, write_run_log


def _two_motions_twice() -> RunLog:
    """Commands rest between a slow and a fast motion, each made twice."""
    time_s = np.arange(0.0, 14.0, 0.01)
    q_des = np.zeros((len(time_s), 12))
    for start, rate in ((1.0, 0.5), (4.0, 2.0), (7.0, 0.5), (10.0, 2.0)):
        inside = (time_s >= start) & (time_s < start + 2.0)
        q_des[inside] = 0.2 * np.sin(2 * np.pi * rate * (time_s[inside] - start))[:, None]
    meta = {**joints_log(seconds=1.0).meta, "control_dt": 0.01}
    return RunLog(meta=meta, joints=JointTable(time_s=time_s, q=q_des, q_des=q_des))


def test_motions_parted_by_rests_are_segments_and_repeats_are_known() -> None:
    found = segments_of(_two_motions_twice())
    assert [round(segment.start_s, 1) for segment in found] == [1.0, 4.0, 7.0, 10.0]
    assert [segment.condition for segment in found] == ["part0", "part1", "part0", "part1"]


def test_logs_that_never_rest_are_cut_into_blocks() -> None:
    log = joints_log(seconds=12.0)
    found = segments_of(log)
    assert found[0].start_s == log.joints.time_s[0]
    assert found[-1].end_s == log.joints.time_s[-1]
    assert all(4.0 < segment.end_s - segment.start_s < 7.0 for segment in found)


def test_named_segments_are_clipped_to_the_log() -> None:
    log = joints_log(seconds=2.0)
    named = [
        {"name": n, "t0": a, "t1": b, "condition": "c"}
        for n, a, b in (("in", -1, 1), ("out", 5, 6))
    ]
    (found,) = segments_of(replace(log, meta={**log.meta, "segments": named}))
    assert (found.name, found.start_s, found.end_s) == ("in", 0.0, 1.0)


def test_several_runs_follow_each_other(tmp_path: Path) -> None:
    one, other = body_log(seconds=4.0), body_log(seconds=3.0, seed=1)
    for name, log in (("one", one), ("other", other)):
        write_run_log(log, tmp_path / name)
    (both,) = load_rigs([tmp_path / "one", tmp_path / "other"])
    gap = np.diff(both.joints.time_s).max()
    assert gap == pytest.approx(PAUSE_S)
    assert len(both.joints.q) == len(one.joints.q) + len(other.joints.q)
    assert both.imu is not None
    assert both.depth is not None
    assert one.depth is not None
    assert other.depth is not None
    assert (np.diff(both.imu.time_s) > 0).all()
    assert (np.diff(both.depth.frame_id) == 1).all()
    assert len(both.depth.depth_mm) == len(one.depth.depth_mm) + len(other.depth.depth_mm)
    names = {segment.name.split("/")[0] for segment in segments_of(both)}
    assert names == {"one", "other"}


@pytest.mark.parametrize(
    ("claim", "value"),
    [
        ("kp", 30.0),
        ("terrain", [{"center": [0.0, 0.0, 0.05], "size": [1.0, 1.0, 0.1]}]),
        ("ground", {"friction": 0.5}),
        ("payload_kg", 1.0),
        ("payload_position", [0.1, 0.0, 0.0]),
        ("motor_strength", 0.9),
    ],
)
def test_runs_of_which_another_simulator_is_built_are_not_one(
    claim: str, value: object, tmp_path: Path
) -> None:
    log = joints_log(seconds=1.0)
    write_run_log(log, tmp_path / "one")
    write_run_log(replace(log, meta={**log.meta, claim: value}), tmp_path / "other")
    each = load_rigs([tmp_path / "one", tmp_path / "other"])
    assert [rig.meta.get(claim) for rig in each] == [log.meta.get(claim), value]


def test_without_a_run_it_asks_for_one() -> None:
    with pytest.raises(RecordingError, match="at least one"):
        load_rigs([])


def test_a_model_beside_the_log_is_found_from_anywhere(tmp_path: Path) -> None:
    log = joints_log(seconds=1.0)
    write_run_log(replace(log, meta={**log.meta, "robot": "dog.xml"}), tmp_path / "run")
    with pytest.raises(RecordingError, match=r"dog\.xml"):
        load_rigs([tmp_path / "run"])
    (tmp_path / "run" / "dog.xml").write_text("<mujoco/>")
    (found,) = load_rigs([tmp_path / "run"])
    assert Path(found.meta["robot"]).read_text() == "<mujoco/>"
    assert json.loads((tmp_path / "run" / "meta.json").read_text())["robot"] == "dog.xml"
