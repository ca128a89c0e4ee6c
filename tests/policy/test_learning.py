import json
from dataclasses import replace

import numpy as np
import onnx
import pytest
import torch
from samples import ROBOT
from tensordict import TensorDict

from saltus.errors import ModelError, SaltusError
from saltus.grid import LINE
from saltus.policy.actor import PolicyActor
from saltus.policy.bounds import ACTIONS, ActionBounds
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.settings import JumpTrainSettings, LearningSettings
from saltus.policy.policy_features import size_with
from saltus.policy.training.export import export_policy
from saltus.policy.training.learner import FIRST_ACTION, JumpLearner, make_actor, rebase
from saltus.policy.training.train import Rank, make_engine, train_policy

CONFIG = JumpTrainSettings(
    robot="go1",
    grid="line",
    robots=16,
    learning=LearningSettings(hidden=(32, 16), horizon=4, epochs=1, minibatches=2),
)


def run(folder, iterations, resume=None):
    train_policy(CONFIG, folder, minutes=1.0, rank=Rank(), resume=resume, iterations=iterations)
    return torch.load(folder / "checkpoint.pt", weights_only=True)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    folder = tmp_path_factory.mktemp("training")
    run(folder, 3)
    return folder / "checkpoint.pt"


def test_goes_on_from_one_file(checkpoint, tmp_path):
    first = torch.load(checkpoint, weights_only=True)
    second = run(tmp_path, 5, resume=checkpoint)
    assert (first["iteration"], second["iteration"]) == (3, 5)
    assert second["steps"] == 5 * 4 * 16
    assert second["seconds"] > first["seconds"]
    assert (
        second["optimizer_state_dict"]["state"][0]["step"]
        > first["optimizer_state_dict"]["state"][0]["step"]
    )
    assert {path.name for path in checkpoint.parent.iterdir()} >= {
        "checkpoint.pt",
        "config.toml",
        "commit.txt",
    }


def test_the_same_seed_learns_the_same(checkpoint, tmp_path):
    again = run(tmp_path, 3)
    first = torch.load(checkpoint, weights_only=True)
    for name, tensor in first["actor_state_dict"].items():
        assert torch.equal(tensor, again["actor_state_dict"][name])


def test_a_file_that_is_no_checkpoint_is_refused(tmp_path):
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(b"nothing")
    with pytest.raises(SaltusError, match="no checkpoint"):
        export_policy(path, tmp_path / "policy.onnx")


def test_the_exported_policy_equals_the_trained_one(checkpoint, tmp_path):
    path = tmp_path / "policy.onnx"
    assert export_policy(checkpoint, path) < 1e-5
    actor, bounds = PolicyActor(ROBOT, LINE, path), ActionBounds()
    values = actor.values(np.random.default_rng(0).normal(0.0, 5.0, (2, 7, size_with(LINE))))
    assert values.shape == (2, 7, len(ACTIONS))
    assert (values >= np.array(bounds.low) - 1e-5).all()
    assert (values <= np.array(bounds.high) + 1e-5).all()


def test_an_untrained_policy_bounds_slowly():
    bounds = ActionBounds()
    actor = make_actor(
        TensorDict({"policy": torch.zeros(1, size_with(LINE))}, batch_size=[1]),
        CONFIG.learning,
        bounds,
    )
    plan = bounds.denormalised(
        actor(TensorDict({"policy": torch.randn(50, size_with(LINE))}, batch_size=[50])).detach()
    )
    np.testing.assert_allclose(plan, np.tile(FIRST_ACTION, (50, 1)), atol=0.2)


def test_other_bounds_change_no_action(checkpoint):
    state = torch.load(checkpoint, weights_only=True)
    old = ActionBounds()
    new = ActionBounds(
        low=tuple(2.0 * v - 0.1 for v in old.low), high=tuple(1.5 * v + 0.2 for v in old.high)
    )
    given = TensorDict({"policy": torch.randn(20, size_with(LINE))}, batch_size=[20])
    actor = make_actor(given, CONFIG.learning, old)
    actor.load_state_dict(state["actor_state_dict"])
    half = (
        torch.tensor(old.high) - torch.tensor(old.low),
        torch.tensor(new.high) - torch.tensor(new.low),
    )
    plan, spread = old.denormalised(actor(given)), actor.distribution.std_param * half[0]
    rebase(actor, old, new)
    np.testing.assert_allclose(new.denormalised(actor(given)).detach(), plan.detach(), atol=1e-5)
    np.testing.assert_allclose(
        (actor.distribution.std_param * half[1]).detach(), spread.detach(), rtol=1e-5
    )


def test_actions_vary_as_much_as_is_asked_at_least():
    learning = replace(CONFIG.learning, std_range=(0.6, 1.0))  # it begins with less
    env = JumpEnv(
        make_engine(ROBOT, CONFIG.robots, CONFIG.env, "cpu", threads=1), CONFIG.env, LINE, seed=0
    )
    learner = JumpLearner(env, learning)
    assert learner.std == pytest.approx(0.6)
    actions = torch.stack([learner.act() for _ in range(200)])
    assert actions.std(dim=0).mean().item() == pytest.approx(0.6, rel=0.03)


def test_a_training_goes_on_with_other_bounds(checkpoint, tmp_path):
    old = ActionBounds()
    wider = ActionBounds(low=old.low, high=(*old.high[:9], 0.9))
    config = replace(CONFIG, env=replace(CONFIG.env, bounds=wider))
    # None is left to do
    train_policy(config, tmp_path, minutes=1.0, rank=Rank(), resume=checkpoint, iterations=3)
    path = tmp_path / "policy.onnx"
    assert export_policy(tmp_path / "checkpoint.pt", path) < 1e-5
    given = np.random.default_rng(0).normal(0.0, 0.3, (5, size_with(LINE)))
    first = tmp_path / "first.onnx"
    export_policy(checkpoint, first)
    np.testing.assert_allclose(
        PolicyActor(ROBOT, LINE, path).values(given),
        PolicyActor(ROBOT, LINE, first).values(given),
        atol=1e-4,
    )


@pytest.mark.parametrize(
    "name",
    [
        "format",
        "features",
        "actions",
        "robot",
        "grid_m",
        "swing_foot_z_range_m",
        "low",
        "high",
        "past_steps",
    ],
)
def test_a_policy_for_another_program_is_refused(checkpoint, tmp_path, name):
    path = tmp_path / "policy.onnx"
    export_policy(checkpoint, path)
    file = onnx.load(path)
    metadata = {entry.key: entry.value for entry in file.metadata_props}
    changed = tmp_path / "changed.onnx"  # beside the first lies its checksum
    lacking = {key: value for key, value in metadata.items() if key != name}
    for bad in (metadata | {name: json.dumps([1.0])}, metadata | {name: '"much"'}, lacking):
        if bad is lacking and name == "past_steps":  # files that are older recall nothing
            continue
        onnx.helper.set_model_props(file, bad)
        onnx.save(file, changed)
        with pytest.raises(ModelError, match=name):
            PolicyActor(ROBOT, LINE, changed)
