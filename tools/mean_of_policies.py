"""Mean of the weights of networks of one shape, as those of one policy before and after a training.

Between them lies what both can do: see "Stones" in docs/history.md. What the file says of itself
(description, configuration, commit) is that of the last network, and of which files it is the mean.

    python tools/mean_of_policies.py 0.3 models/walk_go1.onnx 0.7 runs/DATE-policy-walk/walk.onnx \
        --out walk.onnx
"""

import argparse
import hashlib
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper


def mean_of(parts: list[tuple[float, Path]]) -> onnx.ModelProto:
    """The last network with the mean of all weights; floats are averaged, in their own precision.

    Raises:
        SystemExit: they differ in the names or shapes of their weights.
    """
    models = [(share, onnx.load(path)) for share, path in parts]
    total, result = sum(share for share, _ in models), onnx.load(parts[-1][1])
    shapes = [[(each.name, *each.dims) for each in m.graph.initializer] for _, m in models]
    if any(each != shapes[0] for each in shapes):
        raise SystemExit("the weights are not alike in all files: train on from one of them")
    for index, kept in enumerate(result.graph.initializer):
        given = [(share, model.graph.initializer[index]) for share, model in models]
        own = numpy_helper.to_array(kept)
        if own.dtype.kind == "f":
            mean = sum(share * numpy_helper.to_array(each).astype(float) for share, each in given)
            array = np.asarray(mean / total, dtype=own.dtype)
            kept.CopyFrom(numpy_helper.from_array(array, kept.name))
    names = ((share, hashlib.sha256(path.read_bytes()).hexdigest()[:16]) for share, path in parts)
    said = ", ".join(f"{share / total:g} of {name}" for share, name in names)
    result.metadata_props.append(onnx.StringStringEntryProto(key="mean_of", value=said))
    return result


def main() -> None:
    """Writes the mean of the files given by their shares."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("parts", nargs="+", metavar="SHARE FILE")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    if len(given.parts) % 2:
        parser.error("each file needs a share before it")
    pairs = zip(given.parts[::2], given.parts[1::2], strict=True)
    onnx.save(mean_of([(float(share), Path(path)) for share, path in pairs]), given.out)


if __name__ == "__main__":
    main()
