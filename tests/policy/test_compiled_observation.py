"""The compiled observation is the observation, over drawn states of robots."""

from dataclasses import fields

import numpy as np
import pytest
from samples import ROBOT

from saltus.loop.planner import compiled_observe, observe
from saltus.policy.policy_features import policy_features
from saltus.robots.legs import LegKinematics
from saltus.states import ProprioceptionArrays


def drawn_states(seed: int, count: int) -> list[ProprioceptionArrays]:
    rng = np.random.default_rng(seed)
    quaternion = rng.normal(size=(count, 4))
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    three, four = rng.normal(size=(3, count, 3)), rng.uniform(size=(3, count, 4))
    joints = ROBOT.stand_pose + rng.normal(size=(count, 12))
    return [
        ProprioceptionArrays(
            quaternion_base_in_world=quaternion[i], angular_velocity_base=10.0 * three[0, i],
            acceleration_base=three[1, i], joint_position=joints[i], joint_velocity=joints[i],
            velocity_base_in_world=three[2, i], base_height=float(four[0, i, 0]),
            leg_contact=four[1, i] > 0.5, leg_progress=four[0, i], leg_trusted=four[2, i] > 0.5,
            cycle=i,
        )
        for i in range(count)
    ]  # fmt: skip


@pytest.mark.sample(1)
@pytest.mark.parametrize("seed", range(5))
def test_compiled_observations_are_the_observations(seed: int) -> None:
    legs = LegKinematics(ROBOT)
    compiled, heights = compiled_observe(legs), np.zeros(30)
    for states in drawn_states(seed, 2_000):
        expected, found = observe(states, legs), compiled(states)
        for field in fields(expected):
            one, other = getattr(expected, field.name), getattr(found, field.name)
            assert np.shape(one) == np.shape(other)
            np.testing.assert_allclose(np.asarray(other), np.asarray(one), rtol=0.0, atol=1e-9)
        vectors = [policy_features(observation, heights) for observation in (expected, found)]
        np.testing.assert_allclose(*vectors, rtol=0.0, atol=1e-9)
