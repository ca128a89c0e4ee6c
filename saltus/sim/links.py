"""Mass, centre of mass and inertia of the Go1's links.

Unitree's published robot description (newer version), the rotor of each motor (0.089 kg) lumped into the link that
carries it; principal moments and axes as MuJoCo's model collection derives them from it. The four legs mirror each
other in the planes of the trunk.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus import go1
from saltus.rotations import rotation_matrix

HIP_RADIUS, HIP_LENGTH = 0.046, 0.04  # unitree_ros, collision cylinder along y


@dataclass(frozen=True, kw_only=True, eq=False)
class Inertia:
    """Inertial properties of a rigid body, in the frame of its link."""

    mass: float
    """[kg]."""
    com: NDArray[np.float64]
    """Centre of mass [m], shape (3,)."""
    tensor: NDArray[np.float64]
    """About the centre of mass, in the link's axes [kg m^2], shape (3, 3)."""

    def mirrored(self, x: float, y: float) -> "Inertia":
        """The body mirrored in x, in y, in both or not: factors +1 or -1 [-]."""
        mirror = np.diag([x, y, 1.0])
        return Inertia(mass=self.mass, com=mirror @ self.com, tensor=mirror @ self.tensor @ mirror)


def trunk() -> Inertia:
    """The trunk with everything in it."""
    return _principal(
        go1.TRUNK_MASS,
        com=(0.0223, 0.002, -0.0005),
        moments=(0.0716565, 0.0630105, 0.0168101),
        axes=(-0.00342088, 0.705204, 0.000106698, 0.708996),
    )


def hip(leg: int) -> Inertia:
    """The abduction link of a leg, with the rotor of the thigh motor."""
    front_right = _principal(
        go1.HIP_MASS,
        com=(-0.0049166, 0.00762615, -8.865e-05),
        moments=(0.000734064, 0.000468438, 0.000398719),
        axes=(0.507341, 0.514169, 0.495027, 0.482891),
    )
    return front_right.mirrored(float(np.sign(go1.HIP_ANCHOR[leg, 0])), -float(go1.SIDE[leg]))


def thigh(leg: int) -> Inertia:
    """The thigh of a leg, with the rotor of the calf motor."""
    right = _principal(
        go1.THIGH_MASS,
        com=(-0.00304722, 0.019315, -0.0305004),
        moments=(0.00478717, 0.00460903, 0.000709268),
        axes=(0.65243, -0.0272313, 0.0775126, 0.753383),
    )
    return right.mirrored(1.0, -float(go1.SIDE[leg]))


def calf() -> Inertia:
    """The calf with the foot; the same on both sides."""
    return _principal(
        go1.CALF_MASS,
        com=(0.00429862, 0.000976676, -0.146197),
        moments=(0.00149767, 0.00148468, 3.58427e-05),
        axes=(0.691246, 0.00357467, 0.00511118, 0.722592),
    )


def _principal(mass: float, com: tuple[float, ...], moments: tuple[float, ...], axes: tuple[float, ...]) -> Inertia:
    """A body from its principal moments [kg m^2] and the rotation (w, x, y, z) of their axes into the link's."""
    quaternion = np.array(axes)
    rotation = np.asarray(rotation_matrix(quaternion / np.linalg.norm(quaternion)))
    return Inertia(mass=mass, com=np.array(com), tensor=rotation @ np.diag(moments) @ rotation.T)
