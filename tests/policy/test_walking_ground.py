"""Laws of the ground of walking trainings, and of the heights that it is told with."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from numpy_and_torch import both

from saltus.config import load_config
from saltus.grid import SCAN
from saltus.policy.evaluation.walking_grounds import GROUNDS
from saltus.policy.walking.course_field import (
    DROP_M,
    EDGE_M,
    MISSED_M,
    REACH_M,
    CourseField,
    beside_drop,
    in_trench,
)
from saltus.policy.walking.scan_errors import ScanDraws, ScanErrors
from saltus.policy.walking.settings import (
    GroundSettings,
    ScanErrorSettings,
)
from saltus.terrain.boxes import Boxes
from saltus.terrain.course import FOLDER, Course
from saltus.terrain.course_segments import Hurdles, Level, RandomSizes, Stairs, Stones


def test_the_nearest_boxes_are_the_ground_below_a_robot_and_nearly_all_that_the_scan_sees():
    config = GroundSettings(levels=2)
    ground, rng = CourseField(config, torch.zeros(1)), np.random.default_rng(5)
    course = torch.as_tensor(rng.integers(0, len(ground.table.finish_x), 600))
    place = torch.as_tensor(rng.uniform(-0.8, 0.8, (600, 2)), dtype=torch.float32)
    place[:, 0] = ground.table.finish_x[course] * torch.as_tensor(rng.uniform(size=600)).float()
    yaw = torch.as_tensor(rng.uniform(-3.1, 3.1, 600)).float()
    x, y = SCAN.points_in_world(place, yaw)
    near = ground.near(course, place)
    assert near.center.shape == (600, config.boxes, 3)
    whole = ground.table.solid.of_robot(course)
    wrong = (near.height_at(x, y) - whole.height_at(x, y)).abs() > 1e-4
    below = torch.as_tensor((np.abs(SCAN.points) < [0.41, 0.31]).all(axis=1))
    assert not wrong[:, below].any()
    assert wrong.float().mean() < 0.003


def test_a_foot_missed_where_it_is_low_between_two_edges_and_not_on_a_step_down():
    rng, n = np.random.default_rng(7), 300
    width, depth = rng.uniform(0.05, REACH_M, n), rng.uniform(0.0, 0.5, n)
    across = rng.uniform(-0.49, 0.49, n) * width
    for beyond in (0.0, -1.0):  # a trench, and a step down
        boxes = Boxes(
            center=torch.tensor([[
                [-0.5 - 0.5 * w, 0.0, -1.0], [0.5 + 0.5 * w, 0.0, beyond * d - 1.0],
                [0.0, 0.0, -d - 1.0]] for w, d in zip(width, depth, strict=True)]),
            half_size=torch.tensor([[0.5, 3.0, 1.0], [0.5, 3.0, 1.0], [3.0, 3.0, 1.0]]).expand(
                n, 3, 3),
        )  # fmt: skip
        along_y = torch.as_tensor(rng.uniform(-1.0, 1.0, n))
        foot = torch.stack([torch.as_tensor(across), along_y, torch.as_tensor(-depth)], -1)
        found = in_trench(boxes, foot[:, None].expand(n, 4, 3)).numpy()
        expected = (depth > MISSED_M) & (beyond == 0.0)
        assert (found == expected[:, None]).all()


def test_a_foot_is_beside_a_drop_where_the_ground_close_to_it_is_far_lower_and_not_in_the_trench():
    rng, n = np.random.default_rng(8), 300
    depth, across = rng.uniform(0.0, 0.6, n), rng.uniform(-0.2, 0.2, n)
    for axis in (0, 1):  # a trench across x, and one across y, 0.2 m wide
        place = np.array(
            [[[-1.1, 0.0, -1.0], [1.1, 0.0, -1.0], [0.0, 0.0, -d - 1.0]] for d in depth]
        )
        size = np.array([[1.0, 9.0, 1.0], [1.0, 9.0, 1.0], [9.0, 9.0, 1.0]])
        turned = [axis, 1 - axis, 2]
        boxes = Boxes(
            center=torch.tensor(place[..., turned]),
            half_size=torch.tensor(size[:, turned]).expand(n, 3, 3),
        )
        foot = np.stack([across, rng.uniform(-1.0, 1.0, n), np.full(n, 0.02)], -1)
        inside = np.abs(across) < 0.1
        foot[inside, 2] -= depth[inside]
        found = beside_drop(boxes, torch.tensor(foot[:, None, turned]).expand(n, 4, 3)).numpy()
        expected = ~inside & (np.abs(across) < 0.1 + EDGE_M) & (depth + 0.02 > DROP_M)
        assert (found == expected[:, None]).all()


def told_heights(scan, heights, places, error, drawn):
    """Heights that robots are told, by numpy, which torch has to equal."""

    def told(heights, x, y, error, shift, noise):
        return scan.observed(heights, (x, y), error, ScanDraws(shift, noise))

    return both(told, heights, *places, error, *drawn)


@pytest.mark.parametrize("noise", [0.0, 0.5, 1.0])
def test_errors_of_heights_have_the_stated_spread_and_vanish_on_flat_ground(noise):
    config = ScanErrorSettings(shift_m=0.0)
    scan, rng, n = ScanErrors(config), np.random.default_rng(6), 400
    every = np.ones(n, dtype=bool)
    error = scan.changed(np.zeros((n, 187)), every, every, rng.uniform(size=(n, 187)))
    uneven = np.tile(rng.normal(0.0, 0.1, (n, SCAN.shape[1])), SCAN.shape[0])  # no gap across
    seen = (SCAN.points[:, 0] >= config.seen_x_m) & (abs(SCAN.points[:, 1]) <= config.seen_y_m)
    drawn = ScanDraws(np.zeros(n), np.full(n, noise))
    places = SCAN.points_in_world(np.zeros((n, 2)), np.zeros(n))
    wrong = told_heights(scan, uneven, places, error, drawn) - uneven
    size = noise**2
    assert wrong[:, seen].std() == pytest.approx(size * config.seen_m, rel=0.05)
    spread = config.unseen * np.abs(uneven).mean()
    assert wrong[:, ~seen].std() == pytest.approx(size * spread, rel=0.1)
    flat = scan.observed(0.0 * uneven, places, error, drawn)
    assert np.abs(flat).max() <= np.sqrt(3.0) * size * config.seen_m


NO_NOISE = ScanErrorSettings(seen_m=0.0, unseen=0.0, shift_m=0.0)


@pytest.mark.parametrize("filled", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("along", [0, 1])
def test_gaps_of_one_spacing_across_the_way_are_told_as_dips(filled, along):
    scan, rng, n = ScanErrors(replace(NO_NOISE, filled=filled)), np.random.default_rng(8), 400
    error, drawn = rng.uniform(-1.0, 1.0, (n, 187)), ScanDraws(*rng.uniform(size=(2, n)))
    edge, depth = rng.normal(0.0, 0.1, (n, 1)), rng.uniform(0.02, 0.6, (n, 1))
    place = rng.integers(2, 8, n)
    places = SCAN.points_in_world(rng.uniform(-9.0, 9.0, (n, 2)), rng.uniform(-3.0, 3.0, n))
    for width in (1, 2):  # spacings; the wider gap is told as it is
        row = np.indices(SCAN.shape)[along].ravel()
        low = (row >= place[:, None]) & (row < place[:, None] + width)
        truth = edge - np.where(low, depth, 0.0)
        told = told_heights(scan, truth, places, error, drawn)
        np.testing.assert_array_equal(told[~low], truth[~low])
        if width == 2 or along == 1:
            np.testing.assert_array_equal(told, truth)
            continue
        deep = (depth[:, 0] > MISSED_M)[:, None] & low
        np.testing.assert_array_equal(told[low & ~deep], truth[low & ~deep])
        assert (told >= truth).all()
        assert (told <= np.maximum(truth, edge)).all()
        share = ((edge - told) / 0.65)[low & (depth > 0.4)]
        assert np.mean(share < 1e-9) == pytest.approx(filled, abs=0.04)
        for part in (0.2, 0.5, 0.8) if filled < 1.0 else ():
            expected = filled + (1.0 - filled) * part
            assert np.mean(share < part**2.2) == pytest.approx(expected, abs=0.05)


def test_a_dip_stays_where_it_is_while_the_robot_moves():
    scan, rng, n = ScanErrors(NO_NOISE), np.random.default_rng(9), 300
    drawn, error = ScanDraws(*rng.uniform(size=(2, n))), np.zeros((n, 187))
    edge = rng.integers(-20, 20, n) * 0.1 - 0.05  # gaps of one spacing, along the cells of dips
    told = []
    for way in (0.0, 0.2, 0.5):  # whole spacings: the same places of the world
        base = np.stack([edge - 0.4 + way, np.full(n, 0.05)], -1)
        x, y = SCAN.points_in_world(base, np.zeros(n))
        is_gap = np.abs(x - edge[:, None] - 0.2) < 0.01
        truth = np.where(is_gap, -0.4, 0.0)
        heights = told_heights(scan, truth, (x, y), error, drawn)
        told.append(heights[is_gap].reshape(n, -1))
    np.testing.assert_allclose(told[1], told[0], atol=1e-9)
    np.testing.assert_allclose(told[2], told[0], atol=1e-9)
    assert np.ptp(told[0], axis=1).min() > 0.0


def test_dips_of_one_gap_are_alike_over_three_spacings_aside_and_apart_ahead():
    scan, rng, n = ScanErrors(NO_NOISE), np.random.default_rng(10), 4000
    drawn, error = ScanDraws(*rng.uniform(size=(2, n))), np.zeros((n, 187))
    base = rng.uniform(-20.0, 20.0, (n, 2))
    places = SCAN.points_in_world(base, np.zeros(n))
    row = np.indices(SCAN.shape)[0].ravel()
    gap = (row == 3) | (row == 9)
    told = told_heights(scan, np.where(gap, -0.4, 0.0) + np.zeros((n, 1)), places, error, drawn)
    one, other = told[:, row == 3], told[:, row == 9]
    for apart, expected in ((1, 2 / 3), (2, 1 / 3), (3, 0.0), (5, 0.0)):
        found = np.corrcoef(one[:, 0], one[:, apart])[0, 1]
        assert found == pytest.approx(expected, abs=0.1)
    assert np.corrcoef(one[:, 0], other[:, 0])[0, 1] == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("change_m", [0.1, 0.3, 1.0])
def test_errors_of_heights_stay_where_a_robot_stands_and_change_with_its_way(change_m):
    scan, rng, n = ScanErrors(ScanErrorSettings(change_m=change_m)), np.random.default_rng(6), 400
    none = np.zeros(n, dtype=bool)
    begun = error = rng.uniform(-1.0, 1.0, size=(n, 187))
    pose = start = rng.normal(size=(n, 4))
    to = rng.uniform(-np.pi, np.pi, n)
    ahead = 0.012 * np.stack([np.cos(to), np.sin(to), 0.0 * to, 0.0 * to], axis=-1)
    place = start
    for step in range(100):  # sways, then goes 0.6 m
        way = ahead if step >= 50 else (-1.0) ** step * ahead
        pose = pose + way
        moved = both(scan.moved, pose, place)
        place = np.where(moved[:, None], pose, place)
        error = both(scan.changed, error, none, moved, rng.uniform(size=(n, 187)))
        assert step >= 50 or (error == begun).all()
    # A stride of 0.06 m, the first over the step of 0.05 m, renews a share of 0.05 / change_m
    assert (error == begun).mean() == pytest.approx((1.0 - 0.05 / change_m) ** 10, abs=0.01)
    assert error.std() == pytest.approx(1.0 / np.sqrt(3.0), rel=0.02)


def test_a_robot_that_only_turns_moves_the_points_of_its_scan():
    scan, zero = ScanErrors(ScanErrorSettings()), np.zeros((2, 4))
    turned = np.array([[0.0, 0.0, 0.0, 0.05], [0.0, 0.0, 0.0, 0.15]])
    assert both(scan.moved, turned, zero).tolist() == [False, True]


@pytest.mark.parametrize("rate", [10.0, 30.0, 50.0])
def test_images_arrive_at_their_rate(rate):
    scan, phase, count = ScanErrors(ScanErrorSettings(image_hz=rate)), np.array([0.3]), 0
    for _ in range(500):
        phase, arrives = scan.arrives(phase)
        count += int(arrives[0])
    assert abs(count - 10.0 * rate) <= 1


def test_half_of_the_hardest_walls_at_a_rim_are_about_as_high_as_those_of_trials() -> None:
    """Where they ended at the height of trials, no robot learned to cross those."""
    course = load_config(Course, FOLDER / "edges.toml")
    draws = RandomSizes(np.random.default_rng(0), GroundSettings().hardest)
    wall = next(each for each in GROUNDS["hurdles"] if isinstance(each, Hurdles)).height
    step = next(each for each in GROUNDS["stairs"] if isinstance(each, Stairs)).rise
    walls = [each.height for each in course.segments if isinstance(each, Hurdles)]
    steps = [each.rise for each in course.segments if isinstance(each, Stairs)]
    assert walls
    assert steps
    for asked, given in ((wall, walls), (step, steps)):
        for size in given:
            drawn = np.abs([draws.size(size) for _ in range(1000)])
            assert np.median(drawn) > abs(draws.size(asked)) - 0.02
            assert np.mean(drawn > abs(draws.size(asked))) > 0.25


@pytest.mark.parametrize("seed", range(20))
def test_stones_are_no_farther_from_the_end_of_their_part_than_from_its_rim(seed: int) -> None:
    """A last gap as wide as a cell was wider than any robot steps."""
    rng = np.random.default_rng(seed)
    pitch = rng.uniform(0.3, 0.6)
    length = pitch * rng.uniform(3.0, 9.0)
    stones = Stones(length=length, pitch=pitch, share=1.0, missing=0.0, uneven=0.0)
    course = Course(kind="one", segments=(stones, Level(length=1.0)), width=2.0, floor_m=0.01)
    boxes = course.terrain(RandomSizes(rng)).boxes
    middles = [0.5 * (box.low[0] + box.high[0]) for box in boxes if box.yaw]
    level = [box for box in boxes if not box.yaw and box.high[2] == pytest.approx(0.0, abs=0.02)]
    rim = min(box.high[0] for box in level)
    assert min(box.low[0] for box in level if box.low[0] > rim) == pytest.approx(rim + length)
    for nearest in (min(middles) - rim, rim + length - max(middles)):
        assert 0.0 < nearest < 0.8 * pitch


def test_robots_of_trainings_come_to_stones_again_and_again_as_hard_as_those_of_trials() -> None:
    """Most falls are at the first rows: where all stones are in one part, there is one such place
    in an episode.
    """
    course = load_config(Course, FOLDER / "stones.toml")
    draws = RandomSizes(np.random.default_rng(0), GroundSettings().hardest)
    asked = next(each for each in GROUNDS["stones"] if isinstance(each, Stones))
    parts = [each for each in course.segments if isinstance(each, Stones)]
    before = [a for a, b in pairwise(course.segments) if isinstance(b, Stones)]
    assert len(parts) >= 3
    assert all(isinstance(each, Level) for each in before)
    for part in parts:
        for given, wanted, sign in (
            (part.share, asked.share, -1.0), (part.uneven, asked.uneven, 1.0),
            (part.depth, asked.depth, 1.0),
        ):  # fmt: skip
            drawn = sign * np.array([draws.size(given) for _ in range(1000)])
            assert np.mean(drawn >= sign * draws.size(wanted) - 0.01) > 0.4
