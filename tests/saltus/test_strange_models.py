"""What runs is what the fingerprint covers: each file is read,
with the shipped network's numbers, or refused.
"""

import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import ROBOT
from strange_models import strange_models

from saltus.arrays import Floats
from saltus.errors import ModelError
from saltus.grid import LINE
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.model_file import ModelFile
from saltus.policy.actor import PolicyActor
from saltus.policy.policy_features import size_with
from saltus.resources import shipped_file


def _heights(path: Path) -> Floats:
    network, rng = HeightmapNetwork(ROBOT, path), np.random.default_rng(0)
    image = rng.uniform(size=(1, 2, 48, 16)).astype(np.float32)
    features = rng.normal(size=(1, len(PROPRIOCEPTION))).astype(np.float32)
    age_s, new, hidden = np.array([0.05]), np.array([True]), np.zeros((1, network.hidden_size))
    return network.tick(image, age_s, new, features, hidden).height[0]


def _plans(path: Path) -> Floats:
    actor = PolicyActor(ROBOT, LINE, path)
    return actor.values(
        np.random.default_rng(0).normal(size=(3, size_with(LINE, actor.past_steps)))
    )


@pytest.mark.parametrize(("kind", "numbers"), [("heightmap", _heights), ("policy", _plans)])
def test_every_file_gives_the_shipped_numbers_or_one_line(
    kind: str, numbers: Callable[[Path], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped, met = numbers(shipped_file(f"models/{kind}.onnx")), 0
    for path, refusal in strange_models(kind, tmp_path):
        monkeypatch.chdir(path.parent)  # where the runtime would look for a second file
        met += 1
        if refusal is None:
            np.testing.assert_allclose(numbers(path), shipped, atol=1e-6, err_msg=str(path))
            continue
        with pytest.raises(ModelError) as caught:
            numbers(path)
        assert re.search(refusal, str(caught.value)), path
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)
    assert met > 50


def test_the_fingerprint_is_that_of_the_bytes_that_were_given_to_the_runtime() -> None:
    file = ModelFile(shipped_file("models/policy.onnx"))
    assert file.session._model_bytes is file.data
    assert hashlib.sha256(file.data).hexdigest().startswith(file.model_id)


def test_names_of_second_files_are_told(tmp_path: Path) -> None:
    expected = {
        "two_files": "weights.bin", "a_weight_above": "../weights.bin",
        "branch_in_a_branch_outside": "weights.bin",
    }  # fmt: skip
    paths = {path.parent.name: path for path, _ in strange_models("policy", tmp_path)}
    for name, place in expected.items():
        with pytest.raises(ModelError, match=re.escape(f"in another file ('{place}')")):
            ModelFile(paths[name])
