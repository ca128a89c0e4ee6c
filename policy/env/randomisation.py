"""Randomisation of a training from episode to episode, besides the terrain."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from saltus.arrays import Array, ColumnNames, namespace
from saltus.config import check_between
from saltus.effects.body import (
    LEAST_TURNING_M,
    NOMINAL_CONTACT_TIME_CONSTANT_S,
    NOMINAL_IMPEDANCE_DEPTH_M,
    NOMINAL_TOUCH_IMPEDANCE,
)
from saltus.effects.chain import ActuatorChain
from saltus.effects.delay_line import CommandDelay, FeedforwardDelay
from saltus.effects.effect import Drawn, Effect
from saltus.effects.joint_loads import CoulombFriction, ViscousFriction
from saltus.effects.motors import TorqueGain
from saltus.effects.profile import Profile
from saltus.errors import ConfigError
from saltus.robots.robot import Robot
from saltus.terrain.course_law import scale_draw
from saltus.trial import NOMINAL_FEEDFORWARD_DELAY_S

BODY_DRAWS = ColumnNames(
    friction=(),
    payload_kg=(),
    motor_strength=(),
    com_shift=(3,),
    delay_s=(),
    push_aside=(),
    plan_delay_s=(),
)
"""Uniform random numbers of a robot: what `draw_bodies` takes, and the side of a push."""


WIDE = {
    "joint_damping": 10.0, "joint_friction": 10.0, "softness": 1.0, "command_delay_s": 100.0,
    "push_mps": 1.0, "friction": 1.0,
}  # fmt: skip
"""Values that `WideSettings` draws, by their names in `saltus.policy.env.jump_memory.JumpMemory`,
each from one uniform random number; and what makes it about 1 for the critic."""
WIDE_DRAWS = ColumnNames(**dict.fromkeys(WIDE, ()))
SOFT_RUBBER = {
    "contact_time_constant": (NOMINAL_CONTACT_TIME_CONSTANT_S, 0.02),
    "touch_impedance": (NOMINAL_TOUCH_IMPEDANCE, 0.02),
    "impedance_depth": (NOMINAL_IMPEDANCE_DEPTH_M, 0.02),
    "torsion": (LEAST_TURNING_M, 0.02),
    "rolling": (LEAST_TURNING_M, 0.01),
}
"""Contacts that are usual, and those of soft rubber, by fields of `BodyModel`: MuJoCo's default
time constant, about the impedance of Menagerie's Go1, and the frictions of its feet."""


@dataclass(frozen=True, kw_only=True)
class WideSettings:
    """Draws that some robots meet beyond the definition of a trial:
    nothing, unless `share` is more than 0.

    Each value is drawn between the robot's usual one and the one given here, or stays usual, for
    one episode. The density rises from nothing at the usual value.
    """

    share: float = 0.0
    """Probability with which each value is drawn and not usual."""
    growth_msteps: tuple[float, float] = (0.0, 0.0)
    """Million environment steps, of all processes, between which the ranges grow from nothing to
    all."""
    friction: float = 0.3
    """Friction of the ground."""
    joint_damping: float = 0.3
    """[Nm s/rad]."""
    joint_friction: float = 0.4
    """Dry [Nm]."""
    softness: float = 1.0
    """Softness of contacts: 1 is soft rubber, see `SOFT_RUBBER`."""
    command_delay_s: float = 0.015
    """Delay of whole commands."""
    side_push_ns: float = 15.0
    """Largest push sideways [N s]; each such push has the size that was drawn for the episode."""
    side_push_period_s: float = 4.0
    """Mean time between such pushes; all pushes together are as frequent as without them."""

    def __post_init__(self) -> None:
        check_between(self, share=(0.0, 1.0), growth_msteps=(0.0, 1e9), friction=(0.01, 10.0))
        check_between(self, joint_damping=(0.0, 10.0), joint_friction=(0.0, 10.0))
        check_between(
            self, softness=(0.0, 1.0), command_delay_s=(0.0, 0.1), side_push_ns=(0.0, 1e3)
        )
        check_between(self, side_push_period_s=(1e-3, 1e12))
        if self.growth_msteps[0] > self.growth_msteps[1]:
            raise ConfigError(f"growth_msteps = {self.growth_msteps}: the lowest comes first")

    @property
    def contact_dimensions(self) -> int:
        """Dimensions of the robots' contacts:
        6 where drawn soft soles resist being turned and rolled, else 3.
        """
        return 6 if self.share > 0.0 and self.softness > 0.0 else 3

    @property
    def draws(self) -> int:
        """Uniform random numbers that `draw_wide` takes."""
        return len(WIDE) if self.share > 0.0 else 0

    def grown(self, steps: float) -> float:
        """Share of the ranges that is drawn from after so many environment steps
        of all processes.
        """
        first, last = (1e6 * end for end in self.growth_msteps)
        return 1.0 if steps >= last else max(0.0, (steps - first) / (last - first))


@dataclass(frozen=True, kw_only=True)
class RandomisationSettings:
    """Ranges from which a training draws robots and their hardware; a robot's values hold for one
    episode.

    Those of a trial, and what the original left out.
    """

    friction: tuple[float, float] = (0.5, 1.0)  # definition of a trial
    payload_kg: tuple[float, float] = (0.0, 1.5)  # definition of a trial
    motor_strength: tuple[float, float] = (0.9, 1.1)  # definition of a trial
    # +-; original, where it is switched off
    com_shift_m: tuple[float, float, float] = (
        0.046,
        0.03,
        0.03,
    )
    feedforward_delay_s: tuple[float, float] = (0.008, 0.012)
    """Delay of a robot whose profile has the original's 10 ms, +- one tick; another delay moves it,
    see `saltus.trial`."""
    plan_delay_s: tuple[float, float] = (0.0, 0.012)
    """From a state to its plan being obeyed: 3 to 6 ms on two free cores (`saltus bench stack`),
    twice that on busy ones."""
    height_shift_m: tuple[float, float] = (0.08, 0.05)  # +-; paper: along the yaw, and vertical
    """Around that of the profile, whose own ranges widen it."""
    height_noise_m: float = (
        0.01  # +-, each height and step: a predictor's errors vary within an episode
    )
    pitch_torque_nm: float = 4.0  # +-; original: on the trunk, redrawn every 0.5 s
    torque_period_s: float = 0.5  # original
    push_mps: float = 0.3  # +-, forward and sideways: a change of velocity that a bound absorbs
    push_period_s: float = 2.0  # mean time between pushes
    start_x_m: float = 0.2  # +-; definition of a trial
    start_yaw_rad: float = 0.1  # +-; twice that of a trial
    start_joint_rad: float = 0.05  # +-; how exactly a robot stands up
    wide: WideSettings = field(default_factory=WideSettings)

    def __post_init__(self) -> None:
        period, spread = (1e-3, 1e12), (0.0, 10.0)
        check_between(self, friction=spread, payload_kg=(0.0, 50.0), motor_strength=(0.01, 10.0))
        check_between(
            self, com_shift_m=(0.0, 1.0), feedforward_delay_s=(0.0, 0.1), plan_delay_s=(0.0, 0.1)
        )
        check_between(
            self, height_shift_m=(0.0, 1.0), height_noise_m=(0.0, 1.0), pitch_torque_nm=(0.0, 1e3)
        )
        check_between(self, torque_period_s=period, push_period_s=period, push_mps=spread)
        check_between(self, start_x_m=spread, start_yaw_rad=spread, start_joint_rad=spread)
        for name in (
            "friction",
            "payload_kg",
            "motor_strength",
            "feedforward_delay_s",
            "plan_delay_s",
        ):
            low, high = getattr(self, name)
            if low > high:
                raise ConfigError(f"{name} = {(low, high)}: the lowest comes first")


def draw_bodies(config: RandomisationSettings, draws: Array) -> dict[str, Array]:
    """Makes bodies from uniform numbers in [0, 1), shape (n, BODY_DRAWS.count).

    Returns:
        Fields of `saltus.policy.env.jump_memory.JumpMemory`: each of shape (n,), but the centre of
        mass (n, 3).
    """
    drawn = BODY_DRAWS.of(draws)
    com = [
        (2.0 * drawn.com_shift[:, axis] - 1.0) * limit
        for axis, limit in enumerate(config.com_shift_m)
    ]
    return {
        "friction": scale_draw(config.friction, drawn.friction),
        "payload_kg": scale_draw(config.payload_kg, drawn.payload_kg),
        "motor_strength": scale_draw(config.motor_strength, drawn.motor_strength),
        "com_shift": namespace(draws).stack(com, -1),
        "delay_s": scale_draw(config.feedforward_delay_s, drawn.delay_s),
        "plan_delay_s": scale_draw(config.plan_delay_s, drawn.plan_delay_s),
    }


def draw_wide(
    config: RandomisationSettings, usual_friction: Array, mass_kg: float, grown: Array, draws: Array
) -> dict[str, Array]:
    """Makes what `WIDE` names, each of shape (n,).

    Args:
        config: The ranges.
        usual_friction: What was drawn for the ground, shape (n,).
        mass_kg: Of the robot, which says what speed a push gives.
        grown: Share of the ranges to draw from, shape ().
        draws: Uniform in [0, 1), shape (n, len(WIDE)).
    """
    wide, xp = config.wide, namespace(draws)
    # Below `share` a number is, stretched, another uniform one; its root makes the greater values
    # the more frequent.
    strength = grown * xp.where(
        draws < wide.share, xp.sqrt(draws / wide.share), xp.zeros_like(draws)
    )
    part = WIDE_DRAWS.of(strength)
    return {
        "friction": usual_friction + (wide.friction - usual_friction) * part.friction,
        "joint_damping": wide.joint_damping * part.joint_damping,
        "joint_friction": wide.joint_friction * part.joint_friction,
        "softness": wide.softness * part.softness,
        "command_delay_s": wide.command_delay_s * part.command_delay_s,
        "push_mps": wide.side_push_ns / mass_kg * part.push_mps,
    }


def training_drives(
    robot: Robot, profile: Profile, config: RandomisationSettings, memory: Any
) -> ActuatorChain:
    """The chain of all robots.

    Values that are drawn for them are read from the fields of `memory` at every use.
    """
    wide, m = config.wide, memory
    effects: dict[str, Effect] = {effect.name: effect.fitted(robot) for effect in profile.actuator}

    def draw(
        kind: type[Effect], parameter: str, around: Callable[[Array], Array], beyond: float = 0.0
    ) -> None:
        known = effects.get(kind.name, kind())
        greatest = float(np.max(getattr(known, parameter))) + beyond
        drawn = Drawn(read=lambda array: around(known.value(parameter, array)), greatest=greatest)
        effects[kind.name] = replace(known, **{parameter: drawn})

    draw(TorqueGain, "gain", lambda gain: gain * m.motor_strength[:, None])
    if FeedforwardDelay.name in effects:
        beyond = config.feedforward_delay_s[1] - NOMINAL_FEEDFORWARD_DELAY_S
        draw(
            FeedforwardDelay,
            "delay",
            lambda delay: delay - NOMINAL_FEEDFORWARD_DELAY_S + m.delay_s[:, None],
            beyond,
        )
    if wide.share > 0.0:
        draw(
            CommandDelay,
            "delay",
            lambda delay: delay + m.command_delay_s[:, None],
            wide.command_delay_s,
        )
        draw(CoulombFriction, "torque", lambda torque: torque + m.joint_friction[:, None])
        draw(ViscousFriction, "coefficient", lambda damping: damping + m.joint_damping[:, None])
    return ActuatorChain(tuple(effects.values()))
