"""A model is what its checksum says, or it is refused."""

import hashlib
import shutil
from pathlib import Path

import numpy as np
import pytest

from saltus.errors import ModelError
from saltus.model_file import ModelFile, checksum_path, put_model
from saltus.resources import shipped_file

SHIPPED = (
    "models/heightmap.onnx",
    "models/policy.onnx",
    "models/policy_go2.onnx",
    "models/scan.onnx",
    "models/walk_go1.onnx",
    "models/walk_go2.onnx",
)
FLIPS = 40


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """The smaller of the shipped models, with its checksum, in a folder of its own."""
    source = shipped_file("models/policy.onnx")
    shutil.copy(source, tmp_path)
    shutil.copy(checksum_path(source), tmp_path)
    return tmp_path / source.name


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_models_have_checksums_and_are_what_these_say(name: str) -> None:
    path = shipped_file(name)
    digest, listed = checksum_path(path).read_text().split()
    assert listed == path.name
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert digest.startswith(ModelFile(path).model_id)


def test_every_flipped_bit_is_noticed(model: Path) -> None:
    good = model.read_bytes()
    rng = np.random.default_rng(0)
    for place, bit in zip(
        rng.integers(len(good), size=FLIPS), rng.integers(8, size=FLIPS), strict=True
    ):
        data = bytearray(good)
        data[place] ^= 1 << int(bit)
        model.write_bytes(data)
        with pytest.raises(
            ModelError, match=r"policy\.onnx is not the file that policy\.onnx\.sha256 names"
        ):
            ModelFile(model)


@pytest.mark.parametrize("text", ["", "\n", "nothing", "0" * 64 + "  policy.onnx\n"])
def test_a_checksum_that_says_something_else_refuses_the_model(model: Path, text: str) -> None:
    checksum_path(model).write_text(text)
    with pytest.raises(ModelError, match="is not the file"):
        ModelFile(model)


def test_a_checksum_that_cannot_be_read_refuses_the_model(model: Path) -> None:
    checksum_path(model).write_bytes(b"\xff\xfe")
    with pytest.raises(ModelError, match="cannot read"):
        ModelFile(model)


def test_a_model_is_put_in_its_place_with_its_own_checksum(model: Path) -> None:
    other = model.with_name(".new")
    shutil.copy(shipped_file("models/heightmap.onnx"), other)
    put_model(other, model)
    assert ModelFile(model).model_id == ModelFile(shipped_file("models/heightmap.onnx")).model_id
    assert sorted(path.name for path in model.parent.iterdir()) == [
        "policy.onnx",
        "policy.onnx.sha256",
    ]
