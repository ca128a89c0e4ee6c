"""Laws of walking: frames, observation and card, resets, levels, evaluation."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy_and_torch import both
from samples import ROBOT
from tensordict import TensorDict

from saltus.dialects import dialect_of
from saltus.errors import ModelError
from saltus.grid import SCAN
from saltus.model_file import ModelFile
from saltus.policy.env.settings import LearningSettings
from saltus.policy.joints.description import PolicyDescription
from saltus.policy.joints.observation import ObservationMaker, WalkerReadings, gravity_in_base
from saltus.policy.joints.policy import JointPolicy
from saltus.policy.training.learner import Learner
from saltus.policy.training.train import Rank
from saltus.policy.walking.description import LAYOUT, SIZE, description_of, walking_pose
from saltus.policy.walking.evaluation import evaluate_walk
from saltus.policy.walking.export import DeployedWalk, make_walk_actor
from saltus.policy.walking.settings import (
    GroundSettings,
    ScanErrorSettings,
    WalkSettings,
    WalkTrainSettings,
)
from saltus.policy.walking.starts import JumpStartSettings
from saltus.policy.walking.train import make_walk_engine, train_walk
from saltus.policy.walking.walk_env import PRIVILEGED, WalkEnv
from saltus.resources import shipped_file
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.rotations import rotation_matrix

N = 12


GROUND = GroundSettings(shares={"plain": 0.5, "stairs": 0.5}, levels=2)


CONFIG = WalkTrainSettings(
    robot="go1",
    robots=N,
    env=WalkSettings(ground=GROUND),
    learning=LearningSettings(hidden=(16,), horizon=4, epochs=1, minibatches=2),
)


def make_env(seed=0, config=CONFIG):
    return WalkEnv(
        make_walk_engine(load_robot(config.robot), config, "cpu", threads=1), config.env, seed=seed
    )


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walk")
    train_walk(CONFIG, folder, minutes=1.0, rank=Rank(), iterations=2)
    return folder / "walk.onnx"


@pytest.mark.parametrize("dialect", ["isaaclab", "legged_gym", "mjlab"])
def test_the_vector_holds_its_parts_in_the_stated_order(dialect):
    described = description_of(WalkSettings(dialect=dialect), ROBOT)
    pose, rng = walking_pose(ROBOT, 0.7), np.random.default_rng(3)
    parts = {name: rng.normal(size=(5, size)) for name, size in LAYOUT.items()}
    vector = both(lambda *given: ObservationMaker(described).vector(
        WalkerReadings(**dict(zip(parts, given, strict=True)))), *parts.values())  # fmt: skip
    assert vector.shape == (5, SIZE)
    ends = np.cumsum(list(LAYOUT.values()))
    found = dict(zip(LAYOUT, np.split(vector, ends[:-1], axis=-1), strict=True))
    expected = parts | {
        "joint_position": parts["joint_position"] - pose,
        "heights": dialect_of(dialect).observation(parts["heights"], SCAN),
    }
    for name, value in expected.items():
        np.testing.assert_array_equal(found[name], value)


@pytest.mark.parametrize("name", ["go1", "go2"])
@pytest.mark.parametrize("height", [0.5, 0.7, 0.9])
def test_the_pose_of_any_robot_puts_its_feet_below_its_hips(name, height):
    robot = load_robot(name)
    feet = LegKinematics(robot).position(walking_pose(robot, height))
    np.testing.assert_allclose(feet[:, 0], robot.hip_anchor[:, 0], atol=1e-9)
    np.testing.assert_allclose(
        robot.hip_anchor[:, 2] - feet[:, 2], height * robot.leg_length, atol=1e-9
    )


def test_the_card_says_how_the_vector_is_made_and_the_file_is_the_network(model):
    actor = JointPolicy(model)
    assert actor.description == description_of(CONFIG.env, ROBOT)
    assert PolicyDescription.from_toml(actor.description.to_toml()) == actor.description
    np.testing.assert_allclose(
        actor.description.pose, walking_pose(ROBOT, CONFIG.env.drives.height)
    )
    state = torch.load(model.with_name("checkpoint.pt"), weights_only=True)
    given = np.random.default_rng(4).normal(size=(50, SIZE)).astype(np.float32)
    network = DeployedWalk(state)
    with torch.no_grad():
        for weights in network.state_dict().values():
            if weights.is_floating_point():
                weights.copy_(weights.half())  # as the file keeps them
        expected = network(torch.from_numpy(given)).numpy()
    np.testing.assert_allclose(actor(given), expected, atol=1e-4)


def test_observations_are_what_the_engine_and_the_ground_say():
    exact = replace(
        CONFIG.env,
        scan=ScanErrorSettings(image_hz=50.0, seen_m=0.0, unseen=0.0, shift_m=0.0),
        sensors=replace(CONFIG.env.sensors, **dict.fromkeys(
            ("angular_velocity", "gravity", "joint_position", "joint_velocity"), 0.0)),
    )  # fmt: skip
    env = make_env(config=replace(CONFIG, env=exact))
    before = env.memory.pose.clone()
    for _ in range(10):
        before = env.memory.pose.clone()
        transition = env.step(0.2 * torch.ones(N, 12))
    going = ~transition.done
    qpos, qvel = torch.as_tensor(env._engine.qpos).float(), torch.as_tensor(env._engine.qvel)
    rotation = rotation_matrix(qpos[:, 3:7])
    x, y = SCAN.points_in_world(before[:, :2], before[:, 3])  # heights are an image late
    ground = env.ground.table.solid.of_robot(env.memory.course).height_at(x, y)
    expected = ObservationMaker(description_of(exact, ROBOT)).vector(
        WalkerReadings(
            angular_velocity=qvel[:, 3:6].float(),
            gravity=gravity_in_base(rotation),
            command=env.memory.command,
            joint_position=qpos[:, 7:],
            joint_velocity=qvel[:, 6:].float(),
            action=env.memory.action,
            heights=ground - before[:, 2:3],
        )
    )
    assert transition.critic.shape == (N, SIZE + PRIVILEGED)
    torch.testing.assert_close(transition.actor[going], expected[going], atol=1e-4, rtol=0.0)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.75, 1.0])
def test_a_share_of_the_robots_of_each_family_is_told_true_heights(share):
    scan = ScanErrorSettings(exact=share)
    env = make_env(config=replace(CONFIG, env=replace(CONFIG.env, scan=scan)))
    transition = env.step(0.2 * torch.ones(N, 12))
    told, true = (
        seen[:, SIZE - SCAN.size : SIZE] for seen in (transition.actor, transition.critic)
    )
    is_true = (told == true).all(-1)
    for family in range(2):
        robots = env.memory.kind == family
        assert abs(is_true[robots].sum() - share * robots.sum()) < 1.0


def test_the_same_seed_gives_the_same_run():
    def last(seed):
        env = make_env(seed)
        for _ in range(5):
            transition = env.step(torch.zeros(N, 12))
        return transition.actor

    assert torch.equal(last(3), last(3))
    assert not torch.equal(last(3), last(4))


def test_a_robot_that_falls_starts_anew_and_no_other_notices():
    quiet, fallen = make_env(), make_env()
    torch.as_tensor(fallen._engine.qpos)[2, 3:7] = torch.tensor([0.0, 1.0, 0.0, 0.0]).double()
    others = torch.arange(N) != 2
    for step in range(8):
        calm, after = quiet.step(torch.zeros(N, 12)), fallen.step(torch.zeros(N, 12))
        if step == 0:
            assert after.done[2]
            assert not after.timed_out[2]
            assert after.reward[2] < calm.reward[2]
        torch.testing.assert_close(after.actor[others], calm.actor[others], rtol=0.0, atol=1e-5)
        assert torch.equal(after.done[others], calm.done[others])


def test_robots_start_in_their_pose_above_whatever_ground_they_are_on():
    config = replace(
        CONFIG,
        env=replace(CONFIG.env, ground=GroundSettings(shares={"rubble": 1.0}, levels=2)),
    )
    env = make_env(config=config)
    env.set_levels(torch.ones(N))
    joints = torch.as_tensor(env._engine.qpos)[:, 7:].numpy()
    slack = config.env.randomisation.start_joint_rad + 1e-6
    assert np.abs(joints - walking_pose(ROBOT, config.env.drives.height)).max() <= slack
    falls = torch.zeros(N, dtype=torch.bool)
    for _ in range(15):
        transition = env.step(torch.zeros(N, 12))
        falls |= transition.done & ~transition.timed_out
    assert falls.sum() <= 1


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_episodes_that_begin_in_a_jump_are_short_and_hard_and_leave_the_level_as_it_is(share):
    jump = JumpStartSettings(share=share)
    ground = replace(GROUND, levels=3)
    env = make_env(config=replace(CONFIG, env=replace(CONFIG.env, jump_start=jump, ground=ground)))
    env.set_levels(torch.ones(N))
    assert env.memory.kind.sum() == N // 2
    jumps = (env.memory.kind == 1) & (share > 0.0)
    ahead_mps = torch.as_tensor(env._engine.qvel)[:, :2].norm(dim=-1)
    assert torch.equal(ahead_mps > 0.0, jumps)
    assert set(env.memory.drawn[jumps, 0].tolist()) <= {float(np.float32(0.3))}
    assert torch.equal(env.memory.led_s > 0.0, jumps)
    stands = jumps & env.memory.standing
    assert (env.memory.command[jumps, 0] > 0.0).all()
    env.memory.led_s.fill_(0.0)
    env._look(env.done)
    assert not env.memory.command[stands].any()
    assert (env.memory.command[jumps & ~stands, 0] > 0.0).all()
    variants = env.ground.table.variants
    level = env.memory.course // variants % ground.levels
    assert torch.equal(level, torch.where(jumps, 2, 1))
    env.memory.first_time_s.fill_(1.0)
    torch.as_tensor(env._engine.qpos)[:, 3:7] = torch.tensor([0.0, 1.0, 0.0, 0.0]).double()
    assert env.step(torch.zeros(N, 12)).done.all()
    assert (env.memory.level == 1.0).all()
    left_s = CONFIG.env.time_limit_s - env.memory.time_s
    assert torch.equal(left_s, torch.where(jumps, jump.lasts_s, CONFIG.env.time_limit_s))


def test_a_way_as_commanded_leads_to_harder_ground_and_a_fall_to_easier():
    env = make_env()
    env.memory.level.fill_(1.0)
    env.memory.asked_m.fill_(10.0)
    env.memory.way_m.copy_(torch.where(torch.arange(N) % 2 == 0, 9.9, 1.0))
    env.memory.time_s.fill_(1e3)
    env.memory.first_time_s.fill_(0.0)
    transition = env.step(torch.zeros(N, 12))
    assert transition.timed_out.all()
    level = env.memory.level.numpy()
    assert set(level[1::2]) == {0.0}
    assert set(level[0::2]) <= {0.0, 1.0}  # beyond the last level any is drawn


def test_a_training_goes_on_from_its_checkpoint(model, tmp_path):
    first = torch.load(model.with_name("checkpoint.pt"), weights_only=True)
    train_walk(
        CONFIG, tmp_path, minutes=1.0, rank=Rank(), resume=model.with_name("checkpoint.pt"),
        iterations=3,
    )  # fmt: skip
    second = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    assert (first["iteration"], second["iteration"]) == (2, 3)
    assert second["steps"] == 3 * 4 * N
    assert (tmp_path / "walk.onnx").exists()


def test_the_first_command_of_an_untrained_policy_is_its_pose(model):
    given = np.random.default_rng(7).normal(size=(20, SIZE)).astype(np.float32)
    assert np.abs(JointPolicy(model)(given)).max() < 1.0


def test_an_evaluation_counts_what_it_saw(model):
    score = evaluate_walk(model, "plain", level=0, robots=4, seconds=2.0, seed=1)
    assert score.walked_s == 8.0
    assert 0 <= score.falls <= score.episodes
    assert np.isfinite([score.ahead_mps, score.aside_mps, score.turn_rps]).all()


@pytest.mark.parametrize("name", ["go1", "go2"])
@pytest.mark.parametrize("exact", [False, True])
def test_a_shipped_policy_is_evaluated_on_a_family_alone_and_no_episode_begins_in_a_jump(
    name, exact, monkeypatch
):
    seen, at_first = [], []

    def make(*given, **named):
        seen.append(WalkEnv(*given, **named))
        at_first.append(seen[-1].motion().clone())
        return seen[-1]

    monkeypatch.setattr("saltus.policy.walking.evaluation.WalkEnv", make)
    path = shipped_file(f"models/walk_{name}.onnx")
    for ground in ("stones", "stairs"):
        score = evaluate_walk(path, ground, level=9, robots=4, seconds=2.0, seed=1, exact=exact)
        assert score.walked_s == 8.0
        told, true = (x[:, SIZE - SCAN.size : SIZE] for x in (seen[-1].actor, seen[-1].critic))
        assert (told == true).all(-1).tolist() == 4 * [exact]
        assert not at_first[-1].any()


@pytest.mark.parametrize("name", ["go1", "go2"])
def test_a_training_that_starts_from_a_file_acts_as_the_file_until_its_critic_has_learned(name):
    path = shipped_file(f"models/walk_{name}.onnx")
    config = replace(
        CONFIG, robot=name, learning=LearningSettings(horizon=4, epochs=2, critic_iterations=2)
    )
    learner = Learner(make_env(config=config), config.learning, make_walk_actor(config.learning))
    before = learner.ppo.actor.distribution.std_param.clone()
    learner.begin_with(ModelFile(path), GROUND.levels)
    assert set(learner._env.memory.level.tolist()) == {0.0, 1.0}
    rng = np.random.default_rng(5)
    given = rng.normal(size=(100, SIZE)).astype(np.float32)
    shown = TensorDict({"policy": torch.from_numpy(given)}, batch_size=[100])
    expected = JointPolicy(path)(given)
    most = config.env.drives.most

    def action():
        with torch.no_grad():
            return learner.ppo.actor(shown).clamp(-most, most).numpy()

    np.testing.assert_allclose(action(), expected, atol=1e-3)
    assert torch.equal(learner.ppo.actor.distribution.std_param, before)
    critic = learner.ppo.critic.mlp[0].weight.clone()
    for learns in (False, False, True):
        learner.collect()
        learner.learn()
        assert np.allclose(action(), expected, atol=1e-3) != learns
    assert not torch.equal(learner.ppo.critic.mlp[0].weight, critic)


def test_a_file_of_another_size_is_refused():
    learner = Learner(make_env(), CONFIG.learning, make_walk_actor(CONFIG.learning))
    with pytest.raises(ModelError, match="another network"):
        learner.begin_with(ModelFile(shipped_file("models/walk_go1.onnx")), 2)
