"""From a torch module to the model file that a process runs. Training code only: it needs torch and onnx."""

import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import onnx
import torch
from torch import Tensor, nn

from saltus.errors import ModelError
from saltus.model_file import put_model

OPSET = 17


def write_onnx(
    module: nn.Module,
    example: tuple[Tensor, ...],
    path: Path,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    metadata: Mapping[str, Any],
) -> None:
    """Writes a module as ONNX, whole or not at all, and its checksum.

    Arguments and results of its `forward`, named by `inputs` and `outputs`, have a leading dimension of robots.
    Metadata say what the file is; values become JSON.

    Raises:
        ModelError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with warnings.catch_warnings():
            # The exporter without onnxscript is announced to go away; what it writes is compared with torch.
            warnings.filterwarnings("ignore", category=DeprecationWarning)
            torch.onnx.export(
                module,
                example,
                str(temporary),
                input_names=list(inputs),
                output_names=list(outputs),
                dynamic_axes={name: {0: "batch"} for name in (*inputs, *outputs)},
                opset_version=OPSET,
                dynamo=False,
            )
        file = onnx.load(temporary)
        onnx.helper.set_model_props(file, {name: json.dumps(value) for name, value in metadata.items()})
        file.producer_name, file.doc_string = "saltus", ""
        onnx.checker.check_model(file)
        onnx.save(file, temporary)
        put_model(temporary, path)
    except OSError as error:
        raise ModelError(f"cannot write {path}: {error.strerror}") from error
    finally:
        temporary.unlink(missing_ok=True)
