"""Networks that are compared differ in their images alone."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic_motion import gliding_episodes

from benchmarks.realism import check_twins, with_age_held
from saltus.heightmap.data.delivery import ImageDeliveryModel
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.shards import DatasetError
from saltus.heightmap.model import HeightmapModel
from saltus.heightmap.settings import ModelSettings
from saltus.heightmap.training.dataset import NO_NOISE, EpisodeStore, run_window


@pytest.fixture(scope="module")
def motion() -> list[Episode]:
    return list(gliding_episodes(3, ticks=21, terrains=("step",)))


def test_images_may_differ(motion: list[Episode]) -> None:
    check_twins(motion, [replace(episode, depth=episode.depth // 2) for episode in motion])


@pytest.mark.parametrize("name", ["proprioception", "height"])
@pytest.mark.parametrize("index", range(3))
def test_another_motion_is_refused(motion: list[Episode], index: int, name: str) -> None:
    other = list(motion)
    changed = getattr(motion[index], name).copy()
    changed[-1, 0] += 1e-3
    other[index] = replace(motion[index], **{name: changed})
    with pytest.raises(DatasetError, match=f"episode {index} "):
        check_twins(motion, other)


def test_another_number_or_length_of_episodes_is_refused(motion: list[Episode]) -> None:
    with pytest.raises(DatasetError, match="clean has 2"):
        check_twins(motion, motion[:2])
    shorter = replace(motion[2], height=motion[2].height[:-1])
    with pytest.raises(DatasetError, match="episode 2 "):
        check_twins(motion, [*motion[:2], shorter])


@pytest.mark.parametrize("latency_s", [0.0, 0.03, 0.05])
def test_a_network_whose_age_is_held_says_the_same_of_images_that_it_knows(
    motion: list[Episode], latency_s: float
) -> None:
    store = EpisodeStore(motion, torch.device("cpu"))
    model = HeightmapModel(ModelSettings(), store.normalisation())
    held = with_age_held(model, latency_s)
    known = ImageDeliveryModel(latency_s=(latency_s, latency_s))
    window = next(store.windows(4, 21, known, NO_NOISE, np.random.default_rng(0)))
    # Before its first image a robot has none of whatever age: both are given that of an image that
    # comes now.
    age = torch.where(window.age.isinf(), latency_s + 0.01, window.age)
    with torch.no_grad():
        expected, _ = run_window(
            model, window._replace(age=age), torch.zeros(4, model.config.hidden)
        )
        found, _ = run_window(held, window, torch.zeros(4, model.config.hidden))
        other, _ = run_window(
            held, window._replace(age=age + 0.2), torch.zeros(4, model.config.hidden)
        )
    torch.testing.assert_close(found.height, expected.height, atol=1e-6, rtol=0.0)
    torch.testing.assert_close(other.height, found.height, atol=0.0, rtol=0.0)
