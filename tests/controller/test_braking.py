"""From the scripted planner's fastest gait to a stand,
at every phase, with and without a word of the planner.
"""

from copy import deepcopy
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
import torch
from samples import KINEMATICS, PROFILE, ROBOT, setup_of

from saltus.config import TerrainConfig
from saltus.constants import PHYSICS_DT, POLICY_STEPS
from saltus.controller.braking import Braking, BrakingState
from saltus.controller.control_loop import FIRST_STAND_S, ControlLoop
from saltus.controller.leg_controller import LegController
from saltus.controller.robot.mujoco import MujocoRobot
from saltus.grid import LINE
from saltus.loop.planner import observe
from saltus.plan import REST, plan_message
from saltus.policy.scripted import ScriptedPlanner
from saltus.trial import Trial
from saltus.wire.messages import ControllerMode, PlanStatus

BRAKING = Braking(ROBOT)
LAW = LegController(ROBOT)
PLANNER = ScriptedPlanner(ROBOT, LINE)
CYCLE_S = 1.0 / float(PLANNER.parameters.stepping_frequency_hz)
PHASES = np.arange(0.0, 1.0, 0.1)


@cache
def at_full_speed(silent):
    """A trial at every second phase of a bound: robot, loop and last plan, by the phase's number.

    Where the planner is to fall silent the odd phases. Plans see true heights.
    """
    trial = Trial.draw(seed=silent)
    robot = MujocoRobot(setup_of(TerrainConfig(terrain="flat"), trial, PROFILE))
    robot.reset()
    loop, plan, found = ControlLoop(ROBOT), None, {}
    ends = {
        round((FIRST_STAND_S + 1.4 + PHASES[phase] * CYCLE_S) / PHYSICS_DT): phase
        for phase in range(int(silent), len(PHASES), 2)
    }
    for tick in range(max(ends) + 1):
        if tick in ends:
            loop.take_joint_log(0, 0)  # of the ticks so far: most of what a copy would have to copy
            found[ends[tick]] = deepcopy((robot, loop, plan))
        loop.sense(robot.read())
        late = tick % POLICY_STEPS
        if late == 0:
            heights = robot.truth(0, 0).height
            plan = plan_message(
                PLANNER.step(observe(loop.state(0, 0), KINEMATICS), heights), PlanStatus.GO
            )
        robot.write(loop.act(plan, late * PHYSICS_DT))
    return found


def stop(robot, loop, plan, seconds):
    """The last plan grows old, or says STOP.

    Returns what the controller did, with the time at which it began.
    """
    silent = plan.status == PlanStatus.GO
    modes = {}
    for tick in range(round(seconds / PHYSICS_DT)):
        loop.sense(robot.read())
        robot.write(loop.act(plan, tick * PHYSICS_DT if silent else 0.0))
        modes.setdefault(loop.mode, tick * PHYSICS_DT)
    return modes


@pytest.mark.sample(1)
@pytest.mark.parametrize("phase", range(len(PHASES)), ids=[f"{phase:.1f}" for phase in PHASES])
def test_comes_to_a_stand_from_full_speed_at_any_phase_of_the_gait(phase):
    silent = phase % 2 == 1
    robot, loop, plan = deepcopy(at_full_speed(silent)[phase])
    assert robot.state.velocity_base_in_world[0] > 1.2
    robot.take_trunk_contact()

    # Landing 1.1 s, blend 1 s
    modes = stop(robot, loop, plan if silent else plan_message(REST, PlanStatus.STOP), 2.4)

    order = [ControllerMode.LANDING, ControllerMode.STOPPED]
    assert list(modes) == ([ControllerMode.RUN, ControllerMode.COAST, *order] if silent else order)
    assert modes[ControllerMode.STOPPED] - modes[ControllerMode.LANDING] < 1.1 + 2 * PHYSICS_DT
    state = robot.state
    assert state.position_base_in_world[2] > 0.24
    assert np.linalg.norm(state.velocity_base_in_world) < 0.1
    assert (state.foot_force > 1.0).all()
    assert not robot.take_trunk_contact()


def robots(draw, rng, batch, **changes):
    """Diagnostics of robots that bound, and their memory of the ground."""
    plan, sensed = draw(rng, batch)
    sensed = replace(
        sensed, **{name: np.broadcast_to(value, batch) for name, value in changes.items()}
    )
    state = LAW.init(batch, sensed.joint_position)
    state = replace(
        state, gait=replace(state.gait, phase=rng.uniform(1.0, 3.0, batch)), mode=ControllerMode.RUN
    )
    diagnostics = LAW.step(plan, sensed, state)[2]
    return diagnostics, sensed, plan


def as_tensors(value):
    if isinstance(value, np.ndarray):
        return torch.as_tensor(value)
    return type(value)(**{f.name: as_tensors(getattr(value, f.name)) for f in fields(value)})


def test_plans_of_a_batch_are_those_of_numpy_and_torch_and_of_each_robot(draw):
    rng = np.random.default_rng(21)
    diagnostics, sensed, plan = robots(draw, rng, (16,))
    state = BRAKING.observe(
        diagnostics, BrakingState(foothold=diagnostics.body.foot_yaw + rng.normal(0, 0.1, (4, 3)))
    )
    ours = BRAKING.reference(diagnostics, sensed.base_height, plan.heading, state)
    inputs = [as_tensors(value) for value in (diagnostics, sensed.base_height, plan.heading, state)]
    theirs = BRAKING.reference(*inputs)
    for field in fields(ours):
        value = getattr(ours, field.name)
        assert np.isfinite(value).all()
        np.testing.assert_allclose(getattr(theirs, field.name).numpy(), value, atol=1e-9)


def test_asks_for_rest_and_pushes_against_the_slope(draw):
    rng = np.random.default_rng(22)
    diagnostics, sensed, plan = robots(draw, rng, (64,))
    feet = np.array(
        [[0.19, -0.13, -0.3], [0.19, 0.13, -0.3], [-0.19, -0.13, -0.3], [-0.19, 0.13, -0.3]]
    )
    level = BrakingState(foothold=np.broadcast_to(feet, (64, 4, 3)))
    uphill = BrakingState(
        foothold=level.foothold + 0.2 * level.foothold[..., :1] * np.array([0.0, 0.0, 1.0])
    )
    flat = BRAKING.reference(diagnostics, sensed.base_height, plan.heading, level)
    steep = BRAKING.reference(diagnostics, sensed.base_height, plan.heading, uphill)
    assert (flat.velocity[:, :2] == 0.0).all()
    # Nose up
    np.testing.assert_allclose(
        flat.angular_velocity[:, 1] - steep.angular_velocity[:, 1], BRAKING.config.pitch_gain * 0.2
    )
    np.testing.assert_allclose(BRAKING.catching(plan, level).foot_residual, 0.0, atol=1e-12)
    rise = BRAKING.catching(plan, uphill).foot_residual[..., 2]
    np.testing.assert_allclose(
        rise, np.broadcast_to(0.2 * 0.1881 * np.array([1, 1, -1, -1]), (64, 4))
    )


def test_a_standing_foot_is_where_it_is_and_a_swinging_one_stays_behind(draw):
    rng = np.random.default_rng(23)
    diagnostics, _, _ = robots(draw, rng, (64,))
    before = BrakingState(foothold=rng.normal(0.0, 0.2, (64, 4, 3)))
    after = BRAKING.observe(diagnostics, before).foothold
    trusted = diagnostics.gait.trusted
    assert trusted.any()
    assert not trusted.all()
    np.testing.assert_array_equal(after[trusted], diagnostics.body.foot_yaw[trusted])
    moved = before.foothold - diagnostics.body.velocity[:, None] * PHYSICS_DT
    np.testing.assert_allclose(after[~trusted], moved[~trusted])
