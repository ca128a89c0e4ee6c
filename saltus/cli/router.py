"""`saltus router`: what services, recorders and one's own programs connect to."""

import contextlib
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from saltus.cli.output import run_directory
from saltus.cli.run_options import NetworkOptions, RobotOption, mounted_camera
from saltus.config import RunConfig, TerrainConfig
from saltus.errors import ModelError
from saltus.flags import flag_help
from saltus.grid import DEFAULT_GRID
from saltus.robots.loading import load_robot

LOOK_S = 0.2


@dataclass(frozen=True, kw_only=True)
class Router(RobotOption, NetworkOptions):
    """Starts a Zenoh router, to which services,
    recorders and your own programs connect, until Ctrl-C.

    The folder gets client.json5, a configuration with which any Zenoh program joins, and what the
    processes of Saltus read. Other users of this computer cannot join. Times in messages are those
    of its monotonic clock.

    For example:
      saltus router --out runs/mine
      saltus heightmap serve --run-dir runs/mine
      saltus record run --run-dir runs/mine
    """

    camera: str = RunConfig.camera
    """Where your camera sits, if not where the robot has its own: a TOML file.

    Images say their own intrinsics.
    """
    heightmap_model: Annotated[Path | None, flag_help("PATH", "the shipped model")] = None
    """ONNX file of the heightmap service: your own, where your camera sits elsewhere."""
    grid: str = DEFAULT_GRID
    """Points of the heights: line, of the network of one robot; scan, of any robot.

    Or a TOML file.
    """
    prefix: str = RunConfig.prefix
    """Prefix of the keys."""
    out: Annotated[Path | None, flag_help("PATH", "a new one, runs/DATE-router")] = None
    """Folder."""

    def run(self) -> int:
        """Runs until Ctrl-C."""
        from saltus.heightmap.service.network import HeightmapNetwork
        from saltus.named_setup import named_setup
        from saltus.runtime.run_folder import CLIENT_FILE, write_run
        from saltus.used_networks import model_path
        from saltus.wire.joining import write_client
        from saltus.wire.router import open_router

        _, robot = mounted_camera(self.camera, load_robot(self.robot))
        model = None if self.heightmap_model is None else str(self.heightmap_model.absolute())
        try:  # what is wrong with it is said at once
            if self.grid == DEFAULT_GRID:
                HeightmapNetwork(robot, model_path("heightmap", self.heightmap_model))
        except ModelError as error:
            if model is not None:
                raise
            cure = (
                "heights of 187 points are served of any robot: saltus heightmap serve --grid scan"
            )
            print(
                f"saltus: the line cannot be served here: {error}; {cure}",
                file=sys.stderr,
                flush=True,
            )
        config = RunConfig(
            robot=self.robot, grid=self.grid, prefix=self.prefix,
            terrain=TerrainConfig(terrain="flat"),
            camera=self.camera, pace="realtime",
            heightmap_model=model,
        )  # fmt: skip
        config.check()
        endpoint, router = open_router(self.network(self.prefix))
        with contextlib.closing(router):
            directory = run_directory("router", self.out)
            write_run(directory, config, named_setup(config))
            write_client(directory / CLIENT_FILE, endpoint)
            joined = f"join it with {directory / CLIENT_FILE}, which only you can do"
            print(f"router at {endpoint}, keys under {self.prefix}; {joined}", flush=True)
            if self.listen is not None:
                print(
                    f"and at tls/{self.listen} for who has a certificate of {self.keys}", flush=True
                )
            while True:
                time.sleep(LOOK_S)
