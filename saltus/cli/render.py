"""`saltus render`: see the camera, fit its noise and its place to a real one,
run the camera process.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from saltus.cli.output import JsonOption, run_directory
from saltus.cli.run_options import CourseOptions, RobotOption, SizedCourse, mounted_camera
from saltus.cli.serve import ServeProcess
from saltus.flags import CommandGroup, Subcommands, flag_help
from saltus.robots.loading import load_robot


@dataclass(frozen=True, kw_only=True)
class Preview(RobotOption):
    """Writes the course from the side and what the camera sees:
    true depth, its effects, the model's image.

    For example:
      saltus render preview --terrain stairs
      saltus render preview --camera examples/camera.toml
    """

    course: CourseOptions = field(default_factory=SizedCourse)
    camera: str = "d435i"
    """d435i: with the errors of a stereo camera. ideal: true depth.

    Or a TOML file, see saltus camera show.
    """
    out: Annotated[Path | None, flag_help("PATH", "a new one, runs/DATE-render-preview")] = None
    """Folder for preview.html."""

    def run(self) -> int:
        """Writes the file and says where it is."""
        from saltus.render.preview import write_preview
        from saltus.terrain.curriculum import make_terrain

        camera, robot = mounted_camera(self.camera, load_robot(self.robot))
        terrain = make_terrain(self.course)
        print(
            write_preview(
                robot, terrain, camera, run_directory("render-preview", self.out) / "preview.html"
            )
        )
        return 0


@dataclass(frozen=True, kw_only=True)
class FitStereo(JsonOption):
    """Estimates the noise of a real stereo camera from a recording of a scene at rest.

    Example: saltus render fit wall.bag
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """A RealSense recording (.bag, .db3) or a recorded run (.mcap), without post-filters."""
    out: Annotated[Path | None, flag_help("PATH", "a new one, runs/DATE-render-fit")] = None
    """Folder for camera.toml, which --camera takes and which says what each parameter rests on,
    and for stereo.html, measurements and model."""

    def run(self) -> int:
        """Writes both files and prints what was found, parameter by parameter."""
        from saltus.render.fit_plot import write_fit_plot
        from saltus.render.stereo_fit import fit_stereo, load_frames

        result = fit_stereo(load_frames(self.recording))
        folder = run_directory("render-fit", self.out)
        (folder / "camera.toml").write_text(result.to_toml(), encoding="utf-8")
        write_fit_plot(result, folder / "stereo.html")
        estimates = vars(result.parameters)
        for name, found in estimates.items():
            print(f"{name:16} {found}")
        print(f"{folder}: camera.toml, stereo.html")
        self.tell_json({name: vars(found) for name, found in estimates.items()})
        return 0


@dataclass(frozen=True, kw_only=True)
class Calibrate(JsonOption):
    """Finds where a camera really sits: its pitch, roll and height,
    from a robot that stands on level, free ground.

    For example:
      saltus record run --run-dir runs/mine --out runs/standing
      saltus render calibrate runs/standing/recording.mcap
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """A recorded run (.mcap) in which the robot stands for a second."""
    out: Annotated[Path | None, flag_help("PATH", "a new one, runs/DATE-render-calibrate")] = None
    """Folder for camera.toml, which --camera takes, and for calibration.html, the ground as claimed
    and as found."""

    def run(self) -> int:
        """Writes both files and prints what was found."""
        from saltus.render.calibrate import calibrate_camera
        from saltus.render.calibrate_plot import place_rows, write_calibration_plot

        found = calibrate_camera(self.recording)
        folder = run_directory("render-calibrate", self.out)
        (folder / "camera.toml").write_text(found.camera.to_toml(), encoding="utf-8")
        write_calibration_plot(found, folder / "calibration.html")
        for row in place_rows(found):
            print(
                f"{row.name:8} {row.found:9.3f} {row.unit:4} +- {row.half_width_90:.3f}, claimed "
                f"{row.claimed:.3f}"
            )
        print(
            f"{100 * found.on_ground:.0f} % of the points of {found.frames} images lie on the "
            "ground"
        )
        print(f"{folder}: camera.toml, calibration.html")
        self.tell_json(
            {row.name: vars(row) for row in place_rows(found)} | {"on_ground": found.on_ground}
        )
        return 0


@dataclass(frozen=True, kw_only=True)
class ServeCamera(ServeProcess):
    """Runs the camera process against a running stack.

    Example: saltus render serve --run-dir runs/one
    """

    module = "saltus.render"


@dataclass(frozen=True, kw_only=True)
class RenderCommands(CommandGroup):
    """The depth camera: preview, fit, calibrate, serve."""

    command: Subcommands[
        Preview
        | Annotated[FitStereo, tyro.conf.subcommand("fit")]
        | Calibrate
        | Annotated[ServeCamera, tyro.conf.subcommand("serve")]
    ]
