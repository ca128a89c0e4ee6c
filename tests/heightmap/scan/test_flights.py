"""Flights: rays end on the ground, a seed gives the same flight,
and images without errors give the true map.
"""

import pytest
import torch
from small_flights import EXACT, SMALL

from saltus.heightmap.scan.cells import NO_LINE_M
from saltus.heightmap.scan.elevation import (
    MapUpdate,
    OdometryPoses,
    advance_map,
    is_known,
    new_map,
)
from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.flights import (
    draw_flight,
    next_image,
    redraw_robots,
    true_map_heights,
)
from saltus.heightmap.scan.training.ground_patches import GroundPatches, draw_ground, heights_at
from saltus.heightmap.scan.training.raster_rays import first_hits
from saltus.heightmap.scan.training.seeded_random import SeededRandom
from saltus.heightmap.scan.training.settings import FAMILIES

OFF_M = 0.005


def surface_distance(ground, points, raster_m):
    """How far points (1, n, 3) are from the surface, at most:
    straight up or down, or within OFF_M to any side.
    """
    found = []
    for dx, dy in ((0, 0), (OFF_M, 0), (-OFF_M, 0), (0, OFF_M), (0, -OFF_M)):
        found.append(heights_at(ground.height, points[..., 0] + dx, points[..., 1] + dy, raster_m))
    z, around = points[..., 2], torch.stack(found)
    return torch.maximum(around.amin(0) - z, z - around.amax(0)).clamp(min=0.0)


@pytest.mark.sample(5)
@pytest.mark.parametrize("family", FAMILIES)
def test_rays_end_on_the_ground_within_5_mm(fly, draws, family):
    flight, settings = fly(families=(family,))
    shot = next_image(flight, settings, draws)
    hit = shot.measured.depth > 0.0
    assert hit.float().mean() > 0.1
    assert surface_distance(flight.ground, shot.hits, settings.raster_m)[hit].max() < OFF_M


@pytest.mark.parametrize("down", [20.0, 45.0, 80.0])
def test_a_ray_meets_a_step_where_geometry_says(down):
    """A step of 0.3 m at x = 1 m, seen from the origin, 0.5 m high."""
    settings = EXACT
    x = (torch.arange(settings.raster) + 0.5) * settings.raster_m - 0.5 * settings.patch_m
    height = (
        torch.where(x > 1.0, 0.3, 0.0)[None, :, None].expand(1, -1, settings.raster).contiguous()
    )
    zero = torch.zeros(1)
    ground = GroundPatches(
        height, torch.zeros(1, dtype=torch.long), zero, top=zero + 0.3, bottom=zero
    )
    angle = torch.deg2rad(torch.tensor(down))
    direction = torch.stack((angle.cos(), torch.tensor(0.0), -angle.sin())).view(1, 1, 3)
    origin = torch.tensor([[[0.0, 0.013, 0.5]]])
    found = first_hits(
        ground, origin, direction, torch.zeros(1, 1), torch.full((1, 1), 5.0), settings.raster_m, 96
    )
    level = 0.5 / angle.sin()
    face = 1.0 / angle.cos()
    top = 0.2 / angle.sin()
    expected = level if level < face else top if top > face else face
    assert float(found) == pytest.approx(float(expected), abs=OFF_M / float(angle.cos()))


def test_a_ray_that_meets_nothing_has_no_depth():
    zero = torch.zeros(1)
    ground = GroundPatches(
        torch.zeros(1, 64, 64), torch.zeros(1, dtype=torch.long), zero, top=zero, bottom=zero
    )
    up = torch.tensor([[[1.0, 0.0, 0.2]]])
    found = first_hits(
        ground,
        torch.tensor([[[0.0, 0.0, 0.5]]]),
        up,
        torch.zeros(1, 1),
        torch.full((1, 1), 5.0),
        0.1,
        16,
    )
    assert float(found) == 0.0


def flown_map(flight, settings, draws):
    """A map without matching after four images, and the true heights of its cells."""
    map_settings = MapSettings(matching=False)
    state = new_map(len(flight.image), map_settings, flight.ground.height)
    for _ in range(4):
        shot = next_image(flight, settings, draws)
        state, around = advance_map(state, shot.measured, map_settings)
    return state, true_map_heights(flight, shot, state, around, map_settings, settings)


@pytest.mark.sample(2)
@pytest.mark.parametrize("families", [("flat",), ("stairs",), ("stones",), ("rough",)])
def test_without_errors_the_map_is_the_truth(fly, draws, families):
    """Cells whose points are all at one height hold that height; edges hold what is between.

    Feet, which are known to some millimetres, have no say, nor has matching, which finds drift of
    some millimetres where there is none.
    """
    flight, settings = fly(6, families=families, rows=24, columns=32, feet=0.0)
    state, truth = flown_map(flight, settings, draws)
    error = (state.height - truth).abs()[is_known(state)]
    assert error.median() < 0.0002 if families == ("flat",) else error.median() < 0.005
    assert error.mean() < 0.015


@pytest.mark.sample(5)
@pytest.mark.parametrize("family", FAMILIES)
def test_without_errors_no_ground_is_above_a_line_of_sight(fly, draws, family):
    """Ground of a cell or one beside it is meant: a line may pass beside an edge within a cell.

    Places and turns of the base are read from tables of 10 ms, which are 2 mm off while it turns.
    """
    flight, settings = fly(
        6, families=(family,), rows=24, columns=32, feet=0.0, calibration=(0.0, 0.0)
    )
    state, truth = flown_map(flight, settings, draws)
    lowest = -torch.nn.functional.max_pool2d(-truth[:, None], 3, 1, 1)[:, 0]
    lines = state.clear < NO_LINE_M
    assert lines.float().mean() > 0.02
    assert (lowest - state.clear)[lines].max() < OFF_M


def test_lines_of_sight_tell_a_trench_into_which_no_ray_fell():
    """From 0.4 m up, a ray meets the far wall of a trench of 0.2 m, 1 m ahead, 7 cm below its edge;
    halfway it passed 3 cm below it.
    """
    settings, wall = MapSettings(matching=False, cells=64), -0.2 * 0.4 / 1.1
    x = torch.cat((torch.linspace(0.5, 0.9, 21), torch.tensor([1.1])))
    z = torch.cat((torch.full((21,), -0.4), torch.tensor([-0.4 + wall])))
    points = torch.stack((x, torch.full_like(x, 0.01), z), -1)[None]
    pose = OdometryPoses(torch.zeros(1, 3), torch.eye(3)[None])
    zeros = torch.zeros(1)
    image = MapUpdate(
        points, points[..., 0], pose, pose, torch.zeros(1, 1, 3), torch.zeros(1, 1).bool(), zeros,
        zeros, zeros, zeros, torch.zeros(1, 1, 3),
    )  # fmt: skip
    state, _ = advance_map(new_map(1, settings, points), image, settings)
    column = state.clear[0, :, settings.side // 2]
    first = round(0.9 / settings.fine_m) + settings.side // 2
    over = column[first : first + 10]
    over = over[over < NO_LINE_M] + 0.4
    assert len(over) >= 4
    assert float(over.max()) < 0.01
    assert wall < float(over.min()) < 0.75 * wall
    before = column[first - 10 : first - 1] + 0.4
    assert float(before.abs().max()) < 0.04


def test_a_seed_gives_the_same_ground_and_images():
    device = torch.device("cpu")
    shots = []
    for _ in range(2):
        draws = SeededRandom(7, device)
        flight = draw_flight(3, SMALL, draws)
        shots.append([next_image(flight, SMALL, draws) for _ in range(2)][-1])
    for one, other in zip(shots[0].measured, shots[1].measured, strict=True):
        if isinstance(one, torch.Tensor):
            torch.testing.assert_close(one, other, rtol=0.0, atol=0.0)
    assert not torch.equal(
        draw_ground(3, SMALL, SeededRandom(8, device)).height, flight.ground.height
    )


def test_redrawing_some_robots_leaves_the_others(fly, draws):
    flight, settings = fly(4)
    kept = flight.ground.height[1:3].clone()
    other = draw_flight(2, settings, draws)
    redraw_robots(flight, torch.tensor([0, 3]), other)
    torch.testing.assert_close(flight.ground.height[1:3], kept)
    torch.testing.assert_close(flight.ground.height[[0, 3]], other.ground.height)
    torch.testing.assert_close(flight.motion.position[[0, 3]], other.motion.position)


@pytest.mark.sample(5)
@pytest.mark.parametrize("family", FAMILIES)
def test_standing_feet_touch_the_ground(fly, family):
    flight, settings = fly(3, families=(family,), gaits=("walk", "trot", "bound"), feet=1.0)
    feet, standing = flight.motion.feet, flight.motion.standing
    ground = heights_at(flight.ground.height, feet[..., 0], feet[..., 1], settings.raster_m)
    low = torch.nn.functional.max_pool2d(-flight.ground.height[:, None], 3, 1, 1)[:, 0].neg()
    assert (
        (feet[..., 2] - heights_at(low, feet[..., 0], feet[..., 1], settings.raster_m))[standing]
        > -1e-4
    ).all()
    assert (ground - feet[..., 2]).abs()[standing].median() < 0.005


def test_who_tells_no_velocity_turns_and_does_not_move_by_its_odometry(fly):
    flight, _ = fly(6, velocity=0.0, gaits=("walk", "bound"))
    position, angles = flight.odometry.position, flight.odometry.angles
    torch.testing.assert_close(position, position[:, :1].expand_as(position))
    assert (angles.std(1).amax(-1) > 1e-3).all()
    assert (flight.motion.position.std(1).amax(-1) > 1e-2).all()


@pytest.mark.parametrize("look_deg", [0.0, 90.0, -90.0])
def test_cameras_look_where_they_are_said_to(fly, look_deg):
    flight, _ = fly(5, look_deg=look_deg, aim_deg=0.0, turned=0.0, pairs=0.0, down_deg=(20.0, 20.0))
    ahead = flight.cameras.rotation[:, 0, :, 2]
    yaw = torch.rad2deg(torch.atan2(ahead[:, 1], ahead[:, 0]))
    torch.testing.assert_close(yaw, torch.full_like(yaw, look_deg), atol=1e-3, rtol=0.0)
