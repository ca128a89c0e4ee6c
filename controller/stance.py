"""Stance legs: ground reaction forces from a quadratic program,
torques from the Jacobian transpose.

minimise  (a - a_ref)' U (a - a_ref) + f' V f     with a = M f - g, the centroidal model, in the base frame,
subject to |fx|, |fy| <= mu fz, fz in [fz_min, fz_max] for standing feet and f = 0 for the others,
where f are forces on the feet in the yaw frame. Source: paper ("Feed-forward Optimal Control");
numbers: original.

`StanceLegs.build_qp` is batched; `solve_exact` loops over the robots of a batch.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import (
    AccelerationPairs,
    BodyAccelerations,
    Constant,
    Floats,
    JointMatrices,
    Joints,
    LegFlags,
    Levers,
    Scalars,
    Vectors,
    namespace,
)
from saltus.constants import GRAVITY
from saltus.controller.yaw_frame import YawFrameBody
from saltus.errors import SaltusError
from saltus.robots.robot import Robot
from saltus.robots.similarity import Similarity
from saltus.rotations import SKEW

# Weights and gains for a robot of the reference's size (`Similarity`); original.
ACCELERATION_WEIGHT = (1.0, 1.0, 10.0, 10.0, 10.0, 1.0)
"""U: x, y, z, roll, pitch, yaw."""
FORCE_WEIGHT = 1e-4
"""V."""
FRICTION = 0.6
ROLL_KP = 50.0
"""[1/s^2]; pitch and yaw have none."""
ROLL_STEP_RAD = 0.2
"""The roll reference, 0, is not taken to be further from the present roll than this."""
LINEAR_KD, ANGULAR_KD = (10.0, 10.0, 10.0), (1.0, 10.0, 10.0)
"""[1/s]."""
LINEAR_LOW, LINEAR_HIGH = (-30.0, -30.0, -10.0), (30.0, 30.0, 30.0)
"""Range of the linear reference acceleration, base frame [m/s^2]."""
ANGULAR_LIMIT = (50.0, 50.0, 20.0)
"""Largest angular reference acceleration, base frame [rad/s^2]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StanceQP:
    """minimise 1/2 f' H f + g' f over the forces f of all feet,
    of which those in contact may differ from 0.
    """

    hessian: JointMatrices
    """Shape (..., 12, 12)."""
    gradient: Joints
    """Shape (..., 12)."""
    contact: LegFlags
    """Bool, shape (..., 4)."""
    model: Levers
    """M transposed: acceleration in the base frame by force, shape (..., 12, 6)."""
    target: BodyAccelerations
    """a_ref + g: acceleration that the forces must bring about, base frame, shape (..., 6)."""


class StanceLegs:
    """The legs that stand: the body's wanted acceleration, the quadratic program for the feet's
    forces, and the joint torques.
    """

    def __init__(self, robot: Robot) -> None:
        size = Similarity.of_robot(robot)
        rate = 1.0 / size.time
        # One foot's (linear, angular) acceleration by force, transposed: [I / m | -[p]x / I],
        # linear in p.
        lever = np.zeros((3, 3, 6))
        lever[:, :, 3:] = -SKEW.reshape(3, 3, 3) / robot.inertia
        constant = np.zeros((3, 6))
        constant[:, :3] = np.eye(3) / robot.mass
        self._lever = Constant(lever.reshape(3, 18))
        self._constant = Constant(constant)
        self._weight = Constant(scaled_acceleration_weight(robot))
        self._regular = Constant(scaled_force_weight(robot) * np.eye(12))
        self._gain = Constant(rate * np.array([LINEAR_KD, ANGULAR_KD]))
        self._roll_gain = Constant([[0.0, 0.0, 0.0], [rate**2 * ROLL_KP, 0.0, 0.0]])
        angular_limit = np.array(ANGULAR_LIMIT) / size.length
        self._low = Constant(np.array([LINEAR_LOW, -angular_limit]))
        self._high = Constant(np.array([LINEAR_HIGH, angular_limit]))
        self._up = Constant([[GRAVITY], [0.0]])
        self._torque_limit = Constant(robot.torque_limit)

    def acceleration_reference(
        self, body: YawFrameBody, velocity: Vectors, angular_velocity: Vectors
    ) -> AccelerationPairs:
        """Reference acceleration (linear, angular) in the base frame, clipped. Shape (..., 2, 3).

        Args:
            body: the robot now.
            velocity: reference, yaw frame [m/s], shape (..., 3).
            angular_velocity: reference, yaw frame [rad/s], shape (..., 3).
        """
        xp = namespace(velocity)
        error = xp.stack([velocity - body.velocity, angular_velocity - body.angular_velocity], -2)
        step = ROLL_STEP_RAD
        roll = xp.clip(body.roll, -step, step)[..., None, None]
        acceleration = error * self._gain.like(velocity) - roll * self._roll_gain.like(velocity)
        return xp.clip(
            acceleration @ body.base_in_yaw, self._low.like(velocity), self._high.like(velocity)
        )

    def build_qp(
        self, body: YawFrameBody, acceleration: AccelerationPairs, contact: LegFlags
    ) -> StanceQP:
        """Writes the problem down; `acceleration` (..., 2, 3)
        and `contact` (..., 4) as elsewhere.
        """
        batch = acceleration.shape[:-2]
        rotation = body.base_in_yaw
        lever = (body.foot_base @ self._lever.like(acceleration)).reshape((*batch, 4, 3, 6))
        model = (rotation[..., None, :, :] @ (lever + self._constant.like(acceleration))).reshape(
            (*batch, 12, 6)
        )
        gravity = self._up.like(acceleration) * rotation[..., 2:3, :]
        target = (acceleration + gravity).reshape((*batch, 6))
        weighted = model * self._weight.like(acceleration)
        return StanceQP(
            hessian=weighted @ model.mT + self._regular.like(acceleration),
            gradient=-(weighted @ target[..., None])[..., 0],
            contact=contact,
            model=model,
            target=target,
        )

    def tracking_cost(self, qp: StanceQP, force: Joints) -> Scalars:
        """sqrt((a - a_ref)' U (a - a_ref)) of forces (..., 12), yaw frame. Shape (...)."""
        xp = namespace(force)
        error = (force[..., None, :] @ qp.model)[..., 0, :] - qp.target
        return xp.sqrt(xp.sum(error * error * self._weight.like(force), axis=-1))

    def torque(self, body: YawFrameBody, force: Joints) -> Joints:
        """Joint torques [Nm], shape (..., 12),
        that press the feet down with `force` (yaw frame, (..., 12)).
        """
        xp = namespace(force)
        batch = force.shape[:-1]
        force_base = force.reshape((*batch, 4, 3)) @ body.base_in_yaw
        torque = -(force_base[..., None, :] @ body.jacobian).reshape((*batch, 12))
        limit = self._torque_limit.like(force)
        return xp.clip(torque, -limit, limit)


def scaled_acceleration_weight(robot: Robot) -> Floats:
    """U for a robot, shape (6,): where legs are longer,
    angular accelerations are smaller, and count as much.
    """
    linear, angular = np.array(ACCELERATION_WEIGHT).reshape(2, 3)
    return np.concatenate([linear, angular * Similarity.of_robot(robot).length ** 2])


def scaled_force_weight(robot: Robot) -> float:
    """V for a robot: forces are as many times those of the reference as masses are."""
    return FORCE_WEIGHT / Similarity.of_robot(robot).mass ** 2


class StanceSolver(Protocol):
    """Anything that finds the feet's forces: it solves quadratic programs of stance."""

    def solve(self, qp: StanceQP) -> Joints:
        """Forces on the feet, yaw frame [N], shape (..., 12); zero for feet in the air."""
        ...


class ExactSolver:
    """Finds the feet's forces exactly: it solves quadratic programs of stance with a dense active-
    set method.

    Legs in the air are eliminated first.
    """

    def __init__(self, robot: Robot) -> None:
        import daqp  # here, because training with another solver runs where it is not installed

        self._daqp = daqp.solve
        self._constraints = [_constraints(feet, robot.foot_force, FRICTION) for feet in range(5)]
        self._columns = [_columns(pattern) for pattern in range(16)]
        self._square = [(12 * c[:, None] + c).reshape(-1) for c in self._columns]

    def solve(self, qp: StanceQP) -> Joints:
        """Forces on the feet, yaw frame [N], shape (..., 12); zero for feet in the air.

        Raises:
            SaltusError: the solver failed, which a problem of finite numbers cannot bring about.
        """
        xp = namespace(qp.gradient)
        if isinstance(qp.gradient, np.ndarray):
            return self._solve_all(qp.hessian, qp.gradient, np.asarray(qp.contact))
        force = self._solve_all(
            qp.hessian.detach().cpu().double().numpy(),
            qp.gradient.detach().cpu().double().numpy(),
            qp.contact.cpu().numpy(),
        )
        return xp.asarray(force, dtype=qp.gradient.dtype, device=qp.gradient.device)

    def _solve_all(
        self,
        hessian: NDArray[np.float64],
        gradient: NDArray[np.float64],
        contact: NDArray[np.bool_],
    ) -> NDArray[np.float64]:
        patterns = (contact @ _PATTERN_BITS).reshape(-1).tolist()
        hessians = hessian.reshape(-1, 144)
        gradients = gradient.reshape(-1, 12)
        forces = np.zeros_like(gradients)
        for robot, pattern in enumerate(patterns):
            if pattern:
                columns = self._columns[pattern]
                forces[robot, columns] = self._solve_one(hessians[robot], gradients[robot], pattern)
        return forces.reshape(gradient.shape)

    def _solve_one(
        self, hessian: NDArray[np.float64], gradient: NDArray[np.float64], pattern: int
    ) -> Floats:
        columns = self._columns[pattern]
        size = len(columns)
        matrix, upper, lower = self._constraints[size // 3]
        square = hessian[self._square[pattern]].reshape(size, size)
        force, _, status, _ = self._daqp(square, gradient[columns], matrix, upper, lower)
        if status != 1:
            raise SaltusError(
                f"stance forces: the solver ended with status {status}; is the robot's state "
                "finite?"
            )
        return force


_PATTERN_BITS = np.array([1, 2, 4, 8])


def _columns(pattern: int) -> NDArray[np.intp]:
    """Force components of the feet in contact, for a pattern of four bits."""
    return np.array(
        [3 * leg + axis for leg in range(4) if pattern >> leg & 1 for axis in range(3)],
        dtype=np.intp,
    )


def _constraints(
    feet: int, force_range: Floats, mu: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Rows, upper and lower bounds: first bounds on the forces themselves,
    then +-fx - mu fz <= 0 and the same in y.
    """
    low, high = force_range
    pyramid = np.array([[1.0, 0.0, -mu], [-1.0, 0.0, -mu], [0.0, 1.0, -mu], [0.0, -1.0, -mu]])
    matrix = np.kron(np.eye(feet), pyramid)
    free = 1e30  # what the solver takes for infinity
    upper = np.concatenate([np.tile([free, free, high], feet), np.zeros(4 * feet)])
    lower = np.concatenate([np.tile([-free, -free, low], feet), np.full(4 * feet, -free)])
    return np.ascontiguousarray(matrix), upper, lower
