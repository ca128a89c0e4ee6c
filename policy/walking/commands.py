"""Velocity commands of trainings: drawn, and as they hold now.

A command is velocity ahead and to the left [m/s] and turning to the left [rad/s], in the frame of
the base turned level. On wide ground it leads in any direction; on ground that leads along x the
turning follows from a heading.
"""

from saltus.arrays import Array, ColumnNames, Places, Scalars, namespace
from saltus.policy.walking.settings import VelocityCommandSettings

DRAWS = ColumnNames(when=(), ahead=(), aside=(), turn=(), standing=())
"""Uniform random numbers of a command."""


def draw_command(
    config: VelocityCommandSettings, wide: Array, draws: Array
) -> tuple[Places, Array]:
    """New commands.

    Args:
        config: Their ranges.
        wide: Robots on wide ground, bool, shape (n,).
        draws: Uniform in [0, 1), shape (n, DRAWS.count).

    Returns:
        Velocity ahead and aside, and the turning on wide ground or the heading on other ground,
        shape (n, 3); and who is to stand, bool, shape (n,).
    """
    xp, d = namespace(draws), DRAWS.of(draws)

    def stretched(low: float, high: float, draw: Array) -> Array:
        return low + (high - low) * draw

    ahead = xp.where(
        wide, stretched(*config.ahead_mps, d.ahead), stretched(*config.along_mps, d.ahead)
    )
    sideways, other = 2.0 * d.aside - 1.0, 2.0 * d.turn - 1.0
    aside = xp.where(wide, config.aside_mps * sideways, config.along_aside_mps * sideways)
    turn = xp.where(wide, config.turn_rps * other, config.heading_rad * other)
    return xp.stack([ahead, aside, turn], -1), d.standing < config.standing


def command_now(
    config: VelocityCommandSettings,
    drawn: Places,
    wide: Array,
    standing: Array,
    y: Scalars,
    yaw: Scalars,
) -> Places:
    """The command of this instant: nothing for who stands, elsewhere a turning to the heading.

    On wide ground the turning is what was drawn.

    Args:
        config: Gains.
        drawn: Of `draw_command`, shape (n, 3).
        wide: Robots on wide ground, bool, shape (n,).
        standing: Who is to stand, bool, shape (n,).
        y: Distance of the base to the left of the ground's middle [m], shape (n,).
        yaw: Of the base [rad], shape (n,).
    """
    xp = namespace(drawn)
    heading = xp.clip(drawn[:, 2] - config.middle_gain * y, -1.0, 1.0)
    error = xp.remainder(heading - yaw + xp.pi, 2.0 * xp.pi) - xp.pi
    held = xp.clip(config.heading_gain * error, -config.turn_rps, config.turn_rps)
    turn = xp.where(wide, drawn[:, 2], held)
    command = xp.stack([drawn[:, 0], drawn[:, 1], turn], -1)
    return xp.where(standing[:, None], xp.zeros_like(command), command)
