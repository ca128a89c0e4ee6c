"""`saltus camera`: what a depth camera is and sees, and what holds it."""

import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from saltus.cli.output import JsonOption, print_figures, run_directory
from saltus.cli.run_options import CourseOptions, RobotOption, SizedCourse, mounted_camera
from saltus.flags import CommandGroup, Subcommands, flag_help
from saltus.grid import DEFAULT_GRID, load_grid
from saltus.robots.loading import load_robot


@dataclass(frozen=True, kw_only=True)
class ShowCamera(RobotOption, JsonOption):
    """Draws what a camera sees from a robot that stands, and from beside it.

    Prints where it sits and what it is.

    For example:
      saltus camera show
      saltus camera show examples/camera.toml --terrain stairs --rise-m 0.1
    """

    camera: tyro.conf.Positional[str] = "d435i"
    """Name, ideal, d435i or d435i_whole, or a TOML file."""
    course: CourseOptions = field(default_factory=SizedCourse)
    out: Annotated[Path | None, flag_help("PATH", "a new one, runs/DATE-camera")] = None
    """Folder for camera.html, and for camera.toml, which says all of it."""

    def run(self) -> int:
        """Writes the drawing into `out`, and prints; 1 where no point of the heightmap is seen."""
        from saltus.render.camera_plot import draw_camera
        from saltus.terrain.curriculum import make_terrain

        camera, robot = mounted_camera(self.camera, load_robot(self.robot))
        terrain, grid = make_terrain(self.course), load_grid(DEFAULT_GRID)
        folder = run_directory("camera", self.out)
        page = folder / "camera.html"
        (folder / "camera.toml").write_text(camera.to_toml(), encoding="utf-8")
        coverage = draw_camera(robot, grid, terrain, camera, page)
        image = camera.image
        sides = ((image.width, image.fx), (image.height, image.fy))
        table: dict[str, object] = {
            "name": camera.name,
            "position_m": coverage.position.tolist(),
            "pitch_deg": math.degrees(coverage.pitch),
            "pixels": [image.width, image.height],
            "field_of_view_deg": [
                2.0 * math.degrees(math.atan(0.5 * side / focal)) for side, focal in sides
            ],
            "rate_hz": camera.rate_hz,
            "latency_s": camera.latency_s,
            "range_m": camera.range_m,
            "ideal": camera.ideal,
            "network_view_covered": coverage.covered,
            "network_image_invalid": coverage.invalid,
            "points_in_view_m": grid.points[coverage.visible, 0].tolist(),
            "page": str(page),
        }
        print_figures(table)
        self.tell_json(table)
        if coverage.visible.any():
            return 0
        print(
            f"saltus: this camera sees none of the {grid.size} points of the heightmap, from "
            f"{grid.x[0]:g} "
            f"to {grid.x[-1]:g} m ahead: does it look down, and wide enough? camera_pitch is "
            f"{coverage.pitch:.3g} rad, positive where it looks down; {page} shows its view",
            file=sys.stderr,
        )
        return 1


@dataclass(frozen=True, kw_only=True)
class MakeMount(RobotOption):
    """Makes a bracket that holds a D435i where a robot has its camera.

    Writes bracket.stl, to be printed, and bracket.svg, with its dimensions.

    For example:
      saltus camera mount --robot go2
      saltus camera mount mine.toml --robot go2 --out runs/bracket
    """

    camera: tyro.conf.Positional[str] = "d435i"
    """Name, or a TOML file that says where the camera sits."""
    out: Annotated[Path | None, flag_help("PATH", "a new one, runs/DATE-camera-mount")] = None
    """Folder for both files."""

    def run(self) -> int:
        """Writes both and says where the camera's lens will be; 0."""
        from saltus.render.bracket import MM, Bracket
        from saltus.render.bracket_drawing import bracket_svg

        _, robot = mounted_camera(self.camera, load_robot(self.robot))
        bracket = Bracket(robot=robot)
        folder = run_directory("camera-mount", self.out)
        bracket.mesh().export(folder / "bracket.stl")
        (folder / "bracket.svg").write_text(bracket_svg(bracket), encoding="utf-8")
        ahead, _, above = MM * robot.camera_position
        print(
            f"left imager {ahead - bracket.front:.1f} mm ahead of the trunk's front and "
            f"{above - bracket.top:.1f} mm above its top, {math.degrees(robot.camera_pitch):.1f} "
            "degrees nose down"
        )
        print(f"{folder}: bracket.stl, bracket.svg")
        return 0


@dataclass(frozen=True, kw_only=True)
class CameraCommands(CommandGroup):
    """Depth cameras: show, mount."""

    command: Subcommands[
        Annotated[ShowCamera, tyro.conf.subcommand("show")]
        | Annotated[MakeMount, tyro.conf.subcommand("mount")]
    ]
