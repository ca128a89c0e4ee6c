from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
import torch
from heightmap_inputs import SHORT_STAND_STEPS, WARMUP
from synthetic_motion import gliding_episodes

from saltus.depth_camera import SHIPPED
from saltus.grid import LINE
from saltus.heightmap.data import closed_loop
from saltus.heightmap.data.shards import read_dataset, write_shard
from saltus.heightmap.model import HeightmapModel, Normalisation
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.heightmap.settings import ModelSettings
from saltus.heightmap.training.dataset import EpisodeStore
from saltus.heightmap.training.export import ModelOrigin, export_heightmap


@pytest.fixture(scope="session")
def model() -> HeightmapModel:
    """A network that was never trained: the laws hold for any weights."""
    torch.manual_seed(0)
    n = len(PROPRIOCEPTION)
    normal = Normalisation(
        torch.zeros(n), torch.ones(n), torch.full((30,), -0.27), torch.full((30,), 0.1)
    )
    return HeightmapModel(ModelSettings(), normal).eval()


@pytest.fixture(scope="session")
def model_path(model: HeightmapModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "heightmap.onnx"
    export_heightmap(
        model,
        path,
        ModelOrigin(
            robot="go1",
            grid=LINE,
            camera=SHIPPED["d435i"],
            warmup_frames=WARMUP,
            dataset="none",
            seed=0,
        ),
    )
    return path


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("data")
    write_shard(path, gliding_episodes(20, seed=0), seed=0, config={"source": "synthetic"})
    return path


@pytest.fixture(scope="module")
def short_stand() -> Iterator[None]:
    """Robots of closed loops set out after half a second, not after one:
    what comes then is looked at.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(closed_loop, "Loop", partial(closed_loop.Loop, stand_steps=SHORT_STAND_STEPS))
        yield


@pytest.fixture(scope="module")
def store(data: Path) -> EpisodeStore:
    return EpisodeStore(read_dataset(data), torch.device("cpu"))
