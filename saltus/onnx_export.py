"""From a torch module to the model file that a process runs.

Training code only: it needs torch and onnx.
"""

import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from saltus.errors import ModelError
from saltus.model_file import ModelFile, put_model

OPSET = 17


def write_onnx(
    module: nn.Module,
    example: tuple[Tensor, ...],
    path: Path,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    metadata: Mapping[str, object],
    half_prefixes: tuple[str, ...] = (),
) -> None:
    """Writes a module as ONNX, whole or not at all, and its checksum.

    Arguments and results of its `forward`, named by `inputs` and `outputs`, have a leading
    dimension of robots. Metadata say what the file is; values become JSON. Weights whose names
    begin with one of `half_prefixes` are kept in half precision, which halves them; they are
    computed with in single precision. `round_to_half` makes the module's equal to them.

    Raises:
        ModelError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with warnings.catch_warnings():
            # The exporter without onnxscript is announced to go away; what it writes is compared
            # with torch.
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
        _share_constants(file.graph)
        _halve(file.graph, half_prefixes)
        onnx.helper.set_model_props(
            file, {name: json.dumps(value) for name, value in metadata.items()}
        )
        file.producer_name, file.doc_string = "saltus", ""
        onnx.checker.check_model(file)
        onnx.save(file, temporary)
        put_model(temporary, path)
    except OSError as error:
        raise ModelError(f"cannot write {path}: {error.strerror}") from error
    finally:
        temporary.unlink(missing_ok=True)


def round_to_half(*modules: nn.Module) -> None:
    """Rounds weights to half precision, in place:
    who judges the module afterwards judges the file.
    """
    with torch.no_grad():
        for module in modules:
            for weight in module.parameters():
                weight.copy_(weight.half())


def weights_of(file: ModelFile) -> dict[str, Tensor]:
    """Tensors of a model file by name, in single precision,
    so that a training can go on from what is shipped.
    """
    return {
        tensor.name: torch.from_numpy(numpy_helper.to_array(tensor).astype(np.float32))
        for tensor in onnx.load_model_from_string(file.data).graph.initializer
    }


def _share_constants(graph: onnx.GraphProto) -> None:
    """Merges nodes of equal constants and clears the names of nodes, in place: a smaller file."""
    first: dict[bytes, str] = {}
    same: dict[str, str] = {}
    nodes = []
    for node in graph.node:
        node.ClearField("name")
        for place, name in enumerate(node.input):
            node.input[place] = same.get(name, name)
        if node.op_type == "Constant":
            value = node.attribute[0].SerializeToString()
            same[node.output[0]] = first.setdefault(value, node.output[0])
            if same[node.output[0]] != node.output[0]:
                continue
        nodes.append(node)
    graph.ClearField("node")
    graph.node.extend(nodes)


def _halve(graph: onnx.GraphProto, prefixes: tuple[str, ...]) -> None:
    """Puts weights in half precision in place of single, each with a cast back, in place."""
    wide = {}
    for tensor in graph.initializer:
        if tensor.name.startswith(prefixes):
            half = numpy_helper.to_array(tensor).astype(np.float16)
            wide[tensor.name] = f"{tensor.name}.single"
            tensor.CopyFrom(numpy_helper.from_array(half, tensor.name))
    for node in graph.node:
        for place, name in enumerate(node.input):
            node.input[place] = wide.get(name, name)
    casts = [
        onnx.helper.make_node("Cast", [name], [to], to=onnx.TensorProto.FLOAT)
        for name, to in wide.items()
    ]
    nodes = [*casts, *graph.node]
    graph.ClearField("node")
    graph.node.extend(nodes)
