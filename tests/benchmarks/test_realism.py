"""Networks that are compared differ in their images alone."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.realism import check_twins
from heightmap.kinematic import KinematicBounding
from heightmap.rollouts import episodes
from heightmap.shards import DatasetError, Episode


@pytest.fixture(scope="module")
def motion() -> list[Episode]:
    return list(episodes(KinematicBounding(ticks=21, terrains=("step",)), np.random.default_rng(0), 3))


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
