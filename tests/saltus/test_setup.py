"""Robot and grid come in as values: the command line names them,
and nobody below it has any of its own.
"""

import ast
from dataclasses import fields, replace
from pathlib import Path

import pytest

from saltus.config import RunConfig, TerrainConfig
from saltus.errors import ConfigError
from saltus.grid import HeightGrid
from saltus.named_setup import named_setup
from saltus.setup import Setup
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Trial

ROOT = Path(__file__).parents[2]
ROOMS = ("saltus", "render", "heightmap", "policy", "controller", "real2sim")
MAY = ("saltus/cli/", "saltus/robots/", "saltus/grid.py")
DEFAULTS = {"DEFAULT_ROBOT", "LINE", "HEIGHTMAP_X"}


def defaults_in(source: str) -> set[str]:
    """Names of default robots and grids that a module reads."""
    tree = ast.parse(source)
    imported = {
        name.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }
    read = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    return DEFAULTS & (imported | read)


@pytest.mark.parametrize("room", ROOMS)
def test_no_module_below_the_command_line_has_a_default_robot_or_grid(room: str) -> None:
    files = {str(path.relative_to(ROOT)): path for path in sorted((ROOT / room).rglob("*.py"))}
    if room == "saltus":  # it links to the other rooms
        files = {
            name: path
            for name, path in files.items()
            if not any(p.is_symlink() for p in path.parents)
        }
    found = {name for name, path in files.items() if defaults_in(path.read_text(encoding="utf-8"))}
    assert not {name for name in found if not name.startswith(MAY)}


@pytest.mark.parametrize("camera", ["ideal", "d435i", str(ROOT / "examples/camera.toml")])
@pytest.mark.parametrize("robot", ["go1", str(ROOT / "saltus/robots/go1")])
@pytest.mark.parametrize("terrain", ["flat", "stepping_stones"])
def test_a_setup_reads_back_equal_and_its_fingerprint_tells_it_from_others(
    robot: str, terrain: str, camera: str
) -> None:
    run = RunConfig(
        robot=robot, grid="line", terrain=TerrainConfig(terrain=terrain), camera=camera, seed=5
    )
    setup = named_setup(run)
    assert Setup.from_toml(setup.to_toml()) == setup
    others = {
        "robot": replace(setup.robot, trunk_mass=setup.robot.trunk_mass + 0.1),
        "grid": HeightGrid(x=setup.grid.x, y=(-0.1, 0.1)),
        "terrain": make_terrain(TerrainConfig(terrain="gap")),
        "profile": setup.profile.without("camera_latency"),
        "camera": replace(setup.camera, rate_hz=41.0),
        "trial": Trial.draw(6),
    }
    assert others.keys() == {f.name for f in fields(Setup)}
    changed = [replace(setup, **{name: value}) for name, value in others.items()]
    assert len({setup.fingerprint, *(other.fingerprint for other in changed)}) == 1 + len(others)
    assert all(Setup.from_toml(other.to_toml()) == other != setup for other in changed)


def test_a_damaged_setup_is_told_by_its_table() -> None:
    text = named_setup(RunConfig(robot="go1", grid="line")).to_toml()
    for damaged, said in (
        (text.replace("[grid]", "[gird]"), "it has the tables .*gird"),
        (text.replace("payload_kg", "payload"), r"\[trial\] unknown key 'payload'"),
    ):
        with pytest.raises(ConfigError, match=said):
            Setup.from_toml(damaged)
