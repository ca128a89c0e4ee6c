"""The supervisor with real processes over a real router."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import psutil
import pytest
from limits import files_left

from saltus.config import Pace, RunConfig
from saltus.errors import RecordingError, StackError
from saltus.interrupts import WHOLE
from saltus.recordings.recorder import Recorder
from saltus.recordings.recording import read_recording
from saltus.recordings.timing import rates_and_ages
from saltus.runtime import run_recorder
from saltus.runtime import stack as module
from saltus.runtime.programs import PROGRAMS, Program
from saltus.runtime.run_recorder import RunRecorder
from saltus.runtime.stack import Stack
from saltus.wire.bus import RawSample
from saltus.wire.messages import Event, RobotState

PROCESSES = Path(__file__).resolve().parents[1] / "processes"
CONSUMER = Program(name="consumer", module="consumer", restart=True, spare=True)
STATES = Program(name="states", module="states", restart=False)
BROKEN = """
    import sys
    from saltus.errors import ModelError
    from saltus.runtime.process import run_process

    def body(context):
        raise ModelError("the model file is damaged")

    sys.exit(run_process("consumer", body))
"""

SILENT = """
    import sys
    import time
    import numpy as np
    from saltus.runtime.process import run_process
    from saltus.wire.messages import DepthFrame, Done

    def body(context):
        images, done = context.bus.publisher("camera/depth"), context.bus.publisher("done", "render")
        while not context.heard():  # its one status must not be lost
            time.sleep(0.01)
        context.ready()
        begun_s, step = context.clock.elapsed_s(), 0
        while not context.stopped:
            step += 1
            now_s, now_ns = context.clock.elapsed_s(), context.clock.now_ns()
            if now_s - begun_s < {hung_s}:
                done.put(Done(time_ns=now_ns, step=step, process="render"))
            elif now_s - begun_s < 2.0 * {hung_s}:
                pinhole = dict(depth_unit_m=1e-3, fx=2.0, fy=2.0, cx=1.0, cy=1.0)
                images.put(DepthFrame(time_ns=now_ns, frame_id=step, depth=np.zeros((2, 2), np.uint16), **pinhole))
            time.sleep(0.02)

    sys.exit(run_process("render", body))
"""


def children_of_run(directory: Path) -> list[psutil.Process]:
    """Processes of a run that are still there; the test's process may have other children."""
    return [
        child
        for child in psutil.Process().children()
        if str(directory) in " ".join(child.cmdline())
    ]


@pytest.fixture(autouse=True)
def importable(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{PROCESSES}")


def run_config(
    pace: Pace = "realtime", time_limit_s: float = 60.0, speed: float = 1.0
) -> RunConfig:
    return RunConfig(robot="go1", grid="line", pace=pace, time_limit_s=time_limit_s, speed=speed)


def poll_until(stack: Stack, condition: Callable[[], bool], timeout_s: float) -> float:
    """Limits are in the clock of the run."""
    start_s = stack._clock.elapsed_s()
    while not condition():
        assert stack._clock.elapsed_s() - start_s < timeout_s, "too late"
        assert stack.poll()
        time.sleep(0.01)
    return stack._clock.elapsed_s() - start_s


def pids_of_run(directory: Path) -> set[int]:
    return {child.pid for child in children_of_run(directory)}


def strike_consumer_then_robot(stack: Stack) -> None:
    for restarts, number in enumerate((signal.SIGKILL, signal.SIGSTOP), start=1):
        child = stack._children["consumer"]
        poll_until(stack, lambda c=child: c.has_spare and not c.loading, 10.0)  # type: ignore[misc]
        old, before = stack.pid("consumer"), pids_of_run(stack.run_dir)
        os.kill(old, number)
        poll_until(stack, lambda n=restarts: stack.restarts["consumer"] == n, 5.0)  # type: ignore[misc]
        assert stack.pid("consumer") in before - {old}  # one that had loaded takes over
        poll_until(stack, lambda: stack._children["consumer"].ready, 10.0)
    os.kill(stack.pid("states"), signal.SIGKILL)
    stack.wait(5.0)


def test_the_table_has_the_four_processes_and_the_robot_comes_last() -> None:
    assert [p.name for p in PROGRAMS] == ["render", "heightmap", "policy", "controller"]
    assert [p.restart for p in PROGRAMS] == [True, True, True, False]


def test_the_dead_and_the_hung_come_back_and_the_end_of_the_robot_is_the_end(
    speed: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SPARE_AFTER_S", 0.5)  # no robot lands meanwhile
    run_dir = tmp_path / "run"
    with (
        pytest.raises(StackError, match=r"states died .signal SIGKILL"),
        Stack(run_config(speed=speed), run_dir, (CONSUMER, STATES)) as stack,
    ):
        strike_consumer_then_robot(stack)
    recording = read_recording(stack.recording)
    assert recording.complete, recording.lost
    assert recording.summary["restarts"] == '{"consumer": 2, "states": 0}'
    assert "SIGKILL" in recording.summary["error"]
    events = [(m.code, m.detail) for _, _, m in recording.messages("event")]  # type: ignore[union-attr]
    assert [code for code, _ in events].count("process_ready") == 4
    died = [detail for code, detail in events if code == "process_died"]
    assert [d.split(":")[1].split()[0] for d in died] == ["signal", "hung", "signal"]
    boots = {envelope.boot_id for _, envelope, _ in recording.messages("status/consumer")}
    assert len(boots) == 3
    assert not children_of_run(tmp_path)


def test_a_run_goes_on_where_no_spare_can_be_started_and_has_one_once_it_can(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SPARE_AFTER_S", 0.05)
    with Stack(run_config(speed=0.1), tmp_path, (CONSUMER, STATES)) as stack:
        child = stack._children["consumer"]
        poll_until(stack, lambda: not child.loading, 10.0)
        child.dismiss()
        with files_left(0):
            for _ in range(2):
                tried_s = child.tried_s
                poll_until(stack, lambda before=tried_s: child.tried_s > before, 10.0)  # type: ignore[misc]
        poll_until(stack, lambda: child.has_spare, 10.0)
        assert stack.poll()
    told = [
        m.detail
        for _, _, m in read_recording(stack.recording).messages("event")
        if m.code == "no_spare"
    ]  # type: ignore[union-attr]
    assert told == ["consumer cannot be started: Too many open files"] * 2


def test_a_process_whose_status_does_not_come_lives_while_it_says_anything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a key of its own of a topic that all have, and then on a topic that is its own."""
    hung_s = 0.5  # 2.5 s of the computer, which may be busy
    monkeypatch.setattr(module, "HUNG_S", hung_s)
    (tmp_path / "silent.py").write_text(textwrap.dedent(SILENT.format(hung_s=hung_s)))
    with Stack(
        run_config(speed=0.2),
        tmp_path / "run",
        (Program(name="render", module="silent", restart=True), STATES),
    ) as stack:
        lived_s = poll_until(stack, lambda: stack.restarts["render"] == 1, 4.0 * hung_s)
    assert lived_s > 2.5 * hung_s
    (died,) = [
        m.detail
        for _, _, m in read_recording(stack.recording).messages("event")
        if m.code == "process_died"
    ]  # type: ignore[union-attr]
    assert died == f"render: hung: no sign of life for {hung_s:g} s"


def test_the_run_ends_when_the_robot_returns(tmp_path: Path) -> None:
    with Stack(run_config("lockstep", time_limit_s=0.3), tmp_path, (CONSUMER, STATES)) as stack:
        assert len(pids_of_run(tmp_path)) == 2  # in lockstep nobody takes over
        assert stack.wait(10.0)
        assert stack.finished
    recording = read_recording(stack.recording)
    assert recording.complete, recording.lost
    assert sum(1 for _ in recording.messages("controller/state")) == 30
    assert not children_of_run(tmp_path)


def test_a_process_that_cannot_start_is_named_with_its_last_words(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text(textwrap.dedent(BROKEN))
    broken = Program(name="consumer", module="broken", restart=True)
    with (
        pytest.raises(
            StackError, match=r"(?s)consumer died .exit code 2.*the model file is damaged"
        ),
        Stack(run_config(), tmp_path / "run", (broken,)),
    ):
        pass
    events = read_recording(tmp_path / "run" / "recording.mcap").of(Event)
    assert [e.code for e in sorted(events, key=lambda e: e.time_ns)] == ["error", "process_died"]


def test_a_process_that_is_never_ready_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "idle.py").write_text("import time\ntime.sleep(60)\n")
    monkeypatch.setattr(module, "READY_TIMEOUT_S", 0.3)
    idle = Program(name="idle", module="idle", restart=True)
    with (
        pytest.raises(StackError, match=r"idle is not ready after 0.3 s.*idle.log is empty"),
        Stack(run_config(), tmp_path / "run", (idle,)),
    ):
        pass
    assert not children_of_run(tmp_path)


def test_who_is_interrupted_while_a_recording_begins_has_one_that_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def begun(*arguments: Any) -> Recorder:
        recorder = Recorder(*arguments)
        WHOLE.interrupt(KeyboardInterrupt())
        return recorder

    monkeypatch.setattr(module, "Recorder", begun)
    with (
        pytest.raises(KeyboardInterrupt),
        Stack(RunConfig(robot="go1", grid="line"), tmp_path, (CONSUMER, STATES)),
    ):
        pass
    assert read_recording(tmp_path / "recording.mcap").complete


def test_who_is_interrupted_while_messages_are_taken_has_all_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = 0

    def take(self: RunRecorder, samples: Sequence[RawSample]) -> None:
        nonlocal taken
        taken += sum(sample.key == "controller/state" for sample in samples)
        if taken > 20:
            taken = -1_000_000  # once
            WHOLE.interrupt(KeyboardInterrupt())
        usual(self, samples)

    usual = RunRecorder.take
    monkeypatch.setattr(RunRecorder, "take", take)
    with (
        pytest.raises(KeyboardInterrupt),
        Stack(run_config(), tmp_path / "run", (CONSUMER, STATES)) as stack,
    ):
        stack.wait()
    recording = read_recording(tmp_path / "run" / "recording.mcap")
    assert len(recording.of(RobotState)) > 20
    assert {row.lost for row in rates_and_ages(recording).values()} == {0}


def test_processes_do_not_outlive_a_killed_supervisor(tmp_path: Path) -> None:
    script = (
        "import sys\nfrom pathlib import Path\nfrom saltus.runtime.child import Program\n"
        "from saltus.config import RunConfig\nfrom saltus.runtime.stack import Stack\n"
        "programs = (Program(name='consumer', module='consumer', restart=True),)\n"
        "with Stack(RunConfig(robot='go1', grid='line', pace='realtime'), Path(sys.argv[1]), "
        "programs) as stack:\n"
        "    sys.stdout.write(f'{stack.pid(\"consumer\")}\\n')\n"
        "    sys.stdout.flush()\n"
        "    stack.wait()\n"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "run")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as supervisor:
        assert supervisor.stdout is not None
        child = psutil.Process(int(supervisor.stdout.readline()))
        supervisor.kill()
    child.wait(timeout=10.0)


def test_what_waits_to_be_recorded_is_bounded_and_what_is_left_out_is_told(
    speed: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_recorder, "STREAM_CAPACITY", 40)
    monkeypatch.setattr(run_recorder, "RECORDED_AT_A_TIME", 0)
    with Stack(run_config(time_limit_s=2.0, speed=speed), tmp_path, (STATES,)) as stack:
        waiting = []
        while not stack.wait(0.05):
            waiting.append(len(stack._recorder.waiting))
    assert max(waiting) <= 40
    (lost,) = read_recording(tmp_path / "recording.mcap").lost
    assert int(lost.split()[0]) > 100


def test_a_full_disk_ends_the_run_with_its_reason(speed: float, tmp_path: Path) -> None:
    (tmp_path / "recording.mcap").symlink_to("/dev/full")
    with (
        pytest.raises(RecordingError, match="No space left"),
        Stack(run_config(speed=speed), tmp_path, (CONSUMER, STATES)) as stack,
    ):
        stack.wait(10.0)
    assert not children_of_run(tmp_path)


def test_a_disk_that_is_full_at_the_last_moment_is_told_as_well(tmp_path: Path) -> None:
    (tmp_path / "recording.mcap").symlink_to("/dev/full")
    with (
        pytest.raises(RecordingError, match="No space left"),
        Stack(run_config("lockstep", time_limit_s=0.1), tmp_path, (STATES,)),
    ):
        pass
