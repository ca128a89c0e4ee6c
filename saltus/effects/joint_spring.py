"""A spring or a cable that pulls at a joint beside its drive."""

from dataclasses import dataclass, replace

from saltus.arrays import Array
from saltus.constants import PHYSICS_DT
from saltus.effects.effect import Effect, Values, parameter, period
from saltus.effects.signals import Drive


@dataclass(frozen=True, kw_only=True)
class JointSpring(Effect[Drive], name="joint_spring", site="torque"):
    """A spring or a cable pulls with `torque` at the joint's zero angle, and by `stiffness` less with each rad.

    A `stiffness` of 0 is a pull that stays the same at all angles. The drive knows nothing of it.
    """

    # cables held 0.15 to 0.25 Nm at the joints of a Go2
    torque: Values = parameter(unit="Nm", null=0.0, low=-150.0, high=150.0, sought=(-10.0, 10.0), per_joint=True)
    stiffness: Values = parameter(unit="Nm/rad", null=0.0, low=0.0, high=50.0, sought=(0.0, 20.0), per_joint=True)
    dt_s: float = period(PHYSICS_DT)
    """Period of the torque."""

    def apply(self, signal: Drive, time_s: Array, state: None) -> tuple[Drive, None]:
        """Adds the pull at the angle halfway through the coming period: an older one would feed the joint energy."""
        del time_s, state
        pull, stiffness = (self.value(name, signal.torque) for name in ("torque", "stiffness"))
        halfway = signal.position + 0.5 * self.dt_s * signal.velocity
        return replace(signal, torque=signal.torque + (pull - stiffness * halfway)), None
