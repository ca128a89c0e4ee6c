"""Several robots in one service: each as if it were alone,
whoever else asks, falls silent or starts anew.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heightmap_inputs import WARMUP, frame, on_time, states
from samples import ROBOT as GO1
from test_service import Faulty, bad_tick

from saltus.heightmap.service.fleet import TAKEOVER_NS, FleetService, RobotRequest
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.service import HeightmapService
from saltus.heightmap.service.sight import LONGEST_GAP_S
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus, RobotState

STEPS = 80
CAMERA, ROBOT = b"camera", b"robot"
STATES = states(5 * STEPS)


@pytest.fixture(scope="module")
def network(model_path: Path) -> HeightmapNetwork:
    return HeightmapNetwork(GO1, model_path)


def names(count: int) -> list[str]:
    return [f"robot/{i}" for i in range(count)]


def scene(robot: int, step: int) -> DepthFrame | None:
    """The robots see different things."""
    arrived = on_time(step)
    if arrived is None:
        return None
    return replace(arrived, depth=frame(1000 * robot + arrived.frame_id, 0.0).depth)


def arrival(
    robot: int,
    step: int,
    *,
    state: RobotState | None = None,
    given: DepthFrame | None = None,
    robot_boot: bytes = ROBOT,
    camera_boot: bytes = CAMERA,
) -> RobotRequest:
    taken = scene(robot, step) if given is None else given
    return RobotRequest(
        state=STATES[step] if state is None else state,
        robot_boot=robot_boot,
        frame=taken,
        camera_boot=None if taken is None else camera_boot,
        now_ns=STATES[step].time_ns,
    )


def alone(network: HeightmapNetwork, robot: int, steps: Iterable[int]) -> list[Heightmap]:
    service = HeightmapService(network)
    return [service.step(STATES[step], scene(robot, step), STATES[step].time_ns) for step in steps]


def assert_same(found: list[Heightmap], expected: list[Heightmap]) -> None:
    assert [(h.step, h.status, h.frame_id) for h in found] == [
        (h.step, h.status, h.frame_id) for h in expected
    ]
    np.testing.assert_allclose([h.height for h in found], [h.height for h in expected], atol=1e-6)
    np.testing.assert_allclose(
        [h.half_width_90 for h in found], [h.half_width_90 for h in expected], atol=1e-6
    )


@pytest.mark.parametrize("count", [1, 3, 8])
def test_each_robot_is_answered_as_if_it_were_alone(network: HeightmapNetwork, count: int) -> None:
    fleet = FleetService(network, names(count))
    found: dict[str, list[Heightmap]] = {name: [] for name in names(count)}
    for step in range(STEPS):
        arrivals = {name: arrival(robot, step) for robot, name in enumerate(names(count))}
        for name, heightmap in fleet.step(arrivals).items():
            found[name].append(heightmap)
    for robot, name in enumerate(names(count)):
        assert_same(found[name], alone(network, robot, range(STEPS)))


def test_late_and_silent_robots_change_nothing_for_others(network: HeightmapNetwork) -> None:
    """Robot 0 asks always, robot 1 at every third step,
    robot 2 falls silent, robot 3 asks when it likes.
    """
    steps = np.arange(STEPS)
    sometimes = np.random.default_rng(0).uniform(size=STEPS) < 0.5
    asks = np.array([steps >= 0, steps % 3 == 0, steps < 30, sometimes])
    fleet = FleetService(network, names(4))
    found: list[list[Heightmap]] = [[] for _ in range(4)]
    asked: list[list[int]] = [[] for _ in range(4)]
    for step in range(STEPS):
        who = [robot for robot in range(4) if asks[robot, step]]
        answers = fleet.step({f"robot/{robot}": arrival(robot, step) for robot in who})
        assert set(answers) == {f"robot/{robot}" for robot in who}
        for robot in who:
            found[robot].append(answers[f"robot/{robot}"])
            asked[robot].append(step)
    for robot in range(4):
        assert_same(found[robot], alone(network, robot, asked[robot]))


def test_a_new_boot_empties_the_hidden_state_of_that_robot_and_of_no_other(
    network: HeightmapNetwork,
) -> None:
    fleet = FleetService(network, names(2))
    found: list[list[Heightmap]] = [[], []]
    again = 40
    for step in range(STEPS):
        boot = {"robot_boot": b"new"} if step >= again else {}
        answers = fleet.step({"robot/0": arrival(0, step, **boot), "robot/1": arrival(1, step)})
        for robot in range(2):
            found[robot].append(answers[f"robot/{robot}"])
    assert_same(found[1], alone(network, 1, range(STEPS)))
    assert_same(found[0][:again], alone(network, 0, range(again)))
    assert_same(found[0][again:], alone(network, 0, range(again, STEPS)))
    first_new = again + 1  # frames come with odd steps
    assert {h.status for h in found[0][first_new : first_new + 2 * (WARMUP - 1)]} == {
        HeightmapStatus.WARMING
    }
    assert {h.status for h in found[0][first_new + 2 * (WARMUP - 1) :]} == {HeightmapStatus.OK}


def test_a_camera_that_takes_over_in_time_is_no_break(network: HeightmapNetwork) -> None:
    """As long as no image is missing, heights are those of one camera, to the bit."""
    fleet = FleetService(network, names(1))
    found = [
        fleet.step({"robot/0": arrival(0, step, camera_boot=CAMERA if step < 40 else b"new")})[
            "robot/0"
        ]
        for step in range(STEPS)
    ]
    assert_same(found, alone(network, 0, range(STEPS)))


def test_a_camera_that_comes_after_a_long_pause_empties_the_hidden_state(
    network: HeightmapNetwork,
) -> None:
    fleet, back = FleetService(network, names(1)), 40 + round(100 * LONGEST_GAP_S) + 2
    found = []
    for step in range(back + 2 * WARMUP + 2):
        asked = arrival(0, step, camera_boot=CAMERA if step < 40 else b"new")
        found.append(
            fleet.step({"robot/0": replace(asked, frame=None) if 40 <= step < back else asked})[
                "robot/0"
            ]
        )
    assert {h.status for h in found[back - 5 : back]} == {HeightmapStatus.INVALID}
    assert {h.status for h in found[back + 2 : back + 2 * (WARMUP - 1)]} == {
        HeightmapStatus.WARMING
    }
    assert found[-1].status == HeightmapStatus.OK


def test_a_camera_that_counts_anew_is_believed(network: HeightmapNetwork) -> None:
    """The first frame of a new camera may have the very number of the last frame of the old one."""
    fleet = FleetService(network, names(1))
    for step in range(40):
        last = fleet.step({"robot/0": arrival(0, step)})["robot/0"]
    given = frame(last.frame_id, 360.0)
    answer = fleet.step({"robot/0": arrival(0, 41, given=given, camera_boot=b"new")})["robot/0"]
    assert answer.frame_id == last.frame_id
    assert answer.depth_age_s == pytest.approx(0.05)


def test_a_state_that_was_answered_gets_the_same_answer(network: HeightmapNetwork) -> None:
    fleet = FleetService(network, names(2))
    for step in range(20):
        before = fleet.step({name: arrival(robot, step) for robot, name in enumerate(names(2))})
    again = fleet.step({"robot/0": arrival(0, 19), "robot/1": arrival(1, 20)})
    assert again["robot/0"] is before["robot/0"]
    assert again["robot/1"].step == 20


def test_another_model_takes_over_without_a_gap(
    network: HeightmapNetwork, model_path: Path
) -> None:
    fleet, given = FleetService(network, names(2)), HeightmapNetwork(GO1, model_path)
    given.model_id = "another"
    found: list[Heightmap] = []
    for step in range(STEPS):
        if step == 40:
            fleet.use(given)
        found.append(
            fleet.step({name: arrival(robot, step) for robot, name in enumerate(names(2))})[
                "robot/0"
            ]
        )
    led = [heightmap.model_id == "another" for heightmap in found]
    taken = led.index(True)
    assert taken == 41 + 2 * (WARMUP - 1)
    assert all(led[taken:])
    assert {h.status for h in found[20:]} == {HeightmapStatus.OK}
    assert (fleet.swaps, fleet.given_up) == (2, 0)
    assert_same(found[:taken], alone(network, 0, range(taken)))
    assert_same(found[taken:], alone(network, 0, range(40, STEPS))[taken - 40 :])


def patchy(robot: int, step: int) -> DepthFrame | None:
    """Two fifths of the image are invalid."""
    arrived = scene(robot, step)
    if arrived is None:
        return None
    depth = arrived.depth.copy()
    depth[: 2 * len(depth) // 5] = 0
    return replace(arrived, depth=depth)


def lossy(robot: int, step: int) -> DepthFrame | None:
    """Every second image is lost."""
    arrived = scene(robot, step)
    return None if arrived is None or arrived.frame_id % 2 else arrived


@pytest.mark.parametrize("see", [patchy, lossy])
def test_no_model_takes_over_before_it_is_warm_however_poor_the_images(
    network: HeightmapNetwork, model_path: Path, see: Callable[[int, int], DepthFrame | None]
) -> None:
    for begin in range(56, 62):
        fleet, given = FleetService(network, names(1)), HeightmapNetwork(GO1, model_path)
        given.model_id = "another"
        images, found = 0, list[Heightmap]()
        for step in range(STEPS):
            if step == begin:
                assert found[-1].status == HeightmapStatus.DEGRADED
                fleet.use(given)
            seen = see(0, step)
            taken = (
                arrival(0, step, given=seen)
                if seen is not None
                else replace(arrival(0, step), frame=None)
            )
            found.append(fleet.step({"robot/0": taken})["robot/0"])
            images += step >= begin and seen is not None
            if found[-1].model_id == "another":
                break
        assert found[-1].model_id == "another"
        assert found[-1].status in (HeightmapStatus.OK, HeightmapStatus.DEGRADED)
        assert images == WARMUP
        assert fleet.swaps == 1


def test_a_model_that_answers_badly_is_dropped(network: HeightmapNetwork, model_path: Path) -> None:
    fleet, given = FleetService(network, names(1)), HeightmapNetwork(GO1, model_path)
    nan = bad_tick("height", np.nan)
    given.tick = lambda *_: nan  # type: ignore[method-assign]
    steps = 50 + TAKEOVER_NS // 10_000_000
    found: list[Heightmap] = []
    for step in range(steps):
        if step == 40:
            fleet.use(given)
        found.append(fleet.step({"robot/0": arrival(0, step)})["robot/0"])
    assert_same(found, alone(network, 0, range(steps)))
    assert (fleet.swaps, fleet.given_up) == (0, 1)


def test_a_bad_output_of_one_robot_does_not_touch_the_others(network: HeightmapNetwork) -> None:
    fleet = FleetService(network, names(2))
    found: list[Heightmap] = []
    for step in range(STEPS):
        arrivals = {name: arrival(robot, step) for robot, name in enumerate(names(2))}
        if 40 <= step < 50:
            joints = np.full(12, np.nan)
            arrivals["robot/0"] = replace(
                arrivals["robot/0"], state=replace(arrivals["robot/0"].state, joint_position=joints)
            )
        answers = fleet.step(arrivals)
        assert np.isfinite(answers["robot/0"].height).all()
        found.append(answers["robot/1"])
    assert_same(found, alone(network, 1, range(STEPS)))


def test_the_service_of_one_robot_is_the_same_in_parts(network: HeightmapNetwork) -> None:
    service, whole = HeightmapService(network), HeightmapService(network)
    probe = Faulty(whole, {})
    whole._network = probe  # type: ignore[assignment]
    for step in range(30):
        state, now_ns = STATES[step], STATES[step].time_ns
        inputs = service.prepare(state, scene(0, step), now_ns)
        assert inputs is not None
        answer = service.finish(state, inputs, network.tick(*inputs), now_ns)
        expected = whole.step(state, scene(0, step), now_ns)
        np.testing.assert_array_equal(answer.height, expected.height)
        assert service.last is answer
    assert service.prepare(STATES[29], None, 300_000_000) is None
