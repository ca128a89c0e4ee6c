"""The way of a robot is that of its velocities or of somebody's positions,
at any time of the last second.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plane_world import BEGIN_NS, STEP_NS, PlaneWorld
from samples import ROBOT

from saltus.heightmap.scan.odometry_trail import GAP_NS, JUMP_M, REACH_NS, OdometryTrail
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix

speeds = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
WORLD = PlaneWorld()


@given(velocity=speeds, back=st.integers(0, 900_000_000), told=st.booleans())
@settings(max_examples=30, deadline=None)
def test_at_a_constant_velocity_any_time_has_its_place(
    velocity: tuple[float, float, float], back: int, told: bool
) -> None:
    world, trail = PlaneWorld(velocity=velocity), OdometryTrail()
    for step in range(100):
        at = (
            {"position_base_in_odometry": world.position(BEGIN_NS + step * STEP_NS)} if told else {}
        )
        assert not trail.add(world.state(step, ROBOT, **at))
    time_ns = trail.now.time_ns - back
    found = trail.at(time_ns)
    assert found is not None
    np.testing.assert_allclose(found.position, world.position(time_ns), atol=1e-6)


@given(rate=st.floats(-3.0, 3.0), back=st.integers(0, 300_000_000))
@settings(max_examples=20, deadline=None)
def test_at_a_constant_rate_of_turn_any_time_has_its_attitude(rate: float, back: int) -> None:
    trail = OdometryTrail()

    def turned(time_ns: int) -> np.ndarray:
        yaw = np.asarray(1e-9 * (time_ns - BEGIN_NS) * rate)
        return np.asarray(quaternion_from_roll_pitch_yaw(np.zeros(()), np.zeros(()), yaw))

    for step in range(50):
        attitude = turned(BEGIN_NS + step * STEP_NS)
        rates = {
            "quaternion_base_in_world": attitude,
            "angular_velocity_base": np.array([0.0, 0.0, rate]),
        }
        assert not trail.add(WORLD.state(step, ROBOT, **rates))
    time_ns = trail.now.time_ns - back
    found = trail.at(time_ns)
    assert found is not None
    np.testing.assert_allclose(found.rotation, rotation_matrix(turned(time_ns)), atol=1e-6)


@given(
    jump=st.tuples(*[st.floats(-50.0, 50.0)] * 3).filter(lambda j: np.linalg.norm(j) > 2.0 * JUMP_M)
)
@settings(max_examples=30, deadline=None)
def test_a_position_that_jumps_moves_nothing(jump: tuple[float, float, float]) -> None:
    world, ways = PlaneWorld(velocity=(0.4, -0.2, 0.0)), []
    for moved in (np.zeros(3), np.array(jump)):
        trail = OdometryTrail()
        for step in range(40):
            at = world.position(BEGIN_NS + step * STEP_NS) + (moved if step >= 20 else 0.0)
            assert not trail.add(world.state(step, ROBOT, position_base_in_odometry=at))
        ways.append(trail.now.position)
    np.testing.assert_allclose(ways[0], ways[1], atol=1e-6)


def test_positions_that_come_and_go_leave_no_step() -> None:
    world, trail, before = PlaneWorld(velocity=(1.0, 0.0, 0.0)), OdometryTrail(), None
    for step in range(60):
        at = world.position(BEGIN_NS + step * STEP_NS) + 7.0
        known = {"position_base_in_odometry": at} if step // 10 % 2 else {}
        trail.add(world.state(step, ROBOT, **known))
        if before is not None:
            assert np.linalg.norm(trail.now.position - before) == pytest.approx(0.01, abs=1e-6)
        before = trail.now.position


def test_what_is_too_far_from_all_states_has_no_place() -> None:
    trail = OdometryTrail()
    assert trail.at(BEGIN_NS) is None
    for step in range(3):
        trail.add(WORLD.state(step, ROBOT))
    assert trail.at(BEGIN_NS - REACH_NS - 1) is None
    assert trail.at(trail.now.time_ns + REACH_NS + 1) is None


@pytest.mark.parametrize("time_ns", [GAP_NS + 1, -STEP_NS])
def test_a_robot_that_was_silent_may_be_anywhere(time_ns: int) -> None:
    trail = OdometryTrail()
    trail.add(WORLD.state(0, ROBOT))
    assert trail.add(WORLD.state(1, ROBOT, time_ns=BEGIN_NS + time_ns))
