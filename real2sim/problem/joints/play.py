"""Backlash in a batch of short chains: rotor and joint as two masses that meet at the ends of a gap."""

import numpy as np

from saltus.arrays import Floats


class Play:
    """Where rotors are in their gaps.

    The law of the drive and the rotor are on the motor's side; in contact both sides move as one. Contact ends when the
    rotor would have to pull, and begins again, without rebound, at an end of the gap.

    Args:
        width: Of the gaps [rad], shape (branches, joints, sets).
        motor_side: Where the logged encoder sits, 0 at the joint and 1 at the motor, shape as `width`.
        rotor: Inertia on the motor's side [kg m^2], broadcast with `width`.
        shape: Of all simulations: (windows, branches, joints, sets).

    Attributes:
        offset: How far the rotor is ahead of its joint [rad].
        rate: How fast it gets ahead [rad/s].
    """

    def __init__(self, width: Floats, motor_side: Floats, rotor: Floats, shape: tuple[int, ...]) -> None:
        self._half = 0.5 * width
        self._motor_side = motor_side
        self._rotor = rotor
        self.offset, self.rate = np.zeros(shape), np.zeros(shape)
        self._touches = np.ones(shape, dtype=bool)
        self._drive = np.zeros(shape)

    def begun(self, torque: Floats) -> Floats:
        """Rotors that push from the start; returns by how much what is logged is then ahead of the joints [rad]."""
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
        """Torque that arrives at the joints, and rotor inertia that they lack, for the drives' torque."""
        self._drive = torque
        return np.where(self._touches, torque, 0.0), np.where(self._touches, 0.0, self._rotor)

    def moved(self, velocity: Floats, acceleration: Floats, inverse: Floats, dt_s: float) -> Floats:
        """Advances the rotors; returns the joints' velocities after rotors have hit.

        Args:
            velocity: Of the joints at the end of the step [rad/s].
            acceleration: Over the step [rad/s^2].
            inverse: Of the mass matrix that the step was made with, shape (windows, branches, joints, joints, sets).
            dt_s: The step.
        """
        touches = self._touches
        # 1. rotors that would have to pull: they leave, or cross a gap that is narrower than a step's way
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
            column = inverse[:, :, :, joint]
            own = column[:, :, joint]
            rotor = self._rotor[..., joint, :]
            gained = approach[:, :, joint] * rotor / (rotor + 1.0 / own)
            velocity += column * (gained / own)[:, :, None]
        return velocity
