"""The recording of a real Go2, a table that holds one of every few states,
becomes a log of each leg.
"""

from pathlib import Path

import numpy as np
import pytest

from saltus.config import load_config
from saltus.real2sim.importers.file_kinds import rate_scale, resample_joints, state_times
from saltus.real2sim.importers.importing import import_recording
from saltus.real2sim.problem.log import load_rigs, segments_of
from saltus.real2sim.screening.screen import screen_log
from saltus.recordings.recording_description import RecordingDescription
from saltus.robots.loading import load_robot
from saltus.robots.robot import LEGS, Robot

GO2 = Path(__file__).resolve().parents[2] / "examples" / "go2"
RECORDINGS = Path(__file__).resolve().parents[3] / "shared" / "data"


def _leg(leg: str, front: int, left: int) -> str:
    """A leg of about a Go2's size and mass, with friction, which the import leaves out."""
    rub = 'damping="0.2" frictionloss="0.3"'
    return f"""
    <body name="{leg}_hip" pos="{0.19 * front} {0.0465 * left} 0">
      <inertial pos="0 {0.002 * left} 0" mass="0.678" diaginertia="0.0009 0.0006 0.0005"/>
      <joint name="{leg}_hip_joint" axis="1 0 0" {rub}/>
      <body name="{leg}_thigh" pos="0 {0.0955 * left} 0">
        <inertial pos="-0.004 {-0.022 * left} -0.033" mass="1.152" diaginertia="0.006 0.006 0.001"/>
        <joint name="{leg}_thigh_joint" axis="0 1 0" {rub}/>
        <body name="{leg}_calf" pos="0 0 -0.213">
          <inertial pos="0.006 0 -0.141" mass="0.241" diaginertia="0.0015 0.0015 0.00005"/>
          <joint name="{leg}_calf_joint" axis="0 1 0" {rub}/> <geom type="sphere" size="0.022" pos="0 0 -0.213"/>
        </body>
      </body>
    </body>"""


@pytest.fixture
def go2(tmp_path: Path) -> Robot:
    legs = "".join(
        _leg(leg, 1 if leg[0] == "F" else -1, 1 if leg[1] == "L" else -1) for leg in LEGS
    )
    (tmp_path / "go2").mkdir()
    (tmp_path / "go2" / "go2.xml").write_text(f"""<mujoco><worldbody><body name="base"><freejoint/>
      <inertial pos="0 0 0" mass="6.9" diaginertia="0.02 0.1 0.1"/> <geom type="box" size="0.19 0.05 0.06"/>
      {legs}</body></worldbody></mujoco>""")
    rotors = "reduction = [6.33, 6.33, 12.13461]\narmature = [0.0044797, 0.0044797, 0.0164624]\n"
    (tmp_path / "go2" / "robot.toml").write_text(rotors)
    return load_robot(str(tmp_path / "go2"))


def _record(q: np.ndarray, dq: np.ndarray, path: Path) -> Path:
    """A recording in the form of the Go2's."""
    header = (
        [f"jpos{j}" for j in range(12)]
        + [f"jvel{j}" for j in range(12)]
        + [f"jpos{j}_des" for j in range(12)]
    )
    rows = np.column_stack([q, dq, q[np.arange(len(q)) // 4 * 4]])
    np.savetxt(path, rows, delimiter=",", header=",".join(header), comments="")
    return path


def _motion(seconds: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Angles and velocities of twelve joints every 2 ms."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.002)[:, None]
    f, phase = rng.uniform(1.0, 4.0, 12), rng.uniform(0, 6, 12)
    size = np.tile([0.1, 0.2, 0.25], 4)
    q = np.tile([0.0, 0.7, -1.3], 4) + size * np.sin(2 * np.pi * f * t + phase)
    return q, 2 * np.pi * f * size * np.cos(2 * np.pi * f * t + phase)


@pytest.mark.parametrize("loop_jitter_s", [0.0, 0.0005])
@pytest.mark.parametrize("scale", [1.0, 1.14])
def test_the_states_that_passed_between_rows_are_counted(
    loop_jitter_s: float, scale: float
) -> None:
    rng = np.random.default_rng(3)
    q, dq = _motion(20.0)
    loop_s = 0.005 * np.arange(1, 3900) + rng.normal(0, loop_jitter_s, 3899)
    state = np.floor(loop_s / 0.002).astype(int)
    seen_q = q[state] + rng.normal(0, 3e-4, (len(state), 12))
    seen_dq = scale * dq[state] + rng.normal(0, 0.1, (len(state), 12))
    found = state_times(seen_q, seen_dq, 0.005, 0.002)
    true = 0.002 * (state - state[0])
    assert np.mean(np.abs(found - true) < 1e-9) > 0.98
    np.testing.assert_allclose(rate_scale(seen_q, seen_dq, 0.005), scale, rtol=0.01)
    even, rate = resample_joints(found, seen_q, seen_dq / scale, 0.005 * np.arange(len(state)))
    rows_s = 0.005 * np.arange(len(state)) + 0.002 * state[0]
    exact = np.stack([np.interp(rows_s, 0.002 * np.arange(len(q)), joint) for joint in q.T], axis=1)
    assert np.sqrt(np.mean((even - exact)[10:-10] ** 2)) < 0.3 * np.sqrt(
        np.mean((seen_q - exact)[10:-10] ** 2)
    )
    true_rate = np.stack(
        [np.interp(rows_s, 0.002 * np.arange(len(q)), joint) for joint in dq.T], axis=1
    )
    assert np.sqrt(np.mean((rate - true_rate)[10:-10] ** 2)) < 0.15  # rad/s; noise is 0.1 of them


def test_every_leg_has_a_log_without_what_its_end_stop_disturbs(go2: Robot, tmp_path: Path) -> None:
    q, dq = _motion(16.0)
    q[2500:2600, 2] = -0.88
    rows = np.floor(0.005 * np.arange(3100) / 0.002).astype(int)
    table = _record(q[rows], dq[rows], tmp_path / "recording.csv")
    logs = import_recording(
        table, tmp_path / "logs", load_config(RecordingDescription, GO2 / "log.toml"), go2
    ).logs
    assert [path.name for path in logs] == ["FL", "FR", "RL", "RR"]
    for path in logs:
        (log,) = load_rigs([path])
        assert log.meta["joints"] == [f"{path.name}_{joint}" for joint in ("hip", "thigh", "calf")]
        touched = path.name == "FL"
        assert any(5.01 < t < 5.4 for t in log.joints.time_s) != touched
        assert all(segment.end_s - segment.start_s >= 1.0 for segment in segments_of(log))
        assert log.joints.q[:, 2].max() <= -0.93
        assert log.joints.dq is not None
        # Not the shipped one, of which it has the name
        assert Path(log.meta["robot"]).name == "go2.xml"
        model = (path / "go2.xml").read_text()
        assert not any(word in model for word in ("damping", "frictionloss"))
        bare = load_robot(str(path / "go2.xml"))
        np.testing.assert_allclose(
            bare.armature, np.tile([0.00448, 0.00448, 0.01646], 4), rtol=1e-3
        )


@pytest.fixture(scope="module")
def recording() -> Path:
    if not RECORDINGS.is_dir():
        pytest.skip(f"no real recordings beside the checkout: {RECORDINGS} is absent")
    return RECORDINGS / "go2_motor_response_200hz.csv"


def test_gravity_tells_left_from_right_in_the_recording(
    recording: Path, go2: Robot, tmp_path: Path
) -> None:
    for path in import_recording(
        recording, tmp_path / "logs", load_config(RecordingDescription, GO2 / "log.toml"), go2
    ).logs:
        (log,) = load_rigs([path])
        assert not any(fault.is_fatal for fault in screen_log(log)), path.name
        mirror = {"FL": "FR", "FR": "FL", "RL": "RR", "RR": "RL"}[path.name]
        log.meta["joints"] = [f"{mirror}_{joint}" for joint in ("hip", "thigh", "calf")]
        assert any(fault.name == "against_gravity" for fault in screen_log(log)), path.name
        assert log.meta["kp"] == 20
        assert log.joints.q_des is not None
        changes = np.flatnonzero(np.any(np.diff(log.joints.q_des, axis=0) != 0, axis=1))
        assert np.median(np.diff(changes)) * 0.005 == pytest.approx(0.02)
