"""When each place of the ground was last seen."""

import math

import torch
from torch import Tensor
from torch.nn import functional

from saltus.heightmap.scan.training.flights import FlightImage
from saltus.heightmap.scan.training.settings import FlightSettings

CELL_M = 0.02
"""Cell of the raster of views; with its neighbours a cell reaches 3 cm around its middle [m]."""


class LastSeen:
    """When each place of the ground was last seen: a raster over the patch of each robot with the
    time of the last image with a point there.
    """

    def __init__(self, robots: int, settings: FlightSettings, like: Tensor) -> None:
        self._side = round(settings.patch_m / CELL_M)
        self._half = 0.5 * settings.patch_m
        self._time = like.new_full((robots, self._side**2), -math.inf)

    def add(self, shot: FlightImage) -> None:
        """Takes note of an image."""
        index = self._index(shot.hits[..., :2])
        exposed = shot.measured.exposed_s[:, None]
        time = torch.where(shot.measured.depth > 0.0, exposed, -math.inf)
        self._time.scatter_reduce_(1, index, time, "amax")

    def at(self, place: Tensor) -> Tensor:
        """Time at which a ray last ended within 3 cm of places (robots, n, 2) [s]; -inf: never."""
        wide = functional.max_pool2d(self._time.view(-1, 1, self._side, self._side), 3, 1, 1)
        return wide.flatten(1).gather(1, self._index(place))

    def _index(self, place: Tensor) -> Tensor:
        cell = ((place + self._half) / CELL_M).floor().long().clamp(0, self._side - 1)
        return cell[..., 0] * self._side + cell[..., 1]
