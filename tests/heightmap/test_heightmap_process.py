import contextlib
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heightmap_inputs import on_time, states
from memory_bus import MemoryBus, MemoryHub
from samples import ROBOT, put_run

from saltus.clock import RunClock
from saltus.config import Pace, RunConfig
from saltus.grid import LINE
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.process import HeightmapProcess
from saltus.heightmap.service.robot_inbox import RobotInbox
from saltus.heightmap.service.service import HeightmapService
from saltus.runtime.process import ProcessContext
from saltus.used_networks import SCAN, model_id
from saltus.used_networks import model_path as shipped_model
from saltus.wire.bus import Publisher
from saltus.wire.messages import DepthFrame, Heightmap, RobotState
from saltus.wire.topics import TOPICS

PATIENCE_S = 5.0
# Of tests in real time: a busy computer stalls for less than the 0.5 s in which a state is answered
SPEED = 0.1


class House:
    """The heightmap process in a thread, and the buses of a robot and a camera."""

    def __init__(self, model_path: Path, run_dir: Path, pace: Pace, robot: str = "go1") -> None:
        self.hub = MemoryHub()
        config = RunConfig(
            robot=robot,
            grid="line",
            pace=pace,
            speed=SPEED if pace == "realtime" else 1.0,
            heightmap_model=str(model_path),
            epoch_ns=time.monotonic_ns() - 10_000_000_000,
        )
        self.context = ProcessContext(
            "heightmap", config, put_run(run_dir, config), MemoryBus(config.prefix, self.hub)
        )
        self.process = HeightmapProcess([self.context])
        self.clock = RunClock.of(config)
        self.bus = MemoryBus(config.prefix, self.hub)
        self.states: Publisher = self.bus.publisher("controller/state")
        self.frames: Publisher = self.bus.publisher("camera/depth")
        self.heightmaps = self.bus.latest("heightmap/heightmap")
        self.done = self.bus.latest("done", "heightmap")
        self.thread = threading.Thread(
            target=self.process.run, args=(lambda: self.context.stopped,)
        )

    def ask(self, state: RobotState) -> Heightmap:
        """Sends a state and waits for its answer."""
        self.states.put(state)
        sample = self.heightmaps.wait(PATIENCE_S)
        assert sample is not None
        if self.context.config.pace == "lockstep":  # where somebody waits for it
            done = self.done.wait(PATIENCE_S)
            assert done is not None
            assert done.message.step == sample.message.step
        answer: Heightmap = sample.message
        return answer


@contextlib.contextmanager
def at_work(house: House) -> Iterator[House]:
    house.thread.start()
    yield house
    house.context.stopped = True
    house.thread.join(PATIENCE_S)
    assert not house.thread.is_alive()
    house.bus.close()


@pytest.fixture
def house(model_path: Path, tmp_path: Path, request: Any) -> Iterator[House]:
    with at_work(House(model_path, tmp_path, request.param)) as house:
        yield house


def due(state: RobotState) -> RobotState:
    """The state as the controller sends it in lockstep."""
    newest = (state.step - 5) // 2 if state.step >= 5 else -1
    return replace(state, depth_due=newest)


@pytest.mark.parametrize(("robot", "model"), [("go1", shipped_model(SCAN)), ("go2", Path(SCAN))])
def test_a_network_of_any_grid_has_the_line_of_any_robot(
    robot: str, model: Path, tmp_path: Path
) -> None:
    """A run names it as the file of its model, or by its name."""
    with at_work(House(model, tmp_path, "lockstep", robot)) as house:
        for state in states(2):
            answer = house.ask(due(state))
    np.testing.assert_array_equal(answer.x, LINE.x)
    assert np.isfinite(answer.height).all()
    assert answer.model_id == model_id(shipped_model(SCAN).read_bytes())


def answers_alone(model_path: Path, steps: int) -> list[Heightmap]:
    service = HeightmapService(HeightmapNetwork(ROBOT, model_path))
    return [service.step(state, on_time(state.step), state.time_ns) for state in states(steps)]


@pytest.mark.parametrize("house", ["lockstep"], indirect=True)
def test_lockstep_answers_are_those_of_the_service_whatever_comes_first(
    house: House, model_path: Path
) -> None:
    for state, expected in zip(states(40), answers_alone(model_path, 40), strict=True):
        frame = on_time(state.step)
        late = state.step % 3 == 0
        timer = (
            threading.Timer(0.02, house.frames.put, (frame,))
            if late and frame is not None
            else None
        )
        if timer is not None:
            timer.start()
        elif frame is not None:
            house.frames.put(frame)
        answer = house.ask(due(state))
        assert answer.frame_id == expected.frame_id
        assert answer.status == expected.status
        np.testing.assert_array_equal(
            answer.height, np.asarray(expected.height, answer.height.dtype)
        )


@pytest.mark.parametrize("house", ["lockstep"], indirect=True)
def test_lockstep_asks_twice_and_gets_the_same(house: House) -> None:
    for state in states(12):
        frame: DepthFrame | None = on_time(state.step)
        if frame is not None:
            house.frames.put(frame)
        first, second = house.ask(due(state)), house.ask(due(state))
        assert first.step == second.step == state.step
        np.testing.assert_array_equal(first.height, second.height)


@pytest.mark.parametrize("house", ["lockstep"], indirect=True)
def test_a_robot_that_starts_anew_gets_an_empty_hidden_state(
    house: House, model_path: Path
) -> None:
    for state in states(3):
        house.ask(due(state))
    house.states = MemoryBus(house.context.config.prefix, house.hub).publisher("controller/state")
    answer = house.ask(due(states(1)[0]))
    assert answer.step == 0
    np.testing.assert_allclose(answer.height, answers_alone(model_path, 1)[0].height, atol=1e-6)


@pytest.mark.parametrize("house", ["realtime"], indirect=True)
def test_in_real_time_old_states_are_not_answered(house: House) -> None:
    house.states.put(replace(states(1)[0], time_ns=house.clock.now_ns() - 500_000_000, step=1))
    assert house.heightmaps.wait(0.2) is None
    assert house.ask(replace(states(1)[0], time_ns=house.clock.now_ns(), step=2)).step == 2


@pytest.mark.parametrize("ahead_s", [-1e5, -1.0, 0.01, 1.0, 1e5])
def test_a_robot_whose_clock_differs_is_not_answered_and_it_is_said_once_within_a_second(
    ahead_s: float, tmp_path: Path
) -> None:
    """As of a robot whose computer is not that of the service."""
    config, hub = RunConfig(robot="go1", grid="line", pace="realtime"), MemoryHub()
    context = ProcessContext(
        "heightmap", config, put_run(tmp_path, config), MemoryBus(config.prefix, hub)
    )
    link, bus, begin_ns = (
        RobotInbox(context, TOPICS["camera/depth"]),
        MemoryBus(config.prefix, hub),
        10**15,
    )
    publisher, events = bus.publisher("controller/state"), bus.latest("event", "heightmap")
    told_ns = []
    for step in range(200):
        now_ns = begin_ns + step * 10_000_000
        context.clock = cast(RunClock, SimpleNamespace(now_ns=lambda now=now_ns: now))
        publisher.put(replace(states(1)[0], step=step, time_ns=now_ns + round(1e9 * ahead_s)))
        assert link.take() is None
        if (event := events.take()) is not None:
            assert event.message.code == "states_refused"
            assert (
                f"{abs(ahead_s):.3f} s {'ahead of' if ahead_s > 0 else 'behind'} the clock"
                in event.message.detail
            )
            told_ns.append(now_ns - begin_ns)
    assert len(told_ns) == 1
    assert told_ns[0] <= 1e9
    assert context.bus.rejected == {
        f"controller/state/{'future' if ahead_s > 0 else 'invalid'}": 200
    }
    publisher.put(replace(states(1)[0], step=200, time_ns=now_ns))
    assert link.take() is not None


def test_of_what_waited_while_a_process_hung_only_the_newest_is_answered(
    model_path: Path, tmp_path: Path
) -> None:
    house = House(model_path, tmp_path, "realtime")
    heard, now_ns = house.bus.stream(), house.clock.now_ns()
    for state in states(40):  # 0.4 s of the run: the last ones are fresh
        house.states.put(replace(state, time_ns=now_ns - 10_000_000 * (39 - state.step)))
    house.thread.start()
    sample = house.heightmaps.wait(PATIENCE_S)
    assert sample is not None
    assert sample.message.step == 39
    assert house.ask(replace(states(1)[0], time_ns=house.clock.now_ns(), step=40)).step == 40
    house.context.stopped = True
    house.thread.join(PATIENCE_S)
    answered = [sample.key for sample in heard.drain()].count("heightmap/heightmap")
    house.bus.close()
    assert answered == 2


@pytest.mark.parametrize("house", ["realtime"], indirect=True)
def test_in_real_time_each_state_gets_the_answer_of_the_service_once(
    house: House, model_path: Path
) -> None:
    """States at the rate of the robot, then a pause in which nothing more may come."""
    heard = house.bus.stream()
    alone, count = HeightmapService(HeightmapNetwork(ROBOT, model_path)), 20
    first_ns = house.clock.now_ns()
    for state in states(count):
        time_ns = first_ns + 10_000_000 * state.step
        time.sleep(max(0.0, house.clock.machine_s(1e-9 * (time_ns - house.clock.now_ns()))))
        frame, now = on_time(state.step), replace(state, time_ns=time_ns)
        if frame is not None:
            frame = replace(frame, time_ns=time_ns - 50_000_000)
            house.frames.put(frame)
        answer = house.ask(now)
        expected = alone.step(now, frame, time_ns)
        assert (answer.step, answer.frame_id) == (expected.step, expected.frame_id)
        np.testing.assert_allclose(answer.height, expected.height, atol=1e-6)
    time.sleep(0.2)
    keys = [sample.key for sample in heard.drain()]
    assert keys.count("heightmap/heightmap") == count
    assert "done/heightmap" not in keys  # nobody waits for it


def test_junk_on_the_keys_of_one_robot_does_not_touch_another(
    model_path: Path, tmp_path: Path
) -> None:
    """Nor does a robot that has no camera: in lockstep its states wait
    for images that never come.
    """
    hub = MemoryHub()
    names = ("robot/0", "robot/1", "robot/2")
    configs = [
        RunConfig(
            robot="go1", grid="line", prefix=name, pace="lockstep", heightmap_model=str(model_path)
        )
        for name in names
    ]
    put_run(tmp_path, configs[0])
    contexts = [
        ProcessContext("heightmap", config, tmp_path, MemoryBus(config.prefix, hub))
        for config in configs
    ]
    process = HeightmapProcess(contexts)
    stop = threading.Event()
    thread = threading.Thread(target=process.run, args=(stop.is_set,))
    thread.start()
    bus, blind = MemoryBus("robot/0", hub), MemoryBus("robot/2", hub)
    ask, see, blind_ask = (
        bus.publisher("controller/state"),
        bus.publisher("camera/depth"),
        blind.publisher("controller/state"),
    )
    heightmaps = bus.latest("heightmap/heightmap")
    rng = np.random.default_rng(0)
    try:
        for state, expected in zip(states(40), answers_alone(model_path, 40), strict=True):
            for topic in ("controller/state", "camera/depth"):
                hub.inject(f"robot/1/{topic}", rng.bytes(200), rng.bytes(40))
            blind_ask.put(due(state))
            frame = on_time(state.step)
            if frame is not None:
                see.put(frame)
            ask.put(due(state))
            sample = heightmaps.wait(PATIENCE_S)
            assert sample is not None
            np.testing.assert_array_equal(
                sample.message.height, np.asarray(expected.height, sample.message.height.dtype)
            )
    finally:
        stop.set()
        thread.join(PATIENCE_S)
    assert contexts[0].bus.rejected == {}
    assert contexts[1].bus.rejected["controller/state/envelope"] == 40
    assert process._links["robot/2"].ticks == 5  # until the first image is due
