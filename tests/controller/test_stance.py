from dataclasses import replace

import numpy as np
import pytest
import torch
from samples import KINEMATICS, ROBOT

from benchmarks.qp import independent, row
from saltus.controller.stance import (
    ACCELERATION_WEIGHT,
    FORCE_WEIGHT,
    FRICTION,
    ExactSolver,
    StanceLegs,
    StanceQP,
)
from saltus.controller.yaw_frame import CentroidalReference, YawFrameBody, observe_body
from saltus.robots.robot import Robot
from saltus.robots.similarity import Similarity
from saltus.states import standing_state

STANCE = StanceLegs(ROBOT)
SOLVER = ExactSolver(ROBOT)
PROBLEMS = 1000


@pytest.fixture
def problems(draw):
    rng = np.random.default_rng(1)
    plan, sensed = draw(rng, (PROBLEMS,))
    body = observe_body(sensed, KINEMATICS)
    acceleration = STANCE.acceleration_reference(body, plan.velocity, plan.angular_velocity)
    contact = rng.random((PROBLEMS, 4)) < 0.6
    return body, STANCE.build_qp(body, acceleration, contact)


def test_forces_equal_an_independent_solver(problems):
    _, qp = problems
    force = SOLVER.solve(qp)
    worst = 0.0
    for k in range(PROBLEMS):
        worst = max(worst, np.abs(force[k] - independent(row(qp, k))).max())
    assert worst < 1e-3


def test_forces_obey_schedule_cone_and_limits(problems):
    _, qp = problems
    force = SOLVER.solve(qp).reshape(PROBLEMS, 4, 3)
    assert (force[~qp.contact] == 0.0).all()
    standing = force[qp.contact]
    low, high = ROBOT.foot_force
    assert (standing[:, 2] >= low - 1e-6).all()
    assert (standing[:, 2] <= high + 1e-6).all()
    assert (np.abs(standing[:, :2]) <= FRICTION * standing[:, 2:] + 1e-6).all()


def test_problem_is_the_tracking_cost(problems, draw):
    _, qp = problems
    force = np.random.default_rng(2).normal(scale=50.0, size=(PROBLEMS, 12))
    quadratic = 0.5 * np.sum(force * (qp.hessian @ force[..., None])[..., 0], -1) + np.sum(
        qp.gradient * force, -1
    )
    weight = np.asarray(ACCELERATION_WEIGHT)
    constant = 0.5 * np.sum(qp.target**2 * weight, -1)
    cost = 0.5 * STANCE.tracking_cost(qp, force) ** 2 + 0.5 * FORCE_WEIGHT * np.sum(force**2, -1)
    np.testing.assert_allclose(quadratic + constant, cost, rtol=1e-9)


def test_a_level_robot_at_rest_carries_its_weight():
    body = observe_body(standing_state(ROBOT), KINEMATICS)
    acceleration = STANCE.acceleration_reference(body, np.zeros(3), np.zeros(3))
    force = SOLVER.solve(STANCE.build_qp(body, acceleration, np.ones(4, dtype=bool))).reshape(4, 3)
    np.testing.assert_allclose(force[:, 2].sum(), ROBOT.mass * 9.81, rtol=2e-3)
    np.testing.assert_allclose(force[:, :2].sum(axis=0), 0.0, atol=0.1)
    torque = STANCE.torque(body, force.reshape(12)).reshape(4, 3)
    assert (torque[:, 2] > 0.0).all()  # knees are stretched


def test_torques_do_the_work_of_the_forces_and_keep_the_limits(problems):
    body, qp = problems
    force = SOLVER.solve(qp)
    torque = STANCE.torque(body, force)
    assert (np.abs(torque) <= ROBOT.torque_limit).all()
    small = 0.02 * force
    velocity = np.random.default_rng(4).normal(size=(PROBLEMS, 4, 3))
    foot_velocity = (body.jacobian @ velocity[..., None])[..., 0] @ body.base_in_yaw.mT
    joint_power = np.sum(
        STANCE.torque(body, small).reshape(PROBLEMS, 4, 3) * velocity, axis=(-1, -2)
    )
    foot_power = -np.sum(small.reshape(PROBLEMS, 4, 3) * foot_velocity, axis=(-1, -2))
    np.testing.assert_allclose(joint_power, foot_power, atol=1e-9)


def test_torch_problems_give_the_same_forces(problems):
    _, qp = problems
    tensors = StanceQP(
        **{name: torch.as_tensor(getattr(qp, name)) for name in StanceQP.__dataclass_fields__}
    )
    np.testing.assert_array_equal(SOLVER.solve(tensors).numpy(), SOLVER.solve(qp))


def test_forces_of_a_robot_of_another_size_grow_with_its_mass(draw):
    plan, sensed = draw(np.random.default_rng(5), (100,))
    contact = np.random.default_rng(6).random((100, 4)) < 0.6
    reference, (length, mass) = (
        _forces(ROBOT, plan, observe_body(sensed, KINEMATICS), contact),
        (1.7, 4.2),
    )
    robot = replace(
        ROBOT, thigh_length=ROBOT.thigh_length * length, calf_length=ROBOT.calf_length * length,
        trunk_mass=ROBOT.trunk_mass * mass, link_mass=ROBOT.link_mass * mass,
        foot_force=ROBOT.foot_force * mass,
        inertia=ROBOT.inertia * mass * length**2,
    )  # fmt: skip
    time = Similarity.of_robot(robot).time
    speed = length / time
    plan = replace(
        plan, velocity=plan.velocity * speed, angular_velocity=plan.angular_velocity / time
    )
    body = observe_body(sensed, KINEMATICS)
    larger = replace(
        body, velocity=body.velocity * speed, angular_velocity=body.angular_velocity / time,
        foot_base=body.foot_base * length, foot_yaw=body.foot_yaw * length,
    )  # fmt: skip
    np.testing.assert_allclose(
        _forces(robot, plan, larger, contact), mass * reference, atol=1e-3 * mass
    )


def _forces(
    robot: Robot, plan: CentroidalReference, body: YawFrameBody, contact: np.ndarray
) -> np.ndarray:
    legs = StanceLegs(robot)
    acceleration = legs.acceleration_reference(body, plan.velocity, plan.angular_velocity)
    return ExactSolver(robot).solve(legs.build_qp(body, acceleration, contact))
