"""Rollouts on one device follow the laws of those with processes.

On a processor a seed repeats them to the bit.
"""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from samples import ROBOT

from saltus.cli.main import main as saltus
from saltus.config import from_toml, to_toml
from saltus.effects.camera import NOMINAL_LATENCY
from saltus.effects.signals import DepthImage
from saltus.errors import ConfigError
from saltus.grid import LINE
from saltus.heightmap.data.delivery import FRAME_TICKS, TICK_S, TRAINING, ImageDeliveryModel
from saltus.heightmap.data.device_cameras import late_images
from saltus.heightmap.data.device_rollouts import DeviceRollouts
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.inventory import validate_dataset
from saltus.heightmap.data.shards import read_dataset, read_manifest
from saltus.heightmap.model import HeightmapModel
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.heightmap.service.sight import Sight
from saltus.heightmap.settings import MIN_TICKS, TERRAINS, DeviceLoop
from saltus.heightmap.training.validate import run_episode
from saltus.policy.bounds import ACTIONS
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.randomisation import WideSettings
from saltus.policy.env.settings import JumpTrainSettings
from saltus.policy.env.training_env import Transition
from saltus.policy.policy_features import size_with
from saltus.policy.training.checkpoint import read_policy_checkpoint

pytestmark = pytest.mark.slow

CHECKPOINTS = Path(__file__).resolve().parents[2] / "models" / "checkpoints"
ROBOTS, TICKS = len(TERRAINS), 70
LED_TICKS = 15
NOT_ON_GPU_MACHINES = ("open3d", "cv2", "pyrender", "zenoh", "rosbags", "mcap", "plotly")


def collected(folder: Path, *more: str) -> list[Episode]:
    """What the command with a predictor in the loop puts into a dataset, in two batches."""
    assert saltus([*command(folder), *more]) == 0
    return read_dataset(folder)


def command(folder: Path) -> list[str]:
    given = {
        "episodes": 2 * ROBOTS,
        "loop.robots": ROBOTS,
        "loop.ticks": TICKS,
        "seed": 3,
        "device": "cpu",
    }
    files = {
        "policy": CHECKPOINTS / "policy.pt",
        "predictor": CHECKPOINTS.parent / "heightmap.onnx",
        "out": folder,
    }
    flags = (
        part for name, value in {**given, **files}.items() for part in (f"--{name}", str(value))
    )
    return ["heightmap", "collect", "gpu", *flags]


@pytest.fixture(scope="module")
def datasets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Images of both cameras from one motion."""
    folder = tmp_path_factory.mktemp("device")
    collected(folder / "d435i", "--loop.cameras", "d435i", "ideal")
    (folder / "d435i-ideal").rename(folder / "ideal")
    return {name: folder / name for name in ("d435i", "ideal")}


def test_robots_are_on_their_way_nearly_all_the_time(datasets: dict[str, Path]) -> None:
    assert read_manifest(datasets["d435i"])[0].ticks > 0.9 * 2 * ROBOTS * TICKS


def test_both_cameras_see_the_same_motion(datasets: dict[str, Path]) -> None:
    for name in ("d435i", "ideal"):
        assert validate_dataset(datasets[name]) == []
        assert read_manifest(datasets[name])[0].config["camera"] == name
    pairs = list(zip(*(read_dataset(datasets[name]) for name in ("d435i", "ideal")), strict=True))
    for stereo, true in pairs:
        np.testing.assert_array_equal(stereo.proprioception, true.proprioception)
        np.testing.assert_array_equal(stereo.height, true.height)
        both = (stereo.depth > 0) & (true.depth < 2000)
        assert both.mean() > 0.2
        error = stereo.depth[both].astype(float) - true.depth[both]
        assert 0.5 < np.median(np.abs(error)) < 30.0  # [mm]; edges and holes err more
    assert {true.terrain for _, true in pairs} == set(TERRAINS)


def test_episodes_are_what_robots_meet_from_a_start_to_the_next(datasets: dict[str, Path]) -> None:
    for episode in read_dataset(datasets["d435i"]):
        assert MIN_TICKS <= len(episode.height) <= TICKS
        assert episode.frame_tick[0] < FRAME_TICKS
        assert (np.diff(episode.frame_tick) == FRAME_TICKS).all()
        assert np.isfinite(episode.proprioception).all()
        base_height = episode.proprioception[:, PROPRIOCEPTION.index("base_height")]
        # Ground under a robot that stands
        level = np.abs(episode.height[0] - episode.height[0, 0]) < 0.005
        assert level[:10].all()
        assert episode.height[0, 0] == pytest.approx(-base_height[0], abs=0.06)


def test_plans_that_are_kept_are_the_policys_on_true_heights(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A policy whose plan is the heights farthest ahead,
    of robots that are shown heights with errors.
    """
    loop = DeviceLoop(
        robot="go1",
        grid="line",
        robots=3,
        ticks=MIN_TICKS,
        terrains=("stairs",),
        cameras=("ideal",),
        plans=True,
    )
    rollouts = DeviceRollouts(
        loop, read_policy_checkpoint(CHECKPOINTS / "policy.pt"), None, device="cpu", seed=0
    )
    bounds = rollouts._env.config.bounds
    monkeypatch.setattr(
        rollouts,
        "_policy",
        lambda shown: bounds.denormalised(
            shown[:, size_with(LINE) - len(ACTIONS) : size_with(LINE)]
        ),
    )
    recorded = rollouts.batch()
    assert recorded.state is not None
    assert recorded.plan is not None
    np.testing.assert_allclose(recorded.plan, recorded.height[..., -len(ACTIONS) :], atol=1e-5)
    standing = {"roll": 8, "pitch": 9, "base_height": 16}
    for name, place in standing.items():
        known = recorded.proprioception[..., PROPRIOCEPTION.index(name)]
        np.testing.assert_allclose(recorded.state[..., place], known, atol=1e-5, err_msg=name)


@pytest.mark.parametrize(
    ("share", "robots"), [(0.0, (0, 0)), (0.5, (1, ROBOTS - 1)), (1.0, (ROBOTS, ROBOTS))]
)
def test_robots_are_led_by_whom_the_share_says(
    share: float, robots: tuple[int, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scripted planner keeps to one rhythm for each robot, the policy to none."""
    outputs: list[torch.Tensor] = []
    step = JumpEnv.step

    def watched(env: JumpEnv, output: torch.Tensor) -> Transition:
        outputs.append(output.clone())
        if len(outputs) == LED_TICKS:
            raise KeyboardInterrupt  # no more is looked at
        return step(env, output)

    monkeypatch.setattr(JumpEnv, "step", watched)
    assert (
        saltus([*command(tmp_path), "--loop.learned", str(share), "--loop.cameras", "ideal"]) == 130
    )
    rhythm = torch.stack(outputs)[..., ACTIONS.index("stepping_frequency_hz")]
    assert rhythm.shape == (LED_TICKS, ROBOTS)
    varies = rhythm.std(0) > 1e-6
    assert robots[0] <= int(varies.sum()) <= robots[1]
    scripted = rhythm[0, ~varies]
    scripted = scripted[scripted < 1.0]  # some would be faster than an action can be
    assert len(scripted.unique()) == len(scripted)  # each has a rhythm of its own


def test_robots_differ_as_at_the_end_of_their_policys_training() -> None:
    policy = read_policy_checkpoint(CHECKPOINTS / "policy.pt")
    config = from_toml(JumpTrainSettings, policy["config"])
    wide = WideSettings(share=1.0, growth_msteps=(100.0, 400.0))
    randomisation = replace(config.env.randomisation, wide=wide)
    policy["config"] = to_toml(
        replace(config, env=replace(config.env, randomisation=randomisation))
    )
    loop = DeviceLoop(robot="go1", grid="line", robots=16, ticks=MIN_TICKS, terrains=("flat",))
    memory = DeviceRollouts(loop, policy, None, device="cpu", seed=0)._env.memory
    for drawn, most in (
        (memory.joint_damping, wide.joint_damping),
        (memory.joint_friction, wide.joint_friction),
    ):
        assert 0.3 * most < float(drawn.mean()) <= float(drawn.max()) <= most


def test_late_and_lost_images_never_go_back_in_time() -> None:
    count = 150
    images = late_images(count, TRAINING, NOMINAL_LATENCY, np.random.default_rng(1), "cpu")
    nobody, ages, fresh = torch.zeros(count, dtype=torch.bool), [], []
    for tick in range(200):
        now_s = torch.full((count,), TICK_S * tick, dtype=torch.float64)
        exposed = (
            DepthImage(depth=torch.full((count, 48, 16), 1000), time_s=now_s)
            if tick % FRAME_TICKS == 0
            else None
        )
        fresh.append(images.step(exposed, TICK_S * tick, nobody))
        ages.append(now_s - images.in_hand.time_s)
    age, new = torch.stack(ages)[20:], torch.stack(fresh)[20:]
    step = age[1:] - age[:-1]
    torch.testing.assert_close(
        step[~new[1:]], torch.full_like(step[~new[1:]], TICK_S), atol=1e-5, rtol=0.0
    )
    assert age[new].min() >= TRAINING.latency_s[0] - 1e-6
    assert age[new].max() <= sum((TRAINING.latency_s[1], TRAINING.jitter_s, TICK_S))
    arrived = FRAME_TICKS * new.float().mean(0)
    assert 1.0 - TRAINING.loss < arrived.mean() < 1.0
    forgotten = torch.arange(count) < 7
    new = images.step(None, 2.0, forgotten)
    assert (images.in_hand.depth[:7] == 0.0).all()
    assert (images.in_hand.depth[7:] > 0.0).all()
    assert not new[:7].any()
    assert torch.isinf(images.in_hand.time_s[:7]).all()


def test_heights_on_a_device_are_those_of_the_file(model: HeightmapModel, model_path: Path) -> None:
    """Tick by tick, and again after a robot starts anew."""
    rng = np.random.default_rng(0)
    ticks, latency = 60, ImageDeliveryModel()
    episode = Episode(
        terrain="flat",
        proprioception=rng.normal(size=(ticks, len(PROPRIOCEPTION))).astype(np.float32),
        height=np.zeros((ticks, 30), np.float32),
        depth=rng.integers(0, 5000, (ticks // 2, 48, 16)).astype(np.uint16),
        frame_tick=np.arange(0, ticks, FRAME_TICKS, dtype=np.int32),
    )
    expected, _ = run_episode(HeightmapNetwork(ROBOT, model_path), episode, latency)
    images = late_images(2, latency, NOMINAL_LATENCY, np.random.default_rng(0), "cpu")
    sight = Sight(model, images.in_hand.depth)
    for tick in range(2 * ticks):
        k = tick % ticks
        image = torch.tensor(episode.depth[k // 2].astype(np.int32))
        now_s = torch.full((2,), TICK_S * tick, dtype=torch.float64)
        exposed = (
            DepthImage(depth=image.expand(2, 48, 16), time_s=now_s)
            if k % FRAME_TICKS == 0
            else None
        )
        features = torch.tensor(episode.proprioception[k]).expand(2, -1)
        time_s, fresh = TICK_S * tick, torch.full((2,), k == 0)
        arrived = images.step(exposed, time_s, fresh)
        found = sight.step(arrived, images.in_hand, time_s, features, fresh)
        np.testing.assert_allclose(found, np.tile(expected[k], (2, 1)), atol=1e-4)


def test_all_that_a_gpu_machine_needs_is_imported_without_what_it_lacks() -> None:
    blocked = f"import sys; sys.modules.update(dict.fromkeys({NOT_ON_GPU_MACHINES!r}))"
    needed = (
        "saltus.heightmap.device_collection, saltus.heightmap.training.train, "
        "saltus.sim.warp_engine, saltus.cli.main, benchmarks.hard_courses"
    )
    program = f"{blocked}; import {needed}"
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"robots": 0}, "robots"),
        ({"ticks": 10}, "ticks"),
        ({"hardest": 1.5}, "hardest"),
        ({"learned": -0.1}, "learned"),
    ],
)
def test_loops_that_lead_nowhere_are_refused(changes: dict[str, float], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        DeviceLoop(robot="go1", grid="line", **changes)


def test_a_missing_gpu_is_said_in_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert saltus(["heightmap", "collect", "gpu", "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err.strip()
    assert "no GPU found" in said.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("interrupted_at", [3, TICKS + 3])
def test_a_seed_repeats_the_data_and_batches_that_were_whole_when_it_was_interrupted_are_kept(
    datasets: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    interrupted_at: int,
) -> None:
    calls, step = [], JumpEnv.step

    def interrupted(env: JumpEnv, output: torch.Tensor) -> Transition:
        calls.append(env)
        if len(calls) == interrupted_at:
            raise KeyboardInterrupt
        return step(env, output)

    monkeypatch.setattr(JumpEnv, "step", interrupted)
    assert saltus(command(tmp_path / "data")) == 130
    said = capsys.readouterr().err
    if interrupted_at < TICKS:
        assert "nothing is kept" in said
        assert list((tmp_path / "data").iterdir()) == []
        return
    assert "what was collected is kept" in said
    assert validate_dataset(tmp_path / "data") == []
    kept, whole = read_dataset(tmp_path / "data"), read_dataset(datasets["d435i"])
    assert 0 < len(kept) <= ROBOTS < len(whole)
    for left, right in zip(kept, whole, strict=False):
        for name in ("proprioception", "height", "depth", "frame_tick"):
            np.testing.assert_array_equal(getattr(left, name), getattr(right, name))
