"""Ground that is the same to the side, on maps of which a camera showed a part."""

import numpy as np
import pytest

from saltus.heightmap.scan.prism import LARGEST_SPREAD_M, Prism

SIDE, CELL_M = 128, 0.02
ROWS, COLUMNS = np.mgrid[:SIDE, :SIDE].astype(np.float64)
CENTRE = 0.5 * (SIDE - 1)


def ahead(turned: float) -> np.ndarray:
    """Distance of each cell from the middle along a direction [m]."""
    way = np.cos(turned) * (ROWS - CENTRE) + np.sin(turned) * (COLUMNS - CENTRE)
    return np.asarray(CELL_M * way)


def strip(turned: float, width_m: float) -> np.ndarray:
    """Cells that a camera sees that looks along a direction."""
    aside = -np.sin(turned) * (ROWS - CENTRE) + np.cos(turned) * (COLUMNS - CENTRE)
    return np.asarray(np.abs(CELL_M * aside) < 0.5 * width_m)


PROFILES = {
    "stairs": lambda x: 0.2 * np.floor(x / 0.25),
    "stairs down": lambda x: -0.15 * np.floor(x / 0.3),
    "step": lambda x: np.where(x > 0.2, 0.5, 0.0),
    "stones": lambda x: np.where(x % 0.8 < 0.5, 0.0, -0.4),
}


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("looks", [-0.3, 0.0, 0.2])
@pytest.mark.parametrize("turned", np.linspace(-3.0, 3.0, 7))
def test_ground_that_is_the_same_to_the_side_is_told_where_nobody_saw_it(
    profile: str, turned: float, looks: float
) -> None:
    rng = np.random.default_rng(7)
    true = PROFILES[profile](ahead(turned))
    told = true + rng.normal(0.0, 0.004, true.shape)
    seen = strip(turned + looks, 0.6) & (rng.random(true.shape) < 0.98)
    found = Prism.of(told.astype(np.float32), seen)
    assert found is not None
    height, half_width = found.at(np.argwhere(~seen))
    known = np.isfinite(height)
    assert known.mean() > 0.5
    off = np.abs(height - true[~seen])[known]
    assert np.median(off) < 0.006
    assert np.mean(off > 0.03) < 0.2  # within a cell or two of an edge
    assert np.mean(off < half_width[known]) > 0.85


@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_told_of_ground_that_differs_to_the_side(seed: int) -> None:
    """Blocks, and a heap."""
    rng = np.random.default_rng(seed)
    blocks = np.kron(rng.uniform(0.0, 0.15, (16, 16)), np.ones((8, 8)))
    heap = 0.3 * np.exp(-((ROWS - 50) ** 2 + (COLUMNS - 70) ** 2) / 20**2)
    for true in (blocks, heap):
        assert Prism.of(true.astype(np.float32), strip(0.1 * seed, 0.8)) is None


@pytest.mark.parametrize("noise_m", [0.0, 0.3 * LARGEST_SPREAD_M])
@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_ground_without_an_edge_has_no_direction(slope: float, noise_m: float) -> None:
    """Else what nobody saw ahead would be told from the side: there may be a trench."""
    even = slope * ahead(0.4) + np.random.default_rng(3).normal(0.0, noise_m, (SIDE, SIDE))
    assert Prism.of(even.astype(np.float32), strip(0.0, 0.8)) is None


def test_nothing_is_told_beyond_what_was_seen_ahead() -> None:
    true = PROFILES["stairs"](ahead(0.0))
    seen = strip(0.0, 0.6) & (ahead(0.0) < 0.5)
    found = Prism.of(true.astype(np.float32), seen)
    assert found is not None
    height, _ = found.at(np.argwhere(ahead(0.0) > 0.5 + CELL_M))
    assert np.isnan(height).all()


def test_little_that_was_seen_tells_nothing() -> None:
    true = PROFILES["stairs"](ahead(0.0)).astype(np.float32)
    assert Prism.of(true, np.zeros(true.shape, np.bool_)) is None
    assert Prism.of(true, strip(0.0, 0.1)) is None
