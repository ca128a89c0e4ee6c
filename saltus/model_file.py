"""A trained network as one ONNX file: read, named by its hash,
run on one thread, refused in one line.
"""

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import onnxruntime

from saltus.errors import ConfigError, ModelError
from saltus.files import atomic_write
from saltus.grid import HeightGrid, stated_grid
from saltus.used_networks import MODEL_ID_DIGITS

Session: TypeAlias = onnxruntime.InferenceSession
CHECKSUM_SUFFIX = ".sha256"
"""Checksum suffix of the file beside a model that says what it must be, as `sha256sum` writes
it."""
MAX_BYTES = 64 << 20
"""25 times the largest that is shipped: a larger file is another file."""
_FLOAT32 = "tensor(float)"  # as ONNX Runtime writes it
_ELSEWHERE = re.compile(rb"\x6a.{1,2}\x0a\x08location\x12(.)", re.DOTALL)
"""Bytes before the name of the file in which the values of a tensor lie (`TensorProto` of
onnx.proto); the last one is the length of the name."""
_TRIED_ROBOTS = 2  # a network that is exported for one robot only fails with two


class ModelFile:
    """An ONNX file in ONNX Runtime, on one thread that sleeps between calls.

    Attributes:
        path: Where it was read.
        data: Its bytes, all that runs: a model with weights in a second file is refused.
        model_id: First half of their sha256, as hexadecimal digits.
        session: ONNX Runtime's.
        metadata: As text; `field` reads them.

    Where a checksum lies beside the file, the file must be what it says: the runtime loads most
    files with flipped bits without complaint.

    Raises:
        ModelError: the file is unreadable, of no sensible size, not what its checksum says, has
            weights in a second file, or is not a network that can be run.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            data = path.read_bytes()
        except OSError as error:
            raise ModelError(f"cannot read model {path}: {error.strerror}") from error
        if not 0 < len(data) <= MAX_BYTES:
            raise ModelError(f"model {path} has {len(data)} bytes: expected 1 to {MAX_BYTES}")
        self.data = data
        sha256 = hashlib.sha256(data).hexdigest()
        _compare_checksum(path, sha256)
        self.model_id = sha256[:MODEL_ID_DIGITS]
        _refuse_external(path, data)
        try:
            self.session = onnxruntime.InferenceSession(
                data, _options(), providers=["CPUExecutionProvider"], enable_fallback=0
            )
            self.metadata: dict[str, str] = dict(self.session.get_modelmeta().custom_metadata_map)
        except Exception as error:  # the runtime has no common base class of its errors
            raise ModelError(
                f"{path} is not a model that can be run: {_first_line(error)}"
            ) from error

    def field(self, name: str) -> Any:
        """An entry of the file's metadata, which are JSON; `ModelError` where it is missing."""
        if name not in self.metadata:
            raise ModelError(
                f"model {self.path} does not fit: '{name}' is missing from its metadata"
            )
        try:
            return json.loads(self.metadata[name])
        except (ValueError, RecursionError) as error:
            raise ModelError(f"model {self.path} does not fit: '{name}' is not JSON") from error

    @property
    def grid(self) -> HeightGrid:
        """The grid that it states (`saltus.grid.grid_metadata`);
        `ModelError` where that is none.
        """
        try:
            aside = {"grid_y_m": self.field("grid_y_m")} if "grid_y_m" in self.metadata else {}
            return stated_grid({"grid_m": self.field("grid_m"), **aside})
        except ConfigError as error:
            raise ModelError(f"model {self.path} does not fit: {error}") from error

    def check(
        self, inputs: Mapping[str, Sequence[int]], outputs: Mapping[str, Sequence[int]]
    ) -> None:
        """Refuses a network that takes or returns anything else, and runs it once, on zeros.

        Args:
            inputs: Shape of each input, without the first dimension, which is that of robots and
                free.
            outputs: Of each output that is read; there may be more.

        All of them are float32.

        Raises:
            ModelError: it names the input or output, what it is and what it must be.
        """
        unfit = f"model {self.path} does not fit:"
        taken = {value.name: value for value in self.session.get_inputs()}
        returned = {value.name: value for value in self.session.get_outputs()}
        for name, shape in (*inputs.items(), *outputs.items()):
            value = (taken if name in inputs else returned).get(name)
            if value is None:
                raise ModelError(
                    f"{unfit} it has no {'input' if name in inputs else 'output'} '{name}'"
                )
            if value.type != _FLOAT32:
                kind = value.type.removeprefix("tensor(").removesuffix(")")
                raise ModelError(
                    f"{unfit} '{name}' is of type {kind}, not float: export the network in float32"
                )
            found = list(value.shape)
            if not found or isinstance(found[0], int):
                raise ModelError(
                    f"{unfit} '{name}' has shape {found}: its first dimension, of robots, must be "
                    "free"
                )
            if found[1:] != list(shape):
                raise ModelError(f"{unfit} '{name}' has shape {found[1:]}, not {list(shape)}")
            if not all(isinstance(size, int) for size in shape):
                raise ModelError(f"{unfit} the size of '{name}' is not fixed")
        for name in taken.keys() - inputs.keys():
            raise ModelError(f"{unfit} it has an input '{name}', which nothing here fills")
        self._try(inputs, outputs)

    def _try(
        self, inputs: Mapping[str, Sequence[int]], outputs: Mapping[str, Sequence[int]]
    ) -> None:
        """Runs it once: what a file states about its shapes need not be true."""
        given = {
            name: np.zeros((_TRIED_ROBOTS, *shape), np.float32) for name, shape in inputs.items()
        }
        try:
            answers = self.session.run(list(outputs), given)
        except Exception as error:
            raise ModelError(
                f"{self.path} is not a model that can be run: {_first_line(error)}"
            ) from error
        for (name, shape), answer in zip(outputs.items(), answers, strict=True):
            if answer.shape != (_TRIED_ROBOTS, *shape):
                raise ModelError(
                    f"model {self.path} does not fit: '{name}' came with shape "
                    f"{list(answer.shape)} for "
                    f"{_TRIED_ROBOTS} robots, not {[_TRIED_ROBOTS, *shape]}"
                )


def _options() -> onnxruntime.SessionOptions:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # Its own format may name other files, too
    options.add_session_config_entry("session.load_model_format", "ONNX")
    # Weights in a second file would be looked for wherever a program runs: in no folder there are
    # none
    options.add_session_config_entry(
        "session.model_external_initializers_file_folder_path", os.devnull
    )
    options.log_severity_level = 4  # what is wrong is raised; the runtime need not print it too
    return options


def _refuse_external(path: Path, data: bytes) -> None:
    """Names the second file of a model that has one,
    which the runtime would refuse without naming it.
    """
    names = {data[found.end() : found.end() + found[1][0]] for found in _ELSEWHERE.finditer(data)}
    files = [name.decode(errors="replace") for name in sorted(names)]
    if files:
        raise ModelError(
            f"model {path} has weights in another file ({', '.join(map(repr, files))}), which its "
            "fingerprint does not cover: put them inside, in Python: import onnx; "
            f"onnx.save(onnx.load('{path}'), 'whole.onnx', save_as_external_data=False)"
        )


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def checksum_path(path: Path) -> Path:
    """Where the checksum of a model lies."""
    return path.with_name(path.name + CHECKSUM_SUFFIX)


def put_model(written: Path, path: Path) -> None:
    """Moves a model from the same file system to its place, with its checksum beside it.

    One that is killed half-way leaves no wrong checksum.
    """
    checksum = checksum_path(path)
    with atomic_write(checksum) as partial:
        partial.write_text(
            f"{hashlib.sha256(written.read_bytes()).hexdigest()}  {path.name}\n", encoding="utf-8"
        )
        checksum.unlink(missing_ok=True)
        written.replace(path)


def _compare_checksum(path: Path, sha256: str) -> None:
    checksum = checksum_path(path)
    try:
        words = checksum.read_text(encoding="utf-8").split()
    except FileNotFoundError:
        return
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"cannot read {checksum}: {error}") from error
    if not words or words[0] != sha256:
        raise ModelError(
            f"model {path} is not the file that {checksum.name} names: it is damaged, or its "
            "checksum is another file's"
        )
