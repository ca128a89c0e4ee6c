"""Laws of the heights on which a robot jumps that also walks: a line, and the ground beside it."""

import numpy as np
import pytest

from saltus.arrays import Floats
from saltus.errors import ConfigError
from saltus.grid import LINE, SCAN_AND_LINE
from saltus.loop.shadows import DOUBT_M
from saltus.policy.mover import ASIDE_M, HOLE_M, FeetLines
from saltus.terrain.terrain import TRENCH_DEPTH

X, Y = SCAN_AND_LINE.points.T
LINES = FeetLines(SCAN_AND_LINE, LINE)
SIDES = (-ASIDE_M, 0.0, ASIDE_M)


@pytest.mark.parametrize("degrees", [-40.0, -15.0, 0.0, 15.0, 30.0])
@pytest.mark.parametrize("depth", [0.35, 0.6])
def test_a_trench_reaches_as_far_as_under_any_foot(degrees: float, depth: float) -> None:
    turn = np.radians(degrees)

    def ground(x: Floats, y: Floats | float) -> Floats:
        across = x * np.cos(turn) + y * np.sin(turn)
        return np.where((across >= 0.15) & (across < 0.5), -0.3 - depth, -0.3)

    given = np.array(LINE.x)
    deepest = np.min([ground(given, side) for side in SIDES], axis=0)
    np.testing.assert_array_equal(LINES(ground(X, Y)), deepest)


@pytest.mark.parametrize("rise", [-0.25, -0.1, 0.0, 0.2, 0.25])
@pytest.mark.parametrize("degrees", [-40.0, 0.0, 30.0])
def test_stairs_are_those_of_the_middle(rise: float, degrees: float) -> None:
    turn = np.radians(degrees)
    heights = rise * np.floor((X * np.cos(turn) + Y * np.sin(turn)) / 0.28) - 0.3
    on_line = heights[SCAN_AND_LINE.places_of(LINE)]
    assert abs(rise) < HOLE_M
    np.testing.assert_array_equal(LINES(heights), on_line)


@pytest.mark.parametrize("degrees", [-30.0, 0.0, 30.0])
def test_a_trench_whose_ground_an_edge_hides_reaches_as_far_as_if_it_were_seen(
    degrees: float,
) -> None:
    """The network takes it for a dip, and doubts it; where nothing is in doubt, a dip is a dip."""
    turn = np.radians(degrees)
    across = X * np.cos(turn) + Y * np.sin(turn)
    inside = (across >= 0.15) & (across < 0.5)
    dip = np.where(inside, -0.4, -0.3)
    doubt = np.where(inside, 2.0, 0.5) * DOUBT_M
    seen = LINES(np.where(inside, -0.3 - TRENCH_DEPTH, -0.3))
    np.testing.assert_allclose(LINES(dip, doubt), seen)
    np.testing.assert_array_equal(LINES(dip, np.full_like(dip, 0.5 * DOUBT_M)), LINES(dip))


def test_a_line_has_no_ground_beside_it() -> None:
    with pytest.raises(ConfigError, match="y of a height grid"):
        FeetLines(LINE, LINE)
