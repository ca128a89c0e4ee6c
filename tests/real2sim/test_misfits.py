"""A profile with effects that the robot does not have:
no name stands for them, and the verdict says which they are.
"""

from collections.abc import Mapping

import numpy as np
import pytest
from one_joint import WHERES, OneJoint

from saltus.arrays import Floats
from saltus.effects.motors import ActuatorLag, TorqueSpeedLimit
from saltus.effects.profile import Profile
from saltus.real2sim.problem.problem import Problem, WrappedProblem
from saltus.real2sim.reporting.verdict_text import verdict_sentence
from saltus.real2sim.search.findings import FoundEffect, ParameterInterval
from saltus.real2sim.search.search import search_effects
from saltus.real2sim.stacked_problem import RebasedProblem
from saltus.real2sim.verdict import ResidualGap, Verdict, merge_findings
from saltus.robots.robot import JOINTS

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
    return {
        (name, where, block): values for name, values in effects.items() for where, block in places
    }


OPEN = ResidualGap(before=2.0, after=2.0, floor=1.0)
REACHED = 28.0  # rad/s, by the pendulums
LAG = {"actuator_lag": (0.006,)}


@pytest.mark.sample(1)
@pytest.mark.parametrize("has", SURPLUS.values(), ids=SURPLUS)
@pytest.mark.parametrize("known", [{}, LAG], ids=["lag is missing", "lag is known"])
def test_what_the_log_does_not_show_is_said_and_nothing_is_named_in_its_place(
    known: dict[str, tuple[float, ...]], has: dict[str, tuple[float, ...]]
) -> None:
    findings = search_effects(Profiled(OneJoint(everywhere(**LAG)), {**has, **known}))
    assert (findings.verdict, findings.effects) == ("unexplained", ())
    assert set(findings.misfits) == set(has)
    assert all(gap.floor == min(1.0, gap.after) for gap in findings.gaps)
    said = verdict_sentence(merge_findings([findings]))
    assert all(name in said for name in has)
    assert "lacks" not in said


@pytest.mark.sample(1)
@pytest.mark.parametrize("has", SURPLUS.values(), ids=SURPLUS)
def test_what_the_log_shows_stays_and_what_is_missing_is_named(
    has: dict[str, tuple[float, ...]],
) -> None:
    hidden = everywhere(**has, actuator_lag=(0.006,))
    findings = search_effects(Profiled(OneJoint(hidden), has))
    assert findings.misfits == ()
    assert [effect.name for effect in findings.effects] == ["actuator_lag"]
    assert search_effects(Profiled(OneJoint(everywhere(**has)), has)).verdict == "no_gap"


@pytest.mark.sample(3)
@pytest.mark.parametrize("known", [{}, LAG], ids=["lag is missing", "lag is known"])
@pytest.mark.parametrize("limits", [(0.0, 12.0), (0.0, 24.0), (29.0, 60.0), (0.0, 100.0)])
def test_a_limit_that_the_robot_lacks_is_a_misfit_or_where_no_motion_reaches_it_untestable_but_never_named(
    limits: tuple[float, float], known: dict[str, tuple[float, ...]]
) -> None:
    """A limit that is moved beyond explains the motion as well as none.

    The last one no replay can hold.
    """
    limit = TorqueSpeedLimit(corner=limits[0], no_load=limits[1])
    pendulums = Profiled(OneJoint(everywhere(**LAG), fast=True), known)
    findings = search_effects(RebasedProblem(pendulums, Profile(actuator=(limit,))))
    assert limit.name not in {effect.name for effect in findings.effects}
    if limits[1] < REACHED:
        assert (findings.verdict, findings.misfits) == ("unexplained", (limit.name,))
        assert limit.name not in findings.untestable
    else:
        assert (findings.verdict, findings.misfits) == ("no_gap" if known else "named", ())
        assert limit.name in findings.untestable.keys() - findings.minimum_detectable.keys()


@pytest.mark.sample(1)
@pytest.mark.parametrize("known", [{}, LAG], ids=["lag is missing", "lag is known"])
def test_a_limit_that_the_robot_has_stays(known: dict[str, tuple[float, ...]]) -> None:
    pendulums = Profiled(
        OneJoint(everywhere(torque_speed_limit=(1.0, 0.0, 24.0), **LAG), fast=True), known
    )
    findings = search_effects(
        RebasedProblem(pendulums, Profile(actuator=(TorqueSpeedLimit(corner=0.0, no_load=24.0),)))
    )
    assert (findings.verdict, findings.misfits) == ("no_gap" if known else "named", ())
    assert [effect.name for effect in findings.effects] == ([] if known else ["actuator_lag"])


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "had", [(16.0, 16.0, 12.0) * 4, ((16.0,) * 3 + (12.0,) * 3) * 2], ids=["kinds", "legs"]
)
def test_values_are_stated_as_they_are_at_each_place_also_where_those_of_the_profile_differ(
    had: tuple[float, ...],
) -> None:
    """A limit that lies 3 rad/s higher everywhere is not the same limit everywhere."""
    there = {
        f"{block}_{where}": had[JOINTS.index(f"{block}_{where}")]
        for where in WHERES
        for block in ("FR", "FL")
    }
    hidden = {
        ("torque_speed_limit", place[3:], place[:2]): (1.0, 0.0, no_load + 3.0)
        for place, no_load in there.items()
    }
    profile = Profile(actuator=(TorqueSpeedLimit(corner=0.0, no_load=had),))
    findings = search_effects(RebasedProblem(OneJoint(hidden, fast=True), profile))
    stated = {
        place: effect.params["no_load"].value
        for effect in findings.effects
        for place in effect.where
    }
    assert stated == {
        place: pytest.approx(no_load + 3.0, rel=0.05) for place, no_load in there.items()
    }


def test_an_effect_that_the_profile_has_is_not_said_to_be_lacking() -> None:
    size = ParameterInterval(value=0.004, ci90=(0.003, 0.005), unit="s")
    effect = FoundEffect(name="actuator_lag", where="all", params={"time_constant": size})
    verdict = Verdict(verdict="named", effects=(effect,), gap=OPEN)
    assert verdict_sentence(verdict).startswith("the simulator lacks actuator_lag (")
    changed = verdict_sentence(verdict, Profile(actuator=(ActuatorLag(time_constant=0.01),)))
    assert changed.startswith(
        "the profile's actuator_lag does not fit the log, while actuator_lag (time_constant 0.004"
    )


def test_an_effect_is_said_once_however_many_joints_have_values_of_their_own() -> None:
    effects = tuple(
        FoundEffect(
            name="torque_saturation",
            where=joint,
            params={"knee": ParameterInterval(value=8.0 + k, ci90=(7.0, 21.0), unit="Nm")},
        )
        for k, joint in enumerate(JOINTS)
    )
    assert verdict_sentence(Verdict(verdict="named", effects=effects, gap=OPEN)) == (
        "the simulator lacks torque_saturation (knee 8 to 19 Nm; 12 joints)."
    )
    two = verdict_sentence(Verdict(verdict="named", effects=effects[:2], gap=OPEN))
    assert two == "the simulator lacks torque_saturation (knee 8 to 9 Nm; FR_hip, FR_thigh)."
