"""`saltus record`: record a stack that somebody else has started."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from saltus import config
from saltus.cli.output import run_directory
from saltus.config import RunConfig
from saltus.flags import shown

DRAIN_PERIOD_S = 0.02


@dataclass(frozen=True, kw_only=True)
class Record:
    """Records a running stack until Ctrl-C or until its router is gone.

    Example: saltus record --endpoint tcp/127.0.0.1:7447 --run-dir runs/one
    """

    endpoint: str
    """Zenoh router, e.g. tcp/127.0.0.1:7447."""
    run_dir: Path
    """Folder with the run's run.toml, robot.toml and terrain.toml."""
    out: Annotated[Path | None, shown("PATH", "a new one, runs/DATE-record")] = None
    """Folder for the recording."""

    def run(self) -> int:
        """Writes recording.mcap; 0 where the stack ended, 130 after Ctrl-C (the recording is closed either way)."""
        from saltus.recordings.recorder import Recorder
        from saltus.robots.robot import Robot
        from saltus.runtime.process import ROBOT_FILE, RUN_FILE, TERRAIN_FILE
        from saltus.terrain.terrain import Terrain
        from saltus.wire.zenoh_bus import ZenohBus

        run_config = config.load(RunConfig, self.run_dir / RUN_FILE)
        robot = config.load(Robot, self.run_dir / ROBOT_FILE)
        terrain = config.load(Terrain, self.run_dir / TERRAIN_FILE)
        with ZenohBus(self.endpoint, run_config.prefix) as bus:
            path = run_directory("record", self.out) / "recording.mcap"
            with Recorder(path, run_config, robot, terrain) as recorder:
                stream = bus.stream()
                print(f"recording to {path}; Ctrl-C ends it")
                while bus.connected():
                    for raw in stream.drain():
                        recorder.write(raw)
                    recorder.flush()
                    time.sleep(DRAIN_PERIOD_S)
        return 0
