"""Networks of the ablations: trained from the same data, run where policy and predictor are."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from paper import training
from paper.ablations import files_of, shown_in, trained_systems, trainings_of
from paper.imitation import ImitationNetwork, PassOn
from paper.networks import NetworkEffort, for_imitation, train_network, write_imitator
from paper.runs import Effort, Setting, ran
from paper.training import FULL, NETWORKS
from saltus.config import TerrainConfig
from saltus.errors import SaltusError
from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.data.shards import read_dataset, read_manifest
from saltus.heightmap.model import HeightmapModel, Normalisation
from saltus.heightmap.settings import MIN_TICKS, DeviceLoop, ModelSettings
from saltus.heightmap.training import calibration
from saltus.heightmap.training.train import load_checkpoint
from saltus.loop.planner import observe
from saltus.policy.bounds import ACTIONS, plan_from_values
from saltus.policy.env.settings import JumpTrainSettings
from saltus.policy.policy_features import PROPRIOCEPTION_SIZE, policy_features
from saltus.resources import shipped_file
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.states import standing_state
from saltus.terrain.curriculum import make_terrain

TINY = NetworkEffort(
    updates=1,
    batch=2,
    loop=DeviceLoop(
        robot="go1", grid="line", robots=14, ticks=MIN_TICKS, terrains=("flat", "step"), plans=True
    ),
)


@pytest.fixture
def taught(tmp_path: Path) -> Path:
    """A folder of trainings that has a policy of one seed, and no data."""
    return with_policy(tmp_path / "taught")


def with_policy(folder: Path) -> Path:
    teacher = folder / FULL / "seed-4"
    teacher.mkdir(parents=True)
    shutil.copyfile(shipped_file("models/policy.onnx"), teacher / "policy.onnx")
    return folder


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All networks of a seed, hardly trained, in two rounds."""
    folder = with_policy(tmp_path_factory.mktemp("trained"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "ROUNDS", 2)
        patch.setattr(calibration, "WINDOWS", 1)
        for name in NETWORKS:
            assert train_network(name, 4, folder, "c0ffee", TINY).exists()
    return folder


@pytest.mark.slow
def test_all_networks_of_a_seed_learn_from_the_data_of_the_predictors_rounds(trained: Path) -> None:
    records = read_manifest(trained / "data" / "seed-4")
    assert [record.config["heights"] == "true" for record in records] == [True, False]
    assert len({record.seed for record in records}) == 2
    rounds = [
        load_checkpoint(trained / "predictor" / "seed-4" / f"round-{i}.pt")[1] for i in range(2)
    ]
    assert rounds[0]["start"] is None
    assert rounds[1]["start"]["dataset"] == rounds[0]["dataset"]
    _, late = load_checkpoint(trained / "no-latency" / "seed-4" / "network.pt")
    assert (late["config"]["delivery"], late["dataset"]) == ("at-once", rounds[-1]["dataset"])
    assert late["config"]["updates"] == 2 * TINY.updates


@pytest.mark.slow
def test_systems_are_made_of_trainings_of_one_seed(trained: Path) -> None:
    assert trained_systems(trained) == [FULL, "round 1", "round 2", "no-latency", "imitation"]
    assert shown_in("no-latency", trained) == ("round 3", "no-latency")
    (known,) = trainings_of("no-latency", trained)
    assert (known["seed"], known["predictor_commit"]) == (4, "c0ffee")
    ((policy, predictor),) = files_of("no-latency", trained)
    assert policy == trained / FULL / "seed-4" / "policy.onnx"
    assert predictor == trained / "no-latency" / "seed-4" / "heightmap.onnx"
    with pytest.raises(SaltusError, match=r"saltus paper train no-saturation --seed 0 \(GPU\)"):
        files_of("no-sysid", trained)


@pytest.mark.slow
def test_robots_run_with_what_was_trained(trained: Path) -> None:
    terrain, effort = (
        make_terrain(TerrainConfig(terrain="flat")),
        Effort(trials=1, time_limit_s=1.2, processes=1),
    )
    with_predictor, imitating = (
        Setting(terrain=terrain, predictor=trained / "no-latency" / "seed-4" / "heightmap.onnx"),
        Setting(terrain=terrain, imitator=trained / "imitation" / "seed-4" / "imitator.onnx"),
    )
    ((first,), (second,), (shipped,)) = ran(
        [with_predictor, imitating, Setting(terrain=terrain)], effort
    )
    ends = [run.reference[110:] for run in (first, second, shipped)]  # after it stood
    assert not any(np.array_equal(a, b) for a, b in zip(ends, [*ends[1:], ends[0]], strict=True))
    assert all(np.isfinite(end).all() for end in ends)


def test_an_imitator_that_is_told_what_to_plan_plans_as_the_policy_does(tmp_path: Path) -> None:
    """A network whose answer is always one plan, through the file,
    the place of heights, and the planner.
    """
    robot, config = load_robot(DEFAULT_ROBOT), JumpTrainSettings(robot="go1", grid="line")
    observation = observe(standing_state(robot), LegKinematics(robot))
    heights = np.full(len(HEIGHTMAP_X), -robot.stand_height)
    plan = config.env.bounds.denormalised(np.random.default_rng(0).uniform(-1.0, 1.0, len(ACTIONS)))
    sizes = (PROPRIOCEPTION_SIZE, PROPRIOCEPTION_SIZE, len(ACTIONS), len(ACTIONS))
    model = HeightmapModel(ModelSettings(), Normalisation(*map(torch.ones, sizes)))
    with torch.no_grad():
        model.head[-1].weight.zero_()
        model.height_mean.copy_(torch.from_numpy(config.env.bounds.normalised(plan)))
        model.head[-1].bias.zero_()
    network = ImitationNetwork(
        write_imitator(model, config, tmp_path / "imitator.onnx", 0, "c0ffee")
    )
    state = policy_features(observation, heights)[None, :PROPRIOCEPTION_SIZE]
    hidden = np.zeros((1, network.hidden_size), np.float32)
    tick = network.tick(np.zeros((1, 2, 48, 16)), np.zeros(1), np.zeros(1, np.bool_), state, hidden)
    assert tick.height.shape == (1, len(HEIGHTMAP_X))
    found, wanted = PassOn(network.bounds).step(observation, tick.height[0]), plan_from_values(plan)
    for name, value in vars(wanted).items():
        np.testing.assert_allclose(getattr(found, name), value, atol=1e-4, err_msg=name)


@pytest.mark.slow
def test_data_without_plans_are_not_imitated(trained: Path) -> None:
    episode = read_dataset(trained / "data" / "seed-4")[0]
    shown = for_imitation(episode)
    assert shown.proprioception is episode.state
    assert shown.height is episode.plan
    with pytest.raises(SaltusError, match="the dataset keeps no plans"):
        for_imitation(shown)


def test_without_a_policy_or_data_it_says_what_makes_them(
    tmp_path: Path, taught: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(training, "PUBLISHED_TRAININGS", taught)  # the published policy drives
        with pytest.raises(SaltusError, match="saltus paper train predictor --seed 0 makes them"):
            train_network("imitation", 0, tmp_path, effort=TINY)
    monkeypatch.setattr(training, "PUBLISHED_TRAININGS", tmp_path)
    with pytest.raises(SaltusError, match="saltus paper train full-system --seed 0 makes one"):
        train_network("predictor", 0, tmp_path, effort=TINY)
    with pytest.raises(SaltusError, match="saltus paper train predictor --seed 5 makes them"):
        train_network("imitation", 5, taught, effort=TINY)
