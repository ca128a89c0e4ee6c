"""A camera that is far from its claim in place and time is found all the same.

Others are not aligned.
"""

import pytest
from camera_logs import STEP, Recipe, Truth, camera_log, chirp

from saltus.real2sim.problem.camera.problem import CameraProblem
from saltus.real2sim.search.search import search_effects

FAR = [
    {"camera_pitch": 0.12, "camera_height": -0.05, "camera_latency": 0.16},
    {"camera_pitch": -0.1, "camera_height": 0.04, "camera_latency": 0.12},
    {"camera_pitch": 0.12},
]


def problem(truth: dict[str, float]) -> CameraProblem:
    hidden = Truth(**{name.removeprefix("camera_"): value for name, value in truth.items()})
    return CameraProblem(
        camera_log(Recipe(truth=hidden, motion=chirp, boxes=STEP, duration_s=12.0, rate_hz=20.0))
    )


@pytest.mark.slow
@pytest.mark.parametrize("truth", FAR, ids=lambda truth: ", ".join(truth))
def test_a_camera_that_is_far_off_is_named_with_its_values(truth: dict[str, float]) -> None:
    found = search_effects(problem(truth))
    values = {effect.name: next(iter(effect.params.values())).value for effect in found.effects}
    assert (found.verdict, values) == ("named", pytest.approx(truth, abs=2e-3))


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    "truth", [{}, {"pitch": 0.01}, {"latency": 0.06}, {"scale": 0.9}, {"fov": 1.1}], ids=str
)
def test_a_camera_that_is_near_or_wrong_in_another_way_is_looked_at_from_its_claim(
    truth: dict[str, float],
) -> None:
    assert problem(truth).likely is None
