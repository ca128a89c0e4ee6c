"""`saltus record`: record a stack that somebody else has started."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from saltus.cli.output import run_directory
from saltus.flags import shown

DRAIN_PERIOD_S = 0.02


@dataclass(frozen=True, kw_only=True)
class Record:
    """Records a running stack until Ctrl-C or until its router is gone.

    Example: saltus record --run-dir runs/one
    """

    run_dir: Path
    """Folder of the run, with run.toml."""
    endpoint: Annotated[str | None, shown("STR", "the one that the folder names")] = None
    """Zenoh router, e.g. tcp/127.0.0.1:7447."""
    out: Annotated[Path | None, shown("PATH", "a new one, runs/DATE-record")] = None
    """Folder for the recording."""

    def run(self) -> int:
        """Writes recording.mcap; 0 where the stack ended, 130 after Ctrl-C (the recording is closed either way)."""
        from saltus.recordings.recorder import Recorder
        from saltus.runtime.run_folder import endpoint_of, read_run
        from saltus.wire.zenoh_bus import ZenohBus

        run = read_run(self.run_dir)
        with ZenohBus(self.endpoint or endpoint_of(self.run_dir), run.config.prefix) as bus:
            path = run_directory("record", self.out) / "recording.mcap"
            with Recorder(path, run.config, run.robot, run.terrain, run.camera) as recorder:
                stream = bus.stream()
                print(f"recording to {path}; Ctrl-C ends it")
                while bus.connected():
                    for raw in stream.drain():
                        recorder.write(raw)
                    recorder.flush()
                    time.sleep(DRAIN_PERIOD_S)
        return 0
