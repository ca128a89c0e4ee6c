"""What a policy recalls: the same in a training,
in a rolled-out batch, and in the deployed planner.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from samples import ROBOT, setups_of
from torch import Tensor

from saltus.config import TerrainConfig
from saltus.errors import ConfigError, ModelError, SaltusError
from saltus.grid import LINE
from saltus.loop.loop import Loop
from saltus.loop.planner import observe
from saltus.onnx_export import round_to_half
from saltus.policy.actor import PolicyActor
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.settings import JumpEnvSettings, JumpTrainSettings, LearningSettings
from saltus.policy.policy_features import PROPRIOCEPTION_SIZE, RECALLED, read_features, size_with
from saltus.policy.training.export import DeployedPolicy, export_policy, read_policy
from saltus.policy.training.train import Rank, train_policy
from saltus.resources import shipped_file
from saltus.robots.legs import LegKinematics
from saltus.sim.cpu_engine import CpuEngine
from saltus.terrain.course_batch import BOXES
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Trial

STEPS = (1, 2, 5)
N = 6
CONFIG = JumpTrainSettings(
    robot="go1",
    grid="line",
    robots=16,
    env=JumpEnvSettings(past_steps=STEPS),
    learning=LearningSettings(hidden=(32, 16), horizon=4, epochs=1, minibatches=2),
)


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy that recalls, trained for a moment, whose plans depend on the past."""
    folder = tmp_path_factory.mktemp("training")
    train_policy(CONFIG, folder, minutes=1.0, rank=Rank(), iterations=2)
    checkpoint = folder / "checkpoint.pt"
    state = torch.load(checkpoint, weights_only=True)
    last = [name for name in state["actor_state_dict"] if name.endswith("weight")][-1]
    state["actor_state_dict"][last] *= (
        30.0  # an untrained network says nearly the same whatever it sees
    )
    torch.save(state, checkpoint)
    assert export_policy(checkpoint, folder / "policy.onnx") < 1e-4
    return folder / "policy.onnx"


def test_a_policys_file_drives_on_a_device_as_its_checkpoint_does(
    policy: Path, tmp_path: Path
) -> None:
    one, other = (
        DeployedPolicy(read_policy(path)) for path in (policy, policy.with_name("checkpoint.pt"))
    )
    round_to_half(other.network.get_submodule("mlp"))  # as the file's weights are
    given = torch.randn(100, one.size)
    with torch.no_grad():
        torch.testing.assert_close(one(given), other(given))
    with pytest.raises(ModelError, match="is no motion policy"):
        read_policy(shipped_file("models/heightmap.onnx"))
    file = onnx.load(policy)
    (config,) = (entry for entry in file.metadata_props if entry.key == "config")
    known, config.value = config.value, "3"
    onnx.save(file, tmp_path / "other.onnx")
    with pytest.raises(SaltusError, match="configuration does not fit"):
        read_policy(tmp_path / "other.onnx")
    config.value = known
    file.graph.initializer[1].name += "x"
    for node in file.graph.node:
        node.input[:] = [
            f"{name}x" if f"{name}x" == file.graph.initializer[1].name else name
            for name in node.input
        ]
    onnx.save(file, tmp_path / "other.onnx")
    with pytest.raises(ModelError, match="another network than this program exports"):
        read_policy(tmp_path / "other.onnx")


def trained(
    outputs: Callable[[int, Tensor], Tensor], steps: int
) -> tuple[list[Tensor], list[Tensor], list[Tensor]]:
    """What a training showed its policy, who began, and the plans, as shares of their ranges."""
    engine = CpuEngine(ROBOT, N, BOXES, threads=1)
    env = JumpEnv(engine, CONFIG.env, LINE, seed=0)
    shown, fresh, plans = [env.transition().actor], [torch.ones(N, dtype=torch.bool)], []
    for step in range(steps):
        transition = env.step(outputs(step, shown[-1]))
        plans.append(env.config.bounds.normalised(env.memory.plan))
        shown.append(transition.actor)
        fresh.append(transition.done)
    return shown, fresh, plans


def test_each_instant_is_what_was_felt_and_planned_so_many_steps_ago() -> None:
    generator = torch.Generator().manual_seed(0)
    shown, fresh, plans = trained(lambda *_: torch.randn(N, 10, generator=generator), 60)
    assert shown[0].shape == (N, size_with(LINE, STEPS))
    again, found, expected = 0, [], []
    for now, robot in np.ndindex(len(shown), N):
        begun = max(k for k in range(now + 1) if fresh[k][robot])
        again += begun > 0
        for place, steps in enumerate(STEPS):
            found.append(shown[now][robot, size_with(LINE) + place * RECALLED :][:RECALLED])
            ago = max(now - steps, begun)
            plan = plans[ago][robot] if now - steps >= begun else torch.zeros(10)
            expected.append(torch.cat([shown[ago][robot, :PROPRIOCEPTION_SIZE], plan]))
    torch.testing.assert_close(torch.stack(found), torch.stack(expected))
    assert again > 20, "robots also began in the midst of the run"


def test_the_deployed_planner_recalls_what_the_training_does(policy: Path) -> None:
    actor = PolicyActor(ROBOT, LINE, policy)
    outputs = CONFIG.env.bounds.normalised
    shown, fresh, plans = trained(
        lambda _, vector: outputs(
            torch.as_tensor(actor.values(vector.numpy()), dtype=torch.float32)
        ),
        40,
    )
    together, one = PolicyActor(ROBOT, LINE, policy), PolicyActor(ROBOT, LINE, policy)
    for now, plan in enumerate(plans):
        observation, heights = read_features(shown[now].double().numpy(), LINE)
        said = together.step(observation, heights, fresh[now].numpy())
        alone = one.step(*read_features(shown[now][0].double().numpy(), LINE), bool(fresh[now][0]))
        expected = CONFIG.env.bounds.denormalised(plan).numpy()
        np.testing.assert_allclose(said.velocity_x, expected[:, 1], atol=1e-4)
        np.testing.assert_allclose(said.foot_residual_rear, expected[:, 7:], atol=1e-4)
        np.testing.assert_allclose(alone.pitch_rate, expected[0, 3], atol=1e-4)


def test_the_past_begins_when_the_robot_may_go(policy: Path) -> None:
    flat = [make_terrain(TerrainConfig(terrain="flat"))]
    actor = PolicyActor(ROBOT, LINE, policy)
    rollout = Loop(setups_of(flat, [Trial.draw(0)]), actor, stand_steps=8)
    for _ in range(9):
        step = rollout.step()
    blank = PolicyActor(ROBOT, LINE, policy)
    first = blank.step(observe(step.states, LegKinematics(ROBOT)), step.heights)
    np.testing.assert_array_equal(first.velocity_x, step.plan.velocity_x)


@pytest.mark.parametrize("steps", [(0,), (2, 1), (3, 3), (1, 101), (-1,)])
def test_what_cannot_be_recalled_is_refused(steps: tuple[int, ...]) -> None:
    with pytest.raises(ConfigError, match="past_steps"):
        replace(CONFIG.env, past_steps=steps)


def test_a_file_that_says_nonsense_of_its_past_is_refused(policy: Path, tmp_path: Path) -> None:
    for text in ("[2, 1]", '"x"', "3", "[1.5]", "[[1]]"):
        model = onnx.load(policy)
        next(entry for entry in model.metadata_props if entry.key == "past_steps").value = text
        onnx.save(model, tmp_path / "policy.onnx")
        with pytest.raises(ModelError, match="past_steps"):
            PolicyActor(ROBOT, LINE, tmp_path / "policy.onnx")
