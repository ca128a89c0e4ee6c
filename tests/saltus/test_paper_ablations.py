"""The paper's ablations: what their trainings differ in,
which weights they need, and their learning curves.
"""

import lzma
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from paper import ablations, drawing
from paper.ablations import SYSTEMS, files_of, shipped_in, trainings_of
from paper.making import check_makeable, make
from paper.rows import BY_NAME
from paper.runs import Effort
from paper.stand_in import STAND_IN_SEED, stand_in
from paper.training import ABLATIONS, FULL, PUBLISHED, config_of
from saltus.effects.profile import SHIPPED, load_profile
from saltus.errors import SaltusError
from saltus.folders import setting_differences
from saltus.heightmap.data.delivery import TRAINING
from saltus.heightmap.data.randomisation import PITCH_ERROR, POSITION_ERROR_M
from saltus.policy.env.settings import for_gpu
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT

NOT_ON_GPU_MACHINES = (
    "open3d",
    "cv2",
    "pyrender",
    "zenoh",
    "rosbags",
    "mcap",
    "plotly",
    "matplotlib",
)


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody looks at these figures."""
    monkeypatch.setattr(drawing, "DPI", 40)


def test_an_ablation_differs_from_the_full_system_in_what_it_is_named_after(tmp_path: Path) -> None:
    configs = {name: config_of(name, 3, tmp_path) for name in ABLATIONS}
    full = asdict(configs[FULL])
    assert configs[FULL] == replace(for_gpu("go1", "line"), seed=3)
    found = {
        name: {d.name for d in setting_differences(full, asdict(config))}
        for name, config in configs.items()
    }
    assert found == {
        FULL: set(),
        "no-height-randomisation": {
            "env.randomisation.height_shift_m",
            "env.randomisation.height_noise_m",
        },
        "no-feedback": {"robot"},
        "no-tracking-reward": {"env.reward.tracking_cost"},
        "no-saturation": {"env.profile"},
    }
    usual, robot = load_robot(DEFAULT_ROBOT), load_robot(configs["no-feedback"].robot)
    assert robot.gains == replace(usual.gains, stance_kd=0.0)
    assert robot.name == usual.name
    assert usual.gains.stance_kd > 0.0
    shipped = load_profile(SHIPPED, usual).effects
    without = load_profile(configs["no-saturation"].env.profile, usual).effects
    assert shipped.keys() - without.keys() == {"torque_saturation"}
    assert all(shipped[name] == effect for name, effect in without.items())


def test_the_stand_in_lies_beyond_what_trainings_draw() -> None:
    draws, shipped = (
        for_gpu("go1", "line").env.randomisation,
        load_profile(SHIPPED, load_robot(DEFAULT_ROBOT)).effects,
    )
    assert stand_in() == stand_in() != stand_in(STAND_IN_SEED + 1)
    for seed in (STAND_IN_SEED, *range(20)):
        effects = stand_in(seed).effects
        changed = {name for name, effect in effects.items() if shipped.get(name) != effect}
        assert changed == {
            "actuator_lag", "coulomb_friction", "viscous_friction", "armature", "torque_gain",
            "soft_feet", "imu_bias",
            "camera_latency", "camera_pitch", "camera_height",
        }  # fmt: skip
        assert shipped.keys() <= effects.keys()
        assert max(effects["torque_gain"].gain) < draws.motor_strength[0]  # type: ignore[attr-defined]
        assert effects["camera_latency"].latency > TRAINING.latency_s[1]  # type: ignore[attr-defined]
        assert abs(effects["camera_pitch"].offset) > PITCH_ERROR  # type: ignore[attr-defined]
        assert abs(effects["camera_height"].offset) > POSITION_ERROR_M  # type: ignore[attr-defined]


@pytest.mark.parametrize("system", SYSTEMS)
def test_the_shipped_networks_of_a_system_are_those_that_no_training_replaces(system: str) -> None:
    for files in files_of(system, PUBLISHED / "trainings"):
        setting = ablations._setting(files)
        replaced = {
            "policy": setting.policy or setting.imitator,
            "heightmap": setting.predictor or setting.imitator,
        }
        assert shipped_in(system) == tuple(
            kind for kind, training in replaced.items() if training is None
        )


def test_weights_that_are_not_kept_are_asked_for_before_the_work(tmp_path: Path) -> None:
    kept = next(iter(sorted((PUBLISHED / "trainings").rglob("*.sha256"))))
    folder = tmp_path / FULL / "seed-0"
    folder.mkdir(parents=True)
    (folder / kept.name).write_bytes(kept.read_bytes())
    (known,) = trainings_of(FULL, tmp_path)
    assert known["policy"] == kept.read_text()[:16]
    with pytest.raises(
        SaltusError, match=r"policy.onnx are not kept here: git restore --source=\w+ "
    ):
        ablations.check_weights(FULL, tmp_path, [])
    ablations.check_weights(FULL, tmp_path, [{"simulation": {}}])
    folder.joinpath("policy.onnx").write_bytes(b"weights")
    ablations.check_weights(FULL, tmp_path, [])


def test_a_machine_that_trains_an_ablation_needs_no_camera_and_no_pictures() -> None:
    program = (
        f"import sys\nsys.modules |= dict.fromkeys({NOT_ON_GPU_MACHINES})\nimport paper.training"
    )
    subprocess.run([sys.executable, "-P", "-c", program], check=True, timeout=60)


def test_learning_curves_are_those_of_the_trainings(tmp_path: Path) -> None:
    columns = (
        "steps",
        "seconds",
        "reward",
        "stairs/level",
        "stepping_stones/level",
        "step/level",
        "gap/level",
    )
    for seed, count in enumerate((4, 6)):
        folder = tmp_path / FULL / f"seed-{seed}"
        folder.mkdir(parents=True)
        (folder / "policy.onnx").write_bytes(bytes([seed]))
        rows = [[1e6 * k, 60.0 * k, *(seed + k for _ in columns[2:])] for k in range(1, count)]
        lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
        (folder / "progress.csv").write_text("\n".join(lines))
    (tmp_path / "predictor" / "seed-3").mkdir(parents=True)
    errors = [
        f"round-{k},{100 * j},1.0,{0.01 * (20 - j - 10 * k)}" for k in (0, 1) for j in range(10)
    ]
    (tmp_path / "predictor" / "seed-3" / "progress.csv").write_text(
        "\n".join(["network,update,loss,error", *errors])
    )
    check_makeable(BY_NAME["learning-curves"], tmp_path / "out", tmp_path)
    numbers = make(BY_NAME["learning-curves"], Effort(), tmp_path / "out", tmp_path)["numbers"]
    assert (numbers["seeds"], numbers["million_steps"], numbers["minutes"]) == (
        2,
        [3.0, 5.0],
        [3.0, 5.0],
    )
    assert numbers["at_the_end"]["stairs/level"] == [3.0, 6.0]
    assert numbers["networks"]["predictor"] == {"round 1": [12.0, 11.0], "round 2": [2.0, 1.0]}
    assert numbers["networks"]["imitation"] == {}
    for path in tmp_path.rglob("progress.csv"):  # as published ones are
        path.with_name("progress.csv.xz").write_bytes(lzma.compress(path.read_bytes()))
        path.unlink()
    made = make(BY_NAME["learning-curves"], Effort(), tmp_path / "out", tmp_path)
    assert made["numbers"] == numbers
    (tmp_path / FULL / "seed-1" / "progress.csv.xz").unlink()
    with pytest.raises(SaltusError, match=r"cannot read .*progress.csv"):
        make(BY_NAME["learning-curves"], Effort(), tmp_path / "out", tmp_path)
