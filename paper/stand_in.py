"""A simulated robot that stands in for the real one:
what none of the ablations' trainings draws, drawn once.

Its seed was named before any policy had met it. It is the same for all systems.
"""

import numpy as np

from saltus.effects.body import SoftFeet
from saltus.effects.camera import CameraHeight, CameraPitch
from saltus.effects.effect import Effect
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.imu import ImuBias
from saltus.effects.joint_loads import Armature, CoulombFriction, ViscousFriction
from saltus.effects.motors import ActuatorLag, TorqueGain
from saltus.effects.profile import SHIPPED, Profile, load_profile
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT

STAND_IN_SEED = 20261122
"""A day."""


def stand_in(seed: int = STAND_IN_SEED) -> Profile:
    """The shipped profile with effects that the ablations' policies
    and the shipped predictor have not been drawn.
    """
    rng = np.random.default_rng(seed)
    side = rng.choice([-1.0, 1.0], 6)

    def drawn(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 5)

    # trainings: 0.9 to 1.1, of all alike
    gains = tuple(round(float(gain), 4) for gain in rng.uniform(0.80, 0.89, 12))
    effects: tuple[Effect, ...] = (
        ActuatorLag(time_constant=drawn(0.002, 0.008)),  # what is published of such drives
        CoulombFriction(
            torque=drawn(0.1, 0.4)
        ),  # to what the wide draws of the shipped policy end at
        ViscousFriction(coefficient=drawn(0.05, 0.3)),  # the same
        Armature(added=drawn(0.0005, 0.002)),  # up to that of the rotors of a hip
        TorqueGain(gain=gains),
        SoftFeet(torsion=drawn(0.005, 0.02), rolling=drawn(0.002, 0.01)),  # up to soft rubber's
        ImuBias(  # gyroscopes of this class, and mounts
            gyro_x=side[0] * drawn(0.01, 0.05),
            gyro_y=side[1] * drawn(0.01, 0.05),
            roll=side[2] * drawn(0.009, 0.035),
            pitch=side[3] * drawn(0.009, 0.035),
        ),
        CameraLatency(latency=drawn(0.115, 0.14)),  # the predictor has seen 110 ms at most
        CameraPitch(offset=side[4] * drawn(0.05, 0.08)),  # it has seen 0.044 rad
        CameraHeight(offset=side[5] * drawn(0.022, 0.035)),  # and 0.02 m
    )
    return load_profile(SHIPPED, load_robot(DEFAULT_ROBOT)).having(*effects)
