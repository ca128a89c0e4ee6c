"""Laws of the service of any grid: any mount, any grid,
any dialect, and what goes wrong on robots.
"""

import math
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plane_world import BEGIN_NS, LATENCY_NS, STEP_NS, PlaneWorld, map_network
from samples import ROBOT

from saltus.dialects import DIALECTS
from saltus.grid import LINE, SCAN, HeightGrid
from saltus.heightmap.scan.elevation import MapUpdate
from saltus.heightmap.scan.own_body import NoBody
from saltus.heightmap.scan.predictor import ScanNetwork, ScanPredictor
from saltus.heightmap.scan.scan_camera import ScanCamera
from saltus.heightmap.service.scan import (
    FIRST,
    LEGS_ODOMETRY_ERROR,
    WARM_IMAGES,
    ScanRig,
    ScanService,
)
from saltus.loop.shadows import deepen_shadows
from saltus.robots.legs import LegKinematics
from saltus.robots.mount import Mount
from saltus.robots.robot import Robot
from saltus.rotations import rotation_matrix
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus

DOWN = Mount(position=np.array([0.25, 0.0, 0.1]), pitch=0.8)
OFF_M = 0.012
"""Cells of 2 cm on a slope of 0.2 are 4 mm off, depth in whole millimetres 1 mm, filtered heights
the rest."""
SINKS_MPS = 0.08


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> ScanNetwork:
    return ScanNetwork(map_network(tmp_path_factory.mktemp("map") / "map.onnx"))


def rig(*mounts: Mount, grid: HeightGrid = SCAN, **changes: Any) -> ScanRig:
    names = [FIRST, "rear", "left"]
    return ScanRig(
        grid=grid,
        cameras={n: ScanCamera(m) for n, m in zip(names, mounts, strict=False)},
        **changes,
    )


def images(
    world: PlaneWorld, mounts: dict[str, Mount], step: int, every: int = 2
) -> dict[str, DepthFrame]:
    """Those that arrive at a step."""
    if step % every or step * STEP_NS < LATENCY_NS:
        return {}
    time_ns = BEGIN_NS + step * STEP_NS - LATENCY_NS
    return {name: world.frame(mount, time_ns, step // every) for name, mount in mounts.items()}


def run(
    service: ScanService,
    world: PlaneWorld,
    mounts: dict[str, Mount],
    steps: int = 30,
    first: int = 0,
    **changes: Any,
) -> Iterator[Heightmap]:
    for step in range(first, first + steps):
        state = world.state(step, ROBOT, **changes)
        yield service.step(state, images(world, mounts, step), state.time_ns)


def errors(answer: Heightmap, world: PlaneWorld, grid: HeightGrid) -> np.ndarray:
    """Absolute errors of the points that were seen [m]."""
    off = np.abs(answer.height - world.truth(grid.points, answer.time_ns))
    return np.asarray(off[np.isfinite(answer.age_s)])


WORLDS = [
    PlaneWorld(),
    PlaneWorld(velocity=(1.0, 0.0, 0.0), attitude=(0.0, 0.2, 0.0)),
    PlaneWorld(slope=(0.2, -0.1), velocity=(0.3, 0.6, 0.0), attitude=(0.1, -0.1, 2.0)),
]


@pytest.mark.parametrize("seed", range(4))
def test_any_mount_and_any_grid_tell_the_ground(network: ScanNetwork, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mount = Mount(
        position=rng.uniform(-0.3, 0.3, 3), pitch=rng.uniform(0.6, 1.2),
        roll=rng.uniform(-math.pi, math.pi),
        yaw=rng.uniform(-math.pi, math.pi),
    )  # fmt: skip
    x, y = (tuple(np.cumsum(rng.uniform(0.03, 0.1, rng.integers(1, 12))) - 0.5) for _ in range(2))
    grid, world = HeightGrid(x=x, y=y), WORLDS[seed % len(WORLDS)]
    *_, last = run(ScanService(network, rig(mount, grid=grid)), world, {FIRST: mount})
    assert last.height.shape == last.half_width_90.shape == last.age_s.shape == (grid.size,)
    np.testing.assert_array_equal(last.x, grid.x)
    off = errors(last, world, grid)
    assert off.size == 0 or off.mean() < OFF_M
    assert last.seen_share == pytest.approx(off.size / grid.size)


def test_a_grid_that_is_in_view_is_seen_and_its_ages_are_those_of_the_images(
    network: ScanNetwork,
) -> None:
    world, grid = WORLDS[1], HeightGrid(x=(0.5, 0.6, 0.7), y=(-0.1, 0.0, 0.1))
    *_, last = run(ScanService(network, rig(DOWN, grid=grid)), world, {FIRST: DOWN})
    assert last.seen_share == 1.0
    assert last.depth_age_s == pytest.approx(1e-9 * (LATENCY_NS + STEP_NS))
    np.testing.assert_allclose(last.age_s, last.depth_age_s, atol=1e-3)


@pytest.mark.parametrize("climb_mps", [-0.08, 0.06])
@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)])
def test_legs_whose_velocity_is_off_in_height_tell_the_ground_where_it_is(
    network: ScanNetwork, climb_mps: float, velocity: tuple[float, float, float]
) -> None:
    """Images are late, so that a velocity that stays wrong would move the ground by all of it."""
    world = PlaneWorld(velocity=velocity)
    service = ScanService(network, rig(DOWN, robot=ROBOT))
    told = np.add(velocity, (0.0, 0.0, climb_mps))
    *_, last = run(service, world, {FIRST: DOWN}, 160, velocity_base_in_world=told)
    assert errors(last, world, SCAN).mean() < 0.004


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[MapUpdate]:
    """Updates that predictors are given, image by image."""
    found: list[MapUpdate] = []
    see = ScanPredictor.see

    def seen(self: ScanPredictor, measured: MapUpdate, now_s: float) -> bool:
        found.append(measured)
        return see(self, measured, now_s)

    monkeypatch.setattr(ScanPredictor, "see", seen)
    return found


@pytest.mark.parametrize("errors", [(0.0,), (1.0, 0.5), (0.2, 3.0)])
@pytest.mark.parametrize(("robot", "odometry"), [(None, 1.0), (ROBOT, LEGS_ODOMETRY_ERROR)])
def test_the_network_is_told_how_well_odometry_and_mounts_are_known(
    network: ScanNetwork, told: list[MapUpdate], errors: tuple[float, ...], robot: Robot | None,
    odometry: float,
) -> None:  # fmt: skip
    """The worst of several cameras counts."""
    given = dict(zip((FIRST, "rear"), (ScanCamera(DOWN, None, e) for e in errors), strict=False))
    service = ScanService(network, ScanRig(grid=SCAN, cameras=given, robot=robot))
    list(run(service, WORLDS[0], dict.fromkeys(given, DOWN), 8))
    assert {float(measured.mount_error[0]) for measured in told} == {np.float32(max(errors))}
    assert {float(measured.odometry_error[0]) for measured in told} == {np.float32(odometry)}


def test_every_point_is_told_with_the_place_of_the_camera_that_saw_it(
    network: ScanNetwork, told: list[MapUpdate]
) -> None:
    rear = Mount(position=np.array([-0.25, 0.0, 0.1]), pitch=0.8, yaw=math.pi)
    mounts = {FIRST: DOWN, "rear": rear}
    list(run(ScanService(network, rig(*mounts.values())), WORLDS[0], mounts, 8))
    both = told[-1]
    assert both.viewpoint.shape == both.points.shape
    counts = []
    for mount in mounts.values():
        own = np.all(np.isclose(both.viewpoint, mount.position, atol=1e-4), axis=-1)
        ahead = (both.points - both.viewpoint)[own] @ mount.rotation[:, 2]
        np.testing.assert_allclose(ahead, both.depth[own], atol=1e-4)
        counts.append(np.count_nonzero(own))
    assert min(counts) > 100
    assert sum(counts) == both.depth.size


@pytest.mark.parametrize("name", DIALECTS)
@pytest.mark.parametrize("grid", [SCAN, LINE, HeightGrid(x=(-0.3, 0.1, 0.8), y=(-0.4, 0.0))])
def test_an_observation_is_the_dialects_own_arithmetic(
    network: ScanNetwork, name: str, grid: HeightGrid
) -> None:
    service = ScanService(network, rig(DOWN, grid=grid, dialect=name))
    *_, last = run(service, WORLDS[2], {FIRST: DOWN}, 12)
    assert last.dialect == name
    dialect, table = DIALECTS[name], -last.height.reshape(grid.shape) - DIALECTS[name].offset_m
    rows = table.T if dialect.outer_axis == "y" else table
    expected = np.clip(rows.ravel(), -dialect.clip_m, dialect.clip_m) * dialect.scale
    np.testing.assert_allclose(last.observation, expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("world", WORLDS)
def test_a_planner_of_jumps_is_told_of_shadows(network: ScanNetwork, world: PlaneWorld) -> None:
    plain, told = (
        run(ScanService(network, rig(DOWN, grid=LINE, shadows=shadows)), world, {FIRST: DOWN})
        for shadows in (False, True)
    )
    for given, lowered in zip(plain, told, strict=True):
        expected = deepen_shadows(given.height, given.half_width_90, LINE)
        np.testing.assert_array_equal((lowered.height, lowered.half_width_90), expected)


@pytest.mark.parametrize("sunk_m", [0.0, 0.007, 0.014])
@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (0.05, -0.1, 1.0)])
def test_images_tell_how_deep_standing_feet_sink(
    network: ScanNetwork, sunk_m: float, attitude: tuple[float, float, float]
) -> None:
    """Their undersides are then on the ground that images show, whatever the attitude."""
    above = Mount(position=np.array([0.0, 0.0, 0.3]), pitch=1.5)
    world = PlaneWorld(attitude=attitude)
    under = LegKinematics(ROBOT).position(ROBOT.stand_pose) @ rotation_matrix(world.quaternion).T
    lowest = np.abs(under[:, 2] - under[:, 2].min()) < 1e-9
    world = replace(world, height=float(ROBOT.foot_radius - sunk_m - under[:, 2].min()))
    service = ScanService(network, rig(above, robot=ROBOT))
    assert service.sole == ROBOT.foot_radius
    for step in range(120):
        state = world.state(step, ROBOT, leg_trusted=lowest)
        service.step(state, images(world, {FIRST: above}, step), state.time_ns)
    np.testing.assert_allclose(service.sole, ROBOT.foot_radius - sunk_m, atol=0.003)


def test_legs_whose_velocity_is_off_vertically_leave_the_ground_where_images_show_it(
    network: ScanNetwork,
) -> None:
    """A bounding Go1's was 0.05 to 0.09 m/s too low over three seconds of a real-time run."""
    world, mounts = PlaneWorld(velocity=(0.5, 0.0, 0.0)), {FIRST: DOWN}
    service = ScanService(network, rig(DOWN, robot=ROBOT, body=NoBody()))
    off = np.array(world.velocity) - [0.0, 0.0, SINKS_MPS]
    *_, last = run(service, world, mounts, steps=200, velocity_base_in_world=off)
    assert errors(last, world, SCAN).mean() < 0.7 * OFF_M


def test_empty_images_are_not_used_and_say_so(network: ScanNetwork) -> None:
    service = ScanService(network, rig(DOWN))
    *_, good = run(service, WORLDS[0], {FIRST: DOWN})
    assert good.status == HeightmapStatus.OK
    statuses = []
    for step in range(30, 45):
        state = WORLDS[0].state(step, ROBOT)
        frames = images(WORLDS[0], {FIRST: DOWN}, step)
        empty = {
            name: replace(frame, depth=np.zeros_like(frame.depth)) for name, frame in frames.items()
        }
        blind = service.step(state, empty, state.time_ns)
        statuses.append(blind.status)
    # As long as after a camera that sends nothing it is believed, but not fully
    begun = statuses.index(HeightmapStatus.DEGRADED)
    assert begun <= 3
    assert statuses[-1] == HeightmapStatus.INVALID
    ended = statuses.index(HeightmapStatus.INVALID)
    assert {*statuses[begun:ended]} == {HeightmapStatus.DEGRADED}
    assert {*statuses[ended:]} == {HeightmapStatus.INVALID}
    # It stands still: what was known holds on
    np.testing.assert_allclose(blind.height, good.height, atol=1e-9)


@pytest.mark.parametrize("late_s", [0.18, 1.0, -0.1])
def test_images_too_late_or_from_the_future_are_not_used(
    network: ScanNetwork, late_s: float
) -> None:
    service = ScanService(network, rig(DOWN))
    for step in range(30):
        state = WORLDS[0].state(step, ROBOT)
        time_ns = state.time_ns - round(1e9 * late_s)
        answer = service.step(state, WORLDS[0].frame(DOWN, time_ns, step), state.time_ns)
    assert answer.frame_id == -1
    assert answer.status == HeightmapStatus.INVALID
    assert answer.seen_share == 0.0
    assert np.isfinite(answer.height).all()


@pytest.mark.parametrize("every", [2, 3, 5])
@pytest.mark.parametrize("late", [6, 12, 15, 16])
@pytest.mark.parametrize("world", WORLDS)
def test_images_that_come_in_time_hold_until_the_next_one(
    network: ScanNetwork, world: PlaneWorld, late: int, every: int
) -> None:
    """20 to 50 images a second, 60 to 160 ms late."""
    service, answers = ScanService(network, rig(DOWN)), list[Heightmap]()
    for step in range(100):
        state, frames = world.state(step, ROBOT), {}
        if step >= late and step % every == 0:
            taken_ns = state.time_ns - late * STEP_NS
            frames[FIRST] = world.frame(DOWN, taken_ns, step // every)
        answers.append(service.step(state, frames, state.time_ns))
    warm = answers[late + (WARM_IMAGES + 1) * every :]
    assert len(warm) > 20
    assert {a.status for a in warm} <= {HeightmapStatus.OK, HeightmapStatus.DEGRADED}
    assert all(a.status == HeightmapStatus.DEGRADED for a in warm if a.depth_age_s > 0.1201)
    assert errors(warm[-1], world, SCAN).mean() < OFF_M


def test_images_that_end_are_told(network: ScanNetwork) -> None:
    service = ScanService(network, rig(DOWN))
    list(run(service, WORLDS[0], {FIRST: DOWN}))
    statuses = [answer.status for answer in run(service, WORLDS[0], {}, 20, first=30)]
    assert statuses[0] == HeightmapStatus.OK
    assert statuses[-1] == HeightmapStatus.INVALID


@pytest.mark.parametrize("jump", [(5.0, 0.0, 0.0), (0.0, -0.4, 0.3), (300.0, -200.0, 10.0)])
def test_positions_that_jump_leave_the_ground_where_it_is(
    network: ScanNetwork, jump: tuple[float, ...]
) -> None:
    world, heights = WORLDS[1], []
    for moved in (np.zeros(3), np.array(jump)):
        service = ScanService(network, rig(DOWN))
        for step in range(40):
            at = world.position(BEGIN_NS + step * STEP_NS) + (moved if step >= 25 else 0.0)
            state = world.state(step, ROBOT, position_base_in_odometry=at)
            answer = service.step(state, images(world, {FIRST: DOWN}, step), state.time_ns)
        heights.append(answer.height)
    np.testing.assert_allclose(heights[0], heights[1], atol=2e-3)


def test_an_attitude_that_jumps_empties_the_map(network: ScanNetwork) -> None:
    service = ScanService(network, rig(DOWN))
    *_, before = run(service, WORLDS[0], {FIRST: DOWN})
    turned = replace(WORLDS[0], attitude=(0.0, 0.0, 1.0))
    after = next(iter(run(service, turned, {}, 1, first=31)))
    assert before.seen_share > 0.0
    assert after.seen_share == 0.0
    assert after.status == HeightmapStatus.WARMING


def test_cameras_beside_each_other_see_more_and_one_that_is_lost_is_told(
    network: ScanNetwork,
) -> None:
    mounts = {
        FIRST: DOWN,
        "rear": Mount(position=np.array([-0.25, 0.0, 0.1]), pitch=0.8, yaw=math.pi),
    }
    world, shares = WORLDS[0], []
    for names in ([FIRST], [FIRST, "rear"]):
        some = {name: mounts[name] for name in names}
        service = ScanService(network, rig(*some.values()))
        *_, last = run(service, world, some)
        shares.append(last.seen_share)
        assert last.status == HeightmapStatus.OK
        assert errors(last, world, SCAN).mean() < OFF_M
    assert shares[1] > 1.5 * shares[0]
    *_, alone = run(service, world, {FIRST: DOWN}, 30, first=30)
    assert alone.status == HeightmapStatus.DEGRADED
    assert alone.frame_id == 29


def test_feet_that_stand_tell_the_ground_of_a_robot_without_images(network: ScanNetwork) -> None:
    """The one camera looks ahead at nothing; only an image with the feet makes a map."""
    ahead = Mount(position=np.array([0.25, 0.0, 0.1]), pitch=0.8)
    world, feet = WORLDS[0], np.array([[0.0, 0.2, -0.3], [0.0, -0.2, -0.3]])
    grid = HeightGrid(x=(0.0,), y=(-0.2, 0.2))
    told = []
    for standing in (np.zeros((0, 3)), feet):
        *_, last = run(
            ScanService(network, rig(ahead, grid=grid)),
            world,
            {FIRST: ahead},
            standing_feet=standing,
        )
        told.append(last.height)
        assert np.isfinite(last.height).all()
    np.testing.assert_allclose(told[1], -0.3, atol=0.01)


def test_an_answer_is_given_once_for_a_state(network: ScanNetwork) -> None:
    service, state = ScanService(network, rig(DOWN)), WORLDS[0].state(3, ROBOT)
    first = service.step(state, None, state.time_ns)
    assert service.step(state, None, state.time_ns) is first


class Patient:
    """Does its work when it is told to."""

    def __init__(self) -> None:
        self.given: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, work: Callable[[], Any], /) -> "Future[Any]":
        self.given.append((Future(), work))
        return self.given[-1][0]

    def work(self) -> None:
        done, work = self.given[-1]
        done.set_result(work())


def test_states_are_answered_while_an_image_is_looked_at_and_the_newest_one_is_next(
    network: ScanNetwork,
) -> None:
    patient = Patient()
    service = ScanService(network, rig(DOWN), worker=patient)
    answers = list(run(service, WORLDS[0], {FIRST: DOWN}, 20))
    assert len(answers) == 20
    assert len(patient.given) == 1
    assert answers[-1].frame_id == -1
    patient.work()
    answer = next(iter(run(service, WORLDS[0], {FIRST: DOWN}, 1, first=20)))
    assert answer.frame_id == 3  # the first that came
    assert len(patient.given) == 2
    patient.work()
    answer = next(iter(run(service, WORLDS[0], {}, 1, first=21)))
    assert answer.frame_id == 10


@pytest.mark.parametrize("wrong", [math.nan, math.inf, 100.0])
def test_answers_that_are_not_plausible_are_not_told(tmp_path: Path, wrong: float) -> None:
    mad = ScanNetwork(map_network(tmp_path / "mad.onnx", wrong))
    service = ScanService(mad, rig(DOWN))
    *_, last = run(service, WORLDS[0], {FIRST: DOWN})
    assert last.status == HeightmapStatus.INVALID
    assert np.isfinite(last.half_width_90).all()
