"""Runs one process of the stack in the foreground."""

import contextlib
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from saltus.config import RunConfig, load
from saltus.flags import Flag

END_S = 5.0  # a robot lands and stands within 1.5 s


def serve(module: str, run_dir: Path, endpoint: str, *more: str, peer: bool) -> int:
    """Runs `python -P -m module` against a router and returns its exit code.

    Ctrl-C and the signals that end a command end it too, cleanly.

    Raises:
        ConfigError: the folder holds no run.
    """
    from saltus.runtime.process import PEER_FLAG, RUN_FILE

    load(RunConfig, run_dir / RUN_FILE)

    links = [PEER_FLAG] if peer else []
    command = [sys.executable, "-P", "-m", module, "--run-dir", str(run_dir), "--endpoint", endpoint, *links, *more]
    with subprocess.Popen(command) as process:
        try:
            return process.wait()
        except KeyboardInterrupt:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
            process.kill()
            raise


@dataclass(frozen=True, kw_only=True)
class ServeProcess:
    """The command of a process that needs a running stack and nothing else."""

    module: ClassVar[str]
    """Whose `__main__` is run."""

    endpoint: str
    """Zenoh router, e.g. tcp/127.0.0.1:7447."""
    run_dir: Path
    """Folder with the run's run.toml."""
    peer: Flag = False
    """Link to the other processes directly; the router must be on this machine, not behind a tunnel."""

    def run(self) -> int:
        """Runs until the run is over or it is told to stop."""
        return serve(self.module, self.run_dir, self.endpoint, peer=self.peer)
