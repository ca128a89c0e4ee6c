"""Searches of logs of joints: an effect that a robot hides is found, an ideal one is not accused."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from joint_logs import DT, motion, noisy, of_one_leg

from saltus.effects.body import BaseRoll
from saltus.effects.effect import Effect
from saltus.effects.encoders import EncoderBias, VelocityScale
from saltus.effects.joint_loads import EndStop, JointSpring
from saltus.real2sim.problem.joints.problem import JointProblem
from saltus.real2sim.search.search import search_effects
from saltus.recordings.run_log import JointTable, RunLog
from saltus.robots.robot import JOINTS

HIDDEN = (
    JointSpring(torque=0.5),
    JointSpring(torque=(0.0, 0.0, 2.0) * 4, stiffness=(0.0, 0.0, 1.0) * 4),
    VelocityScale(scale=1.12),
)


@pytest.mark.slow
@pytest.mark.parametrize("effect", HIDDEN, ids=lambda effect: effect.name)
def test_an_effect_that_a_robot_hides_is_found_by_its_name(effect: Effect[Any]) -> None:
    findings = search_effects(JointProblem(of_one_leg(noisy(motion(effect)))))
    assert (findings.verdict, {found.name for found in findings.effects}) == (
        "named",
        {effect.name},
    )
    found = findings.effects[0]
    joint = 0 if found.where == "all" else JOINTS.index(found.where[0])
    for name, interval in found.params.items():
        true = np.broadcast_to(getattr(effect, name), 12)[joint]
        assert interval.value == pytest.approx(true, rel=0.05, abs=0.02), name


def of_motion(log: RunLog, condition: str) -> RunLog:
    """The rows of one motion."""
    own = [s for s in log.meta["excitation"]["segments"] if s["condition"] == condition]
    kept = (log.joints.time_s > own[0]["t0"] - 0.5 * DT) & (
        log.joints.time_s < own[-1]["t1"] - 0.5 * DT
    )
    values = {f.name: getattr(log.joints, f.name) for f in fields(log.joints)}
    return replace(
        log, joints=JointTable(**{n: None if v is None else v[kept] for n, v in values.items()})
    )


@pytest.mark.slow
def test_a_soft_end_stop_is_found_where_knees_lean_on_it() -> None:
    """0.1 rad before the model's limit, at -0.888 rad."""
    log = motion(EndStop(upper=(np.inf, np.inf, -0.99) * 4, stiffness=250.0), stretched=0.5)
    findings = search_effects(JointProblem(of_one_leg(noisy(log))))
    ((name, where, found),) = [(e.name, e.where, e.params) for e in findings.effects]
    assert (findings.verdict, name, where) == ("named", "end_stop", ("FR_calf",))
    assert found["upper"].value == pytest.approx(-0.99, abs=0.005)
    assert found["stiffness"].value == pytest.approx(250.0, rel=0.1)


@pytest.mark.slow
def test_a_base_that_rolls_is_found() -> None:
    findings = search_effects(
        JointProblem(of_motion(noisy(motion(BaseRoll(give=0.05, damping=0.2))), "chirp"))
    )
    ((name, where, found),) = [(e.name, e.where, e.params) for e in findings.effects]
    assert (findings.verdict, name, where) == ("named", "base_roll", "all")
    assert found["give"].value == pytest.approx(0.05, rel=0.1)
    assert found["damping"].value == pytest.approx(0.2, rel=0.2)


def test_a_base_is_not_accused_where_joints_are_missing() -> None:
    assert "not all joints" in JointProblem(of_one_leg(noisy(motion()))).untestable["base_roll"]


@pytest.mark.slow
def test_an_integral_term_is_no_spring() -> None:
    """It pulls much as one does, and is in no library."""
    findings = search_effects(JointProblem(of_one_leg(noisy(motion(integral=4.0)))))
    assert findings.verdict == "unexplained"
    assert {found.name for found in findings.nearest} == {"joint_spring"}


@pytest.mark.slow
def test_effects_that_a_motion_cannot_tell_apart_come_as_a_set() -> None:
    """A slow motion near one pose asks an encoder bias and a pull for the same torque."""
    slow = of_motion(noisy(motion(EncoderBias(bias=0.1))), "triangle")
    (alike,) = search_effects(JointProblem(of_one_leg(slow))).sets
    assert {"encoder_bias", "joint_spring"} <= set(alike)


@pytest.mark.parametrize("stretched", [0.0, pytest.param(0.5, marks=pytest.mark.slow)])
def test_an_ideal_robot_is_not_accused(stretched: float) -> None:
    """Also where its knees hit the limits that the model claims."""
    assert (
        search_effects(JointProblem(of_one_leg(noisy(motion(stretched=stretched))))).verdict
        == "no_gap"
    )
