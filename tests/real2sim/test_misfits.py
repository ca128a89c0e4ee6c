"""A profile with effects that the robot does not have: no name stands for them, and the verdict says which they are."""

from collections.abc import Mapping

import numpy as np
import pytest
from one_joint import OneJoint

from saltus.arrays import Floats
from saltus.effects.actuator_lag import ActuatorLag
from saltus.effects.profile import Profile
from saltus.real2sim.problem.problem import Problem, WrappedProblem
from saltus.real2sim.reporting.words import sentence
from saltus.real2sim.search.findings import FoundEffect, Interval
from saltus.real2sim.search.search import search
from saltus.real2sim.verdict import Verdict, merge

SURPLUS: dict[str, dict[str, tuple[float, ...]]] = {
    "saturation": {"torque_saturation": (0.4, 4.0)},
    "friction": {"coulomb_friction": (0.8,)},
    "saturation and friction": {"torque_saturation": (0.4, 4.0), "coulomb_friction": (0.8,)},
}


class Profiled(WrappedProblem):
    """Pendulums on a simulator that has effects everywhere which no unknown takes away."""

    def __init__(self, inner: Problem, has: Mapping[str, tuple[float, ...]]) -> None:
        super().__init__(inner)
        self._has = dict(has)
        nothing = {c.effect: (0.0,) * len(c.unknowns) for c in inner.candidates}
        self._offset = np.concatenate([(nothing | self._has)[c.effect] for c in inner.candidates])

    def residuals(self, unknowns: Floats) -> Floats:
        """The effects of the profile are in place of the fitted ones."""
        return self._inner.residuals(np.where(self._offset != 0.0, self._offset, unknowns))

    def leaner(self) -> dict[str, Problem]:
        """See `Problem`."""
        kept = {name: {k: v for k, v in self._has.items() if k != name} for name in self._has}
        return {name: Profiled(self._inner, rest) for name, rest in kept.items()}


def everywhere(**effects: tuple[float, ...]) -> dict[tuple[str, str, str], tuple[float, ...]]:
    places = [(where, block) for where in ("hip", "calf") for block in ("FR", "FL")]
    return {(name, where, block): values for name, values in effects.items() for where, block in places}


@pytest.mark.parametrize("has", SURPLUS.values(), ids=SURPLUS)
@pytest.mark.parametrize("hidden", [{}, {"actuator_lag": (0.006,)}], ids=["nothing", "lag"])
def test_what_the_log_does_not_show_is_said_and_nothing_is_named_in_its_place(
    hidden: dict[str, tuple[float, ...]], has: dict[str, tuple[float, ...]]
) -> None:
    findings = search(Profiled(OneJoint(everywhere(**hidden)), has))
    assert (findings.verdict, findings.effects) == ("unexplained", ())
    assert set(findings.misfits) == set(has)
    assert all(gap.floor == 1.0 for gap in findings.gaps)
    said = sentence(merge([findings]))
    assert all(name in said for name in has)
    assert "lacks" not in said


@pytest.mark.parametrize("has", SURPLUS.values(), ids=SURPLUS)
def test_what_the_log_shows_stays_and_what_is_missing_is_named(has: dict[str, tuple[float, ...]]) -> None:
    hidden = everywhere(**has, actuator_lag=(0.006,))
    findings = search(Profiled(OneJoint(hidden), has))
    assert findings.misfits == ()
    assert [effect.name for effect in findings.effects] == ["actuator_lag"]
    assert search(Profiled(OneJoint(everywhere(**has)), has)).verdict == "no_gap"


def test_an_effect_that_the_profile_has_is_not_said_to_be_lacking() -> None:
    size = Interval(value=0.004, ci90=(0.003, 0.005), unit="s")
    effect = FoundEffect(name="actuator_lag", where="all", params={"time_constant": size})
    verdict = Verdict(verdict="named", effects=(effect,))
    assert sentence(verdict).startswith("the simulator lacks actuator_lag (")
    changed = sentence(verdict, Profile(actuator=(ActuatorLag(time_constant=0.01),)))
    assert changed.startswith(
        "the profile's actuator_lag does not fit the log, while actuator_lag (time_constant 0.004"
    )
