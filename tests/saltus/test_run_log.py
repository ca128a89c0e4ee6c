"""Run logs: a recording exported to plain tables reads back to the bit,
and bad tables are named.
"""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from recorded import STEPS, raw, run_samples, write

from saltus.cli.main import main
from saltus.errors import RecordingError
from saltus.recordings.recording import Recording
from saltus.recordings.run_claims import (
    CAMERA,
    CAMERA_OPTIONAL,
    GAINS,
    GROUND,
    OPTIONAL,
    claimed_segments,
)
from saltus.recordings.run_log import (
    BASE_COLUMNS,
    DEPTH_ARRAYS,
    FEET_COLUMNS,
    IMU_COLUMNS,
    JOINT_SIGNALS,
    read_run_log,
    write_run_log,
)
from saltus.recordings.run_log_export import as_run_log, export_run_log
from saltus.trial import Trial
from saltus.wire import codec
from saltus.wire.messages import DepthFrame, GroundTruth, JointLog, RobotState


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return write(tmp_path_factory.mktemp("run") / "recording.mcap", list(run_samples()))


@pytest.fixture
def directory(recording: Recording, tmp_path: Path) -> Path:
    export_run_log(recording, tmp_path / "log")
    return tmp_path / "log"


def test_export_reads_back_to_the_bit(recording: Recording, directory: Path) -> None:
    log = read_run_log(directory)
    rows = recording.of(JointLog)
    np.testing.assert_array_equal(log.joints.q, np.concatenate([m.position for m in rows]))
    assert log.joints.tau_est is not None
    # a drive reports the torque of the step that is over, a row says what the command of its own
    # time makes of it
    np.testing.assert_array_equal(
        log.joints.tau_est[:-1], np.concatenate([m.torque_estimated for m in rows])[1:]
    )
    for gain in ("kp", "kd"):
        np.testing.assert_array_equal(
            getattr(log.joints, gain), np.concatenate([getattr(m, gain) for m in rows])
        )
    np.testing.assert_allclose(np.diff(log.joints.time_s), 0.002, atol=1e-9)
    states = recording.of(RobotState)
    truths = recording.of(GroundTruth)
    assert log.imu is not None
    assert log.base is not None
    assert log.feet is not None
    np.testing.assert_array_equal(log.imu.values[:, 4:7], [m.angular_velocity_base for m in states])
    np.testing.assert_array_equal(
        log.base.values[:, :3], [m.position_base_in_world for m in truths]
    )
    np.testing.assert_array_equal(log.feet.values, [m.foot_force for m in truths])
    assert len(log.base.time_s) == STEPS


def test_depth_is_in_millimetres_and_what_is_not_measured_is_zero(
    recording: Recording, directory: Path
) -> None:
    depth = read_run_log(directory).depth
    assert depth is not None
    assert depth.capture_s is not None
    assert depth.depth_mm.dtype == np.uint16
    frames = recording.of(DepthFrame)
    for image, frame in zip(depth.depth_mm, frames, strict=True):
        np.testing.assert_array_equal(image, np.where(frame.depth == 65535, 0, frame.depth))
    assert (depth.arrival_s >= depth.capture_s).all()


def test_meta_claims_what_the_run_was(directory: Path) -> None:
    meta = read_run_log(directory).meta
    assert meta["schema"] == "saltus-run/1"
    assert meta["base"] == "free"
    assert len(meta["joints"]) == len(meta["kp"]) == len(meta["kd"]) == 12
    assert all(len(box["size"]) == 3 for box in meta["terrain"])
    assert meta["camera"]["latency"] == 0.05
    trial = Trial.draw(7)
    assert (meta["payload_kg"], meta["ground"]["friction"]) == (trial.payload_kg, trial.friction)


def test_rows_of_a_run_in_real_time_follow_each_other(tmp_path: Path) -> None:
    early = [
        raw(s.key, replace(m, time_ns=m.time_ns - 3_000_000 * (m.step % 3)), k)
        for k, s in enumerate(run_samples())
        if isinstance(
            m := codec.decode_message(JointLog, s.payload)
            if s.key == "controller/joints"
            else None,
            JointLog,
        )
    ]
    export_run_log(write(tmp_path / "recording.mcap", early), tmp_path / "log")
    time_s = read_run_log(tmp_path / "log").joints.time_s
    assert np.diff(time_s).min() > 0.0
    np.testing.assert_allclose(
        np.diff(time_s[::5]), np.tile([0.007, 0.007, 0.016], STEPS)[: STEPS - 1], atol=1e-9
    )


def test_everything_but_meta_and_joints_may_be_missing(directory: Path) -> None:
    for name in ("imu.csv", "base.csv", "feet.csv", "depth.npz"):
        (directory / name).unlink()
    table = (directory / "joints.csv").read_text().splitlines()
    keep = [i for i, name in enumerate(table[0].split(",")) if name == "t" or name.startswith("q_")]
    lines = [",".join(line.split(",")[i] for i in keep) for line in table]
    (directory / "joints.csv").write_text("\n".join(lines))
    log = read_run_log(directory)
    assert log.imu is log.base is log.feet is log.depth is None
    assert log.joints.dq is log.joints.tau_ff is None
    assert log.joints.q_des.shape == (5 * STEPS, 12)


def _drop_column(directory: Path) -> None:
    path = directory / "joints.csv"
    path.write_text(path.read_text().replace("q_FR_hip", "q_XX_hip", 1))


def _not_t(directory: Path) -> None:
    path = directory / "imu.csv"
    path.write_text(path.read_text().replace("t,", "time,", 1))


def _text(directory: Path) -> None:
    path = directory / "base.csv"
    path.write_text(path.read_text() + "1,2,spam\n")


def _schema(directory: Path) -> None:
    (directory / "meta.json").write_text(json.dumps({"schema": "saltus-run/9"}))


def _cut_archive(directory: Path) -> None:
    path = directory / "depth.npz"
    path.write_bytes(path.read_bytes()[:100])


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (_drop_column, "q_FR_hip' is missing"),
        (_not_t, "column .t. is missing"),
        (_text, "cannot read .*base.csv"),
        (_schema, "saltus-run/9"),
        (_cut_archive, "depth.npz"),
        (lambda directory: (directory / "joints.csv").unlink(), "joints.csv"),
        (lambda directory: (directory / "meta.json").unlink(), "not a run log"),
    ],
)
def test_what_is_wrong_with_a_log_is_said(directory: Path, damage: object, says: str) -> None:
    assert callable(damage)
    damage(directory)
    with pytest.raises(RecordingError, match=says):
        read_run_log(directory)


def test_a_recording_without_joints_has_no_log(tmp_path: Path) -> None:
    samples = [s for s in run_samples(3) if s.key != "controller/joints"]
    with pytest.raises(RecordingError, match="controller/joints"):
        export_run_log(write(tmp_path / "recording.mcap", samples), tmp_path / "log")


def test_parquet_tables_mean_the_same(directory: Path) -> None:
    expected = read_run_log(directory)
    for name in ("joints", "imu", "base", "feet"):
        csv = directory / f"{name}.csv"
        pyarrow.parquet.write_table(pyarrow.csv.read_csv(csv), directory / f"{name}.parquet")
        csv.unlink()
    log = read_run_log(directory)
    np.testing.assert_array_equal(log.joints.q_des, expected.joints.q_des)
    assert log.imu is not None
    assert expected.imu is not None
    np.testing.assert_array_equal(log.imu.values, expected.imu.values)


@pytest.mark.parametrize("whole", [True, False])
def test_archives_of_numpy_mean_the_same(directory: Path, whole: bool) -> None:
    """With an array for each column, or for each signal of the joints one of all of them."""
    expected = read_run_log(directory)
    for name in ("joints", "imu", "base", "feet"):
        csv = directory / f"{name}.csv"
        table = pyarrow.csv.read_csv(csv)
        arrays = {column: table[column].to_numpy() for column in table.column_names}
        if whole and name == "joints":
            signals = {signal: getattr(expected.joints, signal) for signal in JOINT_SIGNALS}
            arrays = {
                "t": expected.joints.time_s,
                **{s: v for s, v in signals.items() if v is not None},
            }
        np.savez(directory / f"{name}.npz", **arrays)
        csv.unlink()
    log = read_run_log(directory)
    for signal in JOINT_SIGNALS:
        np.testing.assert_array_equal(getattr(log.joints, signal), getattr(expected.joints, signal))
    assert log.imu is not None
    assert expected.imu is not None
    np.testing.assert_array_equal(log.imu.values, expected.imu.values)
    np.savez(directory / "joints.npz", t=expected.joints.time_s[:9], q=expected.joints.q)
    with pytest.raises(RecordingError, match=r"joints.npz: 't' has 9 rows, another column"):
        read_run_log(directory)


def test_what_was_written_reads_back_to_the_bit(directory: Path, tmp_path: Path) -> None:
    log = read_run_log(directory)
    q = log.joints.q * np.pi
    q[3, 2] = np.nan
    write_run_log(replace(log, joints=replace(log.joints, q=q)), tmp_path / "again")
    np.testing.assert_array_equal(read_run_log(tmp_path / "again").joints.q, q)


@pytest.mark.parametrize("outer", [True, False])
def test_segments_stand_beside_or_within_the_excitation(outer: bool) -> None:
    named = [{"name": "a", "t0": 0, "t1": 1.5, "condition": "slow"}]
    assert (
        claimed_segments(
            {"segments": named, "excitation": "text"}
            if outer
            else {"excitation": {"segments": named}}
        )
        == named
    )
    assert claimed_segments({"excitation": "text"}) == []
    for wrong in (
        {"name": "a", "t0": 0, "t1": 1},
        {**named[0], "t1": -1.0},
        {**named[0], "t0": "0"},
    ):
        with pytest.raises(RecordingError, match="segment"):
            claimed_segments({"segments": [wrong]})


def test_a_clock_that_runs_backwards_is_read_as_it_is(directory: Path) -> None:
    lines = (directory / "imu.csv").read_text().splitlines()
    (directory / "imu.csv").write_text("\n".join([lines[0], *reversed(lines[1:])]))
    imu = read_run_log(directory).imu
    assert imu is not None
    assert (np.diff(imu.time_s) < 0).all()


def test_a_run_is_imported_by_its_folder_its_recording_and_by_find(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    write(run / "recording.mcap", list(run_samples()))
    logs = []
    for name, source in (("folder", run), ("file", run / "recording.mcap")):
        assert main(["real2sim", "import", str(source), "--out", str(tmp_path / name)]) == 0
        logs.append(read_run_log(tmp_path / name))
    assert as_run_log(tmp_path / "folder", tmp_path / "unused") == tmp_path / "folder"
    np.testing.assert_array_equal(logs[0].joints.q, logs[1].joints.q)
    assert len(logs[0].joints.q) > 0
    main(["real2sim", "find", str(run), "--no-report", "--out", str(tmp_path / "found")])
    assert (tmp_path / "found" / "logs" / "run" / "meta.json").is_file()
    assert (tmp_path / "found" / "verdict.json").is_file()


def test_the_page_of_the_form_names_every_column_and_claim_that_is_read() -> None:
    page = (Path(__file__).parents[2] / "docs" / "real2sim.md").read_text()
    form = page.split("## Writing a run log")[1].split("\n## ")[0]
    columns = {f"{signal}_J" for signal in JOINT_SIGNALS} | {
        *IMU_COLUMNS,
        *BASE_COLUMNS,
        *FEET_COLUMNS,
        *DEPTH_ARRAYS,
    }
    claims = {
        *GAINS,
        *OPTIONAL,
        *GROUND,
        *CAMERA,
        *CAMERA_OPTIONAL,
        "payload_position",
        "excitation",
    }
    code = " ".join(form.split("`")[1::2])
    assert columns | claims <= set(re.findall(r"\w+", code))
