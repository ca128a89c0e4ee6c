"""Terrains as they are asked for: sizes by difficulty or by name, drawn ones, files, refusals."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from terrain_families import FAMILY, KINDS, name_of

from saltus.config import TerrainConfig
from saltus.errors import ConfigError
from saltus.recordings.report import course_title
from saltus.terrain import level
from saltus.terrain.curriculum import FAMILIES, is_drawn, make_terrain
from saltus.terrain.terrain import Terrain


@given(st.floats(0.0, 1.0))
@settings(max_examples=50, deadline=None)
def test_difficulty_sets_the_sizes(d: float) -> None:
    made = {kind: make_terrain(TerrainConfig(terrain=kind, difficulty=d)).params for kind in KINDS}
    assert made["stairs"]["rise_m"] == pytest.approx(0.05 + 0.25 * d)
    assert made["stepping_stones"]["gap_m"] == pytest.approx(0.6 * d)
    assert made["stepping_stones"]["stone_m"] == 0.5
    assert made["gap"]["gap_m"] == pytest.approx(0.01 + 1.1 * d)
    for kind in ("step", "step_down"):
        assert made[kind]["height_m"] == pytest.approx(0.8 * d)
    for kind in ("stairs_down", "pyramid", "irregular"):
        assert made[kind]["rise_m"] == pytest.approx(0.05 + 0.2 * d)
    assert made["hurdles"]["height_m"] == pytest.approx(0.3 * d)
    assert made["ditch"]["gap_m"] == made["gap"]["gap_m"]
    assert made["ramp_up"]["slope_deg"] == made["ramp_down"]["slope_deg"] == pytest.approx(30.0 * d)


@pytest.mark.parametrize(
    ("kind", "size"), [(kind, size) for kind in KINDS for size in FAMILIES[kind].sizes]
)
def test_an_explicit_size_wins_and_comes_back_and_is_bounded(kind: str, size: str) -> None:
    law = FAMILIES[kind].sizes[size]
    for value in (law.low, law.high):
        given_size = int(value) if size == "steps" else value
        assert (
            make_terrain(TerrainConfig(terrain=kind, difficulty=0.3, **{size: given_size})).params[
                size
            ]
            == value
        )
    for value in (law.low - 1e-6, law.high + 1e-6, float("nan")):
        with pytest.raises(ConfigError, match=rf"{size} = .*{law.low:g} to {law.high:g}"):
            make_terrain(TerrainConfig(terrain=kind, **{size: value}))


@pytest.mark.parametrize("difficulty", [-0.01, 1.01, float("nan"), float("inf")])
@pytest.mark.parametrize("kind", KINDS)
def test_difficulty_is_bounded(kind: str, difficulty: float) -> None:
    with pytest.raises(ConfigError, match=r"difficulty = .* from 0 to 1"):
        make_terrain(TerrainConfig(terrain=kind, difficulty=difficulty))


@pytest.mark.parametrize("kind", KINDS)
def test_a_size_of_another_terrain_is_an_error(kind: str) -> None:
    for size in {"rise_m", "gap_m", "stone_m", "height_m"} - set(FAMILIES[kind].sizes):
        with pytest.raises(ConfigError, match=rf"{size} = 0.2 has no meaning for terrain '{kind}'"):
            make_terrain(TerrainConfig(terrain=kind, **{size: 0.2}))


def test_drawn_gaps_keep_their_range_and_their_seed() -> None:
    def gaps(seed: int) -> np.ndarray:
        sizes = {"steps": 8, "stone_m": 0.5, "gap_m": 0.1, "gap_max_m": 0.4}
        return np.diff(level.make("stepping_stones", np.random.default_rng(seed), **sizes).edges_x)[
            ::2
        ]

    np.testing.assert_array_equal(gaps(1), gaps(1))
    assert np.all((gaps(1) >= 0.1 - 1e-12) & (gaps(1) <= 0.4 + 1e-12))
    assert len(gaps(1)) == 9
    assert not np.array_equal(gaps(1), gaps(2))
    with pytest.raises(ConfigError, match="at least gap_m"):
        make_terrain(TerrainConfig(terrain="stepping_stones", gap_m=0.4, gap_max_m=0.1))


def test_drawn_depths_of_ditches_keep_their_range_and_their_seed() -> None:
    ditches = [
        TerrainConfig(terrain="ditch", depth_m=0.1, depth_max_m=0.9, layout_seed=seed)
        for seed in range(40)
    ]
    assert all(map(is_drawn, ditches))
    depths = [-make_terrain(ditch).boxes[1].high[2] for ditch in ditches]
    assert 0.1 <= min(depths) < 0.2 < 0.8 < max(depths) <= 0.9
    assert depths == [-make_terrain(ditch).boxes[1].high[2] for ditch in ditches]
    with pytest.raises(ConfigError, match="at least depth_m"):
        make_terrain(TerrainConfig(terrain="ditch", depth_m=0.4, depth_max_m=0.1))


@pytest.mark.parametrize("rise", [0.22, -0.22, 0.1])
def test_irregular_stairs_keep_their_ranges_and_their_seed(rise: float) -> None:
    def stairs(seed: int) -> Terrain:
        return make_terrain(
            TerrainConfig(terrain="irregular", steps=100, rise_m=rise, layout_seed=seed)
        )

    terrain = stairs(1)
    rises = np.diff([box.high[2] for box in terrain.boxes]) / rise
    treads = np.diff(terrain.edges_x)
    assert 0.12 / 0.22 - 1e-9 <= rises.min() < 0.6 < 0.95 < rises.max() <= 1.0
    assert 0.22 - 1e-9 <= treads.min() < 0.23 < 0.39 < treads.max() <= 0.40 + 1e-9
    assert stairs(1) == terrain != stairs(2)


@pytest.mark.parametrize("config", FAMILY, ids=name_of)
def test_a_terrain_that_is_written_to_a_file_is_the_same_terrain(
    config: TerrainConfig, tmp_path: Path
) -> None:
    path = tmp_path / "course.toml"
    path.write_text(make_terrain(config).to_toml())
    assert make_terrain(TerrainConfig(terrain=str(path))) == make_terrain(config)


COURSE = "kind = 'x'\nfinish_x = 1.0\n[[boxes]]\nlow = [-2, -2, -1]\nhigh = [9, 2, 0]\n"


@pytest.mark.parametrize(
    ("text", "flags", "named"),
    [
        (None, {}, "cannot read"),
        ("", {}, "course.toml"),
        (COURSE.replace("finish_x = 1.0", ""), {}, "the key 'finish_x' is missing"),
        (COURSE.replace("low = [-2, -2, -1]", ""), {}, r"the key 'boxes\[0\].low' is missing"),
        (f"{COURSE}pitch = -15", {}, "pitch = -15: it is in radians"),
        (f"{COURSE}yaw = 90", {}, "yaw = 90: it is in radians"),
        (
            COURSE.replace("[-2, -2, -1]", "[-0.4, -2, -1]"),
            {},
            "no ground under the start: .* -0.5 to 0.5 m",
        ),
        (COURSE.replace("[-2, -2, -1]", "[-2, 1, -1]"), {}, "no ground under the start"),
        (COURSE.replace("9, 2", "0.9, 2"), {}, "no ground under the finish: .* 1 to 1.5 m"),
        (COURSE.replace("1.0", "-1.0"), {}, "finish_x = -1 m"),
        (COURSE.replace("2, 0]", "2, 0.5]"), {}, "the ground at the start is 0.5 m high"),
        (COURSE, {"difficulty": 0.5}, "difficulty = 0.5 has no meaning"),
        (COURSE, {"rise_m": 0.1}, "rise_m = 0.1 has no meaning"),
    ],
)
def test_a_file_without_a_course_is_refused(
    text: str | None, flags: dict[str, float], named: str, tmp_path: Path
) -> None:
    path = tmp_path / "course.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=named) as error:
        make_terrain(TerrainConfig(terrain=str(path), **flags))  # type: ignore[arg-type]
    assert "\n" not in str(error.value)
    assert "course.toml" in str(error.value)


def test_a_terrain_that_nobody_knows_is_refused() -> None:
    with pytest.raises(ConfigError, match="did you mean 'stairs'"):
        make_terrain(TerrainConfig(terrain="stiars"))


@pytest.mark.parametrize("kind", KINDS)
def test_a_title_names_each_size_with_its_unit(kind: str) -> None:
    sizes = (
        course_title(make_terrain(TerrainConfig(terrain=kind)))
        .partition(" (")[2]
        .rstrip(")")
        .split(", ")
    )
    assert [size.split()[-1] for size in sizes if size] == [
        {"steps": "steps", "slope_deg": "deg"}.get(name, "m") for name in FAMILIES[kind].sizes
    ]
    assert "_" not in "".join(sizes)
