"""Runs one process of the stack in the foreground."""

import contextlib
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from saltus.flags import EndpointOption, Flag

END_S = 5.0  # a robot lands and stands within 1.5 s


def serve_module(module: str, run_dir: Path, endpoint: str | None, *more: str, peer: bool) -> int:
    """Runs `python -P -m module` against a router and returns its exit code.

    Ctrl-C and the signals that end a command end it too, cleanly.

    Raises:
        ConfigError: the folder holds no run.
    """
    from saltus.runtime.process import PEER_FLAG
    from saltus.runtime.run_folder import endpoint_of, read_config

    read_config(run_dir)
    endpoint = endpoint or endpoint_of(run_dir)
    links = [PEER_FLAG] if peer else []
    command = [
        sys.executable,
        "-P",
        "-m",
        module,
        "--run-dir",
        str(run_dir),
        "--endpoint",
        endpoint,
        *links,
        *more,
    ]
    with subprocess.Popen(command, env={**os.environ, "PYTHONUTF8": "1"}) as process:
        try:
            return process.wait()
        except KeyboardInterrupt:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
            process.kill()
            raise


@dataclass(frozen=True, kw_only=True)
class ServeProcess(EndpointOption):
    """The command of a process that needs a running stack and nothing else."""

    module: ClassVar[str]
    """The package whose `__main__` is run."""

    run_dir: Path
    """Folder of the run: of `saltus up` or `saltus router`."""
    peer: Flag = False
    """Link to the other processes directly; the router must be one of Saltus on this machine."""

    def run(self) -> int:
        """Runs until the run is over or it is told to stop."""
        return serve_module(self.module, self.run_dir, self.endpoint, peer=self.peer)
