from pathlib import Path

import pytest
import torch
from heightmap_inputs import WARMUP

from heightmap.export import Origin, export
from heightmap.features import PROPRIOCEPTION
from heightmap.model import HeightmapModel, ModelConfig, Normalisation


@pytest.fixture(scope="session")
def model() -> HeightmapModel:
    """A network that was never trained: the laws hold for any weights."""
    torch.manual_seed(0)
    n = len(PROPRIOCEPTION)
    normal = Normalisation(torch.zeros(n), torch.ones(n), torch.full((30,), -0.27), torch.full((30,), 0.1))
    return HeightmapModel(ModelConfig(), normal).eval()


@pytest.fixture(scope="session")
def model_path(model: HeightmapModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "heightmap.onnx"
    export(model, path, Origin(warmup_frames=WARMUP, dataset="none", seed=0))
    return path
