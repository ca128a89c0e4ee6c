from pathlib import Path

import numpy as np
import pytest
from heightmap_inputs import on_time, states
from samples import KINEMATICS, ROBOT

from saltus import rotations
from saltus.heightmap.level_robot import LevelRobot
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.replay import replay_frames
from saltus.heightmap.service.service import HeightmapService
from saltus.wire.messages import HeightmapStatus


def test_replay_equals_the_live_service(model_path: Path) -> None:
    live = HeightmapService(HeightmapNetwork(ROBOT, model_path))
    expected = [live.step(state, on_time(state.step), state.time_ns) for state in states(60)]
    frames = [frame for step in range(60) if (frame := on_time(step)) is not None]
    for a, b in zip(
        replay_frames(HeightmapNetwork(ROBOT, model_path), frames, states(60)),
        expected,
        strict=True,
    ):
        np.testing.assert_array_equal(a.height, b.height)
        assert (a.status, a.frame_id, a.depth_age_s) == (b.status, b.frame_id, b.depth_age_s)


def test_a_stand_in_warms_up_frame_by_frame(model_path: Path) -> None:
    frames = [frame for step in range(30) if (frame := on_time(step)) is not None]
    statuses = [
        h.status for h in replay_frames(HeightmapNetwork(ROBOT, model_path), frames, LevelRobot())
    ]
    assert statuses[:3] == [HeightmapStatus.WARMING] * 3
    assert set(statuses[3:]) == {HeightmapStatus.OK}


@pytest.mark.parametrize(
    ("height_m", "pitch_deg"), [(0.268, 29.8), (0.3, 29.8), (0.25, 20.0), (0.27, 40.0)]
)
def test_a_stand_in_stands_on_the_ground(height_m: float, pitch_deg: float) -> None:
    (state,) = LevelRobot(base_height_m=height_m, camera_pitch_deg=pitch_deg).states(
        ROBOT, [f for f in [on_time(5)] if f]
    )
    rotation = rotations.rotation_matrix(state.quaternion_base_in_world)
    feet = KINEMATICS.position(state.joint_position) @ rotation.T
    np.testing.assert_allclose(feet[:, 2], ROBOT.foot_radius - height_m, atol=1e-3)
    camera_axis = rotation @ [np.cos(ROBOT.camera_pitch), 0.0, -np.sin(ROBOT.camera_pitch)]
    assert np.rad2deg(np.arcsin(-camera_axis[2])) == pytest.approx(pitch_deg, abs=1e-6)
