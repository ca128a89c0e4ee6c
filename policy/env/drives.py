"""The drives of a training: the effects of a profile,
around whose values each robot gets its own.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from saltus.arrays import Array
from saltus.effects.chain import ActuatorChain
from saltus.effects.delay_line import CommandDelay, FeedforwardDelay
from saltus.effects.effect import Drawn, Effect
from saltus.effects.joint_loads import CoulombFriction, ViscousFriction
from saltus.effects.motors import TorqueGain
from saltus.effects.profile import Profile
from saltus.policy.env.randomisation import RandomisationConfig
from saltus.robots.robot import Robot
from saltus.trial import NOMINAL_FEEDFORWARD_DELAY_S


def training_drives(
    robot: Robot, profile: Profile, config: RandomisationConfig, memory: Any
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
