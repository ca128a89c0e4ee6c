"""A battery that empties and a motor that warms lose torque as a run goes on."""

from dataclasses import dataclass, field, replace

from saltus.arrays import Array, namespace
from saltus.effects.effect import Effect, Values, parameter
from saltus.effects.signals import Drive


@dataclass(frozen=True, kw_only=True)
class BatterySag(Effect[Drive], name="battery_sag", site="torque"):
    """Gain that falls linearly from 1 at time 0 to 1 - `loss_at_end` at `duration_s`, and stays there."""

    # 5 to 20 % over a run
    loss_at_end: Values = parameter(unit="", null=0.0, low=-1.0, high=1.0, sought=(0.0, 0.7), per_joint=True)
    duration_s: float = field(default=30.0, metadata={"unit": "s", "low": 0.1, "high": 1e5, "per_joint": False})
    """Length of the run; not an effect in itself, so without null value."""

    def apply(self, signal: Drive, time_s: Array, state: None) -> tuple[Drive, None]:
        """Scales the torque."""
        del state
        gone = namespace(time_s).clip(time_s / self.duration_s, 0.0, 1.0)
        lost = (gone if isinstance(gone, float) else gone[..., None]) * self.value("loss_at_end", signal.torque)
        return replace(signal, torque=signal.torque * (1.0 - lost)), None
