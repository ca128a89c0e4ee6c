"""A finer replay, which an effect brings with it, is no evidence for the effect."""

import numpy as np
import pytest
from effect_sizes import sizes
from joint_logs import motion, noisy, of_one_leg
from linear_problem import LinearProblem

from saltus.arrays import Floats
from saltus.effects.motors import TorqueGain
from saltus.effects.profile import Profile
from saltus.real2sim.problem.joints.problem import JointProblem
from saltus.real2sim.problem.problem import Candidate, Problem
from saltus.real2sim.search.search import search_effects
from saltus.real2sim.stacked_problem import RebasedProblem, StackedProblem

ROUGH = 1.5
"""Error of a replay in long steps [sigma]."""


class LongStepsProblem(LinearProblem):
    """Models without e3 are replayed in long steps, unless all of them are replayed alike."""

    _is_fine = False

    def residuals(self, unknowns: Floats) -> Floats:
        e3 = np.array([name.startswith("e3.") for name in self.names])
        is_rough = ~np.any(unknowns[..., e3] != 0.0, axis=(1, 2)) & (not self._is_fine)
        error = ROUGH * np.cos(2.0 * np.pi * 5.3 * self.time_s)
        return super().residuals(unknowns) + is_rough[:, None, None] * error

    def replayed_alike(self, effects: tuple[str, ...]) -> Problem:
        if "e3" not in effects or self._is_fine:
            return self
        alike = LongStepsProblem({})
        alike.measured, alike.candidates, alike._is_fine = self.measured, self.candidates, True
        return alike


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("effect", ["e0", "e1", "e2", "e4", "e5"])
def test_no_effect_is_named_for_the_finer_replay_that_comes_with_it(effect: str, seed: int) -> None:
    findings = search_effects(LongStepsProblem(sizes(effect, 6.0), seed=seed))
    assert (findings.verdict, {found.name for found in findings.effects}) == ("named", {effect})


@pytest.mark.parametrize("effect", ["e0", "e1", "e2", "e4", "e5"])
def test_an_effect_that_is_replayed_in_finer_steps_is_named_where_it_is_there(effect: str) -> None:
    findings = search_effects(LongStepsProblem(sizes(effect, 6.0) | sizes("e3", 4.0)))
    assert {found.name for found in findings.effects} == {effect, "e3"}


def values(candidate: Candidate) -> list[float]:
    """Unknowns of an effect of little more than the least size that matters."""
    return [
        start if u.is_shape else u.stated or (0.4 if candidate.is_nuisance else 0.8 * u.scale)
        for u, start in zip(candidate.unknowns, candidate.starts[0], strict=True)
    ]


def beside_play(problem: Problem, effect: str) -> Floats:
    """Unknowns with an effect alone, and with it and play of almost no width."""
    own = [values(c) if c.effect == effect else list(c.absent) for c in problem.candidates]
    sets = np.tile(np.concatenate(own), (2, len(problem.blocks), 1))
    sets[1][:, [name == "backlash.width" for name in problem.names]] = 1e-12
    return sets


def test_play_of_no_width_changes_nothing_beside_any_effect_where_all_is_replayed_alike() -> None:
    """In longer steps a delay of less than one of them changes by several sigma."""
    joints = JointProblem(of_one_leg(noisy(motion())))
    profile = Profile(actuator=(TorqueGain(gain=0.9),))
    wrapped = (
        joints,
        RebasedProblem(joints, profile),
        StackedProblem([joints, joints], (0.0, 20.0)),
    )
    for problem in wrapped:
        assert problem.replayed_alike(("command_delay",)) is problem
        alike = problem.replayed_alike(("backlash", "command_delay"))
        assert alike is not problem
        assert alike.replayed_alike(("backlash",)) is alike
        effects = {c.effect for c in problem.candidates} - {"backlash"}
        for effect in effects if problem is joints else ("command_delay",):
            without, beside = alike.residuals(beside_play(alike, effect))
            assert beside == pytest.approx(without, abs=1e-6), effect
