"""The robot that the logs claim, as a table of its own
(unitree_ros, rotor masses lumped into the links).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]

LEGS = ("FR", "FL", "RR", "RL")
KINDS = ("hip", "thigh", "calf")
JOINTS = tuple(f"{leg}_{kind}" for leg in LEGS for kind in KINDS)
SIDE = (-1.0, 1.0, -1.0, 1.0)
FRONT = (1.0, 1.0, -1.0, -1.0)
GRAVITY = 9.81

ANCHOR = (0.1881, 0.04675)  # abduction axis from the trunk's centre, ahead and aside [m]
ABDUCTION, THIGH, CALF = 0.08, 0.213, 0.213  # [m]
FOOT_RADIUS = 0.02

ARMATURE = np.tile(1.118e-4 * np.array([6.33, 6.33, 9.495]) ** 2, 4)
TORQUE_LIMIT = np.tile([23.7, 23.7, 35.55], 4)
LOWER = np.tile([-0.863, -0.686, -2.818], 4)
UPPER = np.tile([0.863, 4.501, -0.888], 4)
STAND = np.tile([0.0, 0.9, -1.8], 4)
STAND_HEIGHT = 0.268

TRUNK_MASS = 5.204
TRUNK_CENTRE = (0.0223, 0.002, -0.0005)
TRUNK_QUATERNION = (-0.00342088, 0.705204, 0.000106698, 0.708996)
TRUNK_INERTIA = (0.0716565, 0.0630105, 0.0168101)


@dataclass(frozen=True)
class Link:
    """A link of the front left leg; the other legs mirror it."""

    mass: float
    centre: tuple[float, float, float]
    """Centre of mass in the frame of the link's joint [m]."""
    quaternion: tuple[float, float, float, float]
    """Principal axes of inertia in the frame of the link."""
    inertia: tuple[float, float, float]
    """Principal moments [kg m^2]."""


HIP = Link(
    0.68,
    (-0.0049166, -0.00762615, -8.865e-05),
    (0.482891, 0.495027, 0.514169, 0.507341),
    (0.000734064, 0.000468438, 0.000398719),
)
THIGH_LINK = Link(
    1.009,
    (-0.00304722, -0.019315, -0.0305004),
    (0.753383, 0.0775126, -0.0272313, 0.65243),
    (0.00478717, 0.00460903, 0.000709268),
)
CALF_LINK = Link(
    0.195862,
    (0.00429862, 0.000976676, -0.146197),
    (0.691246, 0.00357467, 0.00511118, 0.722592),
    (0.00149767, 0.00148468, 3.58427e-05),
)


def rotation(quaternion: tuple[float, float, float, float] | Floats) -> Floats:
    """Rotation matrix of a quaternion w, x, y, z, shape (3, 3);
    arrays of shape (..., 4) give (..., 3, 3).
    """
    w, x, y, z = np.moveaxis(
        np.asarray(quaternion, dtype=float) / np.linalg.norm(quaternion, axis=-1)[..., None], -1, 0
    )
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def leg_links(leg: int) -> tuple[Floats, Floats, Floats]:
    """Masses (3,), centres (3, 3) and inertia tensors about the centres (3, 3, 3) of a leg,
    in its links' frames.
    """
    masses, centres, inertias = [], [], []
    for number, link in enumerate((HIP, THIGH_LINK, CALF_LINK)):
        axes = rotation(link.quaternion)
        # the hip link is turned about at the rear, hip and thigh are mirrored at the right, the
        # calf is the same
        front = FRONT[leg] if number == 0 else 1.0
        side = SIDE[leg] if number < 2 else 1.0
        mirror = np.array([front, side, 1.0])
        masses.append(link.mass)
        centres.append(mirror * link.centre)
        inertias.append(np.outer(mirror, mirror) * (axes @ np.diag(link.inertia) @ axes.T))
    return np.array(masses), np.array(centres), np.array(inertias)
