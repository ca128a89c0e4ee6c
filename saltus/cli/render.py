"""`saltus render`: see the camera, fit its noise to a real one, run the camera process."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import subcommand

from saltus.cli.output import print_json
from saltus.cli.serve import ServeProcess
from saltus.config import DEFAULT_ROBOT, TerrainConfig
from saltus.errors import SaltusError


@dataclass(frozen=True, kw_only=True)
class Preview:
    """Writes what the camera sees: true depth, its effects one by one, the model's image, a point cloud."""

    course: tyro.conf.OmitArgPrefixes[TerrainConfig] = field(default_factory=TerrainConfig)
    out: Path = Path("preview.html")
    """The HTML file to write."""

    def run(self) -> int:
        """Writes the file and says where it is."""
        from saltus.render.preview import write_preview
        from saltus.robots.loading import load_robot
        from saltus.terrain.curriculum import make_terrain

        write_preview(load_robot(DEFAULT_ROBOT), make_terrain(self.course), self.out)
        print(self.out)
        return 0


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Estimates the noise of a real stereo camera from a recording of a scene at rest."""

    recording: Annotated[Path, tyro.conf.Positional]
    """A RealSense recording (.bag) or a recorded run (.mcap), without post-filters."""
    out: Path = Path("stereo.toml")
    """The parameters, with what each rests on; the plot of measured against model lies beside it as .html."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """The last line is JSON."""

    def run(self) -> int:
        """Writes both files and prints what was found, parameter by parameter."""
        from saltus.render.fit import fit, load_frames
        from saltus.render.fit_plot import write_fit_plot

        result = fit(load_frames(self.recording))
        plot = self.out.with_suffix(".html")
        try:
            self.out.write_text(result.to_toml())
            write_fit_plot(result, plot)
        except OSError as error:
            raise SaltusError(f"cannot write {error.filename}: {error.strerror}; does its folder exist?") from error
        estimates = vars(result.parameters)
        for name, found in estimates.items():
            value = f"{found.value:.4g} +- {found.error:.2g}" if found.testable else "untestable"
            print(f"{name:16} {value:22} {found.note}".rstrip())
        print(self.out, plot)
        if self.json:
            print_json({name: vars(found) for name, found in estimates.items()})
        return 0


@dataclass(frozen=True, kw_only=True)
class Serve(ServeProcess):
    """Runs the camera process against a running stack."""

    module = "saltus.render"


@dataclass(frozen=True, kw_only=True)
class Render:
    """The depth camera: preview, fit, serve."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[Preview, subcommand("preview")]
            | Annotated[Fit, subcommand("fit")]
            | Annotated[Serve, subcommand("serve")]
        ]
    ]

    def run(self) -> int:
        """Runs the chosen command."""
        return self.command.run()
