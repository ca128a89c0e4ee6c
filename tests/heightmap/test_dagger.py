import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heightmap_inputs import SHORT_STAND_STEPS
from samples import KINEMATICS, ROBOT

from saltus.cli.main import main
from saltus.config import PlannerName
from saltus.errors import ConfigError
from saltus.grid import HEIGHTMAP_X, LINE
from saltus.heightmap.data.closed_loop import MixedPlanner, closed_loop_episodes
from saltus.heightmap.data.shards import DatasetError, read_manifest
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.heightmap.settings import MIN_TICKS, ClosedLoop, DaggerSettings
from saltus.heightmap.training.dagger import Observer, run_dagger
from saltus.heightmap.training.train import TrainingProgress
from saltus.loop.planner import observe
from saltus.policy.planner import make_planner
from saltus.states import standing_state
from saltus.workers import in_order

pytestmark = [pytest.mark.usefixtures("short_calibration", "short_stand"), pytest.mark.slow]
TICKS = SHORT_STAND_STEPS + 12  # just beyond the stand: beliefs matter
LOOP = ClosedLoop(robot="go1", grid="line", robots=6, courses=2, ticks=TICKS, hardest=0.3)
CONFIG = DaggerSettings(rounds=2, batches=2, updates=2, batch=2, loop=LOOP)


class Killed(BaseException):
    """Stands for whatever ends a process in mid-work."""


def killed_at(when: str) -> Observer:
    """Ends the run when it is told of this moment: "collect ROUND BATCHES" or "train ROUND"."""

    def collected(index: int, batches: int, _: int) -> None:
        if when == f"collect {index} {batches}":
            raise Killed

    def trained(index: int, progress: TrainingProgress) -> None:
        if when == f"train {index}":
            raise Killed

    return Observer(collected=collected, trained=trained)


SILENT = killed_at("never")


def contents(run: Path) -> list[str]:
    return [record.sha256 for record in read_manifest(run / "dataset")]


@pytest.fixture(scope="module")
def whole(short_stand: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run without interruption."""
    run = tmp_path_factory.mktemp("whole")
    run_dagger(run, CONFIG, SILENT, processes=1)
    return run


def test_rounds_alternate_between_the_loop_and_training(whole: Path) -> None:
    records = read_manifest(whole / "dataset")
    assert [record.config["round"] for record in records] == [0, 1]
    assert records[0].config["heights"] == "true"
    assert records[1].config["heights"] in (whole / "round_000" / "heightmap.md").read_text()
    assert all(record.ticks > 0.5 * CONFIG.batches * LOOP.robots * LOOP.ticks for record in records)
    assert main(["heightmap", "dataset", "validate", str(whole / "dataset")]) == 0


def test_a_run_that_was_killed_again_and_again_gives_the_same_data(
    whole: Path, tmp_path: Path
) -> None:
    for when in ("collect 0 1", "train 0", "collect 1 2", "train 1"):
        with pytest.raises(Killed):
            run_dagger(tmp_path, CONFIG, killed_at(when), processes=1)
    run_dagger(tmp_path, CONFIG, SILENT, processes=1)
    assert contents(tmp_path) == contents(whole)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        path.name for path in whole.iterdir()
    )
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    run_dagger(tmp_path, CONFIG, SILENT, processes=1)  # all is done: nothing is written again
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_a_process_that_is_killed_and_one_that_shares_the_work_give_the_same_data(
    whole: Path, tmp_path: Path
) -> None:
    code = (
        "from functools import partial; from saltus.heightmap.data import closed_loop\n"
        f"closed_loop.Loop = partial(closed_loop.Loop, stand_steps={SHORT_STAND_STEPS})\n"
        "if __name__ == '__main__':\n"  # the workers import this file, and need none of the rest
        "    import sys; from pathlib import Path; from saltus.heightmap.training.dagger import *\n"
        "    from saltus.heightmap.settings import *\n"
        "    told = Observer(collected=lambda i, done, ticks: print(done, flush=True), "
        f"trained=lambda i, p: None)\n"
        f"    run_dagger(Path(sys.argv[1]), {CONFIG!r}, told, processes=2)\n"
    )
    script = tmp_path / "run.py"
    script.write_text(code)
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    run = subprocess.Popen(
        [sys.executable, script, tmp_path / "run"], stdout=subprocess.PIPE, env=environment
    )
    assert run.stdout is not None
    assert run.stdout.readline() == b"1\n"  # one of two batches is done
    run.kill()
    # The pipe ends when the last process that holds it is gone: the workers have died with the one
    # who started them.
    run.communicate(timeout=20)
    assert run.returncode == -signal.SIGKILL
    assert contents(tmp_path / "run") == []
    run_dagger(
        tmp_path / "run", DaggerSettings(**{**vars(CONFIG), "rounds": 1}), SILENT, processes=1
    )
    assert contents(tmp_path / "run") == contents(whole)[:1]


@pytest.mark.parametrize(
    "field", ["batches", "updates", "seed", "profile", "loop", "start", "base"]
)
def test_a_run_of_another_configuration_is_refused_by_name(whole: Path, field: str) -> None:
    changed: dict[str, dict[str, Any]] = {
        "loop": {"loop": ClosedLoop(robot="go1", grid="line", hardest=0.1)},
        "profile": {"profile": "ideal"},
        **{name: {name: 7} for name in ("batches", "updates", "seed")},
    }
    paths: dict[str, dict[str, Any]] = {
        "start": {"start": whole / "round_000" / "heightmap.pt"},
        "base": {"base": whole / "dataset"},
    }
    config = DaggerSettings(**{**vars(CONFIG), **changed.get(field, {})})
    with pytest.raises(DatasetError, match=f"begun with {field} ="):
        run_dagger(whole, config, SILENT, **paths.get(field, {}))


def test_a_base_with_the_rounds_of_this_seed_is_refused_before_anything_is_written(
    whole: Path, tmp_path: Path
) -> None:
    with pytest.raises(DatasetError, match="another seed"):
        run_dagger(tmp_path / "run", CONFIG, SILENT, base=whole / "dataset", processes=1)
    assert not (tmp_path / "run").exists()


def test_a_run_goes_on_from_a_predictor_and_a_dataset(whole: Path, tmp_path: Path) -> None:
    config = DaggerSettings(**{**vars(CONFIG), "rounds": 1})
    start, base = whole / "round_001" / "heightmap.pt", whole / "dataset"
    model = run_dagger(tmp_path, config, SILENT, start=start, base=base, processes=1)
    assert model.exists()
    records = read_manifest(tmp_path / "dataset")
    assert [record.sha256 for record in records[:2]] == contents(whole)
    assert records[2].config["heights"] not in ("true", records[1].config["heights"])


def test_episodes_differ_with_what_the_robot_believes_and_nothing_else(whole: Path) -> None:
    model = whole / "round_000" / "heightmap.onnx"
    true, predicted, again = (
        closed_loop_episodes(LOOP, path, (3, 0, 0)) for path in (None, model, model)
    )
    for a, b in zip(predicted, again, strict=True):
        np.testing.assert_array_equal(a.depth, b.depth)
        np.testing.assert_array_equal(a.proprioception, b.proprioception)
        assert a.height.shape == (len(a.height), 30)
        assert a.proprioception.shape == (len(a.height), len(PROPRIOCEPTION))
        assert len(a.height) >= MIN_TICKS
        assert np.isfinite(a.height).all()
    # Another belief moves the robots otherwise, from the same start.
    assert any(
        not np.array_equal(a.height, b.height) for a, b in zip(true, predicted, strict=False)
    )
    np.testing.assert_array_equal(true[0].height[0], predicted[0].height[0])


@pytest.mark.parametrize(("learned", "name"), [(0.0, "scripted"), (1.0, "learned")])
def test_each_planner_leads_its_share(learned: float, name: PlannerName) -> None:
    count = 5
    rng = np.random.default_rng(0)
    states = replace(
        standing_state(ROBOT),
        quaternion_base_in_world=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        angular_velocity_base=rng.normal(size=(count, 3)),
        joint_position=np.tile(ROBOT.stand_pose, (count, 1)),
        velocity_base_in_world=rng.normal(size=(count, 3)),
        base_height=rng.uniform(0.25, 0.3, count),
        leg_contact=np.tile([True, True, False, False], (count, 1)),
        leg_progress=rng.uniform(size=(count, 4)),
    )
    observation = observe(states, KINEMATICS)
    heights = -0.27 + 0.05 * rng.normal(size=(count, len(HEIGHTMAP_X)))
    mixed = MixedPlanner(ROBOT, LINE, rng, count, learned=learned, variation=0.0).step(
        observation, heights
    )
    alone = make_planner(name, ROBOT, LINE).step(observation, heights)
    np.testing.assert_allclose(mixed.pitch_rate, alone.pitch_rate)
    np.testing.assert_allclose(mixed.velocity_z, alone.velocity_z)
    assert len(np.unique(mixed.velocity_x / alone.velocity_x)) == count  # each at its own speed


@pytest.mark.parametrize(
    "values", [{"courses": 0}, {"courses": 40}, {"ticks": 10}, {"hardest": 1.5}, {"learned": -1.0}]
)
def test_a_loop_that_cannot_be_is_refused(values: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(values))):
        ClosedLoop(robot="go1", grid="line", **values)  # type: ignore[arg-type]


@pytest.mark.parametrize("processes", [1, 2])
def test_work_comes_back_in_order(processes: int) -> None:
    assert list(in_order(abs, [-3, 2, -1, 0, -7], processes)) == [3, 2, 1, 0, 7]


def test_info_counts_what_is_there(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["heightmap", "dataset", "info", str(whole / "dataset"), "--json"]) == 0
    table = json.loads(capsys.readouterr().out.splitlines()[-1])
    records = read_manifest(whole / "dataset")
    assert [shard["record"]["ticks"] for shard in table["shards"]] == [
        record.ticks for record in records
    ]
    assert [sum(shard["terrains"].values()) for shard in table["shards"]] == [
        r.episodes for r in records
    ]
    assert [shard["record"]["config"]["source"] for shard in table["shards"]] == [
        "dagger",
        "dagger",
    ]
