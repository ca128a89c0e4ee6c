"""What is said of a run that failed: what began it comes first, how it ended last."""

import json
import re
from dataclasses import asdict
from pathlib import Path

import pytest
from samples import setup_of

from saltus.config import RunConfig, TerrainConfig
from saltus.named_setup import named_setup
from saltus.recordings.recorder import Recorder
from saltus.recordings.recording import read_recording
from saltus.recordings.report import ScanSection, write_run_report
from saltus.recordings.summary import run_sentence, summarise_run
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Outcome
from saltus.wire import codec
from saltus.wire.bus import RawSample
from saltus.wire.codec import Envelope
from saltus.wire.messages import Event

SLOW = (4.0, "too_slow", "this computer reaches 60% of real time")
DIED = (2.0, "process_died", "render: signal SIGKILL")
BLIND = (2.2, "depth_lost", "step 220, image 120 ms old")
STOPPED = (2.3, "heightmap_invalid", "the heightmap of step 230 is INVALID")
UNPLANNED = (2.5, "plan_lost", "the newest plan is 130 ms old")
RAN = (1.0, "mode_run", "plan GO")
FELL = (3.0, "fell", "not_upright")
AFTERWARDS = (3.1, "heightmap_lost", "no heightmap for 150 ms")
BEFORE = (0.5, "plan_lost", "the newest plan is 110 ms old")

CASES = {
    "alone": ([RAN, FELL], "not upright"),
    "too slow": ([RAN, FELL, SLOW], f"{SLOW[2]}; then not upright"),
    "outside of the run": ([BEFORE, RAN, FELL, AFTERWARDS], "not upright"),
    "stopped": (
        [RAN, STOPPED, UNPLANNED, FELL],
        f"the robot stopped: {STOPPED[2]}; then not upright",
    ),
    "dead": (
        [RAN, DIED, BLIND, STOPPED, FELL],
        f"a process died: {DIED[2]}; then no images: {BLIND[2]}; "
        f"then the robot stopped: {STOPPED[2]}; then not upright",
    ),
    "never began": ([BEFORE], "the run was cut off"),
    "cut off": ([RAN, BLIND], f"no images: {BLIND[2]}; then the run was cut off"),
}


def recorded(event: tuple[float, str, str]) -> RawSample:
    """Each from a process of its own."""
    time_s, code, detail = event
    if code == "fell":
        outcome = Outcome(
            success=False, cause="not_upright", time_s=1.0, distance_m=2.0, mean_speed_mps=1.0
        )
        detail = json.dumps(asdict(outcome))
    message = Event(time_ns=round(1e9 * time_s), process=code, code=code, detail=detail)
    envelope = Envelope(1, message.time_ns, code.ljust(16).encode()[:16])
    return RawSample(
        f"event/{code}", codec.encode_message(message), envelope.to_bytes(), message.time_ns
    )


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("turned", [False, True])
def test_what_began_a_failure_comes_first_and_its_end_last(
    case: str, turned: bool, tmp_path: Path
) -> None:
    events, explanation = CASES[case]
    config = RunConfig(robot="go1", grid="line")
    with Recorder(tmp_path / "run.mcap", config, named_setup(config)) as file:
        for event in reversed(events) if turned else events:  # messages may overtake each other
            file.write(recorded(event))
    recording = read_recording(tmp_path / "run.mcap")
    summary = summarise_run(recording)
    assert summary.explanation == explanation
    assert f"did not cross ({explanation}) stairs" in run_sentence(summary)
    write_run_report(recording, summary, tmp_path / "report.html")
    listed = re.findall(r"<td>(-?\d+\.\d{3}) s</td>", (tmp_path / "report.html").read_text())
    assert len(listed) == len(events)
    assert listed == sorted(listed, key=float)


def test_a_report_shows_the_video_and_leads_to_the_recording(tmp_path: Path) -> None:
    config, folder = RunConfig(robot="go1", grid="line"), tmp_path / "a run"
    folder.mkdir()
    with Recorder(folder / "run.mcap", config, named_setup(config)) as file:
        file.write(recorded(FELL))
    recording = read_recording(folder / "run.mcap")
    write_run_report(
        recording, summarise_run(recording), tmp_path / "report.html", folder / "video.mp4"
    )
    text = (tmp_path / "report.html").read_text()
    assert '<a href="a%20run/run.mcap">run.mcap</a>' in text
    assert 'src="a%20run/video.mp4" poster="a%20run/video.png"' in text  # of what is not yet played
    write_run_report(recording, summarise_run(recording), tmp_path / "report.html")
    assert "<video" not in (tmp_path / "report.html").read_text()
    figures = {
        "points": 187,
        "status": {"ok": 3},
        "seen": {"mean_mm": 16.14, "inside": 0.923, "half_width_mm": 19.6, "share": 0.51},
    }
    section = ScanSection.of_figures(figures, folder / "scan.png")
    write_run_report(recording, summarise_run(recording), tmp_path / "report.html", scan=section)
    text = (tmp_path / "report.html").read_text()
    assert 'src="a%20run/scan.png"' in text
    row = re.sub(r"<[^>]*>", " ", text[text.index("<td>seen") :]).split("\n")
    assert " ".join(row[0].split()) == "seen 51 % 16.1 mm 92 % 20 mm"


@pytest.mark.parametrize("kind", ["flat", "stairs"])
def test_times_are_said_to_run_from_where_they_run(kind: str, tmp_path: Path) -> None:
    config = RunConfig(robot="go1", grid="line", terrain=TerrainConfig(terrain=kind))
    terrain = make_terrain(config.terrain)
    with Recorder(tmp_path / "run.mcap", config, setup_of(terrain)) as file:
        file.write(recorded(FELL))
    recording = read_recording(tmp_path / "run.mcap")
    summary = summarise_run(recording)
    write_run_report(recording, summary, tmp_path / "report.html")
    for said in (run_sentence(summary), (tmp_path / "report.html").read_text()):
        assert ("before the first edge" in said) == (kind == "stairs")
        assert terrain.timed in said
