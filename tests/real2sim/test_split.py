import numpy as np
import pytest
from linear_problem import LinearProblem
from one_joint import OneJoint

from saltus.real2sim.search.residual_split import TEST, ResidualCells, split_residuals


def test_one_of_repeats_is_the_test_late_and_early_in_turn() -> None:
    problem = LinearProblem({})
    parts = split_residuals(
        problem, problem.residuals(np.zeros((1, 2, len(problem.candidates))))[0]
    )
    assert sorted(set(parts.segment[parts.fold == TEST])) == [1, 2, 5]
    assert sorted(set(parts.segment[parts.fold != TEST])) == [0, 3, 4]


def test_amplitudes_are_each_in_fit_and_test() -> None:
    problem = OneJoint({("viscous_friction", "hip", "FR"): (0.3,)})
    residuals = np.ones((2, len(problem.time_s)))
    residuals[:, problem.segment == 1] *= 4.0  # the large chirp
    parts = split_residuals(problem, residuals)
    for segment in (0, 1):
        folds = parts.fold[parts.segment == segment]
        assert (folds == TEST).any() == (folds != TEST).any()


def test_every_residual_is_in_one_chunk_of_its_own_segment() -> None:
    problem = OneJoint({})
    parts = split_residuals(problem, np.ones((2, len(problem.time_s))))
    assert np.array_equal(parts.segment[parts.chunk], problem.segment)
    for chunk in range(len(parts.fold)):
        assert np.ptp(problem.time_s[parts.chunk == chunk]) < 1.01


def test_folds_are_segments_or_pieces_that_do_not_mix() -> None:
    problem = OneJoint({})
    parts = split_residuals(problem, np.ones((2, len(problem.time_s))))
    for fold in parts.folds:
        assert len(set(parts.segment[parts.fold == fold])) == 1


def test_the_test_is_not_the_same_part_of_every_segment() -> None:
    problem = OneJoint({("viscous_friction", "hip", "FR"): (0.3,)})
    residuals = np.ones((2, len(problem.time_s)))
    residuals[:, problem.segment == 1] *= 4.0  # chirps of two amplitudes: each is cut
    parts = split_residuals(problem, residuals)
    held_out = []
    for segment in (0, 1):
        rows = problem.segment == segment
        start = problem.time_s[rows].min()
        held_out.append(np.round(np.unique(problem.time_s[rows & ~parts.is_fit]) - start, 3))
    assert not np.intersect1d(*held_out).size


def test_a_piece_in_which_nothing_is_known_is_no_test() -> None:
    problem = OneJoint({("viscous_friction", "hip", "FR"): (0.3,)})
    one = problem.segment == 1
    problem.segment = np.where(one, 0, -1)
    since = problem.time_s - problem.time_s[one].min()
    for known_s in (1.6, 2.0, 3.0, 4.0):
        residuals = np.where(one & (since < known_s), 1.0, 0.0) * np.ones((2, 1))
        parts = split_residuals(problem, residuals)
        test = one & ~parts.is_fit
        assert residuals[:, test].any()
        assert residuals[:, one & parts.is_fit].any()


def cells_of(rows: int) -> ResidualCells:
    """20,000 cells of so many rows."""
    starts = np.arange(0, 20_000 * rows, rows)
    return ResidualCells(
        rows=np.arange(20_000 * rows),
        starts=starts,
        segment=np.zeros_like(starts),
        signal=np.arange(len(starts)),
    )


@pytest.mark.parametrize("rows", [1, 2, 3, 6, 9, 10, 60])
def test_cells_of_any_number_of_rows_hardly_ever_show_what_is_noise(rows: int) -> None:
    """Nine of a thousand at most, of one row; the test of a body has hundreds of six rows."""
    cells = cells_of(rows)
    structure = cells.structure(np.random.default_rng(rows).normal(size=20_000 * rows))
    assert np.mean(cells.shows(structure, 0.0)) < 0.011
    assert np.mean(cells.rms(structure) > 0.0) < 0.011


@pytest.mark.parametrize("rows", [1, 2, 3, 6, 9])
def test_what_chance_leaves_in_cells_of_few_rows_is_no_gap(rows: int) -> None:
    cells, rng = cells_of(rows), np.random.default_rng(rows)
    after = cells.structure(rng.normal(size=20_000 * rows))
    shares = [
        cells.share_gone(np.full(20_000, 30.0), after, np.arange(20_000) == one)
        for one in range(1000)
    ]
    assert np.mean(np.array(shares) < 1.0) < 0.015
    assert cells.share_gone(np.full(20_000, 30.0), after + 15.0, after >= 0.0) < 0.8
    just = np.full(20_000, 4.01 * np.sqrt(2.0 / rows))  # structure that just shows
    assert cells.share_gone(just, 0.8 * just, just > 0.0) < 0.75
