"""The place for a model that is given to a running service:
watched, checked, and only then handed over.
"""

import contextlib
import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from saltus import config
from saltus.errors import ModelError
from saltus.files import atomic_write, write_whole
from saltus.grid import HeightGrid
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.model_file import checksum_path
from saltus.robots.robot import Robot
from saltus.runtime.run_folder import SETUP_FILE
from saltus.setup import Setup

FILE = "heightmap.onnx"
"""Name of the file below the folder of a run.

Its checksum lies beside it, and the service's answer.
"""
CHECKING, ACCEPTED = "checking", "accepted"
"""Answers of a service; anything else is why it refuses the model."""
TIMEOUT_S = 60.0
HEARD_S = 10.0
"""For the first answer of a service, which looks twice a second: one on a busy computer."""
_POLL_S = 0.1


class ModelInbox:
    """Watches one ONNX file for the robot that is served; a file that was there before is not news.

    A new file is loaded and run in another process first (`saltus.heightmap.service.model_check`),
    then the very same bytes, by their sha256, are loaded here, both away from the thread that
    answers the robots.
    """

    def __init__(self, robot: Robot, grid: HeightGrid, path: Path) -> None:
        self._robot, self._grid, self._path = robot, grid, path
        self._seen = self._signature()
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="model-inbox")
        self._check: Future[HeightmapNetwork] | None = None
        self._process: subprocess.Popen[str] | None = None

    def poll(self) -> HeightmapNetwork | None:
        """Returns a model that was given and has passed,
        or raises `ModelError` for one that has not; never waits.
        """
        if self._check is None:
            signature = self._signature()
            if signature != self._seen:
                self._seen = signature
                if signature is not None:
                    self._answer(CHECKING)
                    self._check = self._worker.submit(self._load_checked)
            return None
        if not self._check.done():
            return None
        check, self._check = self._check, None
        try:
            network = check.result()
        # No memory or no handle for another process: not the fault of those who are served
        except OSError as error:
            self._answer(f"it could not be checked: {error}")
            raise ModelError(f"model {self._path} could not be checked: {error}") from error
        except ModelError as error:
            self._answer(str(error))
            raise
        self._answer(ACCEPTED)
        return network

    def _answer(self, text: str) -> None:
        """Tells whoever gave the model.

        Robots are served all the same where that cannot be written.
        """
        place = _answer_path(self._path)
        with contextlib.suppress(OSError):
            write_whole(place, text)

    def close(self) -> None:
        """Ends a check that is under way, and the thread."""
        if self._process is not None:
            self._process.kill()
        self._worker.shutdown(cancel_futures=True)

    def _load_checked(self) -> HeightmapNetwork:
        """Loads a model that has been checked in another process;
        `ModelError` says what is wrong with it.
        """
        path = self._path
        _ask_for_checksum(path)
        command = [sys.executable, "-P", "-m", "saltus.heightmap.service.model_check", str(path)]
        environment = {
            **os.environ,
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "PYTHONUTF8": "1",
        }
        pipe = subprocess.PIPE
        with subprocess.Popen(
            command,
            stdin=pipe,
            stdout=pipe,
            stderr=pipe,
            text=True,
            env=environment,
            encoding="utf-8",
        ) as check:
            self._process = check
            try:
                model_id, complaint = check.communicate(self._robot.to_toml(), timeout=TIMEOUT_S)
            except subprocess.TimeoutExpired as error:
                check.kill()
                raise ModelError(f"model {path} was not loaded within {TIMEOUT_S:g} s") from error
        if check.returncode != 0:
            lines = complaint.strip().splitlines()
            raise ModelError(
                lines[-1] if lines else f"model {path} ended its check with code {check.returncode}"
            )
        network = HeightmapNetwork(self._robot, path, self._grid)
        if network.model_id != model_id.strip():
            raise ModelError(f"model {path} was replaced while it was checked")
        return network

    def _signature(self) -> tuple[int, int, int] | None:
        """Tells one file from the next; None where there is none."""
        try:
            found = self._path.stat()
        except OSError:
            return None
        return found.st_ino, found.st_size, found.st_mtime_ns


def give_model(model: Path, run_dir: Path) -> str:
    """Puts a model where the service of a run looks, whole or not at all; returns its id.

    Raises:
        ModelError: it has no checksum, is damaged or does not fit, or there is no such folder.
        ConfigError: the folder's robot cannot be read.
    """
    if not (run_dir / SETUP_FILE).is_file():
        raise ModelError(f"'{run_dir}' is no folder of a run: no {SETUP_FILE} is in it")
    _ask_for_checksum(model)
    setup = config.load_config(Setup, run_dir / SETUP_FILE)
    model_id = HeightmapNetwork(setup.robot, model, setup.grid).model_id
    target = run_dir / FILE
    _answer_path(target).unlink(missing_ok=True)
    try:
        with (
            atomic_write(target) as file,
            atomic_write(checksum_path(target)) as checksum,
        ):  # first to its place
            shutil.copyfile(model, file)
            shutil.copyfile(checksum_path(model), checksum)
    except OSError as error:
        raise ModelError(f"cannot write into '{run_dir}': {error.strerror}") from error
    return model_id


def wait_for_answer(run_dir: Path) -> str:
    """Waits until the service of a run has checked the model in its folder;
    removes the model if no answer comes.

    Returns why the service refuses the model; empty if it accepts it.

    Raises:
        ModelError: no service looks there, or its check does not come to an end.
    """
    target = run_dir / FILE
    answer, heard, deadline_s = _answer_path(target), False, time.monotonic() + HEARD_S
    while time.monotonic() < deadline_s:
        text = answer.read_text(encoding="utf-8") if answer.exists() else ""
        if text == ACCEPTED:
            return ""
        if text and text != CHECKING:
            return text
        if text and not heard:
            heard, deadline_s = True, time.monotonic() + TIMEOUT_S + HEARD_S
        time.sleep(_POLL_S)
    for place in (target, checksum_path(target), answer):
        place.unlink(missing_ok=True)
    if heard:
        raise ModelError(
            f"the service of '{run_dir}' did not finish its check within {TIMEOUT_S + HEARD_S:g} s"
        )
    raise ModelError(
        f"no heightmap service looks into '{run_dir}': name the --run-dir of one that runs, in "
        "real time "
        "(a lockstep run takes no model)"
    )


def _answer_path(target: Path) -> Path:
    return target.with_name(f"{target.name}.answer")


def _ask_for_checksum(path: Path) -> None:
    checksum = checksum_path(path)
    if not checksum.exists():
        raise ModelError(
            f"model {path} has no {checksum.name} beside it: a damaged file would not be noticed"
        )
