"""Ground behind an edge that no image shows is told as deep as it may be,
and nothing else is changed.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from saltus.grid import LINE, SCAN, HeightGrid
from saltus.loop.shadows import DOUBT_M, FALL_M, LEAD_M, LEVEL_M, RISES_M, deepen_shadows
from saltus.terrain.terrain import TRENCH_DEPTH

X = np.array(LINE.x)
SURE, DOUBTFUL = 0.5 * DOUBT_M, 3.0 * DOUBT_M
BASE_M = -0.3
lengths = st.floats(0.1, 0.5)
heights = st.lists(st.floats(-1.0, 0.5), min_size=LINE.size, max_size=LINE.size).map(np.array)
widths = st.lists(st.floats(0.005, 0.3), min_size=LINE.size, max_size=LINE.size).map(np.array)


def course(depth: float, begin: float, length: float, far: float) -> tuple[np.ndarray, np.ndarray]:
    """Level ground, a slope of so much depth that is in doubt,
    and sure ground behind it that lies `far` higher.
    """
    inside = (begin < X) & (begin + length > X)
    slope = np.interp(X, [begin, begin + length], [0.0, -depth])
    height = BASE_M + np.where(inside, slope, np.where(begin + length <= X, far, 0.0))
    return height, np.where(inside, DOUBTFUL, SURE)


@given(height=heights, half_width=widths)
@settings(max_examples=200, deadline=None)
def test_no_point_rises_and_intervals_still_reach_as_high(
    height: np.ndarray, half_width: np.ndarray
) -> None:
    told, wide = deepen_shadows(height, half_width, LINE)
    assert (told <= height).all()
    np.testing.assert_allclose(told + wide, height + half_width)
    sure = half_width <= DOUBT_M
    np.testing.assert_array_equal(told[sure], height[sure])
    assert told.min() >= height.min() - TRENCH_DEPTH


@given(height=heights)
@settings(max_examples=50, deadline=None)
def test_sure_ground_is_told_as_it_is(height: np.ndarray) -> None:
    told, wide = deepen_shadows(height, np.full(LINE.size, SURE), LINE)
    np.testing.assert_array_equal(told, height)
    np.testing.assert_array_equal(wide, SURE)


@given(
    depth=st.floats(0.08, 0.3),
    begin=st.floats(-0.3, 0.2),
    length=lengths,
    up=st.floats(-0.04, RISES_M - 0.01),
)
@settings(max_examples=100, deadline=None)
def test_a_trench_whose_ground_nobody_saw_is_as_deep_as_those_of_trainings(
    depth: float, begin: float, length: float, up: float
) -> None:
    height, half_width = course(depth, begin, length, up)
    told, _ = deepen_shadows(height, half_width, LINE)
    inside = half_width == DOUBTFUL
    fallen = inside & (height < BASE_M - FALL_M)
    assert fallen.any()
    np.testing.assert_allclose(told[fallen], BASE_M - TRENCH_DEPTH)
    lead = inside & (X[fallen][0] - LEAD_M + 1e-9 < X)
    np.testing.assert_allclose(told[lead], BASE_M - TRENCH_DEPTH)
    np.testing.assert_array_equal(told[~inside], height[~inside])


@given(
    depth=st.floats(0.04, 0.3),
    begin=st.floats(-0.3, 0.2),
    length=lengths,
    rise=st.floats(RISES_M + 0.01, 0.5),
)
@settings(max_examples=50, deadline=None)
def test_a_dip_before_the_next_tread_of_stairs_that_lead_up_is_told_as_it_is(
    depth: float, begin: float, length: float, rise: float
) -> None:
    height, half_width = course(depth, begin, length, rise)
    np.testing.assert_array_equal(deepen_shadows(height, half_width, LINE)[0], height)


@given(begin=st.floats(-0.3, 0.2), length=lengths, down=st.floats(0.08, 0.5))
@settings(max_examples=100, deadline=None)
def test_steps_down_are_as_deep_as_the_ground_that_is_seen_below(
    begin: float, length: float, down: float
) -> None:
    assert down > LEVEL_M
    height, half_width = course(down, begin, length, -down)
    told, _ = deepen_shadows(height, half_width, LINE)
    fallen = (half_width == DOUBTFUL) & (height < BASE_M - FALL_M)
    np.testing.assert_allclose(told[fallen], BASE_M - down)


@given(begin=st.floats(-0.3, 0.2), length=lengths, rise=st.floats(0.0, 0.5))
@settings(max_examples=50, deadline=None)
def test_ground_that_leads_up_is_told_as_it_is(begin: float, length: float, rise: float) -> None:
    height, half_width = course(-rise, begin, length, rise)
    np.testing.assert_array_equal(deepen_shadows(height, half_width, LINE)[0], height)


@pytest.mark.parametrize("grid", [SCAN, HeightGrid(x=LINE.x, y=(-0.2, 0.0, 0.3))])
def test_columns_of_a_grid_know_nothing_of_each_other(grid: HeightGrid) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        height, half_width = rng.uniform(-0.6, 0.2, grid.size), rng.uniform(0.005, 0.06, grid.size)
        told, wide = (part.reshape(grid.shape) for part in deepen_shadows(height, half_width, grid))
        for column in range(len(grid.y)):
            line = HeightGrid(x=grid.x)
            one = (part.reshape(grid.shape)[:, column] for part in (height, half_width))
            np.testing.assert_array_equal(
                (told[:, column], wide[:, column]), deepen_shadows(*one, line)
            )
