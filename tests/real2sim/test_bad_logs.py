"""Logs that cannot be read or used: `saltus real2sim find` fails,
says why in one line, and leaves nothing behind.
"""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from rig_logs import body_log

from saltus.cli.main import main
from saltus.errors import RecordingError
from saltus.recordings.run_log import read_run_log, write_run_log

Damage = Callable[[Path], None]


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("healthy") / "log"
    write_run_log(body_log(seconds=2.0), folder)
    return folder


@pytest.fixture
def log(healthy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copytree(healthy, tmp_path / "log"))


def claim(**claims: object) -> Damage:
    """Changes claims in meta.json; ... takes one away."""

    def damage(log: Path) -> None:
        meta = json.loads((log / "meta.json").read_text())
        meta |= claims
        meta = {key: value for key, value in meta.items() if value is not ...}
        (log / "meta.json").write_text(json.dumps(meta))

    return damage


def camera(**claims: object) -> Damage:
    """Changes claims of the camera; ... takes one away."""

    def damage(log: Path) -> None:
        own = json.loads((log / "meta.json").read_text())["camera"] | claims
        claim(camera={key: value for key, value in own.items() if value is not ...})(log)

    return damage


def text(name: str, contents: str | bytes) -> Damage:
    """Writes a file of the log anew."""
    contents = contents.encode() if isinstance(contents, str) else contents
    return lambda log: (log / name).write_bytes(contents) and None


def cell(name: str, value: str, row: int = 100, column: int = 1) -> Damage:
    """Changes one value of a table."""

    def damage(log: Path) -> None:
        lines = (log / name).read_text().splitlines()
        values = lines[row].split(",")
        values[column] = value
        (log / name).write_text("\n".join([*lines[:row], ",".join(values), *lines[row + 1 :], ""]))

    return damage


def column(name: str, value: str, index: int = 1) -> Damage:
    """Gives a whole column of a table one value."""

    def damage(log: Path) -> None:
        head, *lines = (log / name).read_text().splitlines()
        rows = [
            ",".join([*v[:index], value, *v[index + 1 :]])
            for v in (line.split(",") for line in lines)
        ]
        (log / name).write_text("\n".join([head, *rows, ""]))

    return damage


def archive(**arrays: object) -> Damage:
    """Changes arrays of depth.npz; ... takes one away."""

    def damage(log: Path) -> None:
        with np.load(log / "depth.npz") as known:
            held = {name: known[name] for name in known.files} | arrays
        held = {name: value for name, value in held.items() if value is not ...}
        np.savez(log / "depth.npz", **held)  # type: ignore[arg-type]

    return damage


def gone(name: str) -> Damage:
    return lambda log: (log / name).unlink()


def cut(name: str, count: int) -> Damage:
    return lambda log: (log / name).write_bytes((log / name).read_bytes()[:count]) and None


def folder(name: str) -> Damage:
    def damage(log: Path) -> None:
        (log / name).unlink()
        (log / name).mkdir()

    return damage


def parquet(table: pa.Table | bytes) -> Damage:
    def damage(log: Path) -> None:
        if isinstance(table, bytes):
            (log / "joints.parquet").write_bytes(table)
        else:
            pyarrow.parquet.write_table(table, log / "joints.parquet")

    return damage


def _all(log: Path) -> None:
    for path in log.iterdir():
        path.unlink()


def _a_run(log: Path) -> None:
    _all(log)
    (log / "recording.mcap").write_bytes(b"\x89MCAP0\r\n")
    (log / "report.html").write_text("<html>")


NOT_READ: dict[str, tuple[Damage, str]] = {
    "no folder": (shutil.rmtree, "no such folder"),
    "empty folder": (_all, "no meta.json"),
    "a demo's folder": (_a_run, "recording.mcap"),
    "meta missing": (gone("meta.json"), "no meta.json"),
    "meta empty": (text("meta.json", ""), "meta.json"),
    "meta is text": (text("meta.json", "kp = 20"), "meta.json"),
    "meta is binary": (text("meta.json", b"\x00\xff\xfe"), "meta.json"),
    "meta is a list": (text("meta.json", "[]"), "meta.json"),
    "meta is too deep": (text("meta.json", "[" * 100_000), "meta.json"),
    "meta is a folder": (folder("meta.json"), "meta.json"),
    "another schema": (claim(schema="saltus-run/9"), "saltus-run/9"),
    "schema is a list": (claim(schema=[1]), "schema"),
    "no joints": (claim(joints=[]), "joints"),
    "joints is text": (claim(joints="FR_hip"), "joints"),
    "joints are numbers": (claim(joints=[1, 2]), "joints"),
    "a joint twice": (claim(joints=["FR_hip", "FR_hip"]), "FR_hip"),
    "base unknown": (claim(base="hanging"), "base"),
    "base is a list": (claim(base=["free"]), "base"),
    "kp missing": (claim(kp=...), "kp"),
    "kp is text": (claim(kp="stiff"), "kp"),
    "kp is null": (claim(kp=None), "kp"),
    "kp of three joints": (claim(kp=[1.0, 2.0, 3.0]), "kp"),
    "kp is nested": (claim(kp=[[20.0] * 12]), "kp"),
    "kp is true": (claim(kp=True), "kp"),
    "kp negative": (claim(kp=-20.0), "kp"),
    "kp not a number": (claim(kp=float("nan")), "kp"),
    "kp huge": (claim(kp=10**400), "kp"),
    "kd infinite": (claim(kd=float("inf")), "kd"),
    "control_dt zero": (claim(control_dt=0.0), "control_dt"),
    "control_dt negative": (claim(control_dt=-0.002), "control_dt"),
    "control_dt is text": (claim(control_dt="2 ms"), "control_dt"),
    "robot is a number": (claim(robot=1), "robot"),
    "robot missing from the folder": (claim(robot="go9.xml"), "go9.xml"),
    "robot elsewhere": (claim(robot="../../etc/passwd"), "robot"),
    "payload is text": (claim(payload_kg="heavy"), "payload_kg"),
    "payload negative": (claim(payload_kg=-1.0), "payload_kg"),
    "payload huge": (claim(payload_kg=1e300), "payload_kg"),
    "payload position of two": (claim(payload_position=[0.0, 1.0]), "payload_position"),
    "ground is text": (claim(ground="ice"), "ground"),
    "friction is text": (claim(ground={"friction": "low"}), "friction"),
    "friction zero": (claim(ground={"friction": 0.0}), "friction"),
    "contact without time": (claim(ground={"contact_time_constant": 0.0}), "contact_time_constant"),
    "terrain unknown": (claim(terrain="stairs"), "terrain"),
    "terrain is a number": (claim(terrain=3), "terrain"),
    "box without size": (claim(terrain=[{"center": [0, 0, 0]}]), "size"),
    "box of two numbers": (claim(terrain=[{"center": [0, 0], "size": [1, 1, 1]}]), "center"),
    "box of text": (claim(terrain=[{"center": ["a", 0, 0], "size": [1, 1, 1]}]), "center"),
    "box of negative size": (claim(terrain=[{"center": [0, 0, 0], "size": [-1, 1, 1]}]), "size"),
    "segments is text": (claim(segments="all"), "segments"),
    "segment without end": (claim(segments=[{"name": "a", "t0": 0.0, "condition": "c"}]), "t1"),
    "segment backwards": (
        claim(segments=[{"name": "a", "t0": 1.0, "t1": 0.0, "condition": "c"}]),
        "t0 < t1",
    ),
    "segment not a number": (
        claim(segments=[{"name": "a", "t0": float("nan"), "t1": 1, "condition": "c"}]),
        "t0 < t1",
    ),
    "camera is text": (claim(camera="D435i"), "camera"),
    "camera without fx": (camera(fx=...), "fx"),
    "camera fx is text": (camera(fx="wide"), "fx"),
    "camera fx zero": (camera(fx=0.0), "fx"),
    "camera position of two": (camera(position=[0.0, 0.1]), "position"),
    "camera latency negative": (camera(latency=-1.0), "latency"),
    "camera width is half": (camera(width=0.5), "width"),
    "camera range infinite": (camera(range_max=float("inf")), "range_max"),
    "joints missing": (gone("joints.csv"), "joints.csv"),
    "joints empty": (text("joints.csv", ""), "joints.csv"),
    "joints without rows": (text("joints.csv", "t,q_FR_hip\n"), "joints.csv"),
    "joints is a folder": (folder("joints.csv"), "joints.csv"),
    "joints is binary": (text("joints.csv", b"\x00\x01\xff" * 100), "joints.csv"),
    "joints has text": (cell("joints.csv", "fast"), "joints.csv"),
    "joints has a long row": (cell("joints.csv", "1,2"), "joints.csv"),
    "joints cut short": (cut("joints.csv", 5000), "joints.csv"),
    "parquet damaged": (parquet(b"PAR1"), "joints.parquet"),
    "parquet empty": (parquet(b""), "joints.parquet"),
    "parquet has text": (parquet(pa.table({"t": ["a"]})), "joints.parquet"),
    "imu without a column": (text("imu.csv", "t,qw\n0,1\n"), "qx"),
    "imu empty": (text("imu.csv", ""), "imu.csv"),
    "base has text": (cell("base.csv", "here"), "base.csv"),
    "depth empty": (text("depth.npz", b""), "depth.npz"),
    "depth is text": (text("depth.npz", "1 2 3"), "depth.npz"),
    "depth cut": (cut("depth.npz", 200), "depth.npz"),
    "depth is a folder": (folder("depth.npz"), "depth.npz"),
    "depth pickled": (archive(depth=np.array([{"a": 1}], dtype=object)), "depth.npz"),
    "depth without images": (archive(depth=...), "depth"),
    "depth without ids": (archive(frame_id=...), "frame_id"),
    "depth of one image": (archive(depth=np.zeros((4, 4), np.uint16)), "depth.npz"),
    "depth in metres": (archive(depth=np.ones((95, 4, 4))), "depth.npz"),
    "depth of no pixels": (archive(depth=np.zeros((95, 0, 0), np.uint16)), "depth.npz"),
    "arrivals are text": (archive(t_arrival=np.array(["now"] * 95)), "t_arrival"),
    "arrivals are a table": (archive(t_arrival=np.zeros((95, 2))), "t_arrival"),
    "captures too few": (archive(t_capture=np.zeros(3)), "t_capture"),
    "ids are fractions": (archive(frame_id=np.linspace(0, 1, 95)), "frame_id"),
}
"""Damage, and what the line must name."""


@pytest.mark.parametrize("case", NOT_READ)
def test_what_is_no_run_log_is_refused_in_one_line(
    case: str, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damage, named = NOT_READ[case]
    damage(log)
    assert main(["real2sim", "find", "log", "--out", "out", "--no-report"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("saltus: ")
    assert "log" in captured.err
    assert named in captured.err
    assert len(captured.err) < 400
    assert not Path("out").exists()


NOT_USED: dict[str, tuple[Damage, str]] = {
    "q is not a number": (column("joints.csv", "nan"), "q"),
    "one q is not a number": (cell("joints.csv", ""), "q"),
    "one q is infinite": (cell("joints.csv", "inf"), "q"),
    "one q is huge": (cell("joints.csv", "1e300"), "q"),
    "time is not a number": (cell("joints.csv", "nan", column=0), "joints"),
    "time is huge": (column("joints.csv", "1e300", 0), "joints"),
    "time stands still": (column("joints.csv", "0.0", 0), "joints"),
    "one time is huge": (cell("joints.csv", "1e300", column=0), "joints"),
    "imu is not a number": (column("imu.csv", "nan", 5), "imu"),
    "imu has no rotation": (column("imu.csv", "0.0"), "imu"),
    "one rate is huge": (cell("imu.csv", "1e200", column=5), "imu"),
    "base is not a number": (column("base.csv", "nan"), "base"),
    "base is huge": (column("base.csv", "-1e200", 3), "base"),
    "images are blind": (
        lambda log: archive(depth=np.zeros((95, 48, 64), np.uint16))(log),
        "depth",
    ),
    "arrivals are not numbers": (lambda log: archive(t_arrival=np.full(95, np.nan))(log), "depth"),
    "arrivals are huge": (lambda log: archive(t_arrival=np.full(95, 1e300))(log), "depth"),
    "ids are huge": (lambda log: archive(frame_id=np.arange(95)[::-1] + 2**62)(log), "depth"),
}
"""Damage, and the table that the line must name."""


@pytest.mark.parametrize("case", NOT_USED)
def test_a_log_that_contradicts_itself_is_not_fitted_and_not_a_success(
    case: str, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damage, named = NOT_USED[case]
    damage(log)
    assert main(["real2sim", "find", "log", "--out", "out", "--no-report", "--json"]) == 1
    captured = capsys.readouterr()
    said = json.loads(captured.out.splitlines()[-1])
    assert said["verdict"] == "bad_log"
    assert not said["effects"]
    assert any(fault.startswith(named) for fault in said["log_faults"])
    assert "Traceback" not in captured.err
    assert json.loads(Path("out/verdict.json").read_text()) == said
    assert sorted(path.name for path in Path("out").iterdir()) == [
        "baselines.json",
        "patch.toml",
        "verdict.json",
    ]


PLACES: dict[str, tuple[list[str], str]] = {
    "a table": (["log/joints.csv"], "is a file"),
    "the same twice": (["log", "./log"], "twice"),
    "one good, one missing": (["log", "other"], "other"),
    "out is a file": (["log", "--out", "log/meta.json"], "log/meta.json"),
    "out is below a file": (["log", "--out", "log/meta.json/out"], "log/meta.json/out"),
    "out cannot be made": (["log", "--out", "/proc/nothing/here"], "/proc/nothing/here"),
}


@pytest.mark.parametrize("case", PLACES)
def test_a_place_that_cannot_be_is_refused_before_anything_is_compared(
    case: str, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, named = PLACES[case]
    before = sorted(Path().rglob("*"))
    assert main(["real2sim", "find", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert named in captured.err
    runs = {Path("runs")} if "--out" not in arguments else set()
    assert set(Path().rglob("*")) - runs == set(before), "nothing was made, nothing was lost"


def test_a_disk_that_is_full_leaves_the_earlier_results_whole(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    column("joints.csv", "nan")(log)
    call = ["real2sim", "find", "log", "--out", "out", "--no-report"]
    assert main(call) == 1
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}

    def full(path: Path, text: str, encoding: str | None = None) -> int:
        if path.name == ".patch.toml.partial":
            raise OSError(28, "No space left on device", str(path))
        return path.write_bytes(text.encode(encoding or "utf-8"))

    monkeypatch.setattr(Path, "write_text", full)
    assert main(call) == 2
    assert "No space left" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before


def test_a_report_of_an_earlier_look_does_not_stay_beside_another_verdict(log: Path) -> None:
    column("joints.csv", "nan")(log)
    assert main(["real2sim", "find", "log", "--out", "out"]) == 1
    assert Path("out/report.html").stat().st_size > 1000
    assert main(["real2sim", "find", "log", "--out", "out", "--no-report"]) == 1
    assert not Path("out/report.html").exists()


def test_a_run_log_is_not_written_over_another_and_is_none_before_it_is_whole(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = body_log(seconds=1.0)
    with pytest.raises(RecordingError, match="already"):
        write_run_log(other, log)

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(RecordingError, match="No space left"):
        write_run_log(other, Path("new"))
    with pytest.raises(RecordingError, match=r"no meta\.json"):
        read_run_log(Path("new"))
