"""A trained network as one ONNX file: read, named by its hash, run on one thread, refused in one line."""

import hashlib
import json
from pathlib import Path
from typing import Any

import onnxruntime

from saltus.errors import ModelError
from saltus.models import MODEL_ID_DIGITS

CHECKSUM_SUFFIX = ".sha256"
"""Of the file beside a model that says what it must be, as `sha256sum` writes it."""
MAX_BYTES = 64 << 20
"""Six times what is shipped at most: a larger file is another file."""


class ModelFile:
    """An ONNX file in ONNX Runtime, on one thread that sleeps between calls.

    Attributes:
        path: Where it was read.
        model_id: First half of the sha256 of the very bytes that run, as hexadecimal digits.
        session: ONNX Runtime's.
        metadata: As text; `field` reads them.

    Where a checksum lies beside the file, the file must be what it says: the runtime loads most files with flipped bits
    without complaint.

    Raises:
        ModelError: the file is unreadable, of no sensible size, not what its checksum says, or not a network that can
            be run.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            data = path.read_bytes()
        except OSError as error:
            raise ModelError(f"cannot read model {path}: {error.strerror}") from error
        if not 0 < len(data) <= MAX_BYTES:
            raise ModelError(f"model {path} has {len(data)} bytes: expected 1 to {MAX_BYTES}")
        sha256 = hashlib.sha256(data).hexdigest()
        _compare_checksum(path, sha256)
        self.model_id = sha256[:MODEL_ID_DIGITS]
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 4  # what is wrong is raised; the runtime need not print it too
        try:
            self.session = onnxruntime.InferenceSession(
                data, options, providers=["CPUExecutionProvider"], enable_fallback=0
            )
            self.metadata: dict[str, str] = dict(self.session.get_modelmeta().custom_metadata_map)
        except Exception as error:  # the runtime has no common base class of its errors; its texts may be none
            raise ModelError(f"{path} is not a model that can be run: {str(error).splitlines()[0]}") from error

    def field(self, name: str) -> Any:
        """One of its metadata, which are JSON; `ModelError` where it is missing."""
        if name not in self.metadata:
            raise ModelError(f"model {self.path} does not fit: '{name}' is missing from its metadata")
        try:
            return json.loads(self.metadata[name])
        except (ValueError, RecursionError) as error:
            raise ModelError(f"model {self.path} does not fit: '{name}' is not JSON") from error


def checksum_path(path: Path) -> Path:
    """Where the checksum of a model lies."""
    return path.with_name(path.name + CHECKSUM_SUFFIX)


def put_model(written: Path, path: Path) -> None:
    """Moves a model from the same file system to its place, with its checksum beside it.

    One that is killed half-way leaves no wrong checksum.
    """
    checksum, partial = checksum_path(path), written.with_name(f"{written.name}{CHECKSUM_SUFFIX}")
    partial.write_text(f"{hashlib.sha256(written.read_bytes()).hexdigest()}  {path.name}\n")
    checksum.unlink(missing_ok=True)
    written.replace(path)
    partial.replace(checksum)


def _compare_checksum(path: Path, sha256: str) -> None:
    checksum = checksum_path(path)
    try:
        words = checksum.read_text().split()
    except FileNotFoundError:
        return
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"cannot read {checksum}: {error}") from error
    if not words or words[0] != sha256:
        raise ModelError(
            f"model {path} is not the file that {checksum.name} names: it is damaged, or its checksum is another file's"
        )
