"""`saltus render`: see the camera, run the camera process."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import subcommand

from saltus.cli.serve import serve
from saltus.config import TerrainConfig


@dataclass(frozen=True, kw_only=True)
class Preview:
    """Writes what the camera sees: true depth, its effects one by one, the model's image, a point cloud."""

    course: tyro.conf.OmitArgPrefixes[TerrainConfig] = field(default_factory=TerrainConfig)
    out: Path = Path("preview.html")
    """The HTML file to write."""

    def run(self) -> int:
        """Writes the file and says where it is."""
        from render.preview import write_preview
        from saltus.terrain.curriculum import make_terrain

        write_preview(make_terrain(self.course), self.out)
        print(self.out)
        return 0


@dataclass(frozen=True, kw_only=True)
class Serve:
    """Runs the camera process against a running stack."""

    endpoint: str
    """Zenoh router, e.g. tcp/127.0.0.1:7447."""
    run_dir: Path
    """Folder with the run's run.toml."""

    def run(self) -> int:
        """Runs until it is told to stop."""
        return serve("render", self.run_dir, self.endpoint)


@dataclass(frozen=True, kw_only=True)
class Render:
    """The depth camera: preview, serve."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[Annotated[Preview, subcommand("preview")] | Annotated[Serve, subcommand("serve")]]
    ]

    def run(self) -> int:
        """Runs the chosen command."""
        return self.command.run()
