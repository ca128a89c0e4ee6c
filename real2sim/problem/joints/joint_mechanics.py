"""Mechanics of a batch of short chains: dry friction and added inertia,
backlash, and a held base that may roll.
"""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.sim.held_robot import RollingBase

SWEEPS = 3
"""Number of sweeps over the joints of a chain in a step: friction at one joint changes what the
others feel by a third or less, and each step starts from the impulses of the last."""
LEAST_WAY, MOST_WAYS = 1e-6, 50.0
"""Ways in a step, in parts of the reach of bristles, below which these slip by less than a
millionth, and above which they have forgotten how they were bent, to 1e-21."""


def joint_by_joint(values: Floats) -> Floats:
    """The joints' axis, the last but one, first, in one piece of memory,
    so that an operation on one joint is one long loop, not a short one for each window and branch.
    """
    return np.ascontiguousarray(np.moveaxis(values, -2, 0))


def inverses_of(inverse: Floats, sets: int) -> Floats:
    """Inverses of mass matrices, shape (windows, branches, joints, joints), for so many sets:
    shape (joints, joints, windows, branches, sets), as all here takes them.
    """
    each = inverse.transpose(2, 3, 0, 1)[..., None]
    return np.array(np.broadcast_to(each, (*each.shape[:-1], sets)), order="C")


def with_inertia(inverse: Floats, added: Floats) -> Floats:
    """Inverse of the mass matrix after `added` [kg m^2] at the joints, one rank-one update a joint.

    Args:
        inverse: Without it, shape (joints, joints, windows, branches, sets); it is changed.
        added: Shape (..., joints, sets).
    """
    for joint, extra in enumerate(joint_by_joint(added)):
        if extra.any():  # a limit of speed seldom holds more than one joint
            column, row = inverse[:, joint].copy(), inverse[joint]
            share = extra / (1.0 + extra * column[joint])
            inverse -= column[:, None] * (row * share)
    return inverse


def joint_accelerations(inverse: Floats, torque: Floats) -> Floats:
    """Product of an inverse of the mass matrix, shape (joints, joints, windows, branches, sets),
    and torques or impulses, of the same shape (windows, branches, joints, sets) as the result.
    """
    first, *others = joint_by_joint(torque)
    total = inverse[:, 0] * first
    for joint, other in enumerate(others, 1):
        total += inverse[:, joint] * other
    return np.ascontiguousarray(total.transpose(1, 2, 0, 3))


def bristle_slip(give: Floats, bent: Floats, ways: Floats) -> tuple[Floats, Floats]:
    """`give` and `bent` of `slowed_by_friction` where bristles slip more the further they bend.

    After a way x they are bent by reach (1 - exp(-x / reach)) (P. Dahl, A solid friction model,
    1968; LuGre, Canudas de Wit et al. 1995).

    Args:
        give: Of bristles that do not slip.
        bent: How far they are bent, as `slowed_by_friction` has it.
        ways: Way of the step, in parts of their reach.
    """
    x = np.clip(ways, LEAST_WAY, MOST_WAYS)
    return give * x / -np.expm1(-x), bent * x / np.expm1(x)


def slowed_by_friction(
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
        inverse: Of the mass matrix, shape (joints, joints, windows, branches, sets).
        limit: Largest impulse of friction over the step [Nm s].
        impulse: That of the last step, from which the search starts; becomes that of this step.
        give: By how much the velocity of a joint gives way for an impulse of friction [rad/s per Nm
            s]: bristles bend like springs, 1 / (stiffness step^2). None where they are rigid.
        bent: How far bristles are bent, over the step [rad/s], with the sign of the impulse that
            bent them.
    """
    # by hand: `np.clip` takes several times as long for arrays of this size, most of it to look at
    # its arguments
    least = -limit
    np.minimum(np.maximum(impulse, least, out=impulse), limit, out=impulse)
    fast, shape = joint_by_joint(velocity + joint_accelerations(inverse, impulse)), velocity.shape
    pushes = joint_by_joint(impulse)
    low, high = (joint_by_joint(np.broadcast_to(each, shape)) for each in (least, limit))
    gives, bends = (
        None if each is None else joint_by_joint(np.broadcast_to(each, shape))
        for each in (give, bent)
    )
    for _ in range(SWEEPS):
        for joint, own in enumerate(pushes):
            mobility = inverse[joint, joint]
            if gives is None or bends is None:
                stopping = own - fast[joint] / mobility
            else:  # the springs' law at the end of the step
                ahead = fast[joint] - mobility * own - bends[joint]
                stopping = -ahead / (mobility + gives[joint])
            new = np.minimum(np.maximum(stopping, low[joint]), high[joint])
            fast += inverse[:, joint] * (new - own)
            own[...] = new
    impulse[...] = pushes.transpose(1, 2, 0, 3)
    return np.ascontiguousarray(fast.transpose(1, 2, 0, 3))


class RotorPlay:
    """Where the rotors of a replay are in the gaps of their gears (backlash).

    The law of the drive and the rotor are on the motor's side; in contact both sides move as one.
    Contact ends when the rotor would have to pull, and begins again, without rebound, at an end of
    the gap.

    Args:
        width: Of the gaps [rad], shape (branches, joints, sets).
        motor_side: Where the logged encoder sits, 0 at the joint and 1 at the motor, shape as
            `width`.
        rotor: Inertia on the motor's side [kg m^2], broadcast with `width`.
        shape: Of all simulations: (windows, branches, joints, sets).

    Attributes:
        offset: How far the rotor is ahead of its joint [rad].
        rate: How fast it gets ahead [rad/s].
    """

    def __init__(
        self, width: Floats, motor_side: Floats, rotor: Floats, shape: tuple[int, ...]
    ) -> None:
        self._half = 0.5 * width
        self._motor_side = motor_side
        self._rotor = rotor
        self.offset, self.rate = np.zeros(shape), np.zeros(shape)
        self._touches = np.ones(shape, dtype=bool)
        self._drive = np.zeros(shape)

    def begun(self, torque: Floats) -> Floats:
        """Rotors that push from the start.

        Returns by how much what is logged is then ahead of the joints [rad].
        """
        self.offset = np.sign(torque) * self._half
        return np.asarray(self._motor_side * self.offset)

    def logged(self, position: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Motion on the side of the logged encoder, for that of the joints."""
        return position + self._motor_side * self.offset, velocity + self._motor_side * self.rate

    def seen(self, position: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Angles [rad] and velocities [rad/s] on the motor's side, which the law sees.

        The arguments are those on the logged encoder's side; all have the shape of all simulations.
        """
        rest = 1.0 - self._motor_side
        return position + rest * self.offset, velocity + rest * self.rate

    def transmitted(self, torque: Floats) -> tuple[Floats, Floats]:
        """Torque that arrives at the joints,
        and rotor inertia that they lack, for the drives' torque.
        """
        self._drive = torque
        return np.where(self._touches, torque, 0.0), np.where(self._touches, 0.0, self._rotor)

    def moved(self, velocity: Floats, acceleration: Floats, inverse: Floats, dt_s: float) -> Floats:
        """Advances the rotors; returns the joints' velocities after rotors have hit.

        Args:
            velocity: Of the joints at the end of the step [rad/s].
            acceleration: Over the step [rad/s^2].
            inverse: Of the mass matrix that the step was made with, shape (joints, joints,
                windows, branches, sets).
            dt_s: The step.
        """
        touches = self._touches
        # 1. rotors that would have to pull: they leave, or cross a gap that is narrower than a
        # step's way
        pushed = self._drive - self._rotor * acceleration
        leaves = touches & (pushed * self.offset < 0.0)
        crosses = leaves & (np.abs(pushed) * (0.5 * dt_s**2) > 2.0 * self._half * self._rotor)
        # 2. rotors under way
        ahead = self.rate + dt_s * (self._drive / self._rotor - acceleration)
        offset = self.offset + (0.5 * dt_s) * (self.rate + ahead)
        hits = ~touches & (np.abs(offset) >= self._half) & (ahead * offset > 0.0)
        # 3. those that hit share their momentum with the joint
        ahead = np.where(touches, 0.0, ahead)
        if hits.any():
            velocity = self._struck(velocity, np.where(hits, ahead, 0.0), inverse)
        offset = np.where(touches, np.where(crosses, -self.offset, self.offset), offset)
        self.offset = np.clip(offset, -self._half, self._half)
        self.rate = np.where(hits, 0.0, ahead)
        self._touches = (touches & ~(leaves & ~crosses)) | hits
        return velocity

    def _struck(self, velocity: Floats, approach: Floats, inverse: Floats) -> Floats:
        velocity = velocity.copy()
        for joint in range(velocity.shape[2]):
            own, rotor = inverse[joint, joint], self._rotor[..., joint, :]
            gained = approach[:, :, joint] * rotor / (rotor + 1.0 / own)
            velocity += (inverse[:, joint] * (gained / own)).transpose(1, 2, 0, 3)
        return velocity


STILL_ROWS = 25
"""At the beginning of a stretch, over whose mean the base is taken to hang still."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeldJointMotion:
    """A log on uniform rows, with coefficients halfway to the next row.

    Stretches are first rows and ends.
    """

    base: RollingBase
    dt_s: float
    stretches: tuple[tuple[int, int], ...]

    def rolled(self, weight: Floats, give: Floats, damping: Floats) -> Floats:
        """Angle, rate and acceleration of the base halfway to the next row,
        shape (rows, 3, branches, sets).

        Args:
            weight: By which they are multiplied, shape (branches, sets).
            give: Of what holds it, as each branch has it [rad/Nm], shape (branches, sets).
            damping: [Nm s/rad], the same shape.
        """
        (gives, damped), which = np.unique(
            np.stack([give, damping]).reshape(2, -1), axis=1, return_inverse=True
        )
        moved = np.concatenate(
            [self._moved(gives, damped, slice(*stretch)) for stretch in self.stretches]
        )
        return np.asarray(weight * moved[..., which.reshape(give.shape)])

    def load(self, rolled: Floats, rows: Indices) -> Floats:
        """Torques that resist the joints from some rows to the next [Nm],
        shape (windows, branches, joints, sets).

        `rolled` is of all rows, `rows` of shape (windows,).
        """
        return np.asarray(np.einsum("wbjk,wkbs->wbjs", self.base.on_joints[rows], rolled[rows]))

    def _moved(self, give: Floats, damping: Floats, own: slice) -> Floats:
        """The midpoint rule over a stretch, shape (its rows, 3, pairs);
        where nothing gives, the base keeps still.
        """
        half, gives = 0.5 * self.dt_s, give > 0.0
        moment = self.base.moment[own, None]
        stiffness, damped, inertia = self.base.on_base[own].T[..., None]
        stiffness, damped = stiffness + 1.0 / np.where(gives, give, 1.0), damped + damping
        resists = inertia + half * (damped + half * stiffness)
        hangs = -np.mean(moment[:STILL_ROWS]) / np.mean(stiffness[:STILL_ROWS], axis=0)
        angle, rate = np.where(gives, hangs, 0.0), np.zeros(len(give))
        out = np.empty((len(moment), 3, len(give)))
        for k in range(len(moment)):
            pushed = moment[k] + stiffness[k] * (angle + half * rate) + damped[k] * rate
            acceleration = np.where(gives, -pushed / resists[k], 0.0)
            middle = rate + half * acceleration
            out[k] = angle + half * middle, middle, acceleration
            angle, rate = angle + 2.0 * half * middle, rate + 2.0 * half * acceleration
        return out
