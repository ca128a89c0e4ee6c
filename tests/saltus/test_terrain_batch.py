import numpy as np
import pytest
import torch

from saltus.terrain import level
from saltus.terrain.course_batch import BOXES, COLUMNS, DITCH_M, DRAWS, REPEATS, draw_courses
from saltus.terrain.course_law import DESCENDING, HURDLE_M, IRREGULAR_RUN_M, KINDS
from saltus.terrain.curriculum import FAMILIES
from saltus.terrain.terrain import TRENCH_DEPTH, WIDTH

N = 400


def courses(difficulty=None, seed=0, xp=np):
    rng = np.random.default_rng(seed)
    kind = np.arange(N) % len(KINDS)
    d = rng.uniform(size=N) if difficulty is None else np.full(N, difficulty)
    draws = rng.uniform(size=(N, DRAWS.count))
    if xp is torch:
        return kind, d, draw_courses(*(torch.as_tensor(a) for a in (kind, d, draws)))
    return kind, d, draw_courses(kind, d, draws)


def test_heights_are_the_tops_of_the_boxes():
    _, _, course = courses()
    x = -3.0 + np.random.default_rng(1).uniform(size=(N, 50)) * (course.finish_x[:, None] + 7.0)
    center, half = course.boxes().center, course.boxes().half_size
    assert center.shape == half.shape == (N, BOXES, 3)
    inside = np.abs(x[..., None] - center[:, None, :, 0]) <= half[:, None, :, 0]
    tops = np.where(inside, center[:, None, :, 2] + half[:, None, :, 2], -np.inf)
    np.testing.assert_allclose(course.height_at(x, 0.0 * x), tops.max(-1), atol=1e-12)
    assert (half > 0.0).all()
    assert (half[..., 1] == 0.5 * WIDTH).all()


@pytest.mark.parametrize("difficulty", [0.0, 0.35, 1.0])
def test_sizes_follow_the_laws_of_difficulty(difficulty):
    kind, _, course = courses(difficulty)
    sizes = {"stairs": "rise_m", "step": "height_m", "stepping_stones": "gap_m", "gap": "gap_m"}
    for name, size in sizes.items():
        rows = kind == KINDS.index(name)
        law = FAMILIES[name].sizes[size]
        expected = (law.base or 0.0) + law.slope * difficulty
        rise = course.top[rows, 1] - course.top[rows, 0]
        gap = course.low[rows, 1] - course.high[rows, 0]
        found = rise if size in ("rise_m", "height_m") else gap
        other = gap if size in ("rise_m", "height_m") else rise
        np.testing.assert_allclose(other, 0.0, atol=1e-12)
        if name == "stepping_stones":  # half of the courses have gaps that differ
            assert (found <= expected + 1e-12).all()
            assert (np.abs(found - expected) < 1e-12).mean() > 0.3
        else:
            np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_course_ends_on_level_ground_behind_its_last_edge():
    kind, _, course = courses()
    after = course.finish_x[:, None] + np.linspace(-0.9, 4.0, 40)
    heights = course.height_at(after, 0.0 * after)
    assert np.ptp(heights, axis=1).max() == 0.0
    assert (
        heights[np.isin(kind, [KINDS.index(name) for name in DESCENDING], invert=True)] >= 0.0
    ).all()
    before, all_along = (
        np.linspace(*ends, 500) + np.zeros((N, 1)) for ends in ((-1.0, 0.5), (0.0, 6.0))
    )
    assert (course.height_at(before, 0.0 * before) == 0.0).all()
    assert (course.height_at(all_along, 0.0 * all_along)[kind == 4] >= -TRENCH_DEPTH).all()


def test_torch_and_numpy_make_the_same_courses():
    _, _, a = courses(seed=3)
    _, _, b = courses(seed=3, xp=torch)
    for name in ("low", "high", "top", "finish_x", "slope", "floor"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name).numpy(), atol=1e-12)
    assert a.low.shape == (N, COLUMNS)


class Draws:
    """A generator that draws what a course of a batch was drawn from."""

    def __init__(self, draws):
        self._draws = draws

    def uniform(self, size):
        return self._draws[:size]


STEPS = {
    kind: count // {"pyramid": 2, "hurdles": 2}.get(kind, 1) for kind, count in REPEATS.items()
}
STEPS["stepping_stones"] -= 1  # the last column is the ground behind the stones


@pytest.mark.parametrize("kind", KINDS[1:])
def test_a_course_of_a_batch_equals_the_single_course_of_its_sizes(kind):
    """But for where it begins and ends.

    Stones of one gap and of gaps that differ, stairs that lead down and up.
    """
    rng = np.random.default_rng(5)
    difficulty, draws = rng.uniform(size=12), rng.uniform(size=(12, DRAWS.count))
    course = draw_courses(np.full(12, KINDS.index(kind)), difficulty, draws)
    way = rng.uniform(-0.5, 20.0, 300)
    for i, d in enumerate(difficulty):
        sizes = {
            n: s.base + s.slope * d for n, s in FAMILIES[kind].sizes.items() if s.base is not None
        }
        if kind == "irregular":
            sizes["rise_m"] *= np.sign(course.top[i, 1])
        if kind == "stepping_stones" and draws[i, 2] < 0.5:
            sizes |= {"gap_m": 0.2 * sizes["gap_m"], "gap_max_m": sizes["gap_m"]}
        if kind == "ditch":
            sizes["depth_m"] = -course.floor[i]
        length = course.high[i, 2] - course.low[i, 2]
        single = level.make(kind, Draws(draws[i, 9:]), **sizes, steps=STEPS[kind], run_m=length)
        start = course.high[i, 0]
        ahead = way[way < course.finish_x[i] - start]
        heights = course.height_at((start + ahead)[None] + np.zeros((12, 1)), 0.0)[i]
        np.testing.assert_allclose(heights, single.height_at(1.5 + ahead, 0.0), atol=1e-12)
        behind = {"step": 1.0, "step_down": 1.0, "gap": 1.0, "ditch": 1.0}.get(kind, 0.5)
        assert course.finish_x[i] - start - 1.0 == pytest.approx(single.finish_x - 1.5 - behind)


def test_kinds_that_lead_down_hurdles_and_ditches():
    kind, difficulty, course = courses(seed=7)

    def of(name):
        return kind == KINDS.index(name)

    used = course.top > -40.0
    step = np.where(used[:, 1:], course.top[:, 1:] - course.top[:, :-1], 0.0)
    last = np.where(used, course.top, np.inf)[np.arange(N), used.sum(1) - 1]
    run = np.where(used[:, 1:], course.high[:, 1:] - course.low[:, 1:], np.nan)
    law = {"stairs_down": -0.05 - 0.2 * difficulty, "step_down": -0.8 * difficulty}
    for name, rise in law.items():
        first = step[of(name)][:, :3]
        np.testing.assert_allclose(first, rise[of(name), None] + 0.0 * first, atol=1e-12)
    np.testing.assert_allclose(last[of("pyramid")], 0.0, atol=1e-12)
    np.testing.assert_allclose(
        course.top[of("pyramid")].max(1), 8.0 * (0.05 + 0.2 * difficulty[of("pyramid")])
    )
    rises, runs = step[of("irregular")][:, :16], run[of("irregular")][:, :15]
    assert (np.sign(rises) == np.sign(rises[:, :1])).all()
    assert set(np.sign(rises[:, 0])) == {-1.0, 1.0}
    assert (np.ptp(np.abs(rises), axis=1) > 0.1 * np.abs(rises).max(1)).all()
    low, high = IRREGULAR_RUN_M
    assert low <= runs.min() < low + 0.01 < high - 0.01 < runs.max() <= high
    assert (np.ptp(runs, axis=1) > 0.05).all()
    sizes = np.abs(rises[:, :15]) / np.abs(rises).max(1, keepdims=True)
    assert abs(np.corrcoef(sizes.ravel(), runs.ravel())[0, 1]) < 0.15
    np.testing.assert_allclose(run[of("hurdles")][:, [0, 2, 4, 6]], HURDLE_M)
    np.testing.assert_allclose(last[of("hurdles")], 0.0, atol=1e-12)
    depth = -course.floor[of("ditch")]
    assert DITCH_M[0] <= depth.min() < 0.2
    assert 0.8 < depth.max() <= DITCH_M[1]
    lowest = np.where(used, course.top, 0.0).min(1)
    np.testing.assert_allclose((course.floor - lowest)[~of("ditch")], -TRENCH_DEPTH)
