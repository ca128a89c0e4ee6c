"""Numbers that an MJCF cannot say and that nobody has given:
those of a robot whose controller is tuned, scaled.

Two robots that move alike in proportion to their size have the same accelerations. With legs
`length` times as long and `mass` times the mass, times scale as the square root of length, forces
as mass, kp as mass x length, and kd as kp x time. The reference has the settings of the authors of
"Agile Continuous Jumping in Discontinuous Terrains".
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from saltus.arrays import Floats
from saltus.robots.robot import Gains, Robot

LEG_LENGTH, MASS = 0.426, 12.743448  # of the reference [m], [kg]
# Of what its controller takes for its inertia about x, y, z to what it is
INERTIA_FACTOR = (
    1.6,
    1.32,
    1.24,
)
STAND_SHARE = 0.62  # height of a standing hip above its foot, as a share of the leg
HIP_TO_CAMERA, CAMERA_Z, CAMERA_PITCH = 0.084, 0.092, 0.52  # [m], [m], [rad]

Numbers = TypeVar("Numbers", bound=Any)


@dataclass(frozen=True, kw_only=True)
class Similarity:
    """A robot's size over that of the reference robot, by which lengths, times and forces of laws
    are scaled.
    """

    length: float
    mass: float

    @classmethod
    def of(cls, leg_length: float, mass: float) -> "Similarity":
        """Similarity of a robot with legs of that length [m] and that mass [kg]."""
        return cls(length=leg_length / LEG_LENGTH, mass=mass / MASS)

    @classmethod
    def of_robot(cls, robot: Robot) -> "Similarity":
        """Similarity of a robot."""
        return cls.of(robot.leg_length, robot.mass)

    @property
    def time(self) -> float:
        """Ratio of times."""
        return math.sqrt(self.length)

    def scaled(
        self,
        numbers: Numbers,
        lengths: Iterable[str],
        speeds: Iterable[str] = (),
        rates: Iterable[str] = (),
    ) -> Numbers:
        """The reference's numbers for this robot:
        by name what grows as lengths, speeds and rates do.
        """
        changes = {name: getattr(numbers, name) * self.length for name in lengths}
        changes |= {name: getattr(numbers, name) * (self.length / self.time) for name in speeds}
        changes |= {name: getattr(numbers, name) / self.time for name in rates}
        return replace(numbers, **changes)

    @property
    def gains(self) -> Gains:
        """Gains of the leg controller."""
        kp = self.mass * self.length
        kd = kp * self.time
        return Gains(
            stand_kp=100.0 * kp,
            stand_kd=3.0 * kd,
            landing_kp=60.0 * kp,
            landing_kd=4.0 * kd,
            swing_kp=30.0 * kp,
            swing_kd=1.0 * kd,
            stance_kd=1.0 * kd,
            damp_kd=3.0 * kd,
        )

    @property
    def swing_foot_z(self) -> Floats:
        """[m], shape (2,)."""
        return np.array([-0.4, 0.1]) * self.length

    @property
    def landing_reach(self) -> Floats:
        """[m], shape (2,)."""
        return np.array([0.15, 0.08]) * self.length

    @property
    def foot_force(self) -> Floats:
        """[N], shape (2,)."""
        return np.array([10.0, 130.0]) * self.mass

    def camera_position(self, hip_x: float) -> Floats:
        """Place of a camera in front of the trunk, a little above it [m], shape (3,)."""
        return np.array([hip_x + HIP_TO_CAMERA * self.length, 0.0, CAMERA_Z * self.length])
