"""Examples of the scan's training: the next image of every robot, and the true heights."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor

from saltus.heightmap.scan.elevation import (
    ElevationMap,
    MapContext,
    MapUpdate,
    advance_map,
)
from saltus.heightmap.scan.network_inputs import ScanInputs, inputs_of
from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.flights import (
    FlightDraws,
    RayMarch,
    next_image,
    true_map_heights,
)
from saltus.heightmap.scan.training.framewise import of_image
from saltus.heightmap.scan.training.raster_rays import first_hits
from saltus.heightmap.scan.training.scan_model import ScanModel
from saltus.heightmap.scan.training.seeded_random import SeededRandom
from saltus.heightmap.scan.training.settings import ScanTrainSettings


@dataclass(frozen=True)
class UpdateCalls:
    """The three parts of a training update of the scan that take time, as they are or compiled."""

    march: RayMarch
    see: Callable[..., tuple[ElevationMap, ScanInputs, MapContext]]
    """`with_image`."""
    model: Callable[..., Any]

    @classmethod
    def of(cls, model: ScanModel, *, compiled: bool) -> Self:
        """Compiling takes half a minute.

        Torch 2.11 loses parts of named tuples, so the map stays as it is.
        """
        if not compiled:
            return cls(first_hits, with_image, model)
        return cls(torch.compile(first_hits), with_image, torch.compile(model))


def with_image(
    state: ElevationMap, measured: MapUpdate, now_s: Tensor, settings: MapSettings
) -> tuple[ElevationMap, ScanInputs, MapContext]:
    """Takes an image into the map of each robot.

    Returns the new map, what the network is shown of it, and what else is known around the robot.
    `now_s`: time of the image's look [s].
    """
    state, around = advance_map(state, measured, settings)
    return state, inputs_of(state, around, now_s, measured), around


def next_example(
    flight: FlightDraws,
    state: ElevationMap,
    settings: ScanTrainSettings,
    draws: SeededRandom,
    calls: UpdateCalls,
) -> tuple[ElevationMap, ScanInputs, MapContext, Tensor]:
    """The next image of every robot: the map with it,
    what the network is shown, and the true heights.
    """
    shot = next_image(flight, settings.flight, draws, calls.march)
    state, inputs, around = calls.see(state, shot.measured, shot.now_s, settings.map)
    shown = state
    if settings.network.frame:
        shown, inputs, around = of_image(state, shot.measured, shot.now_s, settings.map)
    return (
        state,
        inputs,
        around,
        true_map_heights(flight, shot, shown, around, settings.map, settings.flight),
    )
