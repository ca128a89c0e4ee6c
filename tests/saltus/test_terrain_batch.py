import dataclasses

import numpy as np
import pytest
import torch

from saltus.terrain.batch import BOXES, COLUMNS, DRAWS, KINDS, Courses, draw_courses
from saltus.terrain.curriculum import TABLE
from saltus.terrain.terrain import TRENCH_DEPTH, WIDTH

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
        law = TABLE[name][size]
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
    assert (heights >= 0.0).all()
    before, all_along = (np.linspace(*ends, 500) + np.zeros((N, 1)) for ends in ((-1.0, 0.5), (0.0, 6.0)))
    assert (course.height_at(before, 0.0 * before) == 0.0).all()
    assert (course.height_at(all_along, 0.0 * all_along)[kind == 4] >= -TRENCH_DEPTH).all()


def test_torch_and_numpy_make_the_same_courses():
    _, _, a = courses(seed=3)
    _, _, b = courses(seed=3, xp=torch)
    for name in ("low", "high", "top", "finish_x", "slope"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name).numpy(), atol=1e-12)
    assert a.low.shape == (N, COLUMNS)


def test_columns_may_be_turned():
    """Each course is then as high as a terrain of the same boxes."""
    rng = np.random.default_rng(4)
    _, _, level = courses()
    turned = dataclasses.replace(level, turn=rng.uniform(-0.5, 0.5, (N, COLUMNS, 2)))
    x, y = rng.uniform(-1.0, 6.0, (N, 20)), rng.uniform(-2.0, 2.0, (N, 20))
    heights = turned.height_at(x, y)
    for i in range(0, N, 40):
        boxes = turned.boxes().of_robot(i)
        np.testing.assert_allclose(heights[i], boxes.height_at(x[i], y[i]), atol=1e-12)
    tensors = (torch.as_tensor(a) for a in (x, y))
    arrays = {f.name: torch.as_tensor(getattr(turned, f.name)) for f in dataclasses.fields(turned)}
    np.testing.assert_allclose(Courses(**arrays).height_at(*tensors).numpy(), heights, atol=1e-9)
    still = dataclasses.replace(level, turn=np.zeros((N, COLUMNS, 2)))
    np.testing.assert_allclose(still.height_at(x, y), level.height_at(x, y), atol=1e-12)
