"""The closed loop with real physics: the robot bounds, and a batch is made of single robots."""

from collections import deque
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from robots.odd_robot import odd_mjcf
from samples import PROFILE, ROBOT, setups_of

from saltus.arrays import Floats
from saltus.config import TerrainConfig
from saltus.effects.imu import ImuBias
from saltus.grid import HEIGHTMAP_X, LINE
from saltus.loop.heights import exact_heights
from saltus.loop.loop import Loop
from saltus.loop.planner import Observation
from saltus.plan import Plan
from saltus.policy.scripted import ScriptedPlanner
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Trial

FLAT = make_terrain(TerrainConfig(terrain="flat"))


@pytest.fixture
def odd(tmp_path: Path) -> Robot:
    """Twice as heavy, with legs half as long again."""
    path = tmp_path / "odd.xml"
    path.write_text(odd_mjcf())
    return load_robot(str(path))


@pytest.mark.slow
def test_four_robots_bound_two_metres_of_flat_ground() -> None:
    _bound(ROBOT)


def test_another_robot_bounds_with_laws_scaled_to_its_size(odd: Robot) -> None:
    _bound(odd)


def _bound(robot: Robot) -> None:
    trials = [Trial.draw(seed) for seed in range(4)]
    rollout = Loop(
        setups_of([FLAT] * 4, trials, robot=robot), ScriptedPlanner(robot, LINE), stand_steps=30
    )
    start = None
    flying = np.zeros(4)
    for step in (rollout.step() for _ in range(330)):
        assert step.running.all(), [outcome for outcome in rollout.outcomes if outcome]
        start = step.truth.position_base_in_world if start is None else start
        flying += (step.truth.foot_force < 1.0).all(axis=-1)
        way = step.truth.position_base_in_world - start
        if (way[:, 0] > 2.0).all():
            break
    assert (way[:, 0] > 2.0).all()
    assert (np.abs(way[:, 1]) < 0.3).all()
    assert (flying > 10).all()  # a bound has flight phases


def test_a_batch_is_made_of_single_robots() -> None:
    trials = [Trial.draw(seed) for seed in (5, 6)]
    terrains = [FLAT, make_terrain(TerrainConfig(terrain="stairs"))]
    together = Loop(setups_of(terrains, trials), ScriptedPlanner(ROBOT, LINE), stand_steps=5)
    alone = [
        Loop(setups_of([terrains[i]], [trials[i]]), ScriptedPlanner(ROBOT, LINE), stand_steps=5)
        for i in range(2)
    ]
    for _ in range(25):
        batch = together.step()
        for i, rollout in enumerate(alone):
            single = rollout.step()
            for f in fields(batch.states):
                expected = np.asarray(getattr(single.states, f.name))
                got = np.asarray(getattr(batch.states, f.name))
                np.testing.assert_allclose(
                    got[i] if got.ndim else got, expected[0] if got.ndim else expected, atol=1e-9
                )


def test_whoever_is_done_starts_again_and_no_longer_counts() -> None:
    rollout = Loop(
        setups_of([FLAT] * 2, [Trial.draw(0), Trial.draw(1)]),
        ScriptedPlanner(ROBOT, LINE),
        stand_steps=0,
        time_limit_s=0.1,
    )
    steps = [rollout.step() for _ in range(14)]
    assert all(
        outcome is not None and outcome.cause == "time_limit" for outcome in rollout.outcomes
    )
    fresh = [i for i, step in enumerate(steps) if step.fresh.all()]
    assert len(fresh) == 2
    assert fresh[0] == 0
    assert all(step.running.all() for step in steps[: fresh[1]])
    assert not any(step.running.any() for step in steps[fresh[1] :])


class LatePlanner:
    """Answers with what another planner said some steps ago."""

    def __init__(self, steps: int) -> None:
        self._planner = ScriptedPlanner(ROBOT, LINE)
        self._said: deque[Plan] = deque(maxlen=steps + 1)

    def step(self, observation: Observation, heights: Floats, fresh: object = False) -> Plan:
        del fresh
        self._said.append(self._planner.step(observation, heights))
        return self._said[0]


@pytest.mark.sample(2)
@pytest.mark.parametrize("steps", [1, 2, 3, 0])
def test_a_delay_of_plans_by_whole_steps_is_a_planner_that_answers_later(steps: int) -> None:
    trials = [Trial.draw(seed) for seed in (5, 6)]
    late = Loop(setups_of([FLAT] * 2, trials), LatePlanner(steps), stand_steps=5)
    delayed = Loop(
        setups_of([FLAT] * 2, trials),
        ScriptedPlanner(ROBOT, LINE),
        stand_steps=5,
        plan_delay_s=0.010 * steps,
    )
    for _ in range(30):
        expected, got = late.step(), delayed.step()
        np.testing.assert_array_equal(got.states.joint_position, expected.states.joint_position)


def test_the_law_holds_the_heading_that_the_imu_says() -> None:
    """As in the deployed loop: a gyroscope that reads too much is believed
    by law and planner alike.
    """
    drifting = replace(PROFILE, imu=(ImuBias(gyro_z=0.3),))
    rates = []
    for profile in (PROFILE, drifting):
        rollout = Loop(
            setups_of([FLAT], [Trial()], profile), ScriptedPlanner(ROBOT, LINE), stand_steps=5
        )
        rates.append(np.mean([rollout.step().truth.angular_velocity_base[0, 2] for _ in range(60)]))
    assert rates[1] < rates[0] - 0.05


def test_plans_that_are_late_by_part_of_a_step_hold_for_the_rest_of_it() -> None:
    ends = []
    for delay_s in (0.0, 0.002, 0.004, 0.006, 0.008, 0.010):
        rollout = Loop(
            setups_of([FLAT], [Trial()]),
            ScriptedPlanner(ROBOT, LINE),
            stand_steps=0,
            plan_delay_s=delay_s,
        )
        for _ in range(3):
            rollout.step()
        ends.append(rollout.step().states.joint_velocity)
    assert len({end.tobytes() for end in ends}) == len(ends)


@pytest.mark.parametrize(("shift_x", "shift_z"), [(0.0, 0.0), (0.08, -0.05), (-0.03, 0.02)])
def test_true_heights_are_the_terrain_where_they_say(shift_x: float, shift_z: float) -> None:
    stairs = make_terrain(TerrainConfig(terrain="stairs"))
    trial = Trial(height_shift_x=shift_x, height_shift_z=shift_z, yaw=0.1, position_x=1.2)
    step = Loop(setups_of([stairs], [trial]), ScriptedPlanner(ROBOT, LINE), stand_steps=1).step()
    position = step.truth.position_base_in_world[0]
    x = position[0] + (HEIGHTMAP_X + shift_x) * np.cos(0.1)
    np.testing.assert_allclose(
        step.heights[0], stairs.height_at(x, 0.0) - position[2] + shift_z, atol=1e-9
    )
    setups = setups_of([stairs], [trial])
    exact = Loop(
        setups, ScriptedPlanner(ROBOT, LINE), stand_steps=1, heights=exact_heights(setups)
    ).step()
    np.testing.assert_allclose(
        exact.heights[0],
        stairs.height_at(position[0] + HEIGHTMAP_X * np.cos(0.1), 0.0) - position[2],
        atol=1e-9,
    )
