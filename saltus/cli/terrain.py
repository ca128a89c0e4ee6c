"""`saltus terrain`: what a terrain looks like."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from saltus.cli.output import JsonOption, print_figures, run_directory
from saltus.config import TerrainConfig
from saltus.flags import flag_help


@dataclass(frozen=True, kw_only=True)
class TerrainCommand(JsonOption):
    """Draws a terrain from above; prints its size.

    For example:
      saltus terrain show house --layout-seed 3
      saltus terrain show examples/course.toml
    """

    action: tyro.conf.Positional[Literal["show"]]
    """The command to run."""
    terrain: tyro.conf.Positional[str]
    """A family, a course that Saltus ships (house, quarry, yard, plain, rubble, stones,
    flight, edges), or a TOML file with boxes or segments."""
    difficulty: Annotated[float | None, flag_help("FLOAT", "its default sizes, or drawn ones")] = (
        None
    )
    """From 0 to 1."""
    layout_seed: int = 0
    """Seed of what is drawn."""
    out: Annotated[Path | None, flag_help("PATH", "a new one, runs/DATE-terrain")] = None
    """Folder for terrain.png, and for terrain.toml, the terrain as boxes."""

    def run(self) -> int:
        """Writes the drawing and the boxes into `out`, and prints; 0."""
        from saltus.render.terrain_plot import draw_terrain
        from saltus.terrain.curriculum import make_terrain

        config = TerrainConfig(
            terrain=self.terrain, difficulty=self.difficulty, layout_seed=self.layout_seed
        )
        terrain = make_terrain(config)
        folder = run_directory("terrain", self.out)
        (folder / "terrain.toml").write_text(
            replace(terrain, params={}).to_toml(), encoding="utf-8"
        )
        draw_terrain(terrain, folder / "terrain.png")
        boxes = terrain.arrays
        table = {
            "kind": terrain.kind,
            "boxes": len(terrain.boxes),
            "highest_m": float((boxes.center + boxes.extent)[:, 2].max()),
            "finish_x_m": terrain.finish_x,
            "picture": str(folder / "terrain.png"),
        }
        print_figures(table)
        self.tell_json(table)
        return 0
