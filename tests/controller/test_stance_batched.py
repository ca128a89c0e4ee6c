from dataclasses import replace

import numpy as np
import pytest
import torch
from samples import KINEMATICS, ROBOT

from saltus.controller.stance import (
    ACCELERATION_WEIGHT,
    FORCE_WEIGHT,
    FRICTION,
    ExactSolver,
    StanceLegs,
    StanceQP,
)
from saltus.controller.stance_batched import BatchedSolver, invert
from saltus.controller.yaw_frame import observe_body
from saltus.rotations import quaternion_from_roll_pitch_yaw
from saltus.states import standing_state

LEGS = StanceLegs(ROBOT)
PATTERNS = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 1]], dtype=bool)


def demands(count, seed):
    """Bounding robots that are asked for much: most of these problems have active constraints."""
    rng = np.random.default_rng(seed)
    angles = rng.normal(0.0, (0.1, 0.4, 1.0), (count, 3)).T
    body = observe_body(
        replace(
            standing_state(ROBOT),
            quaternion_base_in_world=quaternion_from_roll_pitch_yaw(*angles),
            angular_velocity_base=rng.normal(0.0, 2.0, (count, 3)),
            joint_position=np.clip(
                ROBOT.stand_pose + rng.normal(0.0, 0.35, (count, 12)),
                ROBOT.joint_lower,
                ROBOT.joint_upper,
            ),
            velocity_base_in_world=rng.normal(0.0, 1.0, (count, 3)),
        ),
        KINEMATICS,
    )
    velocity = np.stack([body.velocity[:, 0], np.zeros(count), np.zeros(count)], -1)
    velocity = velocity + rng.uniform((-1, 0, -3), (1, 0, 3), (count, 3))
    spin = rng.uniform((0, -6, -1), (0, 6, 1), (count, 3))
    acceleration = LEGS.acceleration_reference(body, velocity, spin)
    return LEGS.build_qp(body, acceleration, PATTERNS[rng.integers(0, len(PATTERNS), count)])


def clipped_closed_form(qp):
    """The original's: solve without constraints, clip fz, scale fx and fy."""
    root = np.sqrt(np.array(ACCELERATION_WEIGHT))
    A = (qp.model * root).swapaxes(-1, -2) * np.repeat(qp.contact, 3, -1)[:, None]
    right = A.swapaxes(-1, -2) @ (qp.target * root)[..., None]
    force = np.linalg.solve(A.swapaxes(-1, -2) @ A + FORCE_WEIGHT * np.eye(12), right).reshape(
        -1, 4, 3
    )
    fz = np.clip(force[..., 2], *ROBOT.foot_force) * qp.contact
    norm = np.linalg.norm(force[..., :2], axis=-1) + 1e-3
    scale = np.minimum(1.0, FRICTION * fz / norm)
    return np.concatenate([force[..., :2] * scale[..., None], fz[..., None]], -1).reshape(-1, 12)


@pytest.mark.parametrize("steps", [0, 1, 16])
def test_friction_and_force_limits_hold_whatever_the_number_of_steps(steps):
    qp = demands(500, seed=1)
    force = BatchedSolver(ROBOT, steps).solve(qp).reshape(-1, 4, 3)
    low, high = ROBOT.foot_force
    standing = force[qp.contact]
    assert (force[~qp.contact] == 0.0).all()
    assert (standing[:, 2] >= low - 1e-9).all()
    assert (standing[:, 2] <= high + 1e-9).all()
    assert (np.abs(standing[:, :2]) <= FRICTION * standing[:, 2:] + 1e-9).all()


def test_cost_is_near_that_of_the_exact_solution():
    qp = demands(1000, seed=2)
    exact = ExactSolver(ROBOT).solve(qp)

    def excess(force):
        return np.percentile(
            LEGS.tracking_cost(qp, force) - LEGS.tracking_cost(qp, exact), [50, 90]
        )

    batched, clipped = (
        excess(BatchedSolver(ROBOT).solve(qp)),
        excess(clipped_closed_form(qp)),
    )
    assert batched[0] < 0.2  # of costs of which the median is 40
    assert batched[1] < 4.0
    assert (30.0 * batched < clipped).all()


def test_more_steps_bring_it_to_the_exact_forces():
    qp = demands(100, seed=3)
    exact = ExactSolver(ROBOT).solve(qp)
    error = [
        np.abs(BatchedSolver(ROBOT, steps).solve(qp) - exact).max(-1) for steps in (16, 200, 3000)
    ]
    assert np.median(error[1]) < np.median(error[0])
    assert np.median(error[2]) < 1e-3


def test_torch_in_single_precision_agrees_with_numpy():
    qp = demands(200, seed=4)
    single = {
        name: torch.tensor(getattr(qp, name), dtype=torch.float32)
        for name in ("hessian", "gradient", "model")
    }
    given = StanceQP(
        contact=torch.tensor(qp.contact),
        target=torch.tensor(qp.target, dtype=torch.float32),
        **single,
    )
    solver = BatchedSolver(ROBOT)
    np.testing.assert_allclose(solver.solve(given), solver.solve(qp), atol=0.05)


@pytest.mark.parametrize("size", [1, 3, 6])
def test_inverts_positive_definite_matrices(size):
    root = np.random.default_rng(size).normal(size=(50, size, size))
    matrix = root @ root.swapaxes(-1, -2) + 0.1 * np.eye(size)
    np.testing.assert_allclose(
        invert(matrix) @ matrix, np.broadcast_to(np.eye(size), matrix.shape), atol=1e-9
    )
