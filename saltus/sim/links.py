"""Mass, centre of mass and inertia of the Go1's links.

Masses and the trunk's inertia are Unitree's published numbers. The published sheet at hand holds no centres of mass
and inertia tensors of the leg links; they are derived here from the published geometry: each link is a uniform body
of the shape and mass given, and the rotor in it (0.089 kg) is a point at the axis that its motor sits on.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus import go1

ROTOR_MASS = 0.089  # unitree_ros
FOOT_MASS = 0.06  # unitree_ros
HIP_RADIUS, HIP_LENGTH = 0.046, 0.04  # unitree_ros, collision cylinder along y
THIGH_WIDTH, THIGH_DEPTH = 0.0245, 0.034  # unitree_ros, collision box, y and x
CALF_WIDTH = 0.016  # unitree_ros, collision box, y and x
TRUNK_COM = np.array([0.0223, 0.002, -0.0005])  # unitree_ros
TRUNK_INERTIA = np.diag([0.01681, 0.06301, 0.07165])  # unitree_ros, about the centre of mass


@dataclass(frozen=True, kw_only=True, eq=False)
class Inertia:
    """Inertial properties of a rigid body, in the frame of its link."""

    mass: float
    """[kg]."""
    com: NDArray[np.float64]
    """Centre of mass [m], shape (3,)."""
    tensor: NDArray[np.float64]
    """About the centre of mass, in the link's axes [kg m^2], shape (3, 3)."""


def trunk() -> Inertia:
    """The trunk with everything in it."""
    return Inertia(mass=go1.TRUNK_MASS, com=TRUNK_COM, tensor=TRUNK_INERTIA)


def hip(side: float) -> Inertia:
    """The abduction link: a cylinder midway between abduction and thigh axis, the thigh motor's rotor on the latter.

    Args:
        side: +1 for a left leg, -1 for a right leg.
    """
    mass = go1.HIP_MASS - ROTOR_MASS
    across = mass * (3.0 * HIP_RADIUS**2 + HIP_LENGTH**2) / 12.0
    tensor = np.diag([across, 0.5 * mass * HIP_RADIUS**2, across])
    body = Inertia(mass=mass, com=np.array([0.0, 0.5 * side * go1.ABDUCTION_LENGTH, 0.0]), tensor=tensor)
    return _joined(body, _point(ROTOR_MASS, np.array([0.0, side * go1.ABDUCTION_LENGTH, 0.0])))


def thigh() -> Inertia:
    """The thigh: a box from thigh to knee axis, the calf motor's rotor at the thigh axis."""
    body = _box(go1.THIGH_MASS - ROTOR_MASS, np.array([THIGH_DEPTH, THIGH_WIDTH, go1.THIGH_LENGTH]))
    return _joined(body, _point(ROTOR_MASS, np.zeros(3)))


def calf() -> Inertia:
    """The calf: a box from the knee axis to the centre of the foot, and the foot, a ball."""
    body = _box(go1.CALF_MASS - FOOT_MASS, np.array([CALF_WIDTH, CALF_WIDTH, go1.CALF_LENGTH]))
    ball = 0.4 * FOOT_MASS * go1.FOOT_RADIUS**2 * np.eye(3)
    foot = Inertia(mass=FOOT_MASS, com=np.array([0.0, 0.0, -go1.CALF_LENGTH]), tensor=ball)
    return _joined(body, foot)


def _box(mass: float, size: NDArray[np.float64]) -> Inertia:
    """A uniform box that hangs from the link's origin."""
    square = size**2
    tensor = mass / 12.0 * np.diag(square.sum() - square)
    return Inertia(mass=mass, com=np.array([0.0, 0.0, -0.5 * size[2]]), tensor=tensor)


def _point(mass: float, position: NDArray[np.float64]) -> Inertia:
    return Inertia(mass=mass, com=position, tensor=np.zeros((3, 3)))


def _joined(first: Inertia, second: Inertia) -> Inertia:
    """Two bodies as one, by the parallel-axis theorem."""
    mass = first.mass + second.mass
    com = (first.mass * first.com + second.mass * second.com) / mass
    tensor = np.zeros((3, 3))
    for body in (first, second):
        r = body.com - com
        tensor += body.tensor + body.mass * (r @ r * np.eye(3) - np.outer(r, r))
    return Inertia(mass=mass, com=com, tensor=tensor)
