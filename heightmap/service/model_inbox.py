"""A folder's place for a model that is given to a running service: watched, checked, and only then handed over."""

import os
import shutil
import subprocess
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from saltus.errors import ModelError
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.model_file import checksum_path

FILE = "heightmap.onnx"
"""Name of the file below the folder of a run; its checksum lies beside it."""
TIMEOUT_S = 60.0


class ModelInbox:
    """Looks after one file; what lay there before is not news.

    A new file is loaded and run in another process first (`saltus.heightmap.service.model_check`), then the very same
    bytes, by their sha256, are loaded here, both away from the thread that answers the robots.

    Args:
        path: ONNX file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._seen = self._signature()
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="model-inbox")
        self._check: Future[HeightmapNetwork] | None = None
        self._process: subprocess.Popen[str] | None = None

    def poll(self) -> HeightmapNetwork | None:
        """Returns a model that was given and has passed; never waits.

        Raises:
            ModelError: a model was given that must not be used.
        """
        if self._check is None:
            signature = self._signature()
            if signature != self._seen:
                self._seen = signature
                if signature is not None:
                    self._check = self._worker.submit(self._load_checked)
            return None
        if not self._check.done():
            return None
        check, self._check = self._check, None
        try:
            return check.result()
        except OSError as error:  # no memory or no handle for another process: not the fault of those who are served
            raise ModelError(f"model {self._path} could not be checked: {error}") from error

    def close(self) -> None:
        """Ends a check that is under way, and the thread."""
        if self._process is not None:
            self._process.kill()
        self._worker.shutdown(cancel_futures=True)

    def _load_checked(self) -> HeightmapNetwork:
        """Loads a model that has been checked in another process.

        Raises:
            ModelError: it has no checksum, is damaged, does not fit, or did not survive.
        """
        path = self._path
        _ask_for_checksum(path)
        command = [sys.executable, "-P", "-m", "saltus.heightmap.service.model_check", str(path)]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=environment) as self._process:
            try:
                model_id, complaint = self._process.communicate(timeout=TIMEOUT_S)
            except subprocess.TimeoutExpired as error:
                self._process.kill()
                raise ModelError(f"model {path} was not loaded within {TIMEOUT_S:g} s") from error
        if self._process.returncode != 0:
            lines = complaint.strip().splitlines()
            raise ModelError(
                lines[-1] if lines else f"model {path} ended its check with code {self._process.returncode}"
            )
        network = HeightmapNetwork(path)
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


def give(model: Path, run_dir: Path) -> str:
    """Puts a model where the service of a run looks, whole or not at all; returns its id.

    Raises:
        ModelError: it has no checksum, is damaged or does not fit, or there is no such folder; nothing is put there
            then.
    """
    if not run_dir.is_dir():
        raise ModelError(f"'{run_dir}' is no folder of a run")
    _ask_for_checksum(model)
    model_id = HeightmapNetwork(model).model_id
    target = run_dir / FILE
    for source, place in ((checksum_path(model), checksum_path(target)), (model, target)):
        partial = place.with_name(f".{place.name}.partial")
        shutil.copyfile(source, partial)
        partial.replace(place)
    return model_id


def _ask_for_checksum(path: Path) -> None:
    checksum = checksum_path(path)
    if not checksum.exists():
        raise ModelError(f"model {path} has no {checksum.name} beside it: a damaged file would not be noticed")
