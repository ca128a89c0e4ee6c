"""Settings of the robocentric map: what its law, its network and their training agree on."""

from dataclasses import dataclass

from saltus.config import TomlValue, check_between


@dataclass(frozen=True, kw_only=True)
class MapSettings(TomlValue):
    """A square window of cells around the base, along the odometry's axes,
    and how measurements are fused in it.

    Raises:
        ConfigError: a number that no map has; the message names it.
    """

    cell_m: float = 0.04
    """Side of the cells by which the window moves, and on which the network works [m]."""
    cells: int = 64
    """Along each side of the window, a multiple of 8: 2.56 m hold a scan of 1.6 x 1.0 m at any
    yaw."""
    sub: int = 2
    """Heights along each side of a cell: 2 cm are as fine as a point's own error asks
    (prototype: 4 cm lose 9 mm)."""
    depth_noise: float = 0.004
    """Standard deviation of depth at 1 m [m]; it grows with its square. A D435i at 424 x 240 has
    0.0076, smoothed."""
    point_noise_m: float = 0.003
    """Error of a point, however near it is [m]."""
    shared_noise: float = 0.3
    """Share of a point's variance that all points of a cell share, so that more of them do not
    make it smaller."""
    drift: float = 0.02
    """By how much a remembered height gets worse in a second [m]; variances add up."""
    surprise: float = 0.1
    """Share of the squared difference between a new height and the map's that is added to the
    map's variance: near edges and after drift the newer one is right."""
    least_m: float = 0.004
    """No height is surer than this [m]."""
    matching: bool = True
    """Correct the odometry's drift by matching new points to the map."""
    looks: int = 2
    """Number of times one image is matched, each time from where the look before put it."""
    step_m: float = 0.004
    """Standard deviation of the drift from one image to the next, as matching expects it [m]."""
    tilt_rad: float = 0.004
    """Standard deviation of an image's error of attitude that its neighbours do not share [rad]."""
    independent: float = 0.1
    """Share of the matched cells whose errors count as independent."""
    sideways_m: float = 0.006
    """Standard deviation of where in its neighbourhood a cell was hit [m]: matching trusts heights
    on slopes less by it. The classical map is 19.9, 19.5, 19.3 and 19.3 mm off with 0, 6, 12 and
    18 mm, and 24.6, 24.2, 24.4 and 24.7 mm where odometry is bad."""
    matched_slope: float = 5.0
    """Matching leaves cells out where the map is steeper; slopes are measured up to 4.3, so this is
    none. At cliffs `gate_m` keeps those cells whose height changed little, and the slope is that of
    where they happened to be hit: an image moves the pose forward and down on stairs."""
    gate_m: float = 0.06
    """A new height that is farther than this from the map is an edge, not drift [m]."""
    foot_gain: float = 0.4
    """Share of the mean distance between standing feet and map that one image removes."""
    foot_noise_m: float = 0.005
    """Standard deviation of a standing foot's height [m]."""
    body_height_noise_m: float = 0.05
    """How well a robot knows how high above the ground it usually stands [m]."""

    def __post_init__(self) -> None:
        check_between(
            self, cell_m=(0.005, 0.5), cells=(8, 512), sub=(1, 8), depth_noise=(0.0, 0.1),
            point_noise_m=(1e-4, 0.1),
            shared_noise=(0.0, 1.0), drift=(0.0, 1.0), surprise=(0.0, 1.0),
            least_m=(1e-4, 0.1), looks=(1, 16), step_m=(1e-5, 0.1), tilt_rad=(1e-6, 0.1),
            independent=(1e-4, 1.0), sideways_m=(0.0, 0.1), matched_slope=(0.0, 100.0),
            gate_m=(0.001, 1.0), foot_gain=(0.0, 1.0), foot_noise_m=(1e-4, 0.1),
            body_height_noise_m=(1e-3, 1.0),
        )  # fmt: skip

    @property
    def side(self) -> int:
        """Heights along each side of the window."""
        return self.cells * self.sub

    @property
    def fine_m(self) -> float:
        """Distance of neighbouring heights [m]."""
        return self.cell_m / self.sub
