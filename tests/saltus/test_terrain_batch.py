import numpy as np
import pytest
import torch

from saltus.terrain.batch import (
    BOXES,
    COLUMNS,
    DESCENDING,
    DITCH_M,
    DRAWS,
    HURDLE_M,
    IRREGULAR_RUN_M,
    KINDS,
    draw_courses,
)
from saltus.terrain.boxes import Box
from saltus.terrain.curriculum import FAMILIES
from saltus.terrain.terrain import TRENCH_DEPTH, WIDTH, Terrain

N = 400


def courses(difficulty=None, seed=0, xp=np):
    rng = np.random.default_rng(seed)
    kind = np.arange(N) % len(KINDS)
    d = rng.uniform(size=N) if difficulty is None else np.full(N, difficulty)
    draws = rng.uniform(size=(N, DRAWS))
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
    assert (heights[np.isin(kind, [KINDS.index(name) for name in DESCENDING], invert=True)] >= 0.0).all()
    before, all_along = (np.linspace(*ends, 500) + np.zeros((N, 1)) for ends in ((-1.0, 0.5), (0.0, 6.0)))
    assert (course.height_at(before, 0.0 * before) == 0.0).all()
    assert (course.height_at(all_along, 0.0 * all_along)[kind == 4] >= -TRENCH_DEPTH).all()


def test_torch_and_numpy_make_the_same_courses():
    _, _, a = courses(seed=3)
    _, _, b = courses(seed=3, xp=torch)
    for name in ("low", "high", "top", "finish_x", "slope", "floor"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name).numpy(), atol=1e-12)
    assert a.low.shape == (N, COLUMNS)


def as_terrain(course, i):
    """The same ground as columns side by side: the trenches between them are columns too."""
    used = np.flatnonzero(course.top[i] > -40.0)
    ends, tops = [float(course.low[i, 0])], []
    for k in used:
        if course.low[i, k] > ends[-1] + 1e-9:
            ends.append(float(course.low[i, k]))
            tops.append(float(course.floor[i]))
        ends.append(float(course.high[i, k]))
        tops.append(float(course.top[i, k]))
    half, columns = 0.5 * WIDTH, zip(ends[:-1], ends[1:], tops, strict=True)
    boxes = tuple(Box(low=(low, -half, -9.0), high=(high, half, top)) for low, high, top in columns)
    return Terrain(kind="course", params={}, boxes=boxes, finish_x=float(course.finish_x[i]))


def test_each_course_is_as_high_as_the_exact_terrain_of_its_columns():
    kind, _, course = courses(seed=5)
    rng = np.random.default_rng(6)
    x = rng.uniform(-1.0, course.finish_x[:, None] + 2.0, (N, 60))
    heights = course.height_at(x, 0.0 * x)
    for i in range(0, N, 7):
        terrain = as_terrain(course, i)
        assert terrain.columns is not None, KINDS[kind[i]]
        np.testing.assert_allclose(heights[i], terrain.height_at(x[i], 0.0 * x[i]), atol=1e-12)


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
    np.testing.assert_allclose(course.top[of("pyramid")].max(1), 8.0 * (0.05 + 0.2 * difficulty[of("pyramid")]))
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
