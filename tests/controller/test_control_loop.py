"""The loop on a simulated robot: standing, bounding, landing."""

from dataclasses import replace

import numpy as np
import pytest
from samples import PROFILE, ROBOT, setup_of

from saltus.config import TerrainConfig
from saltus.constants import PHYSICS_DT
from saltus.controller.control_loop import FIRST_STAND_S, ControlLoop
from saltus.controller.robot.backend import RobotReading
from saltus.controller.robot.mujoco import MujocoRobot
from saltus.errors import SaltusError
from saltus.rotations import quaternion_from_roll_pitch_yaw, roll_pitch_yaw, rotation_matrix
from saltus.terrain.curriculum import make_terrain
from saltus.trial import Trial
from saltus.wire.messages import ControllerMode, JointPlan, MotionPlan, PlanStatus

FREQUENCY_HZ = 2.75
LIFT = np.array([0.0, 0.0, 0.09])


def bounding(seconds, loop, status=PlanStatus.GO):
    """About 0.9 m/s; all numbers found by a random search."""
    state = loop.state(0, 0)
    _, pitch, _ = roll_pitch_yaw(rotation_matrix(state.quaternion_base_in_world))
    front = (seconds * FREQUENCY_HZ + 0.125) % 1.0 < 0.5
    return MotionPlan(
        time_ns=0,
        step=0,
        status=status,
        stepping_frequency_hz=FREQUENCY_HZ,
        velocity_x=1.43,
        velocity_z=(0.35 if front else 0.76) + 8.0 * (0.31 - state.base_height),
        pitch_rate=(-2.0 if front else 1.7) - 3.3 * float(pitch),
        foot_residual_front=LIFT,
        foot_residual_rear=LIFT,
        reason="",
    )


def make_robot(seed=0):
    trial = Trial.draw(seed)
    robot = MujocoRobot(setup_of(TerrainConfig(terrain="flat"), trial, PROFILE))
    robot.reset()
    return robot


def drive(robot, loop, seconds, planner=None, silent_after_s=np.inf):
    """Runs with the plans of `planner(time, loop)`, which dies at a time;
    returns the modes in their order.
    """
    modes, plan, age_s = [], None, np.inf
    for t in ticks(seconds):
        loop.sense(robot.read())
        if planner is not None:
            age_s = max(0.0, t - silent_after_s)
            plan = planner(t - FIRST_STAND_S, loop) if t <= silent_after_s else plan
        robot.write(loop.act(plan, age_s))
        if not modes or modes[-1] != loop.mode:
            modes.append(loop.mode)
    return modes


def ticks(seconds):
    return np.arange(0, round(seconds / PHYSICS_DT)) * PHYSICS_DT


def test_stands_for_three_seconds_without_plans():
    robot, loop = make_robot(), ControlLoop(ROBOT)
    modes = drive(robot, loop, 3.0)
    state = robot.state
    assert modes == [ControllerMode.STAND]
    assert not robot.take_trunk_contact()
    assert state.position_base_in_world[2] == pytest.approx(ROBOT.stand_height, abs=0.02)
    assert np.linalg.norm(state.velocity_base_in_world) < 0.02
    estimate = loop.state(0, 0)
    assert estimate.base_height == pytest.approx(state.position_base_in_world[2], abs=0.01)
    assert estimate.leg_contact.all()


@pytest.mark.sample(1)
@pytest.mark.parametrize("phase", [0.0, 0.4])  # from a faster gait at every phase: test_braking.py
def test_lands_and_stands_when_plans_stop(phase):
    robot, loop = make_robot(seed=int(10 * phase)), ControlLoop(ROBOT)
    silent_s = FIRST_STAND_S + (2.0 + phase) / FREQUENCY_HZ
    # Lost 0.1 s, landing at most 1.1 s, blend 1 s
    modes = drive(robot, loop, silent_s + 2.5, bounding, silent_s)
    assert modes == [
        ControllerMode.STAND,
        ControllerMode.RUN,
        ControllerMode.COAST,
        ControllerMode.LANDING,
        ControllerMode.STOPPED,
    ]
    state = robot.state
    assert not robot.take_trunk_contact()
    assert state.position_base_in_world[0] - Trial.draw(int(10 * phase)).position_x > 0.2
    assert state.position_base_in_world[2] > 0.24
    assert np.linalg.norm(state.velocity_base_in_world) < 0.1
    assert (state.foot_force > 1.0).all()


def test_lies_down_and_gets_up_again():
    """The trunk never touches the ground, the estimate holds, and it can bound afterwards."""
    robot, loop = make_robot(seed=2), ControlLoop(ROBOT)
    statuses = ((1.5, PlanStatus.GO), (2.5, PlanStatus.LIE), (2.0, PlanStatus.STAND))
    heights, modes = [], []
    for seconds, status in (*statuses, (0.5, PlanStatus.GO)):
        for t in ticks(seconds):
            loop.sense(robot.read())
            robot.write(loop.act(bounding(t, loop, status), 0.0))
            modes += [loop.mode] if modes[-1:] != [loop.mode] else []
        heights.append(float(robot.state.position_base_in_world[2]))
    lying = robot.state.quaternion_base_in_world
    names = ["STAND", "RUN", "LANDING", "STAND", "LIE", "STAND", "RUN"]
    assert [mode.name for mode in modes] == names
    assert not robot.take_trunk_contact()
    assert heights[1] < 0.12 < 0.24 < heights[2]
    assert abs(loop.state(0, 0).base_height - robot.state.position_base_in_world[2]) < 0.05
    assert abs(lying[0]) > 0.95


def joint_plan(status=PlanStatus.GO, targets=ROBOT.stand_pose):
    gains = np.full(12, 40.0), np.full(12, 1.0)
    return JointPlan(
        time_ns=0, step=0, status=status, joint_position=targets, kp=gains[0], kd=gains[1],
        reason="",
    )  # fmt: skip


@pytest.mark.sample(1)
@pytest.mark.parametrize("silent_s", [FIRST_STAND_S + 0.5, np.inf])
def test_joint_targets_are_held_and_their_end_is_a_stand(silent_s):
    """Without them the robot lands and stays stopped; told to stand it stands; it never falls."""
    robot, loop = make_robot(seed=3), ControlLoop(ROBOT)

    def planner(seconds, _):
        lower = ROBOT.stand_pose + np.tile([0.0, 0.1, -0.2], 4)
        return joint_plan(PlanStatus.GO if seconds < 1.0 else PlanStatus.STAND, lower)

    modes = drive(robot, loop, FIRST_STAND_S + 2.5, planner, silent_s)
    late = ["COAST", "LANDING", "STOPPED"] if np.isfinite(silent_s) else ["STAND"]
    assert [mode.name for mode in modes] == ["STAND", "WALK", *late]
    assert not robot.take_trunk_contact()
    assert np.linalg.norm(robot.state.velocity_base_in_world) < 0.1
    assert loop.state(0, 0).leg_trusted.all()


@pytest.mark.sample(1)
@pytest.mark.parametrize("yaw", [-2.0, 0.5, 3.0])
def test_a_robot_that_has_turned_while_it_walked_jumps_in_its_new_heading(yaw):
    """It is commanded as one that stood in that heading from the first."""
    still = make_robot().read()

    def seen(angle):
        quaternion = quaternion_from_roll_pitch_yaw(*map(np.asarray, (0.0, 0.0, angle)))
        return replace(
            still, measurement=replace(still.measurement, quaternion_base_in_world=quaternion)
        )

    stays, turns = ControlLoop(ROBOT), ControlLoop(ROBOT)
    phases = [(FIRST_STAND_S + 0.1, PlanStatus.STAND), (0.1, PlanStatus.GO)]
    for angle, (seconds, status) in zip((0.0, yaw), phases, strict=True):
        for _ in ticks(seconds):
            for loop, seen_yaw in ((stays, yaw), (turns, angle)):
                loop.sense(seen(seen_yaw))
                loop.act(joint_plan(status), 0.0)
    assert stays.mode == turns.mode == ControllerMode.WALK
    for t in ticks(0.1):
        commands = []
        for loop in (stays, turns):
            loop.sense(seen(yaw))
            commands.append(loop.act(bounding(t, loop), 0.0))
    assert stays.mode == turns.mode == ControllerMode.RUN
    for name in ("position", "velocity", "torque"):
        pair = [getattr(command, name) for command in commands]
        np.testing.assert_allclose(*pair, atol=1e-6)


@pytest.mark.parametrize("rate", [-0.4, 0.3])
def test_a_robot_that_is_told_to_turn_jumps_in_the_heading_that_it_was_turned_to(rate):
    """Its hips, which turn it, are commanded as those of one that held that heading from the first;
    standing, it does not turn.
    """
    still, turn_s = make_robot().read(), 0.2

    def seen(angle):
        quaternion = quaternion_from_roll_pitch_yaw(*map(np.asarray, (0.0, 0.0, angle)))
        return replace(
            still, measurement=replace(still.measurement, quaternion_base_in_world=quaternion)
        )

    turned, held, straight = (ControlLoop(ROBOT) for _ in range(3))
    held.sense(seen(rate * turn_s))
    phases = [
        (FIRST_STAND_S + 0.1, PlanStatus.STAND, rate),
        (turn_s, PlanStatus.GO, rate),
        (0.2, PlanStatus.GO, 0.0),
    ]
    for seconds, status, turning in phases:
        for t in ticks(seconds):
            commands = []
            for loop, asked in ((turned, turning), (held, 0.0), (straight, 0.0)):
                loop.sense(seen(0.0))
                plan = replace(bounding(t, loop, status), yaw_rate=asked)
                commands.append(loop.act(plan, 0.0))
    assert turned.mode == held.mode == ControllerMode.RUN
    its, same, other = (command.velocity[::3] for command in commands)
    assert np.abs(its - same).max() < 0.01 * np.abs(other - same).max()


def test_bounds_forward_with_a_useful_estimate():
    robot, loop = make_robot(seed=1), ControlLoop(ROBOT)
    errors, airborne = [], 0
    for t in ticks(3.0):
        loop.sense(robot.read())
        robot.write(loop.act(bounding(t - FIRST_STAND_S, loop), 0.0))
        estimate = loop.state(0, 0)
        if t > FIRST_STAND_S + 0.2:
            errors.append(estimate.velocity_base_in_world - robot.state.velocity_base_in_world)
            airborne += bool((robot.state.foot_force < 1.0).all())
    assert loop.mode == ControllerMode.RUN
    assert not robot.take_trunk_contact()
    assert robot.state.position_base_in_world[0] > 1.0
    assert airborne > 50
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 0.2
    assert loop.state(0, 0).cycle == int(2.0 * FREQUENCY_HZ)


def test_the_first_go_waits_for_the_first_stand():
    robot, loop = make_robot(), ControlLoop(ROBOT)
    assert drive(robot, loop, FIRST_STAND_S, bounding) == [ControllerMode.STAND]
    assert drive(robot, loop, PHYSICS_DT, bounding) == [ControllerMode.RUN]


def test_a_reading_that_is_not_finite_damps_the_joints():
    robot, loop = make_robot(), ControlLoop(ROBOT)
    drive(robot, loop, 0.02)
    good = robot.read()
    for name in vars(good.measurement):
        loop = ControlLoop(ROBOT)
        loop.sense(good)
        bad = np.full_like(getattr(good.measurement, name), np.nan)
        loop.sense(
            RobotReading(
                measurement=replace(good.measurement, **{name: bad}), joint_torque=good.joint_torque
            )
        )
        command = loop.act(None, np.inf)
        assert loop.mode == ControllerMode.DAMP
        assert (command.kp == 0.0).all()
        assert (command.torque == 0.0).all()
        assert np.isfinite(command.position).all()


def test_a_robot_that_tips_over_is_damped():
    good = make_robot().read()
    for angle in (1.1, -1.1):
        for axis in (1, 2):
            quaternion = np.array([np.cos(angle / 2), 0.0, 0.0, 0.0])
            quaternion[axis] = np.sin(angle / 2)
            tipped = replace(good.measurement, quaternion_base_in_world=quaternion)
            loop = ControlLoop(ROBOT)
            loop.sense(RobotReading(measurement=tipped, joint_torque=good.joint_torque))
            loop.act(None, np.inf)
            assert loop.mode == ControllerMode.DAMP


def test_joint_log_pairs_each_measurement_with_its_command():
    robot, loop = make_robot(), ControlLoop(ROBOT)
    commands, positions = [], []
    for _ in range(5):
        reading = robot.read()
        loop.sense(reading)
        commands.append(loop.act(None, np.inf))
        positions.append(reading.measurement.joint_position)
        robot.write(commands[-1])
    log = loop.take_joint_log(7, 3)
    assert (log.time_ns, log.step, log.dt_s) == (7, 3, PHYSICS_DT)
    np.testing.assert_array_equal(log.position, positions)
    np.testing.assert_array_equal(log.position_desired, [c.position for c in commands])
    np.testing.assert_array_equal(log.kp, [c.kp for c in commands])


def test_acting_before_sensing_says_so():
    with pytest.raises(SaltusError, match="sense"):
        ControlLoop(ROBOT).act(None, np.inf)


def test_truth_is_the_terrain_along_the_robots_yaw():
    trial = Trial(position_x=1.4, yaw=0.3)
    terrain = make_terrain(TerrainConfig(terrain="stairs", rise_m=0.1))
    robot = MujocoRobot(setup_of(terrain, trial, PROFILE))
    robot.reset()
    truth = robot.truth(5, 2)
    x, _, z = truth.position_base_in_world
    ahead = x + np.cos(0.3) * np.linspace(-0.4, 0.8, 30)
    np.testing.assert_allclose(truth.height, terrain.height_at(ahead, 0.0) - z)
    assert truth.height.max() > truth.height.min() + 0.2
