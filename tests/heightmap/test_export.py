import copy
import math
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from samples import ROBOT

from saltus.depth_camera import SHIPPED
from saltus.heightmap.model import HeightmapModel
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.training.export import Origin, export, parity, random_inputs


@pytest.mark.parametrize("gain", [1.0, 7.0])  # with 7, rounding becomes 5 cm within 170 steps
def test_file_equals_torch_in_each_of_1000_recurrent_steps_with_resets_even_where_rounding_grows(
    model: HeightmapModel, tmp_path: Path, gain: float
) -> None:
    stirred = copy.deepcopy(model)
    with torch.no_grad():
        stirred.gru.weight_hh_l0.mul_(gain)
    export(stirred, tmp_path / "m.onnx", Origin(camera=SHIPPED["d435i"], warmup_frames=1, dataset="none", seed=0))
    network = HeightmapNetwork(ROBOT, tmp_path / "m.onnx")
    assert parity(stirred, network, random_inputs(model, np.random.default_rng(1), 1000)) < 1e-5


def test_a_file_that_says_no_number_equals_nothing(
    model: HeightmapModel, model_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    law = HeightmapNetwork.tick
    monkeypatch.setattr(
        HeightmapNetwork, "tick", lambda *given: law(*given)._replace(height=np.full(30, np.nan, np.float32))
    )
    assert math.isnan(
        parity(model, HeightmapNetwork(ROBOT, model_path), random_inputs(model, np.random.default_rng(0), 3))
    )


def test_file_is_small_and_its_batch_is_free(model_path: Path) -> None:
    assert model_path.stat().st_size < 3_000_000
    graph = onnx.load(model_path).graph
    for value in (*graph.input, *graph.output):
        assert value.type.tensor_type.shape.dim[0].dim_param == "batch"


def test_window_equals_ticks_one_by_one(model: HeightmapModel) -> None:
    torch.manual_seed(1)
    time, batch = 40, 3
    image = torch.rand(time, batch, 2, 48, 16)
    age, new = torch.rand(time, batch) * 0.2, (torch.rand(time, batch) < 0.5).float()
    features, start = torch.randn(time, batch, 21), torch.tanh(torch.randn(batch, 256))
    with torch.no_grad():
        encoded = model.encode(image.flatten(0, 1)).unflatten(0, (time, batch))
        whole, last = model.ticks(encoded, age, new, features, start)
        hidden = start
        for i in range(time):
            single, hidden = model.step(image[i], age[i], new[i], features[i], hidden)
            torch.testing.assert_close(single.height, whole.height[i], atol=1e-5, rtol=0.0)
            torch.testing.assert_close(single.log_std, whole.log_std[i], atol=1e-5, rtol=0.0)
    torch.testing.assert_close(hidden, last, atol=1e-5, rtol=0.0)


def test_extreme_inputs_stay_finite(model_path: Path) -> None:
    network = HeightmapNetwork(ROBOT, model_path)
    hidden = np.zeros(256, np.float32)
    for value in (0.0, 1e6, -1e6):
        for age in (0.0, 1e9, np.inf):
            tick = network.tick(np.ones((2, 48, 16)), age, True, np.full(21, value), hidden)
            assert all(np.isfinite(array).all() for array in tick)
