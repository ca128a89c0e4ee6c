"""Tables that people write: every key of each kind, misspelt,
of a wrong type or no number, is refused in one line.
"""

import copy
import tomllib
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
import tomli_w
from samples import EVERYTHING

from saltus.config import RunConfig, TerrainConfig, from_toml, read_toml, to_toml, with_changes
from saltus.depth_camera import DepthCamera, load_camera
from saltus.effects.profile import Profile
from saltus.errors import SaltusError
from saltus.grid import HeightGrid
from saltus.heightmap.settings import PredictorTraining as HeightmapTrainConfig
from saltus.policy.env.settings import for_gpu
from saltus.robots.shipped import SUPPLEMENT_FILE, shipped_folder
from saltus.robots.supplement import RobotSupplement
from saltus.terrain.curriculum import make_terrain
from saltus.terrain.terrain import Terrain

Path = tuple[str | int, ...]
RUN = RunConfig(
    robot="go1",
    grid="line",
    terrain=TerrainConfig(terrain="gap", gap_m=0.5),
    policy_model="a",
    heightmap_model="b",
)
TABLES: dict[str, tuple[str, Callable[[str], Any]]] = {
    "run": (to_toml(RUN), partial(from_toml, RunConfig)),
    "profile": (EVERYTHING.to_toml(), Profile.from_toml),
    "camera": (load_camera("d435i").to_toml(), DepthCamera.from_toml),
    "terrain": (make_terrain(TerrainConfig(terrain="gap")).to_toml(), Terrain.from_toml),
    "grid": (HeightGrid(x=(-0.1, 0.1)).to_toml(), HeightGrid.from_toml),
    "robot": (
        (shipped_folder("go1") / SUPPLEMENT_FILE).read_text(),
        partial(from_toml, RobotSupplement),
    ),
    "training of policies": (
        to_toml(for_gpu("go1", "line")),
        lambda text: with_changes(for_gpu("go1", "line"), read_toml(text)),
    ),
    "training of heights": (
        to_toml(HeightmapTrainConfig()),
        partial(from_toml, HeightmapTrainConfig),
    ),
}
FREE = {"terrain": {"params"}}
"""What may have any name."""


def paths(value: Any, where: Path = ()) -> Iterator[Path]:
    """Of all tables, lists of tables and values within."""
    pairs = (
        value.items() if isinstance(value, dict) else enumerate(value) if is_tables(value) else ()
    )
    for key, part in pairs:
        yield (*where, key)
        yield from paths(part, (*where, key))


def is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict)


def part_at(table: Any, path: Path) -> Any:
    for key in path:
        table = table[key]
    return table


CASES = [(kind, path) for kind, (text, _) in TABLES.items() for path in paths(tomllib.loads(text))]


def shown(case: Any) -> str:
    return case if isinstance(case, str) else ".".join(map(str, case))


@pytest.mark.parametrize("kind", TABLES)
def test_as_it_is_it_is_taken(kind: str) -> None:
    text, read = TABLES[kind]
    read(text)


@pytest.mark.parametrize(("kind", "path"), CASES, ids=shown)
def test_what_is_wrong_is_refused_by_its_name(kind: str, path: Path) -> None:
    text, read = TABLES[kind]
    table, key = tomllib.loads(text), path[-1]
    value = part_at(table, path)
    wrong: list[Any] = [
        "much" if not isinstance(value, str) else 7,
        {"much": 1} if not isinstance(value, dict) else 3,
    ]
    if isinstance(value, float):
        wrong.append(float("nan"))
    for other in wrong:
        bad = copy.deepcopy(table)
        part_at(bad, path[:-1])[key] = other
        refused(read, bad, str(key))
    if isinstance(key, str) and path[0] not in FREE.get(kind, ()):
        misspelt = copy.deepcopy(table)
        around = part_at(misspelt, path[:-1])
        around[f"{key}x"] = around.pop(key)
        refused(read, misspelt, key)  # what is there, or what is lacking instead


def refused(read: Callable[[str], Any], table: dict[str, Any], name: str) -> None:
    with pytest.raises(SaltusError) as error:
        read(tomli_w.dumps(table))
    assert "\n" not in str(error.value)
    assert name in str(error.value)
