"""An observer of a robot knows how it moves, and tells a heightmap service."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
from unitree_processes import saltus, simulated

from benchmarks.unitree_link.command import own_domain
from benchmarks.unitree_link.in_memory import ROBOT, Bounding
from saltus.config import RunConfig
from saltus.controller.robot.unitree.messages import LOW_STATE
from saltus.controller.robot.unitree.observer import LONGEST_MS, StateObserver
from saltus.controller.robot.unitree.truth import read_truth
from saltus.named_setup import named_setup
from saltus.render.calibrate import stands_on_all_feet
from saltus.runtime.run_folder import CLIENT_FILE, write_run
from saltus.wire.joining import write_client
from saltus.wire.messages import ControllerMode, RobotState
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

PATIENCE_S = 60.0
BOUNDS_S, ENDS_S = 4.0, 7.0
"""From when on a robot that rises, stands and bounds is judged, and until when."""
RISEN_S, STANDS_UNTIL_S = 0.6, 2.9
"""When the robot stands, before it bounds."""
TICK_S = 0.002


@pytest.fixture(scope="module")
def bounded() -> tuple[list[bytes], list[dict[str, np.ndarray]]]:
    """States of a robot that rises, stands and bounds, and the truth about each."""
    run, said, truth = Bounding(), list[bytes](), []
    while run.run.time_s < ENDS_S:
        run.run.step()
        run.wire.tick()
        said += run.wire.robot.said()
        truth.append(read_truth(run.wire.robot.truth()).motion)
    return said, truth


def observed(said: list[bytes], lost: np.ndarray) -> tuple[list[RobotState], list[int]]:
    """The states that an observer tells which does not hear some, and the rows that they answer."""
    observer, told, rows = StateObserver(ROBOT), list[RobotState](), list[int]()
    for row, payload in enumerate(said):
        if not lost[row] and observer.take(payload, row * TICK_S):
            told.append(observer.state(round(1e9 * row * TICK_S)))
            rows.append(row)
    return told, rows


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_it_knows_how_a_robot_moves_that_bounds(bounded, share: float) -> None:
    """Also where a third of the states is lost: 0.88 to 1.0 of the way ahead, as feet roll, with an
    error that changes by less than 0.1 m/s; of ten feet that it takes to stand nine do.
    """
    said, truth = bounded
    lost = np.random.default_rng(0).random(len(said)) < share
    told, rows = observed(said, lost)
    assert np.diff(rows).max() * TICK_S <= 0.05
    is_judged = np.array(rows) * TICK_S > BOUNDS_S
    velocity = np.array([truth[row]["velocity_base_in_world"] for row in rows])[is_judged]
    off = np.array([each.velocity_base_in_world for each in told])[is_judged] - velocity
    assert velocity[:, 0].mean() > 0.5
    assert -0.12 < off[:, 0].mean() / velocity[:, 0].mean() < 0.0
    assert off[:, 0].std() < 0.1
    assert np.sqrt((off[:, 1:] ** 2).mean(axis=0)).max() < 0.12
    trusted = np.array([each.leg_trusted for each in told])[is_judged]
    touches = np.array([truth[row]["foot_force"] > 0.0 for row in rows])[is_judged]
    assert touches[trusted].mean() > 0.9
    assert trusted.any(axis=1).mean() > 0.3


def test_it_tells_that_a_robot_stands_which_a_calibration_asks_for(bounded) -> None:
    """Recordings of robots that others move had no image of a standing one: all were RUN."""
    said, _ = bounded
    told, rows = observed(said, np.zeros(len(said), np.bool_))
    times = np.array(rows) * TICK_S
    stands = np.array([stands_on_all_feet(state) for state in told])
    assert stands[(times > RISEN_S) & (times < STANDS_UNTIL_S)].all()
    assert not stands[times > BOUNDS_S].any()
    assert {state.mode for state in told} == {ControllerMode.STAND, ControllerMode.RUN}


def test_after_a_silence_it_begins_anew_also_with_a_clock_that_does(bounded) -> None:
    said, _ = bounded
    observer = StateObserver(ROBOT)
    for row in range(1000, 2000):
        observer.take(said[row], row * TICK_S)
    late_s = 2000 * TICK_S + 1e-3 * LONGEST_MS
    told = [observer.take(said[row], late_s + row * TICK_S) for row in range(500)]
    assert sum(told) in (99, 100, 101)
    assert not any(observer.take(said[row], late_s + 1.0) for row in range(400))  # older ones
    assert not observer.take(said[501][:-1], late_s + 1.0)
    np.testing.assert_allclose(observer.state(7).velocity_base_in_world, 0.0, atol=0.1)


@pytest.mark.parametrize(
    ("part", "field", "wrong"),
    [
        ("imu_state", "quaternion", 0.0), ("imu_state", "quaternion", np.nan),
        ("imu_state", "accelerometer", np.inf), ("motor_state", "q", np.nan),
    ],
)  # fmt: skip
def test_what_is_no_measurement_is_left_out(bounded, part: str, field: str, wrong: float) -> None:
    """The first half of a stand is none, as of an IMU that has not started."""
    said, _ = bounded
    observer = StateObserver(ROBOT)
    for row in range(1000):
        message = LOW_STATE.read([said[row]])[0]
        if row < 500:
            message[part][field] = wrong
        told = observer.take(LOW_STATE.sealed(message), row * TICK_S)
        assert not (told and row < 500)
    np.testing.assert_allclose(observer.state(0).velocity_base_in_world, 0.0, atol=0.1)


@pytest.mark.slow
def test_states_of_a_robot_in_another_process_come_to_a_run(tmp_path: Path) -> None:
    run = RunConfig(robot="go2", grid="scan", pace="realtime")
    endpoint, router = open_router()
    where = ("--domain", str(own_domain()), "--interface", "lo")
    with contextlib.closing(router), simulated(own_domain(), "--speed", "0.5"):
        write_run(tmp_path, run, named_setup(run))
        write_client(tmp_path / CLIENT_FILE, endpoint)
        with (
            ZenohBus(endpoint, run.prefix) as bus,
            saltus("robot", "states", *where, "--run-dir", str(tmp_path)) as process,
        ):
            states = bus.latest("controller/state")
            first = states.wait(PATIENCE_S)
            assert first is not None
            assert process.stdout is not None
            assert "waiting for states" in process.stdout.readline()
            assert "is heard" in process.stdout.readline()
            newest = states.wait(PATIENCE_S)
    assert newest is not None
    state = newest.message
    assert state.step > first.message.step
    np.testing.assert_allclose(state.joint_position, ROBOT.stand_pose, atol=0.2)
    np.testing.assert_allclose(state.velocity_base_in_world, 0.0, atol=0.05)
    assert state.base_height == pytest.approx(ROBOT.stand_height, abs=0.03)


@pytest.mark.slow
def test_a_run_with_a_robot_of_its_own_is_refused(tmp_path: Path) -> None:
    run = RunConfig(robot="go2", grid="scan", pace="realtime", epoch_ns=1)
    write_run(tmp_path, run, named_setup(run))
    with saltus("robot", "states", "--run-dir", str(tmp_path), stderr=-2) as process:
        told, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert "has a robot of its own" in told
