"""What differs from episode to episode of a training besides the terrain."""

from dataclasses import dataclass

from saltus.arrays import Array, namespace
from saltus.config import check_between
from saltus.errors import ConfigError

BODY_DRAWS = 9
"""Uniform random numbers that `draw_bodies` takes."""


@dataclass(frozen=True, kw_only=True)
class RandomisationConfig:
    """Ranges; a robot's values hold for one episode. Those of a trial, and what the original left out."""

    friction: tuple[float, float] = (0.5, 1.0)  # definition of a trial
    payload_kg: tuple[float, float] = (0.0, 1.5)  # definition of a trial
    motor_strength: tuple[float, float] = (0.9, 1.1)  # definition of a trial
    com_shift_m: tuple[float, float, float] = (0.046, 0.03, 0.03)  # +-; original, where it is switched off
    feedforward_delay_s: tuple[float, float] = (0.008, 0.012)  # 10 ms measured by the original; +- one tick
    plan_delay_s: tuple[float, float] = (0.0, 0.012)
    """From a state to its plan being obeyed: 3 to 6 ms on two free cores (`saltus bench stack`), twice that on busy
    ones."""
    height_shift_m: tuple[float, float] = (0.08, 0.05)  # +-; paper: along the yaw, and vertical
    height_noise_m: float = 0.01  # +-, each height and step: a predictor's errors vary within an episode
    pitch_torque_nm: float = 4.0  # +-; original: on the trunk, redrawn every 0.5 s
    torque_period_s: float = 0.5  # original
    push_mps: float = 0.3  # +-, forward and sideways: a change of velocity that a bound absorbs
    push_period_s: float = 2.0  # mean time between pushes
    start_x_m: float = 0.2  # +-; definition of a trial
    start_yaw_rad: float = 0.1  # +-; twice that of a trial
    start_joint_rad: float = 0.05  # +-; how exactly a robot stands up

    def __post_init__(self) -> None:
        period, spread = (1e-3, 1e12), (0.0, 10.0)
        check_between(self, friction=spread, payload_kg=(0.0, 50.0), motor_strength=(0.01, 10.0))
        check_between(self, com_shift_m=(0.0, 1.0), feedforward_delay_s=(0.0, 0.1), plan_delay_s=(0.0, 0.1))
        check_between(self, height_shift_m=(0.0, 1.0), height_noise_m=(0.0, 1.0), pitch_torque_nm=(0.0, 1e3))
        check_between(self, torque_period_s=period, push_period_s=period, push_mps=spread)
        check_between(self, start_x_m=spread, start_yaw_rad=spread, start_joint_rad=spread)
        for name in ("friction", "payload_kg", "motor_strength", "feedforward_delay_s", "plan_delay_s"):
            low, high = getattr(self, name)
            if low > high:
                raise ConfigError(f"{name} = {(low, high)}: the lowest comes first")


@dataclass(frozen=True, kw_only=True, eq=False)
class Bodies:
    """One value for each robot."""

    friction: Array
    """Shape (n,)."""
    payload_kg: Array
    """Shape (n,)."""
    motor_strength: Array
    """Shape (n,)."""
    com_shift: Array
    """[m], shape (n, 3)."""
    delay_s: Array
    """Of feed-forward torque, shape (n,)."""
    plan_delay_s: Array
    """Shape (n,)."""


def draw_bodies(config: RandomisationConfig, draws: Array) -> Bodies:
    """Makes bodies from uniform numbers in [0, 1), shape (n, BODY_DRAWS)."""
    xp = namespace(draws)
    com = [(2.0 * draws[:, 3 + axis] - 1.0) * limit for axis, limit in enumerate(config.com_shift_m)]
    return Bodies(
        friction=between(config.friction, draws[:, 0]),
        payload_kg=between(config.payload_kg, draws[:, 1]),
        motor_strength=between(config.motor_strength, draws[:, 2]),
        com_shift=xp.stack(com, -1),
        delay_s=between(config.feedforward_delay_s, draws[:, 6]),
        plan_delay_s=between(config.plan_delay_s, draws[:, 8]),
    )


def between(bounds: tuple[float, float], draw: Array) -> Array:
    """A uniform number in [0, 1) stretched over `bounds`."""
    return bounds[0] + (bounds[1] - bounds[0]) * draw
