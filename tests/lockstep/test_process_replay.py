"""Each process of a recorded run, fed what it heard, says what it said;
where it does not, the difference is told.
"""

import json
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from lockstep_run import check_repeats, compared, recorded_run
from samples import EVERYTHING

from saltus.cli.main import main
from saltus.config import PlannerName, RunConfig, TerrainConfig
from saltus.errors import RecordingError
from saltus.loop.body import Body
from saltus.plan import Plan, plan_of
from saltus.recordings.answers import AnswerComparison
from saltus.recordings.recorder import Recorder
from saltus.recordings.recording import Recording, read_recording
from saltus.runtime.programs import PROGRAMS
from saltus.runtime.replay import ReplayedMessage
from saltus.states import ProprioceptionArrays
from saltus.wire import codec
from saltus.wire.bus import RawSample, sender_of
from saltus.wire.messages import ControllerMode, GroundTruth, MotionPlan, RobotState

NAMES = [program.name for program in PROGRAMS]
STEPS = 150
COURSES = ("flat", "stairs", "gap", "stepping_stones")
ASKED = (None, ("push", "8"), None, ("blind", "0.2"))


def run(folder: Path, number: int) -> Recording:
    """A run of a drawn seed, of another course, camera,
    planner, profile and operator for each number.
    """
    rng = np.random.default_rng(number)
    planners: tuple[PlannerName, ...] = ("learned", "scripted")
    profile = folder / "everything.toml"
    profile.write_text(EVERYTHING.to_toml())
    config = RunConfig(
        robot="go1",
        grid="line",
        terrain=TerrainConfig(terrain=COURSES[number]),
        seed=int(rng.integers(2**31)),
        camera=("ideal", "d435i")[number % 2],
        planner=planners[number % 3 % 2],
        profile=str(profile) if number > 1 else "shipped",
        time_limit_s=1.3,
    )
    return recorded_run(folder, config, ASKED[number])


@pytest.mark.slow
@pytest.mark.parametrize("number", range(1, len(COURSES)))
def test_every_process_repeats_to_the_bit(number: int, tmp_path: Path) -> None:
    recording = run(tmp_path, number)
    for name in NAMES:
        check_repeats(recording, name, STEPS)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return run(tmp_path_factory.mktemp("run"), 0)


def answers(recording: Recording, name: str) -> list[ReplayedMessage]:
    """Messages of a process, as they are recorded."""
    keys = [key for key in recording.senders if sender_of(key) == name]
    return [
        ReplayedMessage(key, message, codec.encode_message(message))
        for key in keys
        if not key.startswith("status/")
        for _, _, message in recording.messages(key)
    ]


def copied(recording: Recording, path: Path, config: RunConfig, without: str = "-") -> Path:
    """The same messages, but for those of one key, under another configuration."""
    with Recorder(path, config, recording.setup) as file:
        for arrival in recording.arrivals(-1, 2**62):
            if not arrival.key.startswith(without):
                attachment = arrival.envelope.to_bytes()
                file.write(RawSample(arrival.key, arrival.payload, attachment, arrival.arrival_ns))
    return path


@pytest.mark.parametrize("name", NAMES)
def test_a_changed_entry_is_told_with_its_place(recording: Recording, name: str) -> None:
    rng = np.random.default_rng(len(name))
    said = answers(recording, name)
    for _ in range(5):
        place = int(rng.integers(len(said)))
        key, message, _ = said[place]
        numbers = [
            field.name
            for field in fields(message)
            if field.name not in ("time_ns", "step")
            and np.asarray(getattr(message, field.name)).dtype.kind in "uif"
            and np.size(getattr(message, field.name))
        ]
        if not numbers:  # of an event
            continue
        field = str(rng.choice(numbers))
        value = np.array(getattr(message, field))
        index = tuple(int(rng.integers(size)) for size in value.shape)
        value[index] += 1
        other = replace(message, **{field: value if value.shape else value.item()})
        comparison = AnswerComparison(recording, name)
        for answer in said:
            changed = answer.message is message
            comparison.take(
                key, other, codec.encode_message(other)
            ) if changed else comparison.take(*answer)
        comparison.finish()
        first = comparison.first
        assert first is not None
        assert (first.topic, first.time_ns) == (key, message.time_ns)
        assert first.field == (f"{field}[{', '.join(map(str, index))}]" if index else field)
        assert list(comparison.fields) == [f"{key}.{field}"]
        assert comparison.fields[f"{key}.{field}"].messages == 1
        assert str(first.recorded) in str(first)


def assert_same(ours: object, theirs: object, names: Iterable[str]) -> None:
    """A batch of one robot, and that robot."""
    for name in names:
        one = np.squeeze(getattr(ours, name))
        np.testing.assert_allclose(one, getattr(theirs, name), atol=1e-9, err_msg=name)


def test_a_body_that_is_given_the_recorded_plans_goes_where_the_robot_went(
    recording: Recording,
) -> None:
    """The controller's process and `Body`, of which evaluations and data are made, are one loop."""
    body, states = Body([recording.setup]), recording.of(RobotState)
    modes = [state.mode for state in states]
    ends = modes.index(ControllerMode.LANDING)  # which the controller's own plans lead
    assert modes[:ends].count(ControllerMode.RUN) > 20
    truths = recording.of(GroundTruth)
    rows = zip(recording.of(MotionPlan), truths, states, modes[1:ends], strict=False)
    for message, truth, known, mode in rows:
        assert_same(body.truth, truth, ("position_base_in_world", "joint_position"))
        assert_same(
            body.states(), known, [f.name for f in fields(ProprioceptionArrays) if f.name != "step"]
        )
        plan = plan_of(message)
        one = {f.name: np.array([getattr(plan, f.name)]) for f in fields(Plan)}
        body.step(Plan(**one), mode)


def test_messages_that_one_side_lacks_are_counted(recording: Recording) -> None:
    said = [answer for answer in answers(recording, "policy") if answer.key == "policy/plan"]
    comparison = AnswerComparison(recording, "policy")
    for answer in (*said[:10], *said[12:]):
        comparison.take(*answer)
    late = replace(said[-1].message, time_ns=said[-1].message.time_ns + 1)
    comparison.take("policy/plan", late, codec.encode_message(late))
    comparison.finish()
    counts = comparison.topics["policy/plan"]
    assert (counts.equal, counts.missing, counts.more) == (len(said) - 2, 2, 1)
    assert comparison.first is not None
    assert comparison.first.time_ns == said[10].message.time_ns
    assert "not said again" in str(comparison.first)


def test_another_planner_plans_otherwise(recording: Recording) -> None:
    config = recording.known_config
    other: PlannerName = "scripted" if config.planner == "learned" else "learned"
    comparison = compared(recording, "policy", replace(config, planner=other))
    assert comparison.first is not None
    assert comparison.first.topic == "policy/plan"
    assert comparison.topics["done/policy"].differ == 0


@pytest.mark.parametrize("process", ["camera", "heightmap", "planner", "controller"])
def test_the_command_repeats_a_process_to_the_bit_and_says_so(
    recording: Recording, process: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(recording.path), "--process", process, "--json"]) == 0
    table = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert table["first_difference"] is None
    assert all(row["equal"] for row in table["messages"].values())
    assert sum(row["equal"] for row in table["messages"].values()) > STEPS


def test_a_difference_fails_where_a_run_must_repeat(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A recording that names another planner than the run had,
    whole, or without the run's outcome.
    """
    config = replace(recording.known_config, planner="scripted")
    changed = copied(recording, tmp_path / "changed.mcap", config)
    assert main(["replay", str(changed), "--process", "planner"]) == 1
    assert "policy/plan at " in capsys.readouterr().out
    cut = copied(recording, tmp_path / "cut.mcap", config, without="event/controller")
    assert main(["replay", str(cut), "--process", "planner"]) == 0
    assert "policy/plan at " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--process", "camera", "--model", "x.onnx"], "the camera has no network"),
        (["--process", "controller", "--grid", "scan"], "--grid is of the heightmap"),
        (["--process", "planner", "--model", "x.onnx"], "x.onnx"),
        (["--process", "camra"], "camera"),
    ],
)
def test_flags_that_do_not_fit_are_said(
    recording: Recording, flags: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(recording.path), *flags]) == 2
    assert said in capsys.readouterr().err


def test_a_run_without_what_a_process_hears_is_refused(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hears = {"render": "plant/truth", "policy": "heightmap/heightmap", "controller": "done/render"}
    for name, topic in hears.items():
        path = copied(recording, tmp_path / f"{name}.mcap", recording.known_config, topic)
        with pytest.raises(RecordingError, match=f"has no {topic}, which is heard"):
            compared(read_recording(path), name)
    assert main(["replay", str(path), "--process", "controller"]) == 2
    assert "saltus demo" in capsys.readouterr().err
