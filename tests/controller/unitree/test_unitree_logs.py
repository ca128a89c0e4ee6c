"""Logs of a robot's low level: whole, as ROS 2 names them, and as run logs."""

import os
import signal
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest
from rosbags import rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from unitree_processes import saltus, simulated

from benchmarks.unitree_link.command import own_domain
from benchmarks.unitree_link.in_memory import ROBOT, Run, tick
from saltus.cli.stop_signals import ending_by_signals
from saltus.constants import PHYSICS_DT
from saltus.controller.control_loop import ControlLoop
from saltus.controller.robot.unitree.link import COMMANDS, STATES, ArrivedMessage, UnitreeLink
from saltus.controller.robot.unitree.log import TOPICS, ArrivalEstimator, new_log, record_link
from saltus.controller.robot.unitree.messages import DEFINITIONS, LOW_COMMAND, LOW_STATE
from saltus.controller.robot.unitree.robot import UnitreeRobot
from saltus.controller.robot.unitree.states import StateWatch
from saltus.errors import RecordingError
from saltus.joint_command import JointCommand
from saltus.real2sim.importers.importing import import_recording
from saltus.recordings.recording_description import RecordingDescription
from saltus.recordings.run_log import RunLog, read_run_log

PATIENCE_S = 60.0
ROWS = 60
TRIALS, LATE_S, SILENT_S = 6, 0.2, 1.0
START_NS = 1_700_000_000 * 10**9
TICK_NS = round(1e9 * PHYSICS_DT)
Rows = list[tuple[str, bytes, int]]
Arrivals = SimpleQueue[tuple[str, ArrivedMessage]]


@dataclass
class Recorded:
    """A robot that was commanded at random: what travelled, and what was commanded in each tick."""

    rows: Rows = field(default_factory=list)
    commands: list[JointCommand] = field(default_factory=list)
    states: list[bytes] = field(default_factory=list)


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    made, run, rng = Recorded(), Run(), np.random.default_rng(1)
    for row in range(ROWS):
        at_ns = START_NS + row * TICK_NS + int(rng.integers(0, TICK_NS // 2))
        state = LOW_STATE.payload(run.robot.message)
        made.rows.append((STATES, state, at_ns))
        made.states.append(state)
        command = JointCommand(
            position=ROBOT.stand_pose + rng.normal(0.0, 0.02, 12), velocity=rng.normal(size=12),
            kp=rng.uniform(10, 60, 12), kd=rng.uniform(1, 3, 12), torque=rng.normal(size=12),
        )  # fmt: skip
        run.robot.write(command)
        made.rows.append((COMMANDS, run.wire.sent[-1], at_ns + TICK_NS // 4))
        made.commands.append(command)
        run.wire.tick()
        run.robot.read()
    return made


def written(path: Path, rows: Rows, kind: str) -> Path:
    """A log of ours, or a rosbag2 as `ros2 bag record` writes it."""
    if kind == "ours":
        with new_log(path / "log.mcap") as log:
            for topic, payload, at_ns in rows:
                log.write(TOPICS[topic], payload, at_ns, at_ns)
        return log.path
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    plugin = rosbag2.StoragePlugin[kind.upper()]
    with rosbag2.Writer(path / "bag", version=9, storage_plugin=plugin) as bag:
        layouts = {COMMANDS: LOW_COMMAND, STATES: LOW_STATE}
        connections: dict[str, Any] = {
            topic: bag.add_connection(TOPICS[topic], layouts[topic].type_name, typestore=store)
            for topic in layouts
        }
        for topic, payload, at_ns in rows:
            bag.write(connections[topic], at_ns, payload)
    return path / "bag"


def imported(path: Path, **claims: Any) -> tuple[RunLog, tuple[str, ...]]:
    out = path.parent / "log"
    told = import_recording(path, out, RecordingDescription(claims=claims), ROBOT)
    return read_run_log(out), told.notes


@pytest.mark.parametrize("kind", ["ours", "mcap", "sqlite3"])
def test_a_log_holds_each_state_and_the_command_that_acted_on_it(
    kind: str, recorded: Recorded, tmp_path: Path
) -> None:
    log, _ = imported(written(tmp_path, recorded.rows, kind), base="fixed")
    joints, states = log.joints, LOW_STATE.read(recorded.states)
    np.testing.assert_allclose(joints.time_s, PHYSICS_DT * np.arange(ROWS), atol=1e-9)
    np.testing.assert_allclose(joints.q, states["motor_state"]["q"][:, :12])
    torques = states["motor_state"]["tau_est"][:, :12]
    np.testing.assert_allclose(joints.tau_est[:-1], torques[1:])  # told by the state after
    names = {"q_des": "position", "dq_des": "velocity", "tau_ff": "torque", "kp": "kp", "kd": "kd"}
    for name, own in names.items():
        sent = np.array([getattr(command, own) for command in recorded.commands])
        np.testing.assert_allclose(getattr(joints, name), sent, rtol=1e-6, atol=1e-6)
    law = joints.kp * (joints.q_des - joints.q) + joints.kd * (joints.dq_des - joints.dq)
    law += joints.tau_ff
    np.testing.assert_allclose(joints.tau_est[:-1], law[:-1], rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(log.meta["kp"], np.median(joints.kp, axis=0))
    assert log.imu is not None
    np.testing.assert_allclose(log.imu.values[:, 4:7], states["imu_state"]["gyroscope"])
    assert log.meta["control_dt"] == pytest.approx(PHYSICS_DT, rel=0.05)
    assert log.meta["base"] == "fixed"


def test_gains_that_never_change_but_at_the_ends_are_claims(
    recorded: Recorded, tmp_path: Path
) -> None:
    rows: Rows = []
    for row, (topic, payload, at_ns) in enumerate(recorded.rows):
        if topic == COMMANDS:
            damped = row < 10 or row > 2 * ROWS - 7  # five states at begin, three at the end
            command = LOW_COMMAND.read([payload])[0]
            command["motor_cmd"]["kp"], command["motor_cmd"]["kd"] = (0, 3) if damped else (30, 0.8)
            payload = LOW_COMMAND.sealed(command)
        rows.append((topic, payload, at_ns))
    log, notes = imported(written(tmp_path, rows, "ours"))
    assert len(log.joints.q) == ROWS - 8
    assert "8 states at begin and end have other gains, and are left out" in notes
    assert (log.meta["kp"], log.meta["kd"]) == ([30.0] * 12, [0.8] * 12)
    assert log.joints.kp is None
    assert log.joints.kd is None


def test_damaged_and_repeated_messages_are_left_out_and_told(
    recorded: Recorded, tmp_path: Path
) -> None:
    rows = list(recorded.rows)
    topic, payload, at_ns = rows[10]
    rows[10] = (topic, payload[:-1] + bytes([payload[-1] ^ 1]), at_ns)
    rows.insert(21, (rows[20][0], rows[20][1], rows[20][2] + 1000))
    log, notes = imported(written(tmp_path, rows, "ours"))
    assert len(log.joints.time_s) == ROWS - 1
    assert any(note.startswith("1 messages unitree_go/msg/LowState") for note in notes)
    assert "1 states came twice, and are left out" in notes


def test_states_alone_are_a_log_without_commands(recorded: Recorded, tmp_path: Path) -> None:
    rows = [row for row in recorded.rows if row[0] == STATES]
    log, notes = imported(written(tmp_path, rows, "ours"), kp=20.0, kd=0.5)
    assert log.joints.q_des is None
    assert "no commands (/lowcmd) were recorded" in notes


def test_a_robot_that_began_anew_is_refused(recorded: Recorded, tmp_path: Path) -> None:
    later = [(topic, payload, at_ns + 10**9) for topic, payload, at_ns in recorded.rows]
    with pytest.raises(RecordingError, match="clock runs backwards"):
        imported(written(tmp_path, [*recorded.rows, *later], "ours"))


def test_a_log_is_not_written_over(recorded: Recorded, tmp_path: Path) -> None:
    written(tmp_path, recorded.rows[:2], "ours")
    with pytest.raises(RecordingError, match="is there already"):
        written(tmp_path, recorded.rows[:2], "ours")


def arrivals_of(times_ns: Iterable[tuple[int, int]]) -> list[int]:
    """Times [ns] at which messages came, of those at which they were taken and sent."""
    estimator, told = ArrivalEstimator(), []
    for taken_ns, sent_ns in times_ns:
        told += estimator.take(ArrivedMessage(b"", int(taken_ns), int(sent_ns)))
    return [arrival_ns for arrival_ns, _ in told + estimator.rest()]


@pytest.mark.parametrize("late_ms", [0.0, 3.0, 30.0])
@pytest.mark.parametrize("drift", [-1e-4, 0.0, 1e-4])
@pytest.mark.parametrize("set_ns", [0, 7 * 10**9, -7 * 10**9, 3 * 10**8, -3 * 10**8])
def test_messages_keep_the_order_in_which_they_were_sent_however_late_they_are_taken(
    late_ms: float, drift: float, set_ns: int
) -> None:
    """Commands come a quarter of a tick after the states that they answer; half-way the clocks of
    both senders are set.
    """
    rng, count = np.random.default_rng(round(late_ms)), 2000
    ticks = TICK_NS * np.arange(count)
    for seen, offset_ns in (("state", 0), ("command", TICK_NS // 4)):
        came_ns = START_NS + ticks + offset_ns
        late_ns = rng.exponential(1e6 * late_ms, count).astype(np.int64)
        late_ns[rng.random(count) < 0.1] = 0  # often enough it is taken at once
        late_ns[[*range(200, 301), *range(count // 2 - 100, count // 2 + 1)]] = 0
        taken_ns = np.maximum.accumulate(came_ns + late_ns)
        sent_ns = START_NS // 2 + (ticks * (1.0 + drift)).astype(np.int64)
        sent_ns[count // 2 :] += set_ns
        found_ns = arrivals_of(zip(taken_ns, sent_ns, strict=True))
        assert (np.diff(found_ns) >= 0).all(), seen
        off_ns = np.abs(np.array(found_ns) - came_ns)
        assert off_ns.max() <= TICK_NS // 8 + 1e9 * abs(drift) * 4.0, seen


def test_messages_of_a_sender_without_a_clock_came_when_they_were_taken() -> None:
    taken_ns = range(START_NS, START_NS + 3 * 10**9, TICK_NS)
    assert arrivals_of((taken, 0) for taken in taken_ns) == list(taken_ns)


def test_what_was_sent_before_ctrl_c_is_logged_and_nothing_else(
    recorded: Recorded, tmp_path: Path
) -> None:
    """Ctrl-C comes between any two steps of the log; a thread of a busy computer hands on late what
    was sent before.
    """

    def say(arrivals: Arrivals, before: int) -> None:
        sent_ns = time.time_ns()
        for row, payload in enumerate(recorded.states):
            if row == before:
                while not arrivals.empty():
                    time.sleep(0.0)
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(LATE_S)
            arrivals.put((STATES, ArrivedMessage(payload, time.monotonic_ns(), sent_ns + row)))
        later_ns = time.time_ns() + 10**9
        arrivals.put((STATES, ArrivedMessage(payload, time.monotonic_ns(), later_ns)))

    for trial in range(TRIALS):
        arrivals, watch = Arrivals(), StateWatch()
        sender = threading.Thread(target=say, args=(arrivals, 1 + trial))
        with ending_by_signals(), new_log(tmp_path / f"{trial}.mcap") as log:
            sender.start()
            with pytest.raises(KeyboardInterrupt):
                record_link(arrivals, log, watch, PATIENCE_S)
        sender.join()
        assert log.counts[TOPICS[STATES]] == watch.health.states == ROWS
        assert watch.health.lost == 0


def test_what_came_is_in_the_file_soon_after_a_robot_falls_silent(
    recorded: Recorded, tmp_path: Path
) -> None:
    """However the program ends then: messages that wait for later ones do not wait for long."""
    arrivals, written_then = Arrivals(), list[int]()
    for row, payload in enumerate(recorded.states):
        arrivals.put((STATES, ArrivedMessage(payload, time.monotonic_ns(), START_NS + row)))
    with new_log(tmp_path / "log.mcap") as log:
        look = threading.Timer(
            0.5 * SILENT_S, lambda: written_then.append(log.counts[TOPICS[STATES]])
        )
        look.start()
        record_link(arrivals, log, StateWatch(), SILENT_S)
        look.join()
    assert written_then == [ROWS]


@pytest.mark.slow
def test_a_robot_is_logged_whole_while_another_process_commands_it(tmp_path: Path) -> None:
    domain, path = str(own_domain()), tmp_path / "log.mcap"
    with (
        simulated(own_domain(), "--pace", "lockstep", "--seconds", "0.6"),
        saltus("robot", "log", "--domain", domain, "--out", str(path)) as logger,
    ):
        assert logger.stdout is not None
        assert logger.stdout.readline().startswith("recording into")
        link = UnitreeLink(own_domain(), "lo", sends=[COMMANDS], takes=[STATES], reliable=True)
        robot, loop = UnitreeRobot(link, ROBOT, lockstep=True), ControlLoop(ROBOT, tick())
        robot.reset()
        for _ in range(300):
            loop.sense(robot.read())
            robot.write(loop.act(None, np.inf))
        robot.read()
        logger.send_signal(signal.SIGINT)
        told, _ = logger.communicate(timeout=PATIENCE_S)
        link.close()
    assert logger.returncode == 130
    assert "(0 more were lost, " in told
    assert 299 <= int(told.split()[-2]) <= 300  # the last may be under way
    out = tmp_path / "log"
    command = ("real2sim", "import", str(path), "--robot", "go2", "--out", str(out))
    with saltus(*command) as process:
        assert process.wait(PATIENCE_S) == 0
    log = read_run_log(out)
    joints, time_s = log.joints, log.joints.time_s
    np.testing.assert_allclose(np.diff(time_s), PHYSICS_DT, atol=1e-9)
    assert 298 <= len(time_s) <= 301  # the first command may come in the midst of the first state
    law = np.array(log.meta["kp"]) * (joints.q_des - joints.q) + joints.tau_ff
    law += np.array(log.meta["kd"]) * (joints.dq_des - joints.dq)
    np.testing.assert_allclose(joints.tau_est[:-1], law[:-1], atol=1e-2)
