"""A shard that robots on processors make: repeatable,
of the robot's own profile, kept where it is interrupted.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heightmap_inputs import SHORT_STAND_STEPS
from samples import EVERYTHING, PROFILE, setups_of

from saltus.cli.main import main
from saltus.depth_camera import load_camera
from saltus.effects.camera import CameraPitch
from saltus.effects.image_delivery import CameraLatency
from saltus.heightmap import collection as heightmap_collection
from saltus.heightmap.data.delivery import hardware_table
from saltus.heightmap.data.device_rollouts import DeviceRollouts
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.inventory import validate_dataset
from saltus.heightmap.data.shards import read_dataset, read_manifest
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.heightmap.settings import MIN_TICKS, DeviceLoop
from saltus.loop.body import Body
from saltus.policy.training.checkpoint import read_policy_checkpoint
from saltus.terrain import flat
from saltus.trial import Trial

pytestmark = pytest.mark.usefixtures("short_stand")
ROBOTS, TICKS = 2, SHORT_STAND_STEPS + 10
POLICY = Path(__file__).resolve().parents[2] / "models" / "checkpoints" / "policy.pt"


def command(out: Path, camera: str, *more: str) -> list[str]:
    sizes = {"robots": ROBOTS, "courses": 1, "ticks": TICKS, "hardest": 0.2, "camera": camera}
    loop = [part for name, value in sizes.items() for part in (f"--loop.{name}", str(value))]
    return [
        "heightmap",
        "collect",
        "cpu",
        "--out",
        str(out),
        "--batches",
        "2",
        "--processes",
        "1",
        *loop,
        *more,
    ]


def collected(out: Path, camera: str, *more: str) -> list[Episode]:
    assert main(command(out, camera, *more)) == 0
    return read_dataset(out)


@pytest.mark.sample(1)
@pytest.mark.parametrize("camera", ["ideal", "d435i"])
def test_a_seed_repeats_the_shard_and_a_profile_moves_the_camera(
    camera: str, tmp_path: Path
) -> None:
    profile = tmp_path / "tilted.toml"
    profile.write_text(
        replace(PROFILE, camera=(*PROFILE.camera, CameraPitch(offset=0.17))).to_toml()
    )
    first, again, tilted = (
        collected(tmp_path / name, camera, *more)
        for name, more in (("a", ()), ("b", ()), ("c", ("--profile", str(profile))))
    )
    assert len(first) == 2 * ROBOTS
    for one, same, other in zip(first, again, tilted, strict=True):
        assert one.height.shape == (TICKS, 30)
        assert one.proprioception.shape == (TICKS, len(PROPRIOCEPTION))
        assert one.depth.shape == (len(one.frame_tick), 48, 16)
        np.testing.assert_array_equal(one.depth, same.depth)
        np.testing.assert_array_equal(one.proprioception, other.proprioception)
        nearer = np.minimum(other.depth, 3000).mean() / np.minimum(one.depth, 3000).mean()
        assert nearer < 0.97  # it looks further down


@pytest.mark.slow
def test_all_that_a_profile_says_of_robots_and_cameras_reaches_both_collections(
    tmp_path: Path,
) -> None:
    path, said = (
        tmp_path / "everything.toml",
        {effect.name for effect in EVERYTHING.effects.values()},
    )
    path.write_text(EVERYTHING.to_toml())
    plant = Body(setups_of([flat.make()], [Trial()], EVERYTHING))._plant
    held = (*plant._chain.effects, *plant._body.effects, *plant._imu_chain.effects)
    assert {effect.name for effect in (*held, *EVERYTHING.camera)} == said
    episodes = collected(tmp_path / "cpu", "ideal", "--profile", str(path))

    loop, policy = (
        DeviceLoop(robot="go1", grid="line", robots=2, ticks=MIN_TICKS, cameras=("ideal",)),
        read_policy_checkpoint(POLICY),
    )
    device = DeviceRollouts(loop, policy, None, device="cpu", seed=0, profile=str(path))
    env, cameras = device._env, device._cameras
    held = (
        *env._drives.effects,
        *env._imu.effects,
        *env.episodes._body.effects,
        *cameras._view.effects,
    )
    assert {effect.name for effect in (*held, *cameras._chain.effects, device._latency)} == said
    episodes += device.batch().episodes("ideal")
    for episode in episodes:
        assert len(episode.frame_tick) < 0.3 * len(episode.height), (
            "the camera holds images and loses some"
        )
    known = hardware_table(str(path), "go1", load_camera("ideal"))
    assert (
        {CameraLatency(**known["latency"])}
        == {e.latency for e in episodes[: 2 * ROBOTS]}
        == {EVERYTHING.camera[-1]}
    )


def test_a_renderer_is_in_the_manifest_and_the_same_motion_is_not_collected_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    collected(tmp_path, "d435i", "--renderer", "pyrender")
    assert read_manifest(tmp_path)[0].config["renderer"] == "pyrender"
    assert main(command(tmp_path, "d435i")) == 2
    assert "already" in capsys.readouterr().err


@pytest.mark.parametrize("interrupted_at", [1, 2])
def test_batches_that_were_whole_when_it_was_interrupted_are_kept(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    interrupted_at: int,
) -> None:
    calls, law = [], heightmap_collection.closed_loop_episodes

    def interrupted(*given: Any, **more: Any) -> list[Episode]:
        calls.append(given)
        if len(calls) == interrupted_at:
            raise KeyboardInterrupt
        return law(*given, **more)

    monkeypatch.setattr(heightmap_collection, "closed_loop_episodes", interrupted)
    out = tmp_path / "data"
    assert main(command(out, "ideal")) == 130
    said = capsys.readouterr().err
    if interrupted_at == 1:
        assert "nothing is kept" in said
        assert list(out.iterdir()) == []
        return
    assert "what was collected is kept" in said
    assert validate_dataset(out) == []
    assert read_manifest(out)[0].episodes == ROBOTS
