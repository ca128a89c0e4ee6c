"""The real recordings in npz, a Go2's sweep and an AlienGo's step answers,
become run logs by their descriptions.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest
from test_go2_recording import GO2, RECORDINGS, go2

from saltus.config import load_config
from saltus.real2sim.importers.importing import import_recording
from saltus.real2sim.problem.log import load_rigs
from saltus.real2sim.screening.screen import screen_log
from saltus.recordings.recording_description import RecordingDescription
from saltus.recordings.run_log import read_run_log
from saltus.robots.loading import load_robot
from saltus.robots.robot import JOINTS, LEGS, Robot

__all__ = ["go2"]
ORDER = [f"{leg}_{part}" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf")]
TO_OURS = [ORDER.index(joint) for joint in JOINTS]


@pytest.fixture(scope="module")
def recordings() -> Path:
    if not RECORDINGS.is_dir():
        pytest.skip(f"no real recordings beside the checkout: {RECORDINGS} is absent")
    return RECORDINGS


def test_the_sweep_is_imported_to_its_numbers_and_gravity_tells_left_from_right(
    recordings: Path, go2: Robot, tmp_path: Path
) -> None:
    sweep = recordings / "go2_sweep_200hz.npz"
    imported = import_recording(
        sweep, tmp_path / "log", load_config(RecordingDescription, GO2 / "sweep.toml"), go2
    )
    assert imported.notes == (
        "not in the log: dq, tau_est, imu, base, depth; what needs them will be untestable",
    )
    log = read_run_log(tmp_path / "log")
    with np.load(sweep) as arrays:
        np.testing.assert_allclose(log.joints.q, arrays["dof_pos"][:, TO_OURS], rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            log.joints.commanded_q, arrays["des_dof_pos"][:, TO_OURS], rtol=0, atol=1e-12
        )
    assert (log.meta["control_dt"], log.meta["kp"], log.meta["kd"]) == (
        pytest.approx(0.005, rel=1e-3),
        20.0,
        1.5,
    )
    (rig,) = load_rigs([tmp_path / "log"])
    assert not any(fault.is_fatal for fault in screen_log(rig))
    mirror = {"FL": "FR", "FR": "FL", "RL": "RR", "RR": "RL"}
    rig.meta["joints"] = [mirror[joint[:2]] + joint[2:] for joint in rig.meta["joints"]]
    assert any(fault.is_fatal for fault in screen_log(rig))


def test_the_step_answers_become_a_log_each_to_their_numbers(
    recordings: Path, go2: Robot, tmp_path: Path
) -> None:
    """On any robot whose joints have these names: nothing is simulated."""
    steps, aliengo = recordings / "aliengo_steps" / "logs.npz", GO2.parent / "aliengo"
    imported = import_recording(
        steps, tmp_path / "logs", load_config(RecordingDescription, aliengo / "log.toml"), go2
    )
    assert [path.name for path in imported.logs] == [
        f"{n:02d}" for n in range(26) if n not in (7, 13)
    ]
    assert [note[:2] for note in imported.notes[:2]] == ["07", "13"]  # 14 and 18 rows
    with np.load(steps) as arrays:
        for path in imported.logs:
            log = read_run_log(path)
            for signal, name in (("q", "actual_joints_position"), ("dq", "actual_joints_velocity")):
                told = arrays[f"{path.name}_{name}"][:, TO_OURS]
                np.testing.assert_allclose(getattr(log.joints, signal), told, rtol=0, atol=1e-12)
            np.testing.assert_allclose(np.diff(log.joints.time_s), 0.02, rtol=0, atol=1e-9)
            assert "kp" not in log.meta


def test_the_description_of_the_aliengo_reads(tmp_path: Path, go2: Robot) -> None:
    shutil.copy(GO2.parent / "aliengo" / "robot.toml", tmp_path / "robot.toml")
    legs = go2.mjcf
    (tmp_path / "aliengo.xml").write_text(legs, encoding="utf-8")
    robot = load_robot(str(tmp_path))
    assert robot.name == "aliengo"
    np.testing.assert_allclose(robot.armature, np.tile([0.0023, 0.0136, 0.0148], len(LEGS)))
