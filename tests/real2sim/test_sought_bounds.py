"""What is sought of an effect is said by the effect alone, and no fit leaves it."""

from itertools import product

import numpy as np
import pytest

from saltus.effects.profile import EFFECTS
from saltus.real2sim.problem.body.candidates import BodyClaims, body_candidates
from saltus.real2sim.problem.camera.candidates import camera_candidates
from saltus.real2sim.problem.imu import imu_candidates
from saltus.real2sim.problem.joints.candidates import KINDS
from saltus.real2sim.problem.problem import Candidate

SLACK = 1e-9
"""Of a number that was a coordinate in between."""
ALL = {
    "joints": KINDS,
    "body": body_candidates(BodyClaims(), 0.4, 30.0),
    "camera": camera_candidates(0.0, 42.0, (3.0, 10.0)),
    "imu": imu_candidates(),
}
EACH = [(sensor, each) for sensor, own in ALL.items() for each in own if not each.is_nuisance]
"""Of every effect that any sensor shows."""


@pytest.mark.parametrize(
    ("sensor", "each"), EACH, ids=[f"{sensor}-{each.effect}" for sensor, each in EACH]
)
def test_a_fit_seeks_between_the_values_that_its_effect_says(sensor: str, each: Candidate) -> None:
    effect = EFFECTS[each.effect]
    for corner in product(*((unknown.low, unknown.high) for unknown in each.unknowns)):
        for name, estimate in each.parameters(np.array(corner)).items():
            if name not in effect.__dataclass_fields__:
                continue  # becomes a parameter at the place of a log that it is of
            low, high = effect.sought(name)
            assert low - SLACK <= estimate.value <= high + SLACK, (name, corner)


def test_an_unknown_that_is_a_parameter_has_all_that_its_effect_says() -> None:
    compared = 0
    for _, each in EACH:
        names = [unknown.name for unknown in each.unknowns] if each.coordinates is None else []
        declared = EFFECTS[each.effect].__dataclass_fields__
        for unknown in (
            unknown
            for unknown in each.unknowns
            if unknown.name in names and unknown.name in declared
        ):
            ends = [
                each.parameters(np.full(len(names), end))[unknown.name].value
                for end in (unknown.low, unknown.high)
            ]
            assert ends == pytest.approx(EFFECTS[each.effect].sought(unknown.name), abs=SLACK)
            compared += 1
    assert compared > 30


def test_what_is_sought_lies_within_the_bounds() -> None:
    for effect in EFFECTS.values():
        for name, declared in effect.__dataclass_fields__.items():
            if "sought" in declared.metadata:
                low, high = effect.sought(name)
                assert min(declared.metadata["low"], 0.0) <= low < high <= declared.metadata["high"]
