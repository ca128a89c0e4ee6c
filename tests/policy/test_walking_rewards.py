"""Rewards and commands of walking: the same in a mirror and in torch, and within their ranges."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from numpy_and_torch import both

from saltus.policy.evaluation.tracking import tracking_errors
from saltus.policy.joints.observation import in_command_frame
from saltus.policy.walking import commands
from saltus.policy.walking.commands import command_now, draw_command
from saltus.policy.walking.description import POLICY_HZ
from saltus.policy.walking.evaluation import SETTLING, STRIDE
from saltus.policy.walking.settings import (
    VelocityCommandSettings,
    WalkRewardSettings,
)
from saltus.policy.walking.walk_rewards import TERMS, WalkRewardInputs, walk_reward_terms
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix

OTHER_SIDE = [1, 0, 3, 2]
"""Each leg's mirror image, in the order of `LEGS`."""


def mirrored(vector, sign):
    return np.asarray(vector) * np.asarray(sign)


def mirrored_joints(values):
    legs = np.asarray(values).reshape(-1, 4, 3)[:, OTHER_SIDE]
    return (legs * [-1.0, 1.0, 1.0]).reshape(-1, 12)


def test_a_velocity_is_told_in_the_level_frame_that_turns_with_the_base():
    rng = np.random.default_rng(0)
    (roll, pitch), yaw = rng.uniform(-0.5, 0.5, (2, 50)), rng.uniform(-3.0, 3.0, 50)
    rotation = rotation_matrix(quaternion_from_roll_pitch_yaw(roll, pitch, yaw))
    ahead, aside, up = rng.normal(size=(3, 50))
    cosine, sine = np.cos(yaw), np.sin(yaw)
    world = np.stack([cosine * ahead - sine * aside, sine * ahead + cosine * aside, up], -1)
    told = both(in_command_frame, world, rotation)
    np.testing.assert_allclose(told, np.stack([ahead, aside, up], -1), atol=1e-12)


def test_commands_stay_within_their_ranges_on_either_kind_of_ground():
    config = VelocityCommandSettings()
    draws = np.random.default_rng(1).uniform(size=(2000, commands.DRAWS.count))
    for wide, ahead, aside, turn in (
        (True, config.ahead_mps, config.aside_mps, config.turn_rps),
        (False, config.along_mps, config.along_aside_mps, config.heading_rad),
    ):
        drawn, standing = draw_command(config, np.full(2000, wide), draws)
        for column, (low, high) in enumerate((ahead, (-aside, aside), (-turn, turn))):
            assert low <= drawn[:, column].min() < low + 0.1 * (high - low)
            assert high >= drawn[:, column].max() > high - 0.1 * (high - low)
        assert abs(standing.mean() - config.standing) < 0.03


def test_who_is_to_stand_is_asked_for_nothing_and_others_turn_towards_their_way():
    config, yaw = VelocityCommandSettings(), np.linspace(-2.5, 2.5, 13)
    drawn, narrow = np.tile([0.5, 0.1, 0.2], (13, 1)), np.zeros(13, dtype=bool)
    command = command_now(config, drawn, narrow, yaw > 2.0, 0.0 * yaw, yaw)
    assert not command[yaw > 2.0].any()
    walks = yaw <= 2.0
    assert (np.sign(command[walks, 2]) == np.sign(0.2 - yaw[walks])).all()
    left_of_the_middle = command_now(config, drawn, narrow, narrow, 0.0 * yaw + 1.0, 0.0 * yaw)
    assert (left_of_the_middle[:, 2] < 0.0).all()
    np.testing.assert_array_equal(
        command_now(config, drawn, ~narrow, narrow, 0.0 * yaw, yaw)[:, 2], 0.2
    )


def inputs(n=40, seed=2):
    rng = np.random.default_rng(seed)
    shapes = dict.fromkeys(("command", "velocity", "angular_velocity", "gravity"), 3)
    joints = ("torque", "joint_acceleration", "joint_offset", "action", "last_action")
    feet = dict.fromkeys(("landed_after_s", "foot_speed_squared", "foot_ground"), 4)
    shapes |= dict.fromkeys(joints, 12) | feet
    values = {name: rng.normal(size=(n, size)) for name, size in shapes.items()}
    flags = {"foot_touching": (n, 4), "leg_touching": (n, 8), "failed": (n,)}
    flags |= {"foot_missed": (n, 4), "foot_beside_drop": (n, 4)}
    values |= {name: rng.uniform(size=shape) < 0.5 for name, shape in flags.items()}
    values["command"][: n // 4] *= 0.01
    values["foot_ground"] *= 0.03
    return WalkRewardInputs(**values)


def in_a_mirror(given):
    """The same motion seen in a mirror that stands along x and z."""
    legs = [*OTHER_SIDE, *(4 + leg for leg in OTHER_SIDE)]
    joints = ("torque", "joint_acceleration", "joint_offset", "action", "last_action")
    changed = {name: mirrored_joints(getattr(given, name)) for name in joints}
    changed |= {
        "command": mirrored(given.command, [1, -1, -1]),
        "velocity": mirrored(given.velocity, [1, -1, 1]),
        "angular_velocity": mirrored(given.angular_velocity, [-1, 1, -1]),
        "gravity": mirrored(given.gravity, [1, -1, 1]),
        "leg_touching": given.leg_touching[:, legs],
    }
    feet = ("landed_after_s", "foot_speed_squared", "foot_touching", "foot_missed")
    feet += ("foot_beside_drop", "foot_ground")
    changed |= {name: getattr(given, name)[:, OTHER_SIDE] for name in feet}
    return replace(given, **changed)


def test_every_term_is_the_same_in_a_mirror_and_in_torch():
    given, config = inputs(), WalkRewardSettings()
    terms = walk_reward_terms(config, given)
    assert terms.shape == (40, len(TERMS))
    np.testing.assert_allclose(walk_reward_terms(config, in_a_mirror(given)), terms, atol=1e-12)
    tensors = {f.name: torch.as_tensor(getattr(given, f.name)) for f in fields(given)}
    np.testing.assert_allclose(
        walk_reward_terms(config, WalkRewardInputs(**tensors)).numpy(), terms, atol=1e-12
    )


def test_each_term_has_its_weight_and_none_rewards_a_worse_velocity():
    given = inputs()
    for name in TERMS:
        alone = WalkRewardSettings(**(dict.fromkeys(TERMS, 0.0) | {name: 1.0}))
        terms = walk_reward_terms(alone, given)
        assert terms[:, TERMS.index(name)].any()
        assert not np.delete(terms, TERMS.index(name), axis=1).any()
    step = np.array([0.1, 0.0, 0.0]) * np.sign(given.velocity - given.command)
    worse = replace(given, velocity=given.velocity + step)
    column = TERMS.index("linear_velocity")
    config = WalkRewardSettings()
    assert (
        walk_reward_terms(config, worse)[:, column] <= walk_reward_terms(config, given)[:, column]
    ).all()


def test_errors_are_averaged_over_a_stride_and_not_counted_after_a_change():
    steps = SETTLING + 3 * STRIDE
    sway = np.where(np.arange(steps) % 2 == 0, 1.0, -1.0)
    error = np.stack([0.2 + sway, 0.0 * sway, 0.1 + 0.0 * sway], -1)[:, None]
    fresh = np.zeros((steps, 1), dtype=bool)
    ahead, aside, turn = tracking_errors(error, fresh, stride=STRIDE, settling=SETTLING)
    assert (ahead, aside, turn) == (pytest.approx(0.2, abs=0.05), 0.0, pytest.approx(0.1))
    fresh[::10] = True
    assert np.isnan(tracking_errors(error, fresh, stride=STRIDE, settling=SETTLING)).all()


def test_a_robot_that_stands_where_it_is_to_walk_loses_most_of_what_walking_earns():
    """Share of the reward for tracking that is left, by the commanded speed."""
    speed = np.linspace(0.3, 1.2, 10)
    given = inputs(len(speed))
    command = np.stack([speed, 0.0 * speed, 0.0 * speed], -1)
    standing = replace(given, command=command, velocity=0.0 * command)
    walking = replace(given, command=command, velocity=command)
    column = TERMS.index("linear_velocity")
    left, whole = (
        walk_reward_terms(WalkRewardSettings(), case)[:, column] for case in (standing, walking)
    )
    share = left / whole
    assert (np.diff(share) <= 0.0).all()
    assert share[0] < 0.45
    assert (share[speed >= 0.5] < 0.15).all()


def test_who_is_to_stand_has_its_pose_on_level_ground_and_bends_its_legs_as_stairs_need():
    given, config = inputs(), WalkRewardSettings()
    stand = replace(given, command=0.0 * given.command)
    still = TERMS.index("still")
    costs = []
    for between in (0.0, 0.05, 0.1, 0.2):  # m, of a stair
        ground = np.tile([between, between, 0.0, 0.0], (40, 1))
        terms = walk_reward_terms(config, replace(stand, foot_ground=ground))
        costs.append(terms[:, still])
        others = np.delete(terms, still, axis=1)
        expected = np.delete(walk_reward_terms(config, stand), still, axis=1)
        np.testing.assert_array_equal(others, expected)
    offset = np.abs(stand.joint_offset).sum(axis=-1)
    np.testing.assert_allclose(costs[0], config.still * offset / POLICY_HZ)
    np.testing.assert_allclose(costs[1], 0.5 * costs[0], atol=1e-12)
    np.testing.assert_allclose(costs[2:], 0.0, atol=1e-12)
