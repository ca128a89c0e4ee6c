"""Dry friction and added inertia in a batch of short chains."""

import numpy as np

from saltus.arrays import Floats

SWEEPS = 3
"""Number of sweeps over the joints of a chain in a step: friction at one joint changes what the
others feel by a third or less, and each step starts from the impulses of the last."""


def with_inertia(inverse: Floats, added: Floats) -> Floats:
    """Inverse of the mass matrix after `added` [kg m^2] at the joints, one rank-one update a joint.

    Shapes (windows, branches, joints, joints, sets or 1) and (..., joints, sets).
    """
    added = added + np.zeros_like(inverse[:, :, 0])  # the shape that both have together
    for joint in range(inverse.shape[2]):
        column, row = inverse[:, :, :, joint], inverse[:, :, joint]
        extra = added[:, :, joint]
        share = extra / (1.0 + extra * column[:, :, joint])
        inverse = inverse - column[:, :, :, None] * (row * share[:, :, None])[:, :, None]
    return inverse


def rubbed(
    velocity: Floats,
    inverse: Floats,
    limit: Floats,
    impulse: Floats,
    give: Floats | None = None,
    bent: Floats | None = None,
) -> Floats:
    """Velocities after dry friction has acted for a step.

    Args:
        velocity: Without it [rad/s], shape (windows, branches, joints, sets).
        inverse: Of the mass matrix, shape (windows, branches, joints, joints, sets or 1).
        limit: Largest impulse of friction over the step [Nm s].
        impulse: That of the last step, from which the search starts; becomes that of this step.
        give: By how much the velocity of a joint gives way for an impulse of friction [rad/s per Nm s]: bristles bend
            like springs, 1 / (stiffness step^2). None where they are rigid.
        bent: How far bristles are bent, over the step [rad/s], with the sign of the impulse that bent them.
    """
    # by hand: `np.clip` takes several times as long for arrays of this size, most of it to look at its arguments
    least = -limit
    np.minimum(np.maximum(impulse, least, out=impulse), limit, out=impulse)
    velocity = velocity + np.einsum("wbij...,wbj...->wbi...", inverse, impulse)
    for _ in range(SWEEPS):
        for joint in range(velocity.shape[2]):
            column, own = inverse[:, :, :, joint], impulse[:, :, joint]
            mobility = column[:, :, joint]
            if give is None or bent is None:
                stopping = own - velocity[:, :, joint] / mobility
            else:  # the springs' law at the end of the step
                ahead = velocity[:, :, joint] - mobility * own - bent[:, :, joint]
                stopping = -ahead / (mobility + give[..., joint, :])
            new = np.minimum(np.maximum(stopping, least[..., joint, :]), limit[..., joint, :])
            velocity += column * (new - own)[:, :, None]
            impulse[:, :, joint] = new
    return velocity
