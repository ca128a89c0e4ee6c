from dataclasses import replace

import numpy as np
import pytest
import torch
from samples import KINEMATICS, ROBOT

from saltus.controller.compensation import compensation_of
from saltus.controller.estimator import Estimator
from saltus.effects.joint_loads import ViscousFriction
from saltus.effects.motors import TorqueGain
from saltus.effects.profile import IDEAL
from saltus.grid import LINE
from saltus.loop.planner import observe
from saltus.policy.env.curriculum import (
    CurriculumSettings,
    kinds_of_robots,
    level_difficulty,
    next_level,
)
from saltus.policy.env.env_observations import PRIVILEGED
from saltus.policy.env.episode import TALLY
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.jump_rewards import TERMS, JumpRewardSettings, jump_reward_terms
from saltus.policy.env.randomisation import RandomisationSettings
from saltus.policy.env.settings import JumpEnvSettings
from saltus.policy.policy_features import feature_layout, policy_features, size_with
from saltus.rotations import rotation_matrix
from saltus.sim.cpu_engine import CpuEngine
from saltus.states import standing_state
from saltus.terrain.course_batch import BOXES
from saltus.terrain.course_law import KINDS

N = 20


def make_env(seed=0, config=None):
    return JumpEnv(
        CpuEngine(ROBOT, N, BOXES, threads=1), config or JumpEnvSettings(), LINE, seed=seed
    )


def bound(env):
    """A slow bound that lifts the feet."""
    values = torch.tensor([[2.0, 1.0, 0.3, 0.0, 0.0, 0.0, 0.12, 0.0, 0.0, 0.12]])
    return env.config.bounds.normalised(values).expand(N, 10)


@pytest.fixture(scope="module")
def driven():
    env = make_env()
    return env, [env.step(bound(env)) for _ in range(30)]


def test_observations_and_rewards_are_finite_and_of_their_sizes(driven):
    env, transitions = driven
    for transition in transitions:
        assert transition.actor.shape == (N, size_with(LINE))
        assert transition.critic.shape == (N, size_with(LINE) + PRIVILEGED)
        for array in (transition.actor, transition.critic, transition.reward):
            assert torch.isfinite(array).all()
    assert env.memory.terms.shape == (N, len(TERMS))


def test_joints_that_near_their_rated_speed_cost_ever_more_and_others_nothing():
    env = make_env(config=JumpEnvSettings(reward=JumpRewardSettings(joint_speed=1.0)))
    shares = torch.linspace(0.0, 1.4, 29)
    costs = []
    for share in shares.tolist():
        env.step(bound(env))  # whatever else holds
        env._qvel[:, 6:] = 0.0
        env._qvel[:, 11] = -share * float(ROBOT.speed_limit[5])
        given = env._reward_inputs(
            rotation_matrix(env._qpos[:, 3:7].float()), torch.zeros(N, 16, dtype=torch.bool)
        )
        costs.append(-jump_reward_terms(env.config.reward, given)[:, TERMS.index("joint_speed")])
    costs = torch.stack(costs)
    assert not costs[shares < 0.9].any()
    assert (costs[(shares > 0.91) & (shares < 1.3)].diff(dim=0) > 0.0).all()
    assert torch.allclose(costs[shares > 1.31], costs[shares > 1.31][:1])


def test_what_a_step_returned_does_not_change_later(driven):
    env, transitions = driven
    before = transitions[-1].actor.clone()
    env.step(bound(env))
    assert torch.equal(transitions[-1].actor, before)


def test_the_same_seed_gives_the_same_run():
    runs = []
    for seed in (3, 3, 4):
        env = make_env(seed)
        for _ in range(10):
            last = env.step(bound(env))
        runs.append(last.actor)
    assert torch.equal(runs[0], runs[1])
    assert not torch.equal(runs[0], runs[2])


def test_the_policy_is_shown_what_the_deployed_stack_shows_it():
    exact = RandomisationSettings(height_shift_m=(0.0, 0.0), height_noise_m=0.0)
    env = make_env(config=JumpEnvSettings(randomisation=exact))
    for _ in range(15):
        transition = env.step(bound(env))
    memory, qpos, qvel = env.memory, np.array(env._engine.qpos), np.array(env._engine.qvel)
    states = replace(
        standing_state(ROBOT),
        quaternion_base_in_world=qpos[:, 3:7],
        angular_velocity_base=qvel[:, 3:6],
        joint_position=qpos[:, 7:],
        velocity_base_in_world=memory.estimate[:, :3].numpy(),
        base_height=memory.estimate[:, 3].numpy(),
        leg_contact=memory.contact.numpy(),
        leg_progress=memory.progress.numpy(),
    )
    heights = transition.actor[:, -feature_layout(LINE)["heights"] :].numpy()
    np.testing.assert_allclose(
        transition.actor, policy_features(observe(states, KINEMATICS), heights), atol=2e-4
    )
    assert (
        np.abs(heights[:, :14] + qpos[:, 2:3]) < 1e-5
    ).all()  # level ground until 0.6 m ahead of the start


@pytest.mark.sample(1)
@pytest.mark.parametrize("steps", [1, 2])
def test_a_delay_of_plans_by_whole_steps_is_a_policy_that_answers_later(steps):
    outputs = [
        bound(make_env()) + 0.1 * torch.randn(N, 10, generator=torch.manual_seed(k))
        for k in range(12)
    ]
    runs = []
    for delay_s, late in ((0.010 * steps, 0), (0.0, steps)):
        env = make_env(
            config=JumpEnvSettings(
                randomisation=RandomisationSettings(plan_delay_s=(delay_s, delay_s))
            )
        )
        for k in range(12):
            assert not env.step(outputs[max(0, k - late)]).done.any()
        runs.append(np.array(env._engine.qpos))
    np.testing.assert_array_equal(*runs)


@pytest.mark.slow
def test_each_two_milliseconds_of_delay_change_what_is_obeyed():
    tracks = []
    for ticks in range(6):
        delay_s = 0.002 * ticks
        env = make_env(
            config=JumpEnvSettings(
                randomisation=RandomisationSettings(plan_delay_s=(delay_s, delay_s))
            )
        )
        for k in range(8):
            env.step(bound(env) * (-1.0) ** k)
        tracks.append(np.array(env._engine.qpos).tobytes())
    assert len(set(tracks)) == len(tracks)


def test_robots_that_fall_start_again_on_their_course():
    env = make_env()
    torch.as_tensor(env._engine.qpos)[: N // 2, 3:7] = torch.tensor(
        [0.0, 1.0, 0.0, 0.0], dtype=torch.float64
    )
    transition = env.step(bound(env))
    assert transition.done[: N // 2].all()
    assert not transition.timed_out[: N // 2].any()
    assert (env.memory.time_s[: N // 2] == 0.0).all()
    blank = Estimator(ROBOT).init((), np.zeros(1)).mean
    np.testing.assert_allclose(
        env.memory.estimate[: N // 2], np.tile(blank, (N // 2, 1)), atol=1e-6
    )
    tally = dict(zip(TALLY, env.episodes.tally.sum(0).tolist(), strict=True))
    assert tally["tilted"] >= N // 2
    assert torch.as_tensor(env._engine.qpos)[: N // 2, 3].min() > 0.99


def test_a_state_that_is_not_finite_ends_the_episode_and_leaves_no_trace():
    env = make_env()
    torch.as_tensor(env._engine.qvel)[0] = float("nan")
    transition = env.step(bound(env))
    assert transition.done[0]
    for _ in range(3):
        transition = env.step(bound(env))
    drives = [state for state in env.memory.actuators if state is not None]
    for array in (
        transition.actor,
        transition.critic,
        transition.reward,
        env.memory.variance,
        *drives,
    ):
        assert torch.isfinite(array).all()


def test_actions_beyond_their_bounds_cost_and_change_nothing_else():
    outputs = []
    for factor in (1.0, 3.0):
        env = make_env()
        env.step(factor * torch.ones(N, 10))
        outputs.append((env.memory.plan.clone(), env.memory.excess.clone()))
    assert torch.allclose(outputs[0][0], outputs[1][0])
    assert (outputs[0][1] < 1e-9).all()
    np.testing.assert_allclose(outputs[1][1], 10.0, rtol=1e-4)  # one range beyond in each of ten


def test_every_kind_of_terrain_gets_its_share():
    config = CurriculumSettings()
    kinds = np.array(kinds_of_robots(config.shares, 1000))
    for k, kind in enumerate(KINDS):
        assert abs((kinds == k).mean() - config.shares[kind] / sum(config.shares.values())) < 2e-3


def test_ramps_are_trained_on_up_and_down():
    none = dict.fromkeys(("flat", "stairs", "stepping_stones", "step", "gap"), 0.0)
    curriculum = CurriculumSettings(**none, own={"ramp_up": 1.0, "ramp_down": 1.0})
    env = JumpEnv(
        CpuEngine(ROBOT, N, curriculum.boxes, threads=1),
        JumpEnvSettings(curriculum=curriculum),
        LINE,
        seed=0,
    )
    env.set_levels(torch.full((N,), 5.0))
    x = torch.linspace(0.0, 6.0, 100).expand(N, -1)
    heights = env.courses().height_at(x, torch.zeros_like(x))
    assert (heights[: N // 2, -1] > 0.5).all()
    assert (heights[N // 2 :, -1] < -0.5).all()
    assert (heights.diff(dim=1).abs() < 0.05).all()  # slopes, no steps
    for _ in range(20):
        transition = env.step(torch.zeros(N, 10))
    assert torch.isfinite(transition.actor).all()
    assert not transition.done.any()


def test_levels_rise_with_the_way_and_fall_without():
    config = CurriculumSettings()
    level = np.array([0.0, 3.0, 3.0, 3.0, 9.0, 9.0])
    way = np.array([0.0, 5.0, 5.0, 1.0, 5.0, 3.0])
    failed = np.array([True, False, True, True, False, False])
    moved = next_level(config, level, way, failed, np.zeros(6, dtype=bool), np.full(6, 0.35))
    np.testing.assert_array_equal(moved, [0.0, 4.0, 3.0, 2.0, 3.0, 9.0])
    assert level_difficulty(config, np.array([9.0]), np.array([1.0])) == 1.0
    assert level_difficulty(replace(config, hardest=0.5), np.array([9.0]), np.array([1.0])) == 0.5


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_a_share_of_courses_is_of_any_level(share):
    config = CurriculumSettings(any_level=share)
    draw = np.random.default_rng(4).random(20_000)
    failed = np.ones(len(draw), dtype=bool)
    moved = next_level(
        config, np.full(len(draw), 2.0), np.full(len(draw), 3.0), failed, ~failed, draw
    )
    found = np.bincount(moved.astype(int), minlength=config.levels) / len(draw)
    expected = np.full(config.levels, share / config.levels)
    expected[2] += 1.0 - share
    np.testing.assert_allclose(found, expected, atol=0.01)


def test_levels_can_be_set():
    env = make_env(config=replace(JumpEnvSettings(), curriculum=CurriculumSettings(stairs=1.0)))
    env.set_levels(torch.full((N,), 7.0))
    for _ in range(5):
        env.step(bound(env))
    assert (env.memory.level == 7.0).all()


def test_robots_that_are_told_to_stand_do_so_and_then_begin_to_step():
    quiet = RandomisationSettings(torque_period_s=1e9, push_mps=0.0, pitch_torque_nm=0.0)
    env = make_env(config=JumpEnvSettings(randomisation=quiet))
    env.standing[: N // 2] = True
    for _ in range(60):
        env.step(bound(env))
    memory, speed = env.memory, torch.as_tensor(env._engine.qvel)[:, 0]
    assert (memory.phase[: N // 2] == 0.0).all()
    assert memory.contact[: N // 2].all()
    assert memory.trusted[: N // 2].all()
    assert speed[: N // 2].abs().max() < 0.1 < speed[N // 2 :].mean()
    env.standing.zero_()
    env.step(bound(env))
    assert (memory.phase[: N // 2] > 0.0).all()


def test_the_leg_controller_knows_the_drives_of_its_profile(tmp_path):
    weak = IDEAL.having(TorqueGain(gain=0.65), ViscousFriction(coefficient=0.5))
    tracks = {}
    for name, profile, known in (
        ("strong", IDEAL, IDEAL),
        ("known", weak, weak),
        ("unknown", weak, IDEAL),
    ):
        (tmp_path / f"{name}.toml").write_text(profile.to_toml())
        env = make_env(config=JumpEnvSettings(profile=str(tmp_path / f"{name}.toml")))
        if known is not profile:
            env._law._compensation = compensation_of(known, ROBOT)
        tracks[name] = []
        for _ in range(12):
            env.step(bound(env))
            tracks[name].append(np.array(env._engine.qpos))
    off = {
        name: np.abs(np.array(track) - tracks["strong"]).mean() for name, track in tracks.items()
    }
    assert off["known"] < 0.2 * off["unknown"]
