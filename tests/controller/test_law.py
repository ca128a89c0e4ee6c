from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from samples import KINEMATICS, ROBOT

from benchmarks.qp import row
from saltus.constants import PHYSICS_DT
from saltus.controller.leg_controller import LegController
from saltus.controller.yaw_frame import reference_of
from saltus.plan import Plan, plan_message, plan_of
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.wire.messages import ControllerMode, PlanStatus

LAW = LegController(ROBOT)
COMMAND = ("position", "velocity", "kp", "kd", "torque")
# Through start-up, both flights, both stances, a landing, a stand and a fall.
MODES = (
    [ControllerMode.STAND] * 3
    + [ControllerMode.RUN] * 160
    + [ControllerMode.COAST] * 20
    + [ControllerMode.LANDING] * 120
    + [ControllerMode.STOPPED] * 3
    + [ControllerMode.DAMP]
)


def tensors(value):
    return type(value)(**{f.name: torch.as_tensor(getattr(value, f.name)) for f in fields(value)})


def test_numpy_equals_torch_through_all_modes(draw):
    rng = np.random.default_rng(11)
    _, sensed = draw(rng, (8,))
    ours, theirs = (
        LAW.init((8,), sensed.joint_position),
        LAW.init((8,), torch.as_tensor(sensed.joint_position)),
    )
    for mode in MODES:
        plan, sensed = draw(rng, (8,))
        command, ours, diagnostics = LAW.step(plan, sensed, ours, mode)
        command_torch, theirs, diagnostics_torch = LAW.step(
            tensors(plan), tensors(sensed), theirs, mode
        )
        for name in COMMAND:
            np.testing.assert_allclose(
                getattr(command_torch, name).numpy(), getattr(command, name), atol=1e-6
            )
        np.testing.assert_array_equal(
            diagnostics_torch.gait.contact.numpy(), diagnostics.gait.contact
        )
        np.testing.assert_allclose(
            diagnostics_torch.tracking_cost.numpy(), diagnostics.tracking_cost, rtol=1e-6, atol=1e-6
        )


def test_a_batch_does_what_its_robots_do_alone(draw):
    rng = np.random.default_rng(12)
    _, sensed = draw(rng, (3,))
    together = LAW.init((3,), sensed.joint_position)
    alone = [LAW.init((), sensed.joint_position) for _ in range(3)]
    for mode in MODES:
        plan, sensed = draw(rng, (3,))
        command, together, _ = LAW.step(plan, sensed, together, mode)
        for k in range(3):
            own, alone[k], _ = LAW.step(row(plan, k), row(sensed, k), alone[k], mode)
            for name in COMMAND:
                np.testing.assert_allclose(getattr(own, name), getattr(command, name)[k], atol=1e-9)


def test_commands_are_finite_and_within_the_drives(draw):
    rng = np.random.default_rng(13)
    _, sensed = draw(rng, (50,))
    state = LAW.init((50,), sensed.joint_position)
    for mode in MODES:
        plan, sensed = draw(rng, (50,))
        command, state, diagnostics = LAW.step(plan, sensed, state, mode)
        for name in COMMAND:
            assert np.isfinite(getattr(command, name)).all()
        assert (np.abs(command.torque) <= ROBOT.torque_limit).all()
        assert (np.abs(command.velocity) <= ROBOT.speed_limit).all()
        swinging = np.repeat(~diagnostics.gait.contact, 3, axis=-1)
        assert (command.torque[swinging] == 0.0).all()


def test_steps_change_neither_state_nor_inputs(draw):
    plan, sensed = draw(np.random.default_rng(14), (4,))
    state = LAW.init((4,), sensed.joint_position)
    copies = {f.name: np.copy(getattr(sensed, f.name)) for f in fields(sensed)}
    liftoff, phase = state.liftoff.copy(), state.gait.phase.copy()
    first, _, _ = LAW.step(plan, sensed, state)
    second, _, _ = LAW.step(plan, sensed, state)
    np.testing.assert_array_equal(first.torque, second.torque)
    np.testing.assert_array_equal(state.liftoff, liftoff)
    np.testing.assert_array_equal(state.gait.phase, phase)
    for name, value in copies.items():
        np.testing.assert_array_equal(getattr(sensed, name), value)


def test_landing_legs_that_are_down_stay_down(draw):
    rng = np.random.default_rng(15)
    plan, sensed = draw(rng, (64,))
    state = LAW.init((64,), sensed.joint_position)
    state = replace(
        LAW.step(plan, sensed, state)[1], gait=replace(state.gait, phase=rng.uniform(1.0, 2.0, 64))
    )
    down = np.zeros((64, 4), dtype=bool)
    for _ in range(int(0.35 / PHYSICS_DT)):  # swing and flight at 2 Hz last 0.3 s
        plan, sensed = draw(rng, (64,))
        _, state, diagnostics = LAW.step(plan, sensed, state, ControllerMode.LANDING)
        assert (diagnostics.gait.contact | ~down).all()
        down = diagnostics.gait.contact
    assert down.all()


@pytest.mark.parametrize("slope", [-1.5, -0.8, -0.3, 0.0, 0.2, 0.5, 0.8, 1.5])
def test_standing_goes_from_the_present_pose_to_one_on_the_slope_that_the_feet_give(draw, slope):
    plan, sensed = draw(np.random.default_rng(16), ())
    level = KINEMATICS.position(ROBOT.stand_pose)
    # Within reach: the trunk is pitched by the rest
    feet = level + slope * level[:, :1] * np.array([0.0, 0.0, 0.5])
    pitch = np.arctan(slope) - np.arctan(0.5 * slope)
    quaternion = quaternion_from_roll_pitch_yaw(np.zeros(()), np.asarray(-pitch), np.zeros(()))
    sensed = replace(
        sensed, joint_position=KINEMATICS.inverse(feet), quaternion_base_in_world=quaternion
    )
    state = replace(LAW.init((), sensed.joint_position), mode=ControllerMode.LANDING)
    positions = []
    for _ in range(600):
        command, state, _ = LAW.step(plan, sensed, state, ControllerMode.STAND)
        positions.append(command.position)
    np.testing.assert_allclose(positions[0], sensed.joint_position, atol=1e-4)
    stood = KINEMATICS.position(positions[-1])
    ahead = stood[0] - stood[2]
    given = np.arctan(np.clip(slope, -0.8, 0.8))
    # The other half is pitch
    np.testing.assert_allclose(np.arctan2(ahead[2], ahead[0]), 0.5 * given, atol=1e-6)
    if slope == 0.0:
        np.testing.assert_allclose(positions[-1], ROBOT.stand_pose, atol=1e-9)
    assert np.abs(np.diff(positions, axis=0)).max() < 0.003
    assert (command.kp == 100.0).all()
    assert (command.kd == 3.0).all()


@pytest.mark.parametrize("uneven_m", [0.0, 0.05])
def test_a_robot_that_walked_rests_over_its_feet_which_do_not_move(draw, uneven_m):
    rng = np.random.default_rng(17)
    plan, sensed = draw(rng, (200,))
    level = KINEMATICS.position(ROBOT.stand_pose)
    feet = level + rng.uniform(-1.0, 1.0, (200, 4, 3)) * np.array([0.06, 0.04, uneven_m])
    tilt = quaternion_from_roll_pitch_yaw(*rng.uniform(-4.0, 4.0, (3, 200)) * uneven_m)
    sensed = replace(sensed, joint_position=KINEMATICS.inverse(feet), quaternion_base_in_world=tilt)
    state = replace(LAW.init((200,), sensed.joint_position), mode=ControllerMode.WALK)
    for _ in range(600):
        command, state, _ = LAW.step(plan, sensed, state, ControllerMode.STAND)
    stood = KINEMATICS.position(command.position)

    def apart(places):
        return np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)

    np.testing.assert_allclose(apart(stood), apart(feet), atol=1e-6)
    if not uneven_m:  # elsewhere the base is tilted by a share of the slope
        middle = stood.mean(axis=1) - level.mean(axis=0)
        np.testing.assert_allclose(middle, 0.0, atol=1e-6)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_yaw_is_turned_back_to_the_heading_the_short_way(draw, side):
    plan, sensed = draw(np.random.default_rng(18), (30,))
    yaw = np.linspace(-3.0, 3.0, 30)
    quaternion = np.stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)], -1)
    still = replace(
        sensed, quaternion_base_in_world=quaternion, angular_velocity_base=np.zeros((30, 3))
    )
    turned = replace(plan, heading=yaw + side * 0.3 + 2.0 * np.pi)
    _, _, diagnostics = LAW.step(turned, still, LAW.init((30,), yaw))
    np.testing.assert_allclose(diagnostics.angular_velocity_reference[:, 2], side * 0.3, atol=1e-9)


def test_residuals_are_mirrored_outward():
    wanted = Plan(
        stepping_frequency_hz=np.asarray(2.0),
        velocity_x=np.asarray(1.0),
        velocity_z=np.asarray(0.5),
        pitch_rate=np.asarray(0.1),
        foot_residual_front=np.array([0.1, 0.05, 0.2]),
        foot_residual_rear=np.array([-0.1, 0.02, 0.3]),
    )
    plan = reference_of(plan_of(plan_message(wanted, PlanStatus.GO)), np.asarray(0.0))
    expected = [[0.1, -0.05, 0.2], [0.1, 0.05, 0.2], [-0.1, -0.02, 0.3], [-0.1, 0.02, 0.3]]
    np.testing.assert_allclose(plan.foot_residual, expected)
    np.testing.assert_allclose(plan.velocity, [1.0, 0.0, 0.5])
    np.testing.assert_allclose(plan.angular_velocity, [0.0, 0.1, 0.0])
