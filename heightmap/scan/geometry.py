"""The classical map's own answer: its heights, filled,
with the half-widths that its variances give.
"""

from saltus.arrays import Array, namespace
from saltus.heightmap.scan.elevation import ElevationMap, MapContext, is_known
from saltus.heightmap.scan.network_inputs import OLDEST_S, MapHeights
from saltus.heightmap.scan.settings import MapSettings

INTERVAL90 = 1.645
"""Half of the 90 % interval of a normal distribution, in standard deviations."""
GUESSED_M = 0.15
"""Half-width of a height that was filled [m]."""


def geometric_heights(
    state: ElevationMap, around: MapContext, now_s: Array, settings: MapSettings
) -> MapHeights:
    """Heights of the map's cells without a network; `now_s` has shape (batch,)."""
    xp = namespace(state.height)
    age = (now_s[:, None, None] - state.seen_s).clip(0.0, OLDEST_S)
    deviation = (state.variance + (settings.drift * age) ** 2) ** 0.5
    return MapHeights(around.filled, xp.where(is_known(state), INTERVAL90 * deviation, GUESSED_M))
