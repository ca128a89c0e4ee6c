"""Compensation: known effects of drives are taken out of the commands,
so that joints do what the law asks for.

A drive makes kp (q* - q) + kd (v* - v) + torque, of which the joint gets `gain` times as much, less
`damping` times its velocity v. So gains and torque are divided by `gain`, and the joint's own
damping counts as a part of kd: it acts at once, while a torque from outside would come late.
"""

from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Constant, Floats, Joints, namespace
from saltus.effects.effect import Effect
from saltus.effects.joint_loads import ViscousFriction
from saltus.effects.motors import TorqueGain
from saltus.effects.profile import Profile, load_profile
from saltus.errors import ConfigError
from saltus.joint_command import JointCommand
from saltus.robots.robot import Robot

MOST_OF_KD = 0.9
"""Share of kd that the joint's own damping may make up: what is known of a joint is not exact."""
LEAST_GAIN = 0.2
"""A motor that is weaker is broken: no command makes up for that."""
KNOWN = (TorqueGain, ViscousFriction)
"""The effects that are taken out."""
_NO_KD = 1e-6  # [Nm s/rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class Compensation:
    """Takes a known torque gain and a known viscous friction out of joint commands."""

    gain: Constant
    """Delivered over commanded torque, shape (12,)."""
    damping: Constant
    """Viscous friction of the joints [Nm s/rad], shape (12,)."""
    torque_limit: Constant
    """Torque limit of the drives, for the feed-forward torque [Nm], shape (12,)."""

    def __call__(self, command: JointCommand) -> JointCommand:
        """Returns what makes such joints do what `command` asks of ideal ones.

        All arrays have shape (..., 12).
        """
        kd: Joints = command.kd
        xp = namespace(kd)
        gain, limit = self.gain.like(kd), self.torque_limit.like(kd)
        left = kd - xp.minimum(self.damping.like(kd), MOST_OF_KD * kd)
        return replace(
            command,
            kp=command.kp / gain,
            kd=left / gain,
            velocity=command.velocity * (kd / xp.clip(left, _NO_KD, None)),
            torque=xp.clip(command.torque / gain, -limit, limit),
        )


def compensation_of(profile: Profile, robot: Robot) -> Compensation | None:
    """Returns what the profile says of torque gain and viscous friction;
    None where it says nothing of them.

    Raises:
        ConfigError: a motor with less than `LEAST_GAIN` of its torque.
    """
    gain, friction = (profile.effects.get(effect.name) for effect in KNOWN)
    if gain is None and friction is None:
        return None
    gains, damping = _of_joints(gain, "gain", 1.0), _of_joints(friction, "coefficient", 0.0)
    if gains.min() < LEAST_GAIN:
        raise ConfigError(
            f"torque_gain = {gains.min():g}: a leg controller makes up for no less than "
            f"{LEAST_GAIN:g}"
        )
    return Compensation(
        gain=Constant(gains), damping=Constant(damping), torque_limit=Constant(robot.torque_limit)
    )


def compensation_for(known: str | None, robot: Robot) -> Compensation | None:
    """Compensation for the profile with a name or path (`compensation_of`), which is read;
    None where none is named.

    The errors of `load_profile`, too.
    """
    return None if known is None else compensation_of(load_profile(known, robot), robot)


def _of_joints(effect: Effect | None, parameter: str, null: float) -> Floats:
    """A parameter of all joints, shape (12,)."""
    return np.ones(12) * (null if effect is None else getattr(effect, parameter))
