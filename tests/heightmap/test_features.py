from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from heightmap_inputs import states
from hypothesis import given, settings
from hypothesis import strategies as st
from samples import KINEMATICS, ROBOT

from saltus import rotations
from saltus.heightmap.service.proprioception_vector import (
    PROPRIOCEPTION,
    proprioception_of,
    proprioception_of_states,
)
from saltus.robots.robot import LEGS

INDEX = {name: i for i, name in enumerate(PROPRIOCEPTION)}
ANGLE = st.floats(-1.2, 1.2)


def vectors(**values: Any) -> Any:
    known: Any = SimpleNamespace(**values)
    return proprioception_of_states(known, KINEMATICS)


def build(roll: float, pitch: float, yaw: float, **changes: np.ndarray) -> np.ndarray:
    quaternion = rotations.quaternion_from_roll_pitch_yaw(
        *(np.asarray(a) for a in (roll, pitch, yaw))
    )
    values: dict[str, np.ndarray] = {
        "quaternion_base_in_world": quaternion,
        "angular_velocity_base": np.zeros(3),
        "joint_position": ROBOT.stand_pose,
        "velocity_base_in_world": np.zeros(3),
        "base_height": np.asarray(0.27),
        "leg_trusted": np.ones(4, np.bool_),
    }
    return vectors(**{**values, **changes})


@given(roll=ANGLE, pitch=ANGLE, yaw=st.floats(-3.1, 3.1))
@settings(deadline=None, max_examples=50)
def test_roll_and_pitch_come_back_and_yaw_has_no_effect(
    roll: float, pitch: float, yaw: float
) -> None:
    vector = build(roll, pitch, yaw)
    assert vector[INDEX["roll"]] == pytest.approx(roll, abs=1e-5)
    assert vector[INDEX["pitch"]] == pytest.approx(pitch, abs=1e-5)
    np.testing.assert_allclose(vector, build(roll, pitch, 0.0), atol=1e-5)


def test_standing_feet_are_below_the_hips() -> None:
    vector = build(0.0, 0.0, 0.7)
    for leg, (x, _, z) in zip(LEGS, KINEMATICS.position(ROBOT.stand_pose), strict=True):
        assert vector[INDEX[f"{leg}_foot_x"]] == pytest.approx(x, abs=1e-6)
        assert vector[INDEX[f"{leg}_foot_z"]] == pytest.approx(z, abs=1e-6)


@pytest.mark.parametrize("leg", range(4))
def test_a_leg_that_is_not_trusted_says_nothing(leg: int) -> None:
    trusted = np.arange(4) != leg
    moved = ROBOT.stand_pose.copy()
    moved[3 * leg : 3 * leg + 3] = [0.3, 1.2, -2.0]
    vector, other = (
        build(0.1, 0.2, 0.3, leg_trusted=trusted, joint_position=q)
        for q in (ROBOT.stand_pose, moved)
    )
    np.testing.assert_array_equal(vector, other)
    assert vector[INDEX[f"{LEGS[leg]}_foot_z"]] == 0.0
    assert vector[INDEX[f"{LEGS[leg]}_trusted"]] == 0.0


def test_velocities_are_in_the_yaw_frame() -> None:
    yaw = 0.8
    forward = np.array([np.cos(yaw), np.sin(yaw), 0.5])
    vector = build(0.2, -0.4, yaw, velocity_base_in_world=forward)
    velocity = [vector[INDEX[f"velocity_{axis}"]] for axis in "xyz"]
    assert velocity == pytest.approx([1.0, 0.0, 0.5], abs=1e-6)
    turning = build(0.0, np.pi / 2 - 0.1, yaw, angular_velocity_base=np.array([1.0, 0.0, 0.0]))
    assert turning[INDEX["angular_velocity_z"]] == pytest.approx(-np.cos(0.1), abs=1e-5)


def test_a_batch_equals_one_by_one() -> None:
    rng = np.random.default_rng(0)
    n = 7
    quaternion = rng.normal(size=(2, n, 4))
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    values = {
        "quaternion_base_in_world": quaternion,
        "angular_velocity_base": rng.normal(size=(2, n, 3)),
        "joint_position": rng.normal(size=(2, n, 12)),
        "velocity_base_in_world": rng.normal(size=(2, n, 3)),
        "base_height": rng.normal(size=(2, n)),
        "leg_trusted": rng.uniform(size=(2, n, 4)) < 0.5,
    }
    batch = vectors(**values)
    assert batch.shape == (2, n, len(PROPRIOCEPTION))
    assert batch.dtype == np.float32
    for i in range(2):
        for j in range(n):
            single = vectors(**{name: value[i, j] for name, value in values.items()})
            np.testing.assert_allclose(single, batch[i, j], atol=1e-6)


def test_tensors_give_the_same_vector() -> None:
    rng = np.random.default_rng(1)
    values = {
        "quaternion_base_in_world": rotations.quaternion_from_roll_pitch_yaw(
            *rng.uniform(-1.0, 1.0, (3, 50))
        ),
        "angular_velocity_base": rng.normal(size=(50, 3)),
        "joint_position": rng.uniform(ROBOT.joint_lower, ROBOT.joint_upper, (50, 12)),
        "velocity_base_in_world": rng.normal(size=(50, 3)),
        "base_height": rng.uniform(0.1, 0.5, 50),
        "leg_trusted": rng.uniform(size=(50, 4)) < 0.5,
    }
    tensors = {name: torch.as_tensor(value) for name, value in values.items()}
    single = {
        name: value.float() if value.is_floating_point() else value
        for name, value in tensors.items()
    }
    for arrays in (tensors, single):
        vector = vectors(**arrays)
        assert vector.dtype == torch.float32
        np.testing.assert_allclose(vector, vectors(**values), atol=1e-5)


def test_a_message_gives_the_same_vector() -> None:
    """Floats of one robot and arrays of many: the law is the same, and so are the numbers."""
    rng = np.random.default_rng(2)
    quaternion = rotations.quaternion_from_roll_pitch_yaw(*rng.uniform(-1.2, 1.2, (3, 50)))
    quaternion[::2] *= rng.uniform(0.996, 1.004, (25, 1))  # as far from one as a message may be
    for row in quaternion:
        values = {
            "quaternion_base_in_world": row,
            "angular_velocity_base": rng.normal(size=3),
            "joint_position": rng.uniform(ROBOT.joint_lower, ROBOT.joint_upper),
            "velocity_base_in_world": rng.normal(size=3),
            "leg_trusted": rng.uniform(size=4) < 0.5,
        }
        height = rng.uniform(0.1, 0.5)
        state = replace(states(1)[0], base_height=height, **values)
        expected = vectors(base_height=np.asarray(height), **values)
        np.testing.assert_array_equal(proprioception_of(state, KINEMATICS), expected)
