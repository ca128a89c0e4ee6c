"""Laws of how episodes of walking begin: standing or in a jump, above the ground."""

import numpy as np
import pytest
from numpy_and_torch import both
from samples import ROBOT

from saltus.errors import ConfigError
from saltus.policy.walking import starts
from saltus.policy.walking.settings import WalkSettings
from saltus.policy.walking.starts import JumpStartSettings, first_motion, height_above, under_trunk
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.sim.plant import CLEARANCE
from saltus.terrain.boxes import Boxes

N = 400


def test_robots_stand_in_their_pose_or_move_as_the_ranges_of_a_jump_say():
    rng, jump = np.random.default_rng(0), JumpStartSettings()
    draws, jumps = rng.uniform(size=(N, starts.DRAWS.count)), rng.uniform(size=N) < 0.5
    pose, yaw_rad = rng.normal(size=12), rng.choice([0.1, np.pi], N)

    def motion(*given):
        found = first_motion(jump, *given[:1], 0.05, *given[1:])
        return found.joints, found.quaternion, found.velocity

    joints, quaternion, velocity = (
        both(lambda *given, k=k: motion(*given)[k], pose, yaw_rad, jumps, draws) for k in range(3)
    )
    roll, pitch, yaw = roll_pitch_yaw(rotation_matrix(quaternion))
    assert np.abs(roll).max() < 1e-6
    assert (np.abs(yaw) <= yaw_rad + 1e-6).all()
    standing = ~jumps
    assert np.abs(joints[standing] - pose).max() <= 0.05 + 1e-6
    assert np.abs(pitch[standing]).max() < 1e-6
    assert (velocity[standing] == 0.0).all()
    ahead = velocity[:, 0] * np.cos(yaw) + velocity[:, 1] * np.sin(yaw)
    for value, (low, high) in (
        (pitch, jump.pitch_rad),
        (ahead, jump.ahead_mps),
        (velocity[:, 2], jump.up_mps),
        (velocity[:, 4], jump.pitch_rate_rps),
    ):
        assert (low - 1e-5 <= value[jumps]).all()
        assert (value[jumps] <= high + 1e-5).all()
        assert np.ptp(value[jumps]) > 0.9 * (high - low)
    assert np.abs(ahead**2 - (velocity[:, :2] ** 2).sum(-1)).max() < 1e-5  # along the heading
    mirrored = joints[jumps].mean(0).reshape(2, 2, 3)  # front and rear; right and left
    np.testing.assert_allclose(mirrored[:, 0], mirrored[:, 1] * [-1.0, 1.0, 1.0], atol=0.05)


@pytest.mark.parametrize("radius", [0.0, 0.02])
def test_no_place_of_a_robot_is_in_the_ground_and_one_is_just_above_it(radius):
    rng = np.random.default_rng(1)
    boxes = Boxes(
        center=rng.uniform(-0.5, 0.5, (N, 9, 3)), half_size=rng.uniform(0.05, 0.5, (N, 9, 3))
    )
    begin, places = rng.uniform(-0.5, 0.5, (N, 2)), rng.uniform(-0.4, 0.4, (N, 10, 3))
    z = both(
        lambda at, of, center, half: height_above(
            Boxes(center=center, half_size=half), at, of, radius),
        begin, places, boxes.center, boxes.half_size,
    )  # fmt: skip
    world = places + np.concatenate([begin, z[:, None]], -1)[:, None]
    ground = np.maximum(
        *(boxes.height_at(world[..., 0] + side * radius, world[..., 1]) for side in (-1.0, 1.0))
    )
    free = world[..., 2] - ground - radius
    np.testing.assert_allclose(free.min(-1), CLEARANCE, atol=1e-5)


def test_the_trunk_is_seen_by_its_lower_face():
    places = under_trunk(ROBOT).like(np.zeros(1))
    half = 0.5 * ROBOT.trunk_size
    np.testing.assert_allclose(np.abs(places - ROBOT.trunk_center).max(0), half)
    assert (places[:, 2] < ROBOT.trunk_center[2]).all()


def test_a_family_that_no_robot_is_on_is_told_where_episodes_begin_in_a_jump():
    WalkSettings(jump_start=JumpStartSettings(families=("steps",)))
    with pytest.raises(ConfigError, match=r"no robot is on 'steps'; there are: plain, rubble, "):
        WalkSettings(jump_start=JumpStartSettings(families=("steps",), share=0.5))
