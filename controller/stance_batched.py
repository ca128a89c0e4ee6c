"""Stance forces of thousands of robots at once:
a fixed number of steps of ADMM on the same quadratic program.

The exact solver takes one robot after the other; training needs a fixed amount of arithmetic on
whole batches. With A = U^(1/2) M' the objective is |A f - b|^2 + V |f|^2, and one step is: the
minimiser of the objective plus a spring to the last iterate (a matrix product, as the matrix does
not change), and the projection of each foot's force onto its friction pyramid between the force
limits, which has a closed form. Iterates end on the pyramid: friction and force limits hold exactly
whatever the number of steps; what is approximate is the cost.

Reference: S. Boyd et al., "Distributed Optimization and Statistical Learning via ADMM" (2011),
    3.4.3 and 5.
"""

from saltus.arrays import Array, Constant, JointMatrices, Joints, Levers, namespace
from saltus.controller.stance import (
    FRICTION,
    StanceQP,
    scaled_acceleration_weight,
    scaled_force_weight,
)
from saltus.robots.robot import Robot
from saltus.robots.similarity import Similarity

# Measured over random demands (tests/controller/test_stance_batched.py): a stiffer spring settles
# the cost sooner and the forces later. Over-relaxation: Boyd et al. recommend 1.5 to 1.8.
SPRING = 0.4
RELAXATION = 1.7
STEPS = 16


class BatchedSolver:
    """Approximate stance forces by batched arithmetic,
    numpy or torch, float32 or float64; `steps` of ADMM.
    """

    def __init__(self, robot: Robot, steps: int = STEPS) -> None:
        self._steps = steps
        self._low, self._high = robot.foot_force
        self._spring = SPRING / Similarity.of_robot(robot).mass ** 2
        self._diagonal = scaled_force_weight(robot) + self._spring
        self._root_weight = Constant([w**0.5 for w in scaled_acceleration_weight(robot)])
        self._identity6 = Constant([[float(i == j) for j in range(6)] for i in range(6)])
        self._identity12 = Constant([[float(i == j) for j in range(12)] for i in range(12)])

    def solve(self, qp: StanceQP) -> Joints:
        """Forces on the feet, yaw frame [N], shape (..., 12); zero for feet in the air."""
        xp = namespace(qp.gradient)
        batch = qp.gradient.shape[:-1]
        one = xp.ones_like(qp.gradient)
        standing = one * xp.where(qp.contact[..., None], one.reshape((*batch, 4, 3)), 0.0).reshape(
            (*batch, 12)
        )
        # A transposed, (..., 12, 6)
        model = qp.model * self._root_weight.like(one) * standing[..., None]
        pull = (model @ (qp.target * self._root_weight.like(one))[..., None])[..., 0]
        inverse = self._inverse(model)

        free = (inverse @ pull[..., None])[..., 0]
        force = self._project(free, standing)
        excess = xp.zeros_like(force)
        start, held = RELAXATION * free, (RELAXATION * self._spring) * inverse
        for _ in range(self._steps):
            relaxed = (
                start
                + (held @ (force - excess)[..., None])[..., 0]
                + (1.0 - RELAXATION) * force
                + excess
            )
            force = self._project(relaxed, standing)
            excess = relaxed - force
        return force

    def _inverse(self, model: Levers) -> JointMatrices:
        """(A'A + d I)^-1 by way of the 6 x 6 matrix A A' + d I (Woodbury). Shape (..., 12, 12)."""
        xp = namespace(model)
        d = self._diagonal
        small = invert(model.mT @ model + d * self._identity6.like(model))
        return (self._identity12.like(model) - (model @ small) @ model.mT) * (
            1.0 / d
        ) + xp.zeros_like(model[..., :1])

    def _project(self, force: Joints, standing: Joints) -> Joints:
        """The nearest forces that friction and limits allow; 0 for feet in the air."""
        xp = namespace(force)
        mu = FRICTION
        feet = force.reshape((*force.shape[:-1], 4, 3))
        sides, z = feet[..., :2], feet[..., 2]
        size = xp.abs(sides)
        x, y = size[..., 0], size[..., 1]
        # fz minimises a convex function of one variable, whose slope is the least of those with no
        # side of the pyramid active, one, or both: the zero of the least of rising lines is the
        # largest of their zeros
        one_side = (z + mu * xp.maximum(x, y)) * (1.0 / (1.0 + mu * mu))
        two_sides = (z + mu * (x + y)) * (1.0 / (1.0 + 2.0 * mu * mu))
        z = xp.clip(xp.maximum(xp.maximum(z, one_side), two_sides), self._low, self._high)[
            ..., None
        ]
        bound = mu * z
        allowed = xp.concat([xp.clip(sides, -bound, bound), z], axis=-1)
        return allowed.reshape(force.shape) * standing


def invert(matrix: Array) -> Array:
    """Inverse of small symmetric positive definite matrices by Gauss-Jordan elimination,
    all at once.

    Pivots need no search as they are positive. Libraries factorise batches of tiny matrices slower
    than this, and no compiler can join their work with its surroundings. Shape (..., k, k).
    """
    xp = namespace(matrix)
    size = matrix.shape[-1]
    rows = [matrix[..., i, :] for i in range(size)]
    units = Constant([[float(i == j) for j in range(size)] for i in range(size)]).like(matrix)
    for k in range(size):
        unit, rest = units[k], 1.0 - units[k]
        pivot = 1.0 / rows[k][..., k : k + 1]
        # The column that becomes a unit vector is stored as the column of the inverse that it makes
        # room for.
        scaled = (rows[k] * rest + unit) * pivot
        rows = [
            scaled if i == k else row * rest - row[..., k : k + 1] * scaled
            for i, row in enumerate(rows)
        ]
    return xp.stack(rows, -2)
