"""Laws of the scripted planner over random robots and terrains."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import torch
from samples import KINEMATICS, ROBOT

from benchmarks.planner import bounding
from saltus.arrays import Floats
from saltus.grid import HEIGHTMAP_X, LINE
from saltus.loop.planner import Observation, observe
from saltus.plan import Plan
from saltus.policy.height_line import HeightLine
from saltus.policy.scripted import (
    PITCH_RATE_LIMIT,
    RESIDUAL_HIGH,
    RESIDUAL_LOW,
    VELOCITY_X_LIMIT,
    VELOCITY_Z_LIMIT,
    ScriptedParameters,
    ScriptedPlanner,
)
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.states import standing_state

READ = HeightLine(LINE)
COUNT = 64


def observed(**changes: Any) -> Observation:
    """Of robots that stand level but for what is given."""
    return observe(replace(standing_state(ROBOT), **changes), KINEMATICS)


def observations(rng: np.random.Generator, count: int = COUNT) -> Observation:
    angles = rng.uniform(-0.4, 0.4, (3, count))
    contact = rng.uniform(size=(count, 2)) < 0.5
    progress = rng.uniform(size=(count, 2))
    return observed(
        quaternion_base_in_world=quaternion_from_roll_pitch_yaw(*angles),
        angular_velocity_base=rng.uniform(-6.0, 6.0, (count, 3)),
        joint_position=ROBOT.stand_pose + rng.uniform(-0.4, 0.4, (count, 12)),
        velocity_base_in_world=rng.uniform(-1.0, 2.0, (count, 3)),
        base_height=rng.uniform(0.15, 0.4, count),
        leg_contact=np.repeat(contact, 2, axis=-1),
        leg_progress=np.repeat(progress, 2, axis=-1),
    )


def terrains(rng: np.random.Generator, count: int = COUNT) -> Floats:
    steps = np.cumsum(
        rng.choice([0.0, 0.0, 0.0, 0.0, 0.06, 0.2, -0.4], (count, len(HEIGHTMAP_X))), axis=-1
    )
    return steps - rng.uniform(0.2, 0.35, (count, 1))


def arrays(plan: Plan) -> list[Floats]:
    return [np.asarray(getattr(plan, f.name)) for f in fields(plan)]


def pick(observation: Observation, i: int) -> Observation:
    return Observation(
        **{f.name: np.asarray(getattr(observation, f.name))[i] for f in fields(observation)}
    )


def test_a_batch_gets_what_each_robot_gets_alone() -> None:
    rng = np.random.default_rng(0)
    observation, heights = observations(rng), terrains(rng)
    planner = ScriptedPlanner(ROBOT, LINE)
    together = arrays(planner.step(observation, heights))
    for i in range(COUNT):
        alone = arrays(planner.step(pick(observation, i), heights[i]))
        for batch, single in zip(together, alone, strict=True):
            np.testing.assert_allclose(batch[i], single, atol=1e-12)


def test_parameters_of_its_own_for_each_robot() -> None:
    rng = np.random.default_rng(1)
    observation, heights = observations(rng, 3), terrains(rng, 3)
    speeds, margins = np.array([0.5, 1.0, 1.5]), np.array([0.05, 0.1, 0.15])
    each = ScriptedParameters(velocity_x=speeds, edge_margin_m=margins)
    together = arrays(ScriptedPlanner(ROBOT, LINE, each).step(observation, heights))
    for i in range(3):
        own = ScriptedParameters(velocity_x=float(speeds[i]), edge_margin_m=float(margins[i]))
        alone = arrays(ScriptedPlanner(ROBOT, LINE, own).step(pick(observation, i), heights[i]))
        for batch, single in zip(together, alone, strict=True):
            np.testing.assert_allclose(batch[i], single, atol=1e-12)


def test_the_same_again_and_nothing_is_changed() -> None:
    rng = np.random.default_rng(2)
    observation, heights = observations(rng), terrains(rng)
    before = heights.copy()
    planner = ScriptedPlanner(ROBOT, LINE)
    first, second = planner.step(observation, heights), planner.step(observation, heights)
    for a, b in zip(arrays(first), arrays(second), strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(heights, before)


def test_plans_are_finite_and_within_their_bounds() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        plan = ScriptedPlanner(ROBOT, LINE).step(observations(rng), terrains(rng))
        assert all(np.isfinite(values).all() for values in arrays(plan))
        assert np.all((plan.stepping_frequency_hz >= 0.5) & (plan.stepping_frequency_hz <= 4.0))
        assert np.all(np.abs(plan.velocity_x) <= VELOCITY_X_LIMIT)
        assert np.all(np.abs(plan.velocity_z) <= VELOCITY_Z_LIMIT)
        assert np.all(np.abs(plan.pitch_rate) <= PITCH_RATE_LIMIT)
        for residual in (plan.foot_residual_front, plan.foot_residual_rear):
            assert np.all((residual >= RESIDUAL_LOW) & (residual <= RESIDUAL_HIGH))


@pytest.mark.parametrize("rise", [0.0, 0.06, 0.12])
@pytest.mark.parametrize("progress", [0.45, 0.55])
def test_a_foot_in_mid_swing_clears_a_step_on_its_way(rise: float, progress: float) -> None:
    """Seen from a level robot at 1 m/s with a step ahead of its front feet."""
    base_height = 0.28
    observation = bounding(ROBOT, base_height, (False, True), (progress, 0.7))
    heights = np.where(HEIGHTMAP_X > 0.25, rise, 0.0) - base_height
    # where the rear feet stand they feel the ground exactly where the heightmap has it
    heights = heights + base_height + observation.foot[2, 2] - ROBOT.foot_radius
    plan = ScriptedPlanner(ROBOT, LINE).step(observation, heights)
    # The nominal swing is at -base_height
    sole = -base_height + plan.foot_residual_front[2] - ROBOT.foot_radius
    assert sole >= heights[HEIGHTMAP_X < 0.4].max() + 0.02


def test_a_foot_does_not_aim_into_a_trench() -> None:
    observation = bounding(ROBOT, 0.28, (False, True), (0.2, 0.5))
    flat = np.full(len(HEIGHTMAP_X), -0.28)
    planner = ScriptedPlanner(ROBOT, LINE)
    level = planner.step(observation, flat).foot_residual_front[0]
    neutral = _landing_x(planner, observation)
    for ahead in (-0.08, 0.0, 0.08):
        trench = flat - 0.4 * (np.abs(HEIGHTMAP_X - neutral - ahead) < 0.06)
        landing = neutral + planner.step(observation, trench).foot_residual_front[0] - level
        assert READ.height_at(trench, np.array([landing]))[0] > -0.35


def _landing_x(planner: ScriptedPlanner, observation: Observation) -> float:
    """Where the front feet land on level ground, relative to the base now."""
    p = planner.parameters
    speed, frequency = float(observation.velocity[0]), float(p.stepping_frequency_hz)
    remaining = (1.0 - float(observation.progress[0])) * 0.6 / frequency
    return float(
        ROBOT.hip_anchor[0, 0]
        + 0.5 * speed * 0.4 / frequency
        + p.front_landing_x
        + speed * remaining
    )


def test_reading_a_profile() -> None:
    rng = np.random.default_rng(4)
    heights = terrains(rng)
    for i in range(len(HEIGHTMAP_X)):
        exact = READ.height_at(heights, np.full((COUNT, 1), HEIGHTMAP_X[i]))[:, 0]
        np.testing.assert_allclose(exact, heights[:, i], atol=1e-9)
    x = rng.uniform(-0.6, 1.0, (COUNT, 5))
    expected = np.stack([np.interp(x[i], HEIGHTMAP_X, heights[i]) for i in range(COUNT)])
    np.testing.assert_allclose(READ.height_at(heights, x), expected, atol=1e-9)
    start, end = x[:, 0], x[:, 1]
    between = READ.height_at(heights, np.linspace(start, end, 2000, axis=-1)).max(axis=-1)
    highest = READ.highest_between(heights, start, end)
    assert np.all(highest >= between - 1e-9)
    assert np.all(highest <= between + 0.01)
    line = 0.3 * HEIGHTMAP_X + np.array([[-0.3], [0.1]])
    np.testing.assert_allclose(READ.slope(line, -0.2, 0.5), 0.3)


def test_numpy_and_torch_plan_alike() -> None:
    rng = np.random.default_rng(5)
    observation, heights = observations(rng), terrains(rng)
    tensors = {
        f.name: torch.as_tensor(np.asarray(getattr(observation, f.name)))
        for f in fields(observation)
    }
    planner = ScriptedPlanner(ROBOT, LINE)
    expected = arrays(planner.step(observation, heights))
    got = arrays(planner.step(Observation(**tensors), torch.as_tensor(heights)))
    for a, b in zip(expected, got, strict=True):
        np.testing.assert_allclose(b, a, atol=1e-9)


def test_a_larger_robot_bounds_alike_in_proportion() -> None:
    rng = np.random.default_rng(6)
    length, mass = 1.2, 2.0
    larger = replace(
        ROBOT, thigh_length=ROBOT.thigh_length * length, calf_length=ROBOT.calf_length * length,
        hip_anchor=ROBOT.hip_anchor * length, foot_radius=ROBOT.foot_radius * length,
        trunk_mass=ROBOT.trunk_mass * mass, link_mass=ROBOT.link_mass * mass,
        inertia=ROBOT.inertia * mass * length**2, foot_force=ROBOT.foot_force * mass,
        landing_reach=ROBOT.landing_reach * length,
    )  # fmt: skip
    time = length**0.5
    speed = length / time
    seen = replace(observations(rng), velocity=rng.uniform(0.0, 1.0, (COUNT, 3)))
    seen_larger = replace(
        seen, velocity=seen.velocity * speed, angular_velocity=seen.angular_velocity / time,
        base_height=seen.base_height * length, foot=seen.foot * length,
    )  # fmt: skip
    level = np.repeat(-seen.base_height[:, None], len(HEIGHTMAP_X), axis=1)
    small, large = ScriptedPlanner(ROBOT, LINE), ScriptedPlanner(larger, LINE)
    expected, got = small.step(seen, level), large.step(seen_larger, length * level)
    free = np.abs(expected.pitch_rate) < 5.99  # bounds of actions do not grow
    np.testing.assert_allclose(got.stepping_frequency_hz, expected.stepping_frequency_hz / time)
    np.testing.assert_allclose(got.velocity_x, expected.velocity_x * speed)
    np.testing.assert_allclose(got.velocity_z, expected.velocity_z * speed, atol=1e-12)
    np.testing.assert_allclose(got.pitch_rate[free], expected.pitch_rate[free] / time, atol=1e-12)
    np.testing.assert_allclose(
        got.foot_residual_rear[:, 0], expected.foot_residual_rear[:, 0] * length, atol=1e-12
    )
