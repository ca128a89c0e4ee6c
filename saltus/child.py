"""A process under the supervisor's care."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

LOG_TAIL_LINES = 15
# Four processes on two cores: numeric libraries that start a thread per core only get in each other's way
ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}


@dataclass(frozen=True, kw_only=True)
class Program:
    """One row of the process table."""

    name: str
    module: str
    restart: bool
    """In real time: whether it is started again when it dies. Otherwise its end is the end of the run."""


class Child:
    """A program, its process, and what is known of its health."""

    def __init__(self, program: Program, log: Path) -> None:
        self.program = program
        self.log = log
        self.started_s = 0.0
        self.alive_s: float | None = None
        """Monotonic time of the last proof of life; None until it is ready."""
        self.restarts = 0
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def name(self) -> str:
        """Row of the process table."""
        return self.program.name

    @property
    def ready(self) -> bool:
        """Whether it has said so since it was started."""
        return self.alive_s is not None

    @property
    def pid(self) -> int | None:
        """Process id; None where it does not run."""
        return None if self._process is None or self._process.poll() is not None else self._process.pid

    def start(self, arguments: list[str]) -> None:
        """Starts it in a session of its own, so that Ctrl-C reaches the supervisor alone."""
        with self.log.open("ab") as file:
            self._process = subprocess.Popen(
                [sys.executable, "-m", self.program.module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                env={**os.environ, **ENVIRONMENT},
                start_new_session=True,
            )
        self.started_s = time.monotonic()
        self.alive_s = None

    def exit_code(self) -> int | None:
        """Exit code, negative for a signal; None while it runs or was never started."""
        return None if self._process is None else self._process.poll()

    def running(self) -> bool:
        """Whether it was started and has not ended."""
        return self._process is not None and self._process.poll() is None

    def signal(self, number: signal.Signals) -> None:
        """Sends a signal to it and to whatever it started."""
        if self._process is not None and self._process.poll() is None:
            os.killpg(self._process.pid, number)

    def kill(self) -> None:
        """Ends it at once; it is gone on return."""
        self.signal(signal.SIGKILL)
        if self._process is not None:
            self._process.wait()

    def log_tail(self) -> str:
        """The last lines that it wrote, indented, for the end of an error message."""
        try:
            lines = self.log.read_text(errors="replace").splitlines()[-LOG_TAIL_LINES:]
        except OSError:
            lines = []
        return "".join(f"\n  {line}" for line in lines) or f"; {self.log} is empty"


def name_exit(code: int) -> str:
    """An exit code in words."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"
