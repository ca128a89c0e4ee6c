"""Structure that repeats in depth images is no noise,
however large and of whatever kind noise is.
"""

from dataclasses import replace

import numpy as np
import pytest
from camera_logs import FLAT, STEP, WALL, Recipe, Truth, camera_log, chirp, rocking, still

from saltus.real2sim.problem.camera.problem import CameraProblem
from saltus.real2sim.search.decide import CLOSED_SHARE, SIZE_RMS

STRUCTURES = ("columns", "pixels", "columns of an image")


def drawn_recipe(rng: np.random.Generator) -> Recipe:
    return Recipe(
        motion=(chirp, rocking, still)[rng.integers(3)],
        boxes=(FLAT, STEP, WALL)[rng.integers(3)],
        truth=Truth(subpixel=rng.uniform(0.0, 0.15), alpha=rng.choice([1.0, 0.4])),
        duration_s=12.0,
        is_rough=bool(rng.integers(2)),
        seed=int(rng.integers(1000)),
    )


def powers(recipe: Recipe, structure: str = "", size: float = 0.0) -> dict[str, float]:
    """Mean squares of the rows of noise and of what repeats in it, without effects."""
    log, rng = camera_log(recipe), np.random.default_rng(recipe.seed)
    assert log.depth is not None
    images, height, width = log.depth.depth_mm.shape
    shape = {
        "": (1,),
        "columns": (width,),
        "pixels": (height, width),
        "columns of an image": (images, 1, width),
    }
    factor = 1.0 + size * rng.standard_normal(shape[structure])
    table = replace(log.depth, depth_mm=np.rint(log.depth.depth_mm * factor).astype(np.uint16))
    problem = CameraProblem(replace(log, depth=table))
    residuals = problem.residuals(problem.absent[None, None])[0, 0]
    return {
        name: float(np.mean(residuals[problem.signal == problem.signals.index(name)] ** 2))
        for name in ("noise", "noise that repeats")
    }


@pytest.mark.sample(4)
@pytest.mark.parametrize("seed", range(8))
def test_no_noise_repeats(seed: int) -> None:
    assert powers(drawn_recipe(np.random.default_rng(seed)))["noise that repeats"] < SIZE_RMS**2


@pytest.mark.sample(5)
@pytest.mark.parametrize("structure", STRUCTURES)
@pytest.mark.parametrize("seed", range(3))
def test_added_noise_explains_no_structure(structure: str, seed: int) -> None:
    """Added noise closes what the rows of noise have of the gap,
    which is not enough for its name.
    """
    rng = np.random.default_rng(100 + seed)
    recipe = drawn_recipe(rng)
    found = powers(replace(recipe, truth=Truth()), structure, rng.uniform(0.006, 0.03))
    assert found["noise"] < CLOSED_SHARE[0] * (found["noise"] + found["noise that repeats"])
