"""Laws of the compiled tick: it is the tick on numpy,
over robots of every mode and phase of the gait.
"""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from samples import ROBOT

from benchmarks.qp import row
from saltus.arrays import Constant
from saltus.controller.compensation import Compensation
from saltus.controller.gait import GaitState
from saltus.controller.tick import CompiledTickLaw, TickLaw
from saltus.plan import REST
from saltus.wire.messages import ControllerMode

DRAWN = 500
"""Robots of each of the six modes."""
COMPENSATION = Compensation(
    gain=Constant(np.linspace(0.8, 1.1, 12)),
    damping=Constant(np.full(12, 0.1)),
    torque_limit=Constant(ROBOT.torque_limit),
)
TICK = TickLaw(ROBOT)


@pytest.fixture(scope="module")
def compiled():
    return CompiledTickLaw(ROBOT)


def assert_near(one, other, where=""):
    """The largest difference of each array is below 1e-9 of its greatest entry, or of 1.

    All else is equal.
    """
    if is_dataclass(one):
        for field in fields(one):
            assert_near(
                getattr(one, field.name), getattr(other, field.name), f"{where}.{field.name}"
            )
    elif isinstance(one, np.ndarray | float):
        one, other = np.asarray(one), np.asarray(other)
        assert (one.shape, one.dtype) == (other.shape, other.dtype), where
        scale = max(1.0, np.max(np.abs(1.0 * one)))
        assert np.max(np.abs(1.0 * one - other)) < 1e-9 * scale, where
    else:
        assert one == other, where


def draw_states(rng, count, mode):
    """Law states at any phase, grounds and estimates."""
    law = TICK.law.init((count,), ROBOT.stand_pose)
    ground = TICK.braking.init(law.liftoff + rng.uniform(-0.1, 0.1, (count, 4, 3)))
    estimate = TICK.estimator.init((count,), ROBOT.stand_pose)
    changed = replace(
        law,
        gait=GaitState(phase=rng.uniform(0.0, 3.0, count)),
        liftoff=law.liftoff + rng.uniform(-0.1, 0.1, (count, 4, 3)),
        landed=rng.random((count, 4)) < 0.5,
        mode=mode,
        blend_from=law.blend_from + rng.uniform(-0.3, 0.3, (count, 12)),
        mode_time_s=rng.uniform(0.0, 1.5),
    )
    return changed, ground, replace(estimate, mean=rng.uniform(-1.0, 1.0, (count, 4)))


def row_of(value, k):
    """Robot `k` of a batch, in whatever depth its arrays are."""
    if is_dataclass(value):
        return replace(value, **{f.name: row_of(getattr(value, f.name), k) for f in fields(value)})
    return value[k] if isinstance(value, np.ndarray) and value.ndim else value


def assert_acts_alike(tick, other, rng, count, draw, before, mode):
    """One robot at a time as all of them at once."""
    plans, robots = draw(rng, (count,))
    law, ground, _ = draw_states(rng, count, before)
    together = tick.act(plans, robots, law, ground, mode)
    for k in range(count):
        alone = other.act(row(plans, k), row(robots, k), row_of(law, k), row_of(ground, k), mode)
        assert_near(row_of(together, k), alone, f"{mode.name}, robot {k}: ")


@pytest.mark.sample(4)
@pytest.mark.parametrize("mode", [*ControllerMode])
def test_the_compiled_law_is_the_law(mode, draw, compiled):
    assert_acts_alike(TICK, compiled, np.random.default_rng(mode), DRAWN, draw, mode, mode)


def test_the_compiled_estimator_is_the_estimator(draw, compiled):
    rng = np.random.default_rng(6)
    _, robots = draw(rng, (DRAWN,))
    _, _, estimate = draw_states(rng, DRAWN, ControllerMode.RUN)
    trusted = rng.random((DRAWN, 4)) < 0.6
    together = TICK.sense(robots, trusted, estimate)
    for k in range(DRAWN):
        assert_near(
            row_of(together, k),
            compiled.sense(row(robots, k), trusted[k], row_of(estimate, k)),
            f"robot {k}: ",
        )


def test_the_compiled_reference_of_a_plan_is_the_reference_to_the_bit(compiled):
    rng = np.random.default_rng(11)
    for _ in range(DRAWN):
        plan = replace(
            REST, **{k: np.asarray(rng.normal(size=v.shape)) for k, v in vars(REST).items()}
        )
        heading = np.asarray(rng.uniform(-4.0, 4.0))
        one, other = TICK.reference(plan, heading), compiled.reference(plan, heading)
        for name, value in vars(one).items():
            np.testing.assert_array_equal(value, getattr(other, name), err_msg=name, strict=True)


def test_the_compiled_braking_is_the_braking(draw, compiled):
    rng = np.random.default_rng(12)
    plans, robots = draw(rng, (DRAWN,))
    law, ground, _ = draw_states(rng, DRAWN, ControllerMode.RUN)
    last = TICK.act(plans, robots, law, ground, ControllerMode.RUN)
    height, heading = rng.uniform(0.1, 0.5, DRAWN), rng.uniform(-4.0, 4.0, DRAWN)
    brakes, catches = TICK.brakes(last, height, heading, ground), TICK.catches(plans, ground)
    for k in range(DRAWN):
        given = row_of(last, k), np.asarray(height[k]), np.asarray(heading[k]), row_of(ground, k)
        assert_near(row_of(brakes, k), compiled.brakes(*given), f"robot {k}: ")
        caught = compiled.catches(row(plans, k), row_of(ground, k))
        assert_near(row_of(catches, k), caught, f"robot {k}, caught: ")


def test_what_is_known_of_drives_is_taken_out(draw):
    tick, compiled = TickLaw(ROBOT, COMPENSATION), CompiledTickLaw(ROBOT, COMPENSATION)
    mode = ControllerMode.RUN
    assert_acts_alike(tick, compiled, np.random.default_rng(7), 100, draw, mode, mode)


def test_fast_joints_are_braked_alike(draw):
    braked = replace(ROBOT, gains=replace(ROBOT.gains, brake_kd=8.0), speed_limit=np.full(12, 3.0))
    tick, compiled = TickLaw(braked), CompiledTickLaw(braked)
    mode = ControllerMode.RUN
    assert_acts_alike(tick, compiled, np.random.default_rng(10), 100, draw, mode, mode)


def test_knees_of_fast_robots_are_bent_alike(draw):
    bent = replace(ROBOT, gains=replace(ROBOT.gains, landing_bend=1.4))
    tick, compiled = TickLaw(bent), CompiledTickLaw(bent)
    mode = ControllerMode.RUN
    assert_acts_alike(tick, compiled, np.random.default_rng(11), 100, draw, mode, mode)


@pytest.mark.parametrize("mode", [*ControllerMode])
def test_a_change_of_mode_is_that_of_the_reference(mode, draw, compiled):
    for before in ControllerMode:
        assert_acts_alike(TICK, compiled, np.random.default_rng(8), 3, draw, before, mode)


@pytest.mark.parametrize("broken", [np.nan, np.inf])
def test_readings_that_are_no_numbers_are_told(broken, draw, compiled):
    rng = np.random.default_rng(9)
    _, robots = draw(rng, (1,))
    _, _, estimate = draw_states(rng, 1, ControllerMode.RUN)
    states = replace(row(robots, 0), joint_position=np.full(12, broken))
    with np.errstate(all="ignore"):
        assert not np.isfinite(
            compiled.sense(states, np.ones(4, dtype=np.bool_), row_of(estimate, 0)).total
        )
