"""Logs of others become run logs: bags of ROS to the last digit, tables by their description."""

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from realsense_bag import write_bag as write_realsense
from rig_logs import body_log, joints_log
from ros_bag import write_bag
from samples import ROBOT

from saltus.cli.main import main
from saltus.config import load_config
from saltus.errors import RecordingError
from saltus.real2sim.importers.importing import import_recording
from saltus.real2sim.pipeline import find_in_logs
from saltus.recordings.recording_description import BagTopics, RecordingDescription, TableColumns
from saltus.recordings.run_log import JOINT_SIGNALS, RunLog, read_run_log, write_run_log

PROJECT = Path(__file__).resolve().parents[2]
NOT_OF_A_BAG = ("position", "pitch", "latency", "range_max")


def claims_of(log: RunLog) -> dict[str, Any]:
    """What a bag or a table does not say of itself."""
    claims = {key: log.meta[key] for key in ("base", "kp", "kd", "terrain")}
    camera = log.meta.get("camera")
    return (
        claims
        if camera is None
        else claims | {"camera": {key: camera[key] for key in NOT_OF_A_BAG}}
    )


def same(log: RunLog, other: RunLog) -> None:
    """Times may differ by what a nanosecond's rounding makes of them,
    velocities by a rotation and back.
    """
    assert other.meta["joints"] == log.meta["joints"]
    for signal in JOINT_SIGNALS:
        mine, theirs = getattr(log.joints, signal), getattr(other.joints, signal)
        assert (mine is None) == (theirs is None), signal
        if mine is not None:
            np.testing.assert_allclose(theirs, mine, rtol=0, atol=1e-14)
    for mine, theirs in ((log.imu, other.imu), (log.base, other.base), (log.joints, other.joints)):
        assert (mine is None) == (theirs is None)
        if mine is not None:
            np.testing.assert_allclose(theirs.time_s, mine.time_s, rtol=0, atol=1e-9)
    for mine, theirs in ((log.imu, other.imu), (log.base, other.base)):
        if mine is not None:
            np.testing.assert_allclose(theirs.values, mine.values, rtol=0, atol=1e-14)
    if log.depth is not None:
        np.testing.assert_array_equal(other.depth.depth_mm, log.depth.depth_mm)
        np.testing.assert_allclose(other.depth.arrival_s, log.depth.arrival_s, rtol=0, atol=1e-9)
        np.testing.assert_allclose(other.depth.capture_s, log.depth.capture_s, rtol=0, atol=1e-9)
        mine, theirs = log.meta["camera"], other.meta["camera"]
        assert theirs == {"roll": 0.0, "yaw": 0.0} | mine | {"rate": pytest.approx(mine["rate"])}


@pytest.mark.sample(3)
@pytest.mark.parametrize("kind", ["sqlite3", "mcap", "ros1"])
@pytest.mark.parametrize("made", [body_log, joints_log])
def test_a_bag_of_ros_becomes_the_log_that_it_was_made_of(
    kind: str, made: Callable[..., RunLog], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = made(seconds=1.0)
    bag = write_bag(log, tmp_path / ("run.bag" if kind == "ros1" else "run"), kind)
    description = {"claims": claims_of(log), "topics": {"joints": "/joint_states"}}
    (tmp_path / "mine.toml").write_text(tomli_w.dumps(description))
    out = tmp_path / "log"
    words = [
        "--description",
        str(tmp_path / "mine.toml"),
        "--topics.commands",
        "/joint_commands",
        "--out",
        str(out),
    ]
    assert main(["real2sim", "import", str(bag), *words]) == 0
    assert capsys.readouterr().out.endswith(f"\n{out}\n")
    same(log, read_run_log(out))


def test_joints_are_found_by_the_names_that_are_given_and_others_are_left_out(
    tmp_path: Path,
) -> None:
    log = joints_log(seconds=0.5)
    # Seconds since 1970
    log = replace(log, joints=replace(log.joints, time_s=log.joints.time_s + 1_763_740_800.0))
    names = {f"motor {n}_joint": name for n, name in enumerate(log.meta["joints"])}
    odd = replace(log, meta=log.meta | {"joints": [name.removesuffix("_joint") for name in names]})
    bag, names["motor 11_joint"] = write_bag(odd, tmp_path / "bag"), ""
    description = RecordingDescription(
        claims=claims_of(log), topics=BagTopics(joints="/joint_states"), joint_names=names
    )
    read = read_run_log(import_recording(bag, tmp_path / "log", description, ROBOT).logs[0])
    assert read.meta["joints"] == log.meta["joints"][:11]
    np.testing.assert_array_equal(read.joints.q, log.joints.q[:, :11])
    # Doubles since 1970
    np.testing.assert_allclose(read.joints.time_s, 0.002 * np.arange(250), rtol=0, atol=3e-7)


def test_two_ways_to_one_run_give_one_verdict(tmp_path: Path) -> None:
    log = body_log(seconds=2.0)
    write_run_log(log, tmp_path / "log")
    bag = write_bag(log, tmp_path / "bag")
    description = RecordingDescription(
        claims=claims_of(log), topics=BagTopics(joints="/joint_states")
    )
    imported = import_recording(bag, tmp_path / "imported", description, ROBOT)
    first, second = (
        find_in_logs([path], tmp_path / f"of {path.name}").verdict
        for path in (tmp_path / "log", *imported.logs)
    )
    assert first.verdict != "bad_log"
    assert (second.verdict, second.sets, second.untestable) == (
        first.verdict,
        first.sets,
        first.untestable,
    )
    for mine, theirs in zip(first.effects, second.effects, strict=True):
        assert (mine.name, mine.where) == (theirs.name, theirs.where)
        for name, interval in mine.params.items():
            assert theirs.params[name].value == pytest.approx(interval.value, rel=1e-3)


def test_a_log_is_imported_compared_and_applied_without_zenoh(tmp_path: Path) -> None:
    write_bag(body_log(seconds=1.0), tmp_path / "bag")
    script = """
import sys
sys.modules["zenoh"] = None  # importing it is an error from here on
from saltus.cli.main import main
for words in sys.argv[1:]:
    assert main(words.split()) == 0, words
"""
    commands = (
        f"real2sim import bag --description {PROJECT / 'examples' / 'own_log.toml'} --out log",
        "real2sim find log --out found",
        "real2sim apply found/patch.toml --profile mine",
    )
    environment = {**os.environ, "PYTHONPATH": str(PROJECT)}
    subprocess.run(
        [sys.executable, "-P", "-c", script, *commands], cwd=tmp_path, env=environment, check=True
    )
    assert (tmp_path / "profiles" / "mine.toml").is_file()


@pytest.mark.slow
def test_without_commands_the_camera_is_compared_and_the_drives_are_not(tmp_path: Path) -> None:
    log = body_log(seconds=5.0)
    bag = write_bag(log, tmp_path / "bag", has_commands=False)
    claims = {key: value for key, value in claims_of(log).items() if key not in ("kp", "kd")}
    imported = import_recording(bag, tmp_path / "log", RecordingDescription(claims=claims), ROBOT)
    assert any("q_des, kp, kd" in note for note in imported.notes)
    verdict = find_in_logs(imported.logs, tmp_path / "found").verdict
    assert verdict.verdict != "bad_log"
    assert verdict.untestable["payload_mass"] == "no commands of the joints (q_des)"
    assert "camera_latency" not in verdict.untestable


DEGREES = TableColumns(
    time="clock", time_unit="ms", angle="deg",
    joints=tuple(reversed(joints_log(seconds=0.1).meta["joints"])),
    q="{joint} angle", dq="{joint} rate", q_des="told {number}", tau_est="torque {number}",
    kp="stiffness", kd="damping",
)  # fmt: skip


def write_table(log: RunLog, path: Path, columns: TableColumns) -> Path:
    """As `columns` says, beside a column of text."""
    order = [log.meta["joints"].index(name) for name in columns.joints]
    lines = {columns.time or "": 1e3 * log.joints.time_s}
    for signal in ("q", "dq", "q_des", "tau_est", "kp", "kd"):
        if (values := getattr(log.joints, signal)) is None:
            continue
        if signal in ("q", "dq", "q_des"):
            values = np.rad2deg(values)
        for number, (joint, place) in enumerate(zip(columns.joints, order, strict=True)):
            lines[getattr(columns, signal).format(joint=joint, number=number)] = values[:, place]
    rows = zip(*(map(repr, map(float, column)) for column in lines.values()), strict=True)
    path.write_text(
        "\n".join([", ".join(["mode", *lines]), *(",".join(["stand", *row]) for row in rows), ""])
    )
    return path


def test_a_table_in_other_units_and_another_order_is_the_same_log(tmp_path: Path) -> None:
    log = joints_log(seconds=1.0)
    changing = 20.0 + np.arange(500.0)[:, None] * np.ones(12)
    gains = {"kp": changing, "kd": 0.01 * changing}
    log = replace(log, joints=replace(log.joints, dq_des=None, tau_ff=None, **gains))
    table = write_table(log, tmp_path / "mine.csv", DEGREES)
    imported = import_recording(
        table,
        tmp_path / "log",
        RecordingDescription(claims={"base": "fixed"}, columns=DEGREES),
        ROBOT,
    )
    assert imported.notes == (
        "not in the log: imu, base, depth; what needs them will be untestable",
    )
    same(log, read_run_log(imported.logs[0]))


def _of_example() -> tuple[RunLog, RecordingDescription, TableColumns]:
    """What examples/own_csv.toml describes: a log, the description,
    its columns with the table's names of joints.
    """
    log = joints_log(seconds=1.0)
    log = replace(log, joints=replace(log.joints, dq_des=None, tau_ff=None))
    description = load_config(RecordingDescription, PROJECT / "examples" / "own_csv.toml")
    assert description.columns is not None
    return log, description, replace(description.columns, joints=tuple(description.joint_names))


def test_the_example_reads_a_table_with_its_own_names_of_joints(tmp_path: Path) -> None:
    log, description, named = _of_example()
    own = {joint: name for name, joint in description.joint_names.items()}
    theirs = replace(log, meta=log.meta | {"joints": [own[joint] for joint in log.meta["joints"]]})
    table = write_table(
        theirs, tmp_path / "mine.csv", replace(named, joints=tuple(sorted(named.joints)))
    )
    assert "hip_FL_pos_deg" in table.read_text()
    for number, columns in enumerate((description.columns, named)):
        asked = replace(description, columns=columns)
        read = read_run_log(import_recording(table, tmp_path / f"{number}", asked, ROBOT).logs[0])
        same(log, read)
        assert read.meta["control_dt"] == 0.002


@pytest.mark.parametrize(
    ("listed", "name", "joint", "nearest"),
    [
        (True, "hip_FLL", "FL_hip", "hip_FL"),
        (True, "hip_FLL", "FL_hp", "hip_FL"),
        (False, "hip_FL", "FL_hp", "FL_hip"),
    ],
)
def test_a_name_of_a_joint_that_stands_for_no_column_is_refused(
    listed: bool, name: str, joint: str, nearest: str, tmp_path: Path
) -> None:
    _, description, named = _of_example()
    names = {key: value for key, value in description.joint_names.items() if value != "FL_hip"} | {
        name: joint
    }
    asked = replace(
        description, joint_names=names, columns=named if listed else description.columns
    )
    with pytest.raises(RecordingError, match=f"'{name}' = '{joint}' .*did you mean '{nearest}'"):
        import_recording(tmp_path / "mine.csv", tmp_path / "log", asked, ROBOT)


def _backwards(log: RunLog) -> RunLog:
    time_s = log.joints.time_s.copy()
    time_s[200:] -= 0.1
    return replace(log, joints=replace(log.joints, time_s=time_s))


def _in_degrees(log: RunLog) -> RunLog:
    return replace(log, joints=replace(log.joints, q=np.rad2deg(log.joints.q)))


def _misnamed(log: RunLog) -> RunLog:
    return replace(log, meta=log.meta | {"joints": ["FR_hp", *log.meta["joints"][1:]]})


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    ("damage", "topics", "claims", "says"),
    [
        (
            lambda log: log,
            BagTopics(joints="/states"),
            {},
            "/states .* is not there: did you mean '/joint_states'",
        ),
        (lambda log: log, BagTopics(imu="/odom"), {}, "is of type nav_msgs/msg/Odometry"),
        (
            lambda log: log,
            BagTopics(),
            {},
            "/joint_commands or /joint_states: name one with --topics.joints",
        ),
        (
            _misnamed,
            BagTopics(joints="/joint_states"),
            {},
            "no joint 'FR_hp': did you mean 'FR_hip'",
        ),
        (_backwards, BagTopics(joints="/joint_states"), {}, "time runs backwards"),
        (
            _in_degrees,
            BagTopics(joints="/joint_states"),
            {},
            "more than a full turn in rad; degrees?",
        ),
        (
            lambda log: log,
            BagTopics(joints="/joint_states"),
            {"kp": -1},
            "'kp' is -1; allowed is 0 to",
        ),
    ],
)
def test_what_a_bag_cannot_mean_is_said_and_nothing_is_written(
    damage: Callable[[RunLog], RunLog],
    topics: BagTopics,
    claims: dict[str, Any],
    says: str,
    tmp_path: Path,
) -> None:
    log = replace(body_log(seconds=0.5), joints=joints_log(seconds=0.5).joints)
    bag = write_bag(damage(log), tmp_path / "bag")
    with pytest.raises(RecordingError, match=says):
        import_recording(
            bag, tmp_path / "log", RecordingDescription(topics=topics, claims=claims), ROBOT
        )
    assert not (tmp_path / "log").exists()


def _text(table: Path) -> None:
    lines = table.read_text().splitlines()
    table.write_text("\n".join([*lines[:50], lines[50].rpartition(",")[0] + ",high", *lines[51:]]))


def _rows(count: int) -> Callable[[Path], None]:
    return lambda table: (
        table.write_text("\n".join([*table.read_text().splitlines()[: 1 + count], ""])) and None
    )


@pytest.mark.parametrize(
    ("damage", "columns", "says"),
    [
        (_text, {}, "mine.csv: .* invalid value 'high'"),
        (_rows(0), {}, "mine.csv has no rows"),
        (_rows(15), {}, "15 rows are too few"),
        (lambda table: table.write_bytes(b"\xff\xfe\x00"), {}, "cannot read .*mine.csv"),
        (None, {"dq_des": "speed {number}"}, "column 'speed 0' is missing"),
        (None, {"q": "{name}"}, 'q = "{name}": within {} go joint or number'),
        (None, {"angle": "rad"}, "more than a full turn in rad; degrees?"),
        (None, {"time": None}, "either time, a column, or rate_hz"),
        (None, {"rate_hz": 500.0}, "either time, a column, or rate_hz"),
        (None, {"states_every_s": 0.002}, "it needs rate_hz and dq"),
        (None, {"time_unit": "s"}, r"rows are 2 s apart, .* check \[columns\] time_unit"),
        (None, {"time_unit": "us"}, r"rows are 2e-06 s apart, .* check \[columns\] time_unit"),
        (None, {"time": None, "rate_hz": 0.0}, "rate_hz = 0: it must be more than 0"),
        (
            None,
            {"time": None, "rate_hz": 0.1},
            r"rows are 10 s apart, .* check \[columns\] rate_hz",
        ),
        (_rows(1), {}, "has one row only"),
        (None, {"time": "told 3"}, "time runs backwards"),
        (
            None,
            {"joints": ("hip", *DEGREES.joints[1:]), "q": "told {number}", "dq": None},
            "no joint 'hip'",
        ),
    ],
)
def test_what_a_table_cannot_mean_is_said_and_nothing_is_written(
    damage: Callable[[Path], None] | None, columns: dict[str, Any], says: str, tmp_path: Path
) -> None:
    known = replace(DEGREES, kp=None, kd=None)
    table = write_table(joints_log(seconds=0.5), tmp_path / "mine.csv", known)
    if damage is not None:
        damage(table)
    with pytest.raises(RecordingError, match=says):
        import_recording(
            table, tmp_path / "log", RecordingDescription(columns=replace(known, **columns)), ROBOT
        )
    assert not (tmp_path / "log").exists()


def test_rows_too_far_apart_for_a_leg_are_noted(tmp_path: Path) -> None:
    known = replace(DEGREES, kp=None, kd=None)
    table = write_table(joints_log(seconds=0.5), tmp_path / "mine.csv", known)
    said = {}
    for rate_hz in (500.0, 5.0):
        columns = replace(known, time=None, rate_hz=rate_hz)
        given = RecordingDescription(
            columns=columns, claims={"base": "fixed", "kp": 20.0, "kd": 0.5}
        )
        said[rate_hz] = " ".join(
            import_recording(table, tmp_path / f"{rate_hz}", given, ROBOT).notes
        )
    assert "rows of joints are 0.2 s apart" in said[5.0]
    assert "apart" not in said[500.0]


def test_images_alone_are_for_another_command(tmp_path: Path) -> None:
    bag = write_realsense(tmp_path / "camera.bag", 2)
    with pytest.raises(RecordingError, match=r"`saltus render fit .*camera\.bag`"):
        import_recording(bag, tmp_path / "log", RecordingDescription(), ROBOT)
