"""The map's laws: one robot is as a batch, numpy is as torch,
drift is found, and what is far keeps its place.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from saltus.heightmap.scan.elevation import (
    ElevationMap,
    MapUpdate,
    OdometryPoses,
    advance_map,
    is_known,
    new_map,
)
from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.flights import next_image

SETTINGS = MapSettings(cells=32)


def flown(fly, draws, settings=SETTINGS, robots=3, **changes):
    flight, flights = fly(robots, errors=1.0, odometry=(1.0, 1.0), feet=1.0, **changes)
    return [next_image(flight, flights, draws).measured for _ in range(4)]


def each(measured, change):
    return MapUpdate(
        *(
            OdometryPoses(*map(change, v)) if isinstance(v, OdometryPoses) else change(v)
            for v in measured
        )
    )


def mapped(shots, settings=SETTINGS, like=None):
    state = new_map(len(shots[0].depth), settings, shots[0].points if like is None else like)
    for measured in shots:
        state, around = advance_map(state, measured, settings)
    return state, around


def test_numpy_and_torch_make_the_same_map(fly, draws):
    shots = flown(fly, draws)
    one, _ = mapped(shots)
    other, _ = mapped([each(shot, lambda value: value.numpy()) for shot in shots])
    for name in ElevationMap._fields:
        ours, theirs = np.asarray(getattr(one, name)), getattr(other, name)
        different = np.abs(ours - theirs) > 1e-4 * np.maximum(1.0, np.abs(ours))
        # A point on the border of two cells may fall into either
        assert different.mean() < 1e-3, name


def test_one_robot_is_as_in_a_batch(fly, draws):
    shots = flown(fly, draws)
    together, _ = mapped(shots)
    for robot in range(3):
        alone, _ = mapped(
            [each(shot, lambda value, robot=robot: value[robot : robot + 1]) for shot in shots]
        )
        for name in ElevationMap._fields:
            torch.testing.assert_close(
                getattr(alone, name)[0], getattr(together, name)[robot], rtol=1e-4, atol=1e-5
            )


def bumpy(x, y):
    return 0.1 * np.sin(7.0 * x) * np.cos(6.0 * y)


def still(offset, n=20_000, seed=0):
    """Points of bumpy ground as a robot at the origin measures them
    that believes to be at `offset`.
    """
    xy = np.random.default_rng(seed).uniform(-0.6, 0.6, (1, n, 2))
    points = np.concatenate((xy, bumpy(xy[..., :1], xy[..., 1:])), -1)
    pose = OdometryPoses(np.asarray([offset], float), np.eye(3)[None])
    return MapUpdate(
        points=points, depth=np.full((1, n), 0.5), exposed=pose, now=pose, feet=np.zeros((1, 1, 3)),
        standing=np.zeros((1, 1), bool), body_height=np.full(1, 0.3), exposed_s=np.zeros(1),
        odometry_error=np.ones(1), mount_error=np.ones(1),
        viewpoint=np.array([[[0.0, 0.0, 0.5]]]),
    )  # fmt: skip


@pytest.mark.parametrize(
    "offset", [(0.01, 0.0, 0.0), (0.0, -0.01, 0.0), (0.0, 0.0, 0.01), (0.006, 0.006, -0.01)]
)
def test_matching_finds_the_drift_of_the_odometry(offset):
    """A robot that stands, whose odometry jumps:
    after some images the correction has taken the jump back.
    """
    state, _ = mapped(
        [still((0.0, 0.0, 0.0)), *(still(offset, seed=i) for i in range(1, 9))], like=np.zeros(1)
    )
    assert np.abs(state.correction[0] + offset).max() < 0.003


def test_another_look_comes_nearer_to_where_the_image_was_taken():
    offset, left = np.array([0.01, -0.01, 0.01]), []
    for looks in (1, 2, 4):
        shots = [still((0.0, 0.0, 0.0)), still(offset, seed=1)]
        state, _ = mapped(shots, replace(SETTINGS, looks=looks), like=np.zeros(1))
        left.append(np.linalg.norm(state.correction[0] + offset))
    assert left[0] > left[1] > left[2]


def corrected(shots, sideways_m):
    state, _ = mapped(shots, replace(SETTINGS, sideways_m=sideways_m), like=np.zeros(1))
    return state.correction[0]


def test_a_steep_cell_says_less_the_less_it_is_known_where_it_was_hit():
    shots = [still((0.0, 0.0, 0.0)), still((0.01, -0.01, 0.0), seed=1)]
    moved = [
        np.linalg.norm(corrected(shots, sideways_m)) for sideways_m in (0.0, 0.006, 0.012, 0.05)
    ]
    assert sorted(moved, reverse=True) == moved
    assert moved[0] > 1.2 * moved[-1]
    level = [shot._replace(points=shot.points * [1.0, 1.0, 0.0]) for shot in shots]
    level[1] = level[1]._replace(points=level[1].points + np.array([0.0, 0.0, 0.01]))
    np.testing.assert_allclose(corrected(level, 0.0), corrected(level, 0.05), atol=1e-9)


def before_stairs(seed, n=4000):
    """Points of treads and risers of stairs, each image's others, as a robot at the origin sees
    them."""
    random = np.random.default_rng(seed)
    treads = random.uniform(-0.6, 0.6, (n, 3))
    treads[:, 2] = 0.2 * np.floor(treads[:, 0] / 0.3)
    risers = random.uniform(-0.6, 0.6, (n // 4, 3))
    edge = random.integers(-1, 2, n // 4)
    risers[:, 0], risers[:, 2] = 0.3 * edge, 0.2 * (edge - random.uniform(0.0, 1.0, n // 4))
    points = np.concatenate((treads, risers))[None]
    return still((0.0, 0.0, 0.0))._replace(points=points, depth=np.full(points.shape[:2], 0.5))


def test_matching_without_cliffs_leaves_a_robot_that_stands_before_stairs_where_it_is():
    """With them, it moves by where edges happened to be hit."""

    def moved(slope):
        settings = replace(SETTINGS, matched_slope=slope)
        runs = [[before_stairs(9 * run + image) for image in range(9)] for run in range(5)]
        return max(
            abs(mapped(shots, settings, like=np.zeros(1))[0].correction[0, 0]) for shots in runs
        )

    with_cliffs, without = moved(5.0), moved(1.0)
    assert without < 0.002 < 0.004 < with_cliffs


def test_standing_feet_take_drift_of_the_height_back():
    settings = replace(SETTINGS, matching=False)
    shots = [still((0.0, 0.0, 0.0))]
    foot = np.array([[[0.2, 0.1, bumpy(0.2, 0.1)]]])
    drifted = still((0.0, 0.0, 0.02))
    shots += [
        drifted._replace(
            feet=foot, standing=np.ones((1, 1), bool), depth=np.zeros_like(drifted.depth)
        )
    ] * 20
    state, _ = mapped(shots, settings, like=np.zeros(1))
    assert state.correction[0, 2] == pytest.approx(-0.02, abs=0.004)


def test_the_map_follows_the_base_and_forgets_only_what_leaves_it():
    one, _ = mapped([still((0.0, 0.0, 0.0))], like=np.zeros(1))
    away = still((0.0, 0.0, 0.0))
    away = away._replace(
        now=away.now._replace(position=np.array([[0.2, 0.0, 0.0]])), depth=np.zeros_like(away.depth)
    )
    other, _ = advance_map(one, away, SETTINGS)
    by = int((other.corner - one.corner)[0, 0]) * SETTINGS.sub
    assert by == 10
    np.testing.assert_array_equal(other.height[0, :-by], one.height[0, by:])
    assert not is_known(other)[0, -by:].any()


def test_an_image_without_points_changes_no_height():
    one, _ = mapped([still((0.0, 0.0, 0.0))], like=np.zeros(1))
    empty = still((0.0, 0.0, 0.0))
    other, _ = advance_map(one, empty._replace(depth=np.zeros_like(empty.depth)), SETTINGS)
    np.testing.assert_array_equal(other.height, one.height)
    np.testing.assert_array_equal(other.correction, one.correction)
