"""Recordings that end in the middle: nothing is named without a test,
nobody is accused, and the cut is said.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from linear_problem import LinearProblem
from rig_logs import Rig, body_log, joints_log
from samples import ROBOT

from saltus.cli.main import main
from saltus.constants import POLICY_DT
from saltus.effects.profile import IDEAL
from saltus.real2sim.experiments.menu import EXPERIMENTS
from saltus.real2sim.experiments.run import run_experiment
from saltus.real2sim.pipeline import examine_logs, judge_logs
from saltus.real2sim.reporting.verdict_text import drawn_lines, next_steps, verdict_lines
from saltus.real2sim.results import Judgement
from saltus.real2sim.screening.screen import LEAST_S, log_until, screen_log
from saltus.real2sim.search.findings import (
    FoundEffect,
    ParameterInterval,
    SearchFindings,
    SignalGap,
)
from saltus.real2sim.search.search import search_effects
from saltus.real2sim.sensors import NAMED_FROM_S, SENSORS, moving_s
from saltus.real2sim.verdict import MissingData, ResidualGap, Verdict
from saltus.recordings.recording import read_recording
from saltus.recordings.run_log import RunLog, write_run_log
from saltus.recordings.run_log_export import export_run_log
from saltus.trial import Trial

FAMILIES = ("joints", "weak joints", "body and camera", "sine", "camera", "jumps")
LENGTHS = (0.02, 0.05, 0.35, 0.7, 1.39, 3.9)
EFFECT = FoundEffect(
    name="camera_latency",
    where="camera",
    params={"latency": ParameterInterval(value=0.06, ci90=(0.05, 0.07), unit="s")},
)
TESTED = SignalGap(signal="q", residuals=100, before=5.0, after=1.5, floor=1.0)


@pytest.fixture(scope="module")
def logs(jumps: tuple[RunLog, Path]) -> dict[str, RunLog]:
    return {
        "joints": joints_log(),
        "weak joints": joints_log(Rig(delay_s=0.016, gain=0.8, coulomb=0.8, bias=-0.1)),
        "body and camera": body_log(seconds=6.0),
        "sine": run_experiment(EXPERIMENTS["single_sine"], ROBOT, IDEAL, seed=3),
        "camera": run_experiment(EXPERIMENTS["height_step"], ROBOT, IDEAL, seed=3),
        "jumps": jumps[0],
    }


def cut(log: RunLog, seconds: float) -> RunLog:
    return log_until(log, float(log.joints.time_s[0]) + seconds)


@pytest.mark.sample(7)
@pytest.mark.parametrize("seconds", LENGTHS)
@pytest.mark.parametrize("family", FAMILIES)
def test_a_log_that_is_too_short_names_nothing_and_says_what_it_lacks(
    logs: dict[str, RunLog], family: str, seconds: float
) -> None:
    judgement = judge_logs(examine_logs([cut(logs[family], seconds)]), ())
    verdict = judgement.verdict
    assert (verdict.verdict, verdict.effects, verdict.sets, verdict.nearest, verdict.gap) == (
        "unexplained", (), (), (), None,
    )  # fmt: skip
    assert judgement.patch.effects == ()
    assert verdict.missing
    steps = next_steps(judgement)
    said = "\n".join(verdict_lines(judgement, Path()))
    for missing in verdict.missing:
        amount, least = (
            float(word) for word in missing.why.split() if word.replace(".", "").isdigit()
        )
        assert amount <= seconds + 0.005
        assert least == NAMED_FROM_S
        assert missing.why in said
        assert any(
            step.command.startswith(f"saltus real2sim experiments --run {missing.experiment} ")
            for step in steps
        )
        assert missing.experiment in EXPERIMENTS
    assert (
        set(next(s for s in SENSORS if s.name == verdict.missing[0].sensor).effects)
        <= verdict.untestable.keys()
    )


@pytest.mark.parametrize("rows", [3, 10, 30, 60, 100, 149, 200, 260, 301, 420, 600, 1200])
def test_a_search_names_only_what_a_test_and_the_whole_show(rows: int) -> None:
    hidden = {("e1", where, block): 3.0 for where in ("hip", "thigh") for block in ("FR", "FL")}
    problem = LinearProblem(hidden)
    count = len(problem.time_s) // 2
    problem.keep_rows(np.r_[0:rows, count : count + rows])
    findings = search_effects(problem)
    assert {effect.name for effect in findings.effects} <= {"e1"}
    assert not findings.effects or sum(gap.residuals for gap in findings.gaps) > 0
    assert findings.verdict != "named" or findings.gaps
    if rows >= 600:
        assert findings.verdict == "named"


@pytest.mark.parametrize("ruling", ["named", "set"])
def test_no_finding_and_no_verdict_can_be_made_that_names_something_untested(ruling: str) -> None:
    sets = (("camera_latency", "temporal_smear"),) if ruling == "set" else ()
    named: dict[str, Any] = {"effects": (EFFECT,)} if ruling == "named" else {"sets": sets}
    each: tuple[dict[str, Any], ...] = ({"verdict": ruling}, {"verdict": "unexplained", **named})
    for claims in each:
        with pytest.raises(ValueError, match="test"):
            Verdict(**claims)
        with pytest.raises(ValueError, match="test"):
            SearchFindings(problem="camera", **claims)
    assert SearchFindings(problem="camera", verdict=ruling, gaps=(TESTED,), **named)


@pytest.mark.sample(2)
@pytest.mark.parametrize("family", FAMILIES)
def test_no_cut_of_a_healthy_log_is_called_damaged(logs: dict[str, RunLog], family: str) -> None:
    log, rng = logs[family], np.random.default_rng(FAMILIES.index(family))
    whole_s = float(np.ptp(log.joints.time_s))
    shares = (np.arange(10) + rng.random(10)) / 10.0
    lengths = np.concatenate([0.02 * (whole_s / 0.02) ** shares[::2], whole_s * shares])
    for seconds in lengths:
        bad = [fault.text for fault in screen_log(cut(log, float(seconds))) if fault.is_fatal]
        assert bad == [], seconds


def _flipped(log: RunLog) -> RunLog:
    q, dq = log.joints.q.copy(), np.array(log.joints.dq)
    q[:, 3], dq[:, 3] = -q[:, 3], -dq[:, 3]
    return replace(log, joints=replace(log.joints, q=q, dq=dq))


def _rates_in_degrees(log: RunLog) -> RunLog:
    return replace(log, joints=replace(log.joints, dq=np.rad2deg(np.array(log.joints.dq))))


def _turned_gyroscope(log: RunLog) -> RunLog:
    assert log.imu is not None
    signs = np.array([1.0] * 4 + [-1.0] * 3 + [1.0] * 3)
    return replace(log, imu=replace(log.imu, values=log.imu.values * signs))


FAULTS: dict[str, tuple[str, Callable[[RunLog], RunLog], float]] = {
    "rates in degrees": ("joints", _rates_in_degrees, 3.5),
    "a flipped joint": ("joints", _flipped, 3.5),
    # the slow motion of the first five seconds shows no stiffness
    "another kp": ("joints", lambda log: replace(log, meta={**log.meta, "kp": 30.0}), 9.0),
    "a flipped gyroscope": ("body and camera", _turned_gyroscope, 3.5),
}
"""Damage, the log that it befalls, and the length from which on it shows [s]."""


@pytest.mark.sample(3)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_cut_of_a_damaged_log_is_called_damaged_as_soon_as_it_is_long_enough(
    logs: dict[str, RunLog], fault: str
) -> None:
    family, damage, shows_s = FAULTS[fault]
    whole_s = float(np.ptp(logs[family].joints.time_s))
    for seconds in np.linspace(shows_s, whole_s, 5):
        assert any(
            found.is_fatal for found in screen_log(damage(cut(logs[family], float(seconds))))
        )
    assert not any(found.is_fatal for found in screen_log(damage(cut(logs[family], 0.9 * LEAST_S))))


def test_what_only_the_end_of_a_log_shows_is_told_and_not_fatal() -> None:
    log = joints_log()
    q = log.joints.q.copy()
    first = int(np.searchsorted(log.joints.time_s, float(log.joints.time_s[-1]) - 0.5))
    q[first:, 3] = 2.0 * q[first, 3] - q[first:, 3]
    faults = screen_log(replace(log, joints=replace(log.joints, q=q)))
    assert not any(fault.is_fatal for fault in faults)


@pytest.mark.parametrize("seconds", [0.5, 3.0, 12.0])
def test_a_run_log_that_ends_before_its_segments_is_said_to_be_cut(
    logs: dict[str, RunLog], seconds: float
) -> None:
    assert screen_log(logs["sine"]) == []
    (fault,) = (fault for fault in screen_log(cut(logs["sine"], seconds)) if fault.name == "cut")
    assert not fault.is_fatal
    assert (
        f"ends at {seconds:.2f} s" in fault.text or f"ends at {seconds - 0.002:.2f} s" in fault.text
    )
    assert "segments are missing" in fault.text


def test_a_table_that_ends_early_is_said(logs: dict[str, RunLog]) -> None:
    log = logs["jumps"]
    short = replace(log, imu=cut(log, 3.0).imu)
    assert [fault.name for fault in screen_log(short)] == ["cut"]
    assert screen_log(short)[0].text.startswith("imu: ends 1.4") or screen_log(short)[
        0
    ].text.startswith("imu: ends 1.5")


@pytest.mark.parametrize("share", [0.1, 0.6, 0.95])
def test_a_recording_without_its_end_is_said_to_be_cut(
    jumps: tuple[RunLog, Path], share: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = jumps[1].read_bytes()
    (tmp_path / "recording.mcap").write_bytes(data[: int(share * len(data))])
    export_run_log(read_recording(tmp_path / "recording.mcap"), tmp_path / "log")
    text = (tmp_path / "log" / "meta.json").read_text()
    assert '"cut"' in text
    if share < 0.5:  # what is longer is searched
        log, out = str(tmp_path / "log"), str(tmp_path / "out")
        assert main(["real2sim", "find", log, "--out", out, "--no-report"]) == 0
        assert "note: the recording is cut: " in capsys.readouterr().out


def test_a_log_says_how_long_it_moves(logs: dict[str, RunLog]) -> None:
    log = logs["joints"]
    assert moving_s(log) == pytest.approx(12.0, abs=0.1)
    rows = np.searchsorted(log.joints.time_s, 3.0)
    still = {name: np.array(value) for name, value in vars(log.joints).items() if value is not None}
    for name in still:
        if name != "time_s":
            still[name][rows:] = still[name][rows]
    assert moving_s(replace(log, joints=replace(log.joints, **still))) == pytest.approx(
        3.5, abs=0.2
    )


def _judgement(log: RunLog, verdict: Verdict) -> Judgement:
    judgement = judge_logs(examine_logs([cut(log, 0.35)]), ())
    return replace(
        judgement, verdict=verdict, patch=replace(judgement.patch, effects=verdict.effects)
    )


TOUR = "saltus real2sim experiments --run joint_tour "
BRIEF = MissingData(
    sensor="joints", why="0.35 s of motion; joints need 4 s", experiment="joint_tour"
)
GAP = ResidualGap(before=4.0, after=1.2, floor=1.0)


@pytest.mark.parametrize(
    ("family", "verdict", "first"),
    [
        (
            "joints",
            Verdict(verdict="named", effects=(EFFECT,), gap=GAP),
            "saltus real2sim apply found/patch.toml ",
        ),
        ("joints", Verdict(verdict="no_gap", gap=GAP), None),
        ("joints", Verdict(verdict="bad_log", log_faults=("t runs backwards",)), None),
        ("camera", Verdict(verdict="unexplained", nearest=(EFFECT,), gap=GAP), TOUR),
        ("camera", Verdict(verdict="set", sets=(("a", "b"),), gap=GAP), TOUR),
        ("joints", Verdict(verdict="unexplained", missing=(BRIEF,)), TOUR),
    ],
)
def test_the_terminal_says_the_word_the_values_and_the_next_command(
    logs: dict[str, RunLog], family: str, verdict: Verdict, first: str | None
) -> None:
    said = verdict_lines(_judgement(logs[family], verdict), Path("found"))
    assert said[0].startswith(f"{verdict.verdict}: ")
    for _ in (*verdict.effects, *verdict.nearest):
        assert any(
            "camera_latency at camera: latency 0.06 (0.05 to 0.07) s" in line for line in said
        )
    steps = [line.removeprefix("next: ") for line in said if line.startswith("next: ")]
    assert steps[0].startswith(first) if first else not steps, steps


def test_what_the_seed_of_a_run_drew_is_told_from_what_is_unknown(logs: dict[str, RunLog]) -> None:
    log, trial = logs["jumps"], Trial.draw(1)
    latency = ParameterInterval(
        value=trial.camera_delay_s + 0.5 * POLICY_DT, ci90=(0.0, 0.1), unit="s"
    )
    drawn = replace(EFFECT, params={"latency": latency})
    time_constant = ParameterInterval(value=0.004, ci90=(0.003, 0.005), unit="s")
    lag = FoundEffect(name="actuator_lag", where="all", params={"time_constant": time_constant})
    late = replace(log, meta={**log.meta, "config": {**log.meta["config"], "profile": "go1"}})
    judgement = _judgement(
        late, Verdict(verdict="unexplained", effects=(drawn,), nearest=(lag,), gap=GAP)
    )
    said = "\n".join(drawn_lines(judgement))
    assert f"payload {trial.payload_kg:.3g} kg" in said
    assert "camera_latency" in said.splitlines()[1]
    assert "not drawn by the seed" in said.splitlines()[2]
    assert "actuator_lag" in said.splitlines()[2]
    assert not any("apply" in step.command for step in next_steps(judgement)), (
        "the draw of a seed is none of the robot"
    )
    assert drawn_lines(_judgement(logs["joints"], Verdict(verdict="no_gap", gap=GAP))) == []


def test_who_applies_a_verdict_is_told_which_file_is_the_patch(
    tmp_path: Path, logs: dict[str, RunLog], capsys: pytest.CaptureFixture[str]
) -> None:
    write_run_log(cut(logs["joints"], 0.5), tmp_path / "log")
    assert main(["real2sim", "find", str(tmp_path / "log"), "--out", str(tmp_path / "out")]) == 0
    assert "joints need 4 s" in (tmp_path / "out" / "report.html").read_text()
    capsys.readouterr()
    for name in ("verdict.json", "report.html", ""):
        assert main(["real2sim", "apply", str(tmp_path / "out" / name), "--profile", "mine"]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert str(tmp_path / "out" / "patch.toml") in said
