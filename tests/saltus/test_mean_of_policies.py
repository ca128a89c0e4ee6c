"""tools/mean_of_policies.py: the mean of two files is between them, and is a policy as they are."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from saltus.policy.joints.policy import JointPolicy
from tools.mean_of_policies import mean_of

MODELS = Path(__file__).resolve().parents[2] / "models"
ONE, OTHER = MODELS / "walk_go1.onnx", MODELS / "walk_go2.onnx"


def weights(model: onnx.ModelProto) -> list[np.ndarray]:
    return [numpy_helper.to_array(each) for each in model.graph.initializer]


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 1.0])
def test_each_weight_is_the_mean_and_the_file_is_a_policy(share: float, tmp_path: Path) -> None:
    mean = mean_of([(share, ONE), (1.0 - share, OTHER)])
    for got, one, other in zip(
        weights(mean), weights(onnx.load(ONE)), weights(onnx.load(OTHER)), strict=True
    ):
        assert got.dtype == other.dtype
        if got.dtype.kind == "f":
            wanted = share * one.astype(float) + (1.0 - share) * other.astype(float)
            np.testing.assert_array_equal(got, wanted.astype(got.dtype))
        else:
            np.testing.assert_array_equal(got, other)
    onnx.save(mean, tmp_path / "walk.onnx")
    assert JointPolicy(tmp_path / "walk.onnx").description == JointPolicy(OTHER).description


def test_files_of_other_shape_are_refused() -> None:
    with pytest.raises(SystemExit, match="not alike"):
        mean_of([(0.5, MODELS / "policy.onnx"), (0.5, ONE)])
