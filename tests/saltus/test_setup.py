"""Robot and grid come in as values: the command line names them, and nobody below it has any of its own."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("saltus", "render", "heightmap", "policy", "controller", "real2sim")
MAY = ("saltus/cli/", "saltus/robots/", "saltus/grid.py")
DEFAULTS = {"DEFAULT_ROBOT", "LINE", "HEIGHTMAP_X"}
STILL = {
    "controller/robot/mujoco.py",
    "heightmap/data/closed_loop.py",
    "heightmap/data/columns.py",
    "heightmap/data/delivery.py",
    "heightmap/data/device_heights.py",
    "heightmap/data/device_recording.py",
    "heightmap/data/device_rollouts.py",
    "heightmap/data/export.py",
    "heightmap/data/predicted.py",
    "heightmap/data/rollouts.py",
    "heightmap/data/shards.py",
    "heightmap/evaluation/benchmark/files.py",
    "heightmap/evaluation/benchmark/predictors.py",
    "heightmap/evaluation/benchmark/split.py",
    "heightmap/evaluation/comparison.py",
    "heightmap/evaluation/edges.py",
    "heightmap/evaluation/errors_by.py",
    "heightmap/evaluation/geometric.py",
    "heightmap/evaluation/report_figures.py",
    "heightmap/evaluation/visibility.py",
    "heightmap/scan/training/evaluation.py",
    "heightmap/service/network.py",
    "heightmap/service/service.py",
    "heightmap/training/export.py",
    "heightmap/training/train.py",
    "heightmap/training/validate.py",
    "policy/actor.py",
    "policy/env/episode.py",
    "policy/env/views.py",
    "policy/evaluation/heights.py",
    "policy/evaluation/pictures.py",
    "policy/features.py",
    "policy/planner.py",
    "policy/profile.py",
    "policy/training/export.py",
    "render/camera_plot.py",
    "render/preview.py",
    "saltus/sim/video.py",
}
"""Files in which they still stand: the list only shrinks."""


def defaults_in(source: str) -> set[str]:
    """Names of default robots and grids that a module reads."""
    tree = ast.parse(source)
    imported = {name.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for name in node.names}
    read = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    return DEFAULTS & (imported | read)


@pytest.mark.parametrize("room", ROOMS)
def test_no_module_below_the_command_line_has_a_default_robot_or_grid(room: str) -> None:
    files = {str(path.relative_to(ROOT)): path for path in sorted((ROOT / room).rglob("*.py"))}
    if room == "saltus":  # it links to the other rooms
        files = {name: path for name, path in files.items() if not any(p.is_symlink() for p in path.parents)}
    found = {name for name, path in files.items() if defaults_in(path.read_text(encoding="utf-8"))}
    assert {name for name in found if not name.startswith(MAY)} == {n for n in STILL if n.startswith(f"{room}/")}
