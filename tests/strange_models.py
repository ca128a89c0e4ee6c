"""Model files as strangers have them: each is the shipped network, changed in one way.

    python tests/strange_models.py FOLDER

writes all of them there. Tests ask that each is read, with the numbers of the shipped one, or
refused by one line.
"""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import onnx
from onnx import TensorProto, external_data_helper, helper, numpy_helper

from saltus.resources import shipped_file

INSIDE = "save_as_external_data=False"
"""In the line that refuses weights in a second file."""


class Strange(NamedTuple):
    """A file, and what becomes of it."""

    path: Path
    refusal: str | None
    """A pattern in the line that refuses it; None where it is read."""


def strange_models(kind: str, folder: Path) -> Iterator[Strange]:
    """Files made of the shipped `heightmap` or `policy`,
    one after the other, each in a folder of its own.
    """
    for (name, refusal), change in CHANGES.items():
        place = folder / kind / name.replace(" ", "_")
        place.mkdir(parents=True)
        model = onnx.load(shipped_file(f"models/{kind}.onnx"))
        written = change(model, place)
        path = place / f"{kind}.onnx"
        path.write_bytes(model.SerializeToString() if written is None else written)
        yield Strange(path, refusal)


def _as_saved_in_two_files(model: onnx.ModelProto, folder: Path) -> None:
    external_data_helper.convert_model_to_external_data(
        model, location="weights.bin", size_threshold=0
    )
    onnx.save(model, folder / "two.onnx")
    model.CopyFrom(onnx.load(folder / "two.onnx", load_external_data=False))


def _one_weight_outside(model: onnx.ModelProto, folder: Path) -> None:
    _move_out(model.graph.initializer[-1], folder)


def _move_out(tensor: TensorProto, folder: Path, place: str = "weights.bin") -> None:
    values = numpy_helper.to_array(tensor).tobytes()
    (folder / Path(place).name).write_bytes(values)
    tensor.raw_data = values
    external_data_helper.set_external_data(tensor, place)
    tensor.ClearField("raw_data")


def _place(place: str) -> Callable[[onnx.ModelProto, Path], None]:
    return lambda model, folder: _move_out(model.graph.initializer[0], folder, place)


def _outside(folder: Path) -> TensorProto:
    tensor = numpy_helper.from_array(np.arange(4, dtype=np.float32), "outside")
    _move_out(tensor, folder)
    return tensor


def _branches(folder: Path, depth: int) -> onnx.NodeProto:
    """If within If, the innermost with values outside."""
    inner = helper.make_node("Constant", [], ["branch"], value=_outside(folder))
    node = inner if depth == 0 else _branches(folder, depth - 1)
    given = helper.make_tensor_value_info("branch", TensorProto.FLOAT, [4])
    graphs = [helper.make_graph([node], name, [], [given]) for name in ("yes", "no")]
    return helper.make_node(
        "If", ["condition"], ["branch"], then_branch=graphs[0], else_branch=graphs[1]
    )


def _subgraph(depth: int) -> Callable[[onnx.ModelProto, Path], None]:
    def change(model: onnx.ModelProto, folder: Path) -> None:
        model.graph.initializer.append(numpy_helper.from_array(np.array(True), "condition"))
        model.graph.node.append(_branches(folder, depth))

    return change


def _constant(model: onnx.ModelProto, folder: Path) -> None:
    model.graph.node.append(helper.make_node("Constant", [], ["outside"], value=_outside(folder)))


def _list_of_tensors(model: onnx.ModelProto, folder: Path) -> None:
    node = helper.make_node("Constant", [], ["outside"], value_float=1.0)
    node.attribute.append(helper.make_attribute("tables", [_outside(folder), _outside(folder)]))
    model.graph.node.append(node)


def _sparse(model: onnx.ModelProto, folder: Path) -> None:
    indices = numpy_helper.from_array(np.arange(4, dtype=np.int64), "indices")
    model.graph.sparse_initializer.append(helper.make_sparse_tensor(_outside(folder), indices, [9]))


def _sparse_indices(model: onnx.ModelProto, folder: Path) -> None:
    indices = numpy_helper.from_array(np.arange(4, dtype=np.int64), "indices")
    _move_out(indices, folder)
    values = numpy_helper.from_array(np.ones(4, np.float32), "sparse")
    sparse = helper.make_sparse_tensor(values, indices, [9])
    model.graph.node.append(helper.make_node("Constant", [], ["sparse"], sparse_value=sparse))


def _function(model: onnx.ModelProto, folder: Path) -> None:
    node = helper.make_node("Constant", [], ["y"], value=_outside(folder))
    opset = [helper.make_opsetid("", 17)]
    model.functions.append(helper.make_function("own", "Table", [], ["y"], [node], opset))


def _training_graph(model: onnx.ModelProto, folder: Path) -> None:
    training = model.training_info.add()
    training.initialization.CopyFrom(helper.make_graph([], "start", [], [], [_outside(folder)]))


def _typed(name: str, kind: int, is_input: bool) -> Callable[[onnx.ModelProto, Path], None]:
    """One of the inputs or outputs as another type, cast where it is used or made."""

    def change(model: onnx.ModelProto, folder: Path) -> None:
        for value in model.graph.input if is_input else model.graph.output:
            if name in ("all", value.name):
                _cast(model, value, kind, is_input)

    return change


def _cast(model: onnx.ModelProto, value: onnx.ValueInfoProto, kind: int, is_input: bool) -> None:
    inside = f"{value.name}_as_float32"
    for node in model.graph.node:
        for names in (node.input, node.output):
            renamed = [inside if each == value.name else each for each in names]
            del names[:]
            names.extend(renamed)
    value.type.tensor_type.elem_type = kind
    if is_input:
        model.graph.node.insert(
            0, helper.make_node("Cast", [value.name], [inside], to=TensorProto.FLOAT)
        )
    else:
        model.graph.node.append(helper.make_node("Cast", [inside], [value.name], to=kind))


def _size(is_input: bool, axis: int, size: int | str) -> Callable[[onnx.ModelProto, Path], None]:
    """States another size; what is computed stays."""

    def change(model: onnx.ModelProto, folder: Path) -> None:
        value = (model.graph.input if is_input else model.graph.output)[0]
        dimension = value.type.tensor_type.shape.dim[axis]
        dimension.Clear()
        setattr(dimension, "dim_value" if isinstance(size, int) else "dim_param", size)

    return change


def _more_inputs(model: onnx.ModelProto, folder: Path) -> None:
    model.graph.input.append(helper.make_tensor_value_info("clock", TensorProto.FLOAT, ["batch"]))


def _no_input(model: onnx.ModelProto, folder: Path) -> None:
    value = model.graph.input[0]
    for node in model.graph.node:
        for i, name in enumerate(node.input):
            if name == value.name:
                node.input[i] = "picture"
    value.name = "picture"


def _no_output(model: onnx.ModelProto, folder: Path) -> None:
    del model.graph.output[0]


def _more_outputs(model: onnx.ModelProto, folder: Path) -> None:
    """That of the first node: legal, and nobody reads it."""
    model.graph.output.append(onnx.ValueInfoProto(name=model.graph.node[0].output[0]))


def _fails_when_run(model: onnx.ModelProto, folder: Path) -> None:
    """Something is taken from beyond the end of a list whose length depends on what is given."""
    output = model.graph.output[0]
    _cast(model, output, TensorProto.FLOAT, is_input=False)
    inside = model.graph.node.pop().input[0]
    model.graph.initializer.append(numpy_helper.from_array(np.array(7919), "beyond"))
    model.graph.node.extend([
        helper.make_node("Shape", [inside], ["list"]),
        helper.make_node("Gather", ["list", "beyond"], ["taken"]),
        helper.make_node("Cast", ["taken"], ["number"], to=TensorProto.FLOAT),
        helper.make_node("Add", [inside, "number"], [output.name]),
    ])  # fmt: skip


def _opset(version: int) -> Callable[[onnx.ModelProto, Path], None]:
    def change(model: onnx.ModelProto, folder: Path) -> None:
        model.opset_import[0].version = version

    return change


def _unknown_operator(model: onnx.ModelProto, folder: Path) -> None:
    model.graph.node.append(helper.make_node("Climb", [model.graph.node[0].output[0]], ["climbed"]))


def _unknown_domain(model: onnx.ModelProto, folder: Path) -> None:
    node = helper.make_node("Climb", [model.graph.node[0].output[0]], ["climbed"], domain="own")
    model.graph.node.append(node)
    model.opset_import.append(helper.make_opsetid("own", 1))


def _cycle(model: onnx.ModelProto, folder: Path) -> None:
    model.graph.node.append(helper.make_node("Identity", ["b"], ["a"]))
    model.graph.node.append(helper.make_node("Identity", ["a"], ["b"]))


def _bytes(change: Callable[[bytes], bytes]) -> Callable[[onnx.ModelProto, Path], bytes]:
    return lambda model, _: change(model.SerializeToString())


def _only(data: bytes) -> Callable[[onnx.ModelProto, Path], bytes]:
    return lambda *_: data


def _as_lists(model: onnx.ModelProto, folder: Path) -> None:
    """Weights as numbers, not as raw bytes: as small files are often written."""
    for tensor in model.graph.initializer:
        if tensor.data_type == TensorProto.FLOAT:
            values = numpy_helper.to_array(tensor).ravel().tolist()
            tensor.CopyFrom(
                helper.make_tensor(tensor.name, TensorProto.FLOAT, list(tensor.dims), values)
            )


def _weights_as_constants(model: onnx.ModelProto, folder: Path) -> None:
    for tensor in model.graph.initializer:
        model.graph.node.insert(0, helper.make_node("Constant", [], [tensor.name], value=tensor))
    del model.graph.initializer[:]


def _put_inside(model: onnx.ModelProto, folder: Path) -> None:
    """What the line of a refused file tells to do."""
    _as_saved_in_two_files(model, folder)
    onnx.save(onnx.load(folder / "two.onnx"), folder / "whole.onnx", save_as_external_data=False)
    model.CopyFrom(onnx.load(folder / "whole.onnx", load_external_data=False))


def _as_it_is(model: onnx.ModelProto, folder: Path) -> None:
    """Nothing is changed."""


_NOTES = b"\xa2\x06\x05notes"  # field 100, which nobody knows
_RUN = "is not a model that can be run"
CHANGES: dict[tuple[str, str | None], Callable[[onnx.ModelProto, Path], bytes | None]] = {
    ("as it is", None): _as_it_is,
    ("put inside", None): _put_inside,
    ("weights as lists", None): _as_lists,
    ("weights as constants", None): _weights_as_constants,
    ("more outputs", None): _more_outputs,
    ("an unknown field", None): _bytes(lambda data: data + _NOTES),
    ("two files", INSIDE): _as_saved_in_two_files,
    ("one weight outside", INSIDE): _one_weight_outside,
    ("a weight above", INSIDE): _place("../weights.bin"),
    ("a weight in memory", INSIDE): _place("*/_ORT_MEM_ADDR_/*"),
    ("constant outside", INSIDE): _constant,
    ("list of tensors outside", INSIDE): _list_of_tensors,
    ("sparse values outside", INSIDE): _sparse,
    ("sparse indices outside", INSIDE): _sparse_indices,
    ("branch outside", INSIDE): _subgraph(0),
    ("branch in a branch outside", INSIDE): _subgraph(1),
    ("branches 6 deep outside", INSIDE): _subgraph(5),
    ("function outside", INSIDE): _function,
    ("training outside", INSIDE): _training_graph,
    ("float16 inputs", "is of type float16, not float"): _typed("all", TensorProto.FLOAT16, True),
    ("float64 inputs", "is of type double, not float"): _typed("all", TensorProto.DOUBLE, True),
    ("int32 inputs", "is of type int32, not float"): _typed("all", TensorProto.INT32, True),
    ("int64 inputs", "is of type int64, not float"): _typed("all", TensorProto.INT64, True),
    ("bool inputs", "is of type bool, not float"): _typed("all", TensorProto.BOOL, True),
    ("bfloat16 inputs", "is of type bfloat16, not float"): _typed(
        "all", TensorProto.BFLOAT16, True
    ),
    ("float16 outputs", "is of type float16, not float"): _typed("all", TensorProto.FLOAT16, False),
    ("float64 outputs", "is of type double, not float"): _typed("all", TensorProto.DOUBLE, False),
    ("int32 outputs", "is of type int32, not float"): _typed("all", TensorProto.INT32, False),
    ("one robot", "its first dimension, of robots, must be free"): _size(True, 0, 1),
    ("one robot comes out", "its first dimension, of robots, must be free"): _size(False, 0, 1),
    ("a free size", "has shape"): _size(True, 1, "anything"),
    ("another size", f"has shape|{_RUN}"): _size(True, 1, 5),
    ("another size is stated", None): _size(False, 1, 5),  # the runtime works out what comes out
    ("a free size is stated", None): _size(False, 1, "anything"),
    ("more inputs", "an input 'clock', which nothing here fills"): _more_inputs,
    ("an input renamed", "it has no input"): _no_input,
    ("an output less", "it has no output"): _no_output,
    ("fails when run", _RUN): _fails_when_run,
    ("opset of the future", _RUN): _opset(99),
    ("opset 0", _RUN): _opset(0),
    ("unknown operator", _RUN): _unknown_operator,
    ("unknown domain", _RUN): _unknown_domain,
    ("a circle", _RUN): _cycle,
    ("half", _RUN): _bytes(lambda data: data[: len(data) // 2]),
    ("a byte less", _RUN): _bytes(lambda data: data[:-1]),
    ("its head", _RUN): _bytes(lambda data: data[:300]),
    ("empty", "has 0 bytes"): _only(b""),
    ("zeros", _RUN): _only(bytes(4000)),
    ("noise", _RUN): _only(np.random.default_rng(0).bytes(4000)),
    ("text", _RUN): _only(b"a model\n"),
    ("a pointer of Git LFS", _RUN): _only(b"version https://git-lfs.github.com/spec/v1\n"),
    ("the runtime's own format", _RUN): _only(b"\x20\0\0\0ORTM" + bytes(100)),
    ("a zip archive", _RUN): _bytes(lambda data: b"PK\x03\x04" + data[:1000]),
}
"""By a name and by what its refusal says, a pattern."""


def main() -> None:
    """Writes all of them."""
    for kind in ("heightmap", "policy"):
        for path, refusal in strange_models(kind, Path(sys.argv[1])):
            sys.stdout.write(f"{path}: {refusal or 'read'}\n")


if __name__ == "__main__":
    main()
