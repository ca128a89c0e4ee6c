"""Rows are missing only where times do not come back to their line:
not by rounding, jitter or a stall.
"""

import numpy as np
import pytest

from saltus.real2sim.screening.clock_faults import lost_rows
from saltus.recordings.run_log import period_of

ROWS = 3000


def evenly(hz: float, seed: int = 0, share: float = 0.0) -> np.ndarray:
    """Times of rows at a rate, of which a share is lost at random."""
    kept = np.random.default_rng(seed).random(ROWS) >= share
    kept[[0, -1]] = True
    return np.flatnonzero(kept) / hz


@pytest.mark.parametrize(
    "hz", [200, 333, 500, 600, 667, 700, 750, 800, 850, 900, 950, 980, 990, 1000, 1200, 2000]
)
@pytest.mark.parametrize("into_s", [0.0, 3.7e-4])
def test_whole_milliseconds_lose_no_rows(hz: float, into_s: float) -> None:
    time_s = np.floor(1e3 * (evenly(hz) + into_s) + 1e-6) / 1e3
    assert lost_rows(time_s) == (0, 0.0)
    assert period_of(time_s) == pytest.approx(1.0 / hz, rel=0.02)


@pytest.mark.parametrize(
    ("hz", "jitter_s"), [(500, 9e-4), (500, 5e-4), (200, 2e-3), (1000, 4e-4), (100, 4e-3)]
)
@pytest.mark.parametrize("seed", range(3))
def test_jitter_loses_no_rows(hz: float, jitter_s: float, seed: int) -> None:
    late = np.random.default_rng(seed).uniform(-jitter_s, jitter_s, ROWS)
    assert lost_rows(np.sort(evenly(hz) + late))[0] <= 1  # of three thousand, by chance


def test_what_a_stalled_loop_catches_up_with_is_not_lost() -> None:
    time_s = evenly(500)
    for row in range(100, ROWS - 100, 250):  # 8 ms late, and in time again after five rows
        time_s[row : row + 4] = time_s[row + 4] - 1e-4 * np.arange(4, 0, -1)
    assert lost_rows(time_s)[0] == 0


@pytest.mark.parametrize("hz", [200, 500, 1000])
@pytest.mark.parametrize("jitter", [0.0, 0.2])
@pytest.mark.parametrize("share", [0.002, 0.01, 0.03])
def test_lost_rows_are_counted(hz: float, jitter: float, share: float) -> None:
    time_s = evenly(hz, 3, share)
    lost = ROWS - len(time_s)
    noisy = time_s + np.random.default_rng(4).uniform(-jitter, jitter, len(time_s)) / hz
    found, longest_s = lost_rows(noisy)
    # Two that follow each other closely may look like one
    assert found == pytest.approx(lost, rel=0.35, abs=1.5)
    assert longest_s == pytest.approx(np.diff(time_s).max(), abs=0.5 / hz)


@pytest.mark.parametrize("rows", [1, 3, 50, 200])
def test_a_hole_is_as_long_as_it_is(rows: int) -> None:
    time_s = np.delete(evenly(500), np.arange(1000, 1000 + rows))
    assert lost_rows(time_s) == (rows, pytest.approx((rows + 1) / 500))
    assert lost_rows(np.floor(1e3 * time_s + 1e-6) / 1e3)[0] == rows


def test_pauses_between_runs_do_not_change_the_period() -> None:
    runs = [evenly(50)[:120] + 10.0 * number for number in range(20)]
    assert period_of(np.concatenate(runs)) == pytest.approx(0.02)
