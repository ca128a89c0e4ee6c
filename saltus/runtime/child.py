"""A process under the supervisor's care."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

from saltus.clock import RunClock
from saltus.errors import StackError
from saltus.runtime import cue
from saltus.runtime.programs import Program

LOG_TAIL_LINES = 15
LOAD_TIMEOUT_S = 30.0
# Four processes on two cores: numeric libraries that start a thread per core only get in each
# other's way
ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "PYTHONUNBUFFERED": "1",
    "PYTHONUTF8": "1",  # its log is read as UTF-8, whatever the locale
    # Nobody draws here; to find a window system MuJoCo would start one more Python, for 0.07 s
    "MUJOCO_GL": "off",
    # One thread waits for the sockets, reads and writes: of the many of the default one wakes the
    # other for each message. Not for the router: with one it drops large messages.
    "ZENOH_RUNTIME": (
        "(rx: (worker_threads: 1), tx: (handover: rx), acc: (handover: rx), net: (handover: rx))"
    ),
}


class Child:
    """A program: the process that runs, one that may wait to take over,
    and what is known of its health.
    """

    def __init__(self, program: Program, log: Path, clock: RunClock) -> None:
        self.program = program
        self.log = log
        self.started_s = 0.0
        """When the process that runs was told to begin, by the run's clock."""
        self.tried_s = 0.0
        """When a process of this program was last started, or could not be, by the run's clock."""
        self.alive_s: float | None = None
        """When the last proof of life came, by the run's clock; None until it is ready."""
        self._clock = clock
        self.restarts = 0
        self._runs: _Launch | None = None
        self._waits: _Launch | None = None

    @property
    def name(self) -> str:
        """Row of the process table."""
        return self.program.name

    @property
    def ready(self) -> bool:
        """True where it has said so since it was told to begin."""
        return self.alive_s is not None

    @property
    def has_spare(self) -> bool:
        """True where a process waits to take over, or loads to do so."""
        return self._waits is not None

    @property
    def loading(self) -> bool:
        """True where there is a process that will wait for its cue and has not come so far."""
        return self._waits is not None and self._waits.loading()

    @property
    def pid(self) -> int | None:
        """Process id; None where it does not run."""
        return self._runs.process.pid if self._runs is not None and self.running() else None

    def load(self, arguments: list[str]) -> None:
        """Starts a process that loads everything, and then waits to take over.

        Raises:
            StackError: the system gives no process, or no file for its line or its log.
        """
        self.tried_s = self._clock.elapsed_s()
        waits = cue.WORKING if self.program.hot else cue.IDLE
        try:
            self._waits = _Launch(
                self.program.module,
                [*arguments, *self.program.arguments, cue.FLAG, waits],
                self.log,
                self._clock,
            )
        except OSError as error:
            raise StackError(f"{self.name} cannot be started: {error.strerror}") from error

    def begin(self, arguments: list[str]) -> None:
        """Tells the process that waits to take over; starts one where none waits.

        The one before must have ended.
        """
        if self._waits is None or self._waits.process.poll() is not None:
            self._drop(self._waits)
            self.load(arguments)
        self._drop(self._runs)
        self._runs, self._waits = self._waits, None
        self.started_s = self._clock.elapsed_s()  # before it is told to: it may answer at once
        self.alive_s = None
        if self._runs is not None:
            self._runs.begin()

    def exit_code(self) -> int | None:
        """Exit code, negative for a signal; None while it runs or was never told to begin."""
        return None if self._runs is None else self._runs.process.poll()

    def running(self) -> bool:
        """True where it was told to begin and has not ended."""
        return self._runs is not None and self._runs.process.poll() is None

    def signal(self, number: signal.Signals) -> None:
        """Sends a signal to the process that runs and to whatever it started."""
        if self._runs is not None:
            self._runs.signal(number)

    def kill(self) -> None:
        """Ends the process that runs, at once; it is gone on return."""
        if self._runs is not None:
            self._runs.end()

    def dismiss(self) -> None:
        """Ends the process that waits: it has nothing to finish."""
        self._drop(self._waits)
        self._waits = None

    def log_tail(self) -> str:
        """The last lines that it wrote, indented, for the end of an error message."""
        try:
            lines = self.log.read_text(errors="replace", encoding="utf-8").splitlines()[
                -LOG_TAIL_LINES:
            ]
        except OSError:
            lines = []
        return "".join(f"\n  {line}" for line in lines) or f"; {self.log} is empty"

    @staticmethod
    def _drop(launch: "_Launch | None") -> None:
        if launch is not None:
            launch.end()


class _Launch:
    """One start of a program: its process, and the line on which it is told to begin."""

    def __init__(self, module: str, arguments: list[str], log: Path, clock: RunClock) -> None:
        self._line, theirs = socket.socketpair()
        self._line.setblocking(False)
        try:
            with theirs, log.open("ab") as file:
                self.process = subprocess.Popen(
                    [sys.executable, "-P", "-m", module, *arguments],
                    stdin=theirs.fileno(),
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    env={**os.environ, **ENVIRONMENT},
                    start_new_session=True,  # so that Ctrl-C reaches the supervisor alone
                )
        except OSError:
            self._line.close()
            raise
        self._clock = clock
        self._started_s = clock.elapsed_s()
        self._loaded = False

    def loading(self) -> bool:
        """True where it has not yet said that it waits, and still may."""
        with contextlib.suppress(BlockingIOError, ConnectionResetError):
            self._loaded = self._loaded or self._line.recv(1) == cue.LOADED
        in_time = self._clock.elapsed_s() - self._started_s < LOAD_TIMEOUT_S
        return not self._loaded and in_time and self.process.poll() is None

    def begin(self) -> None:
        """Tells it to begin as soon as it has loaded."""
        with contextlib.suppress(
            BrokenPipeError, ConnectionResetError
        ):  # it has died: its exit code will say so
            self._line.send(cue.BEGIN)

    def signal(self, number: signal.Signals) -> None:
        """Sends a signal to its group, unless it has ended."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, number)

    def end(self) -> None:
        """Ends it at once; may be called again."""
        self.signal(signal.SIGKILL)
        self.process.wait()
        self._line.close()


def name_exit(code: int) -> str:
    """An exit code in words."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"
