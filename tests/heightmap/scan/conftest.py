"""Small flights for the tests of the scan: seconds on one core."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from small_flights import EXACT, SMALL

from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.flights import FlightDraws, draw_flight
from saltus.heightmap.scan.training.seeded_random import SeededRandom
from saltus.heightmap.scan.training.settings import (
    FlightSettings,
    NetworkSettings,
    ScanTrainSettings,
)


@pytest.fixture
def draws() -> SeededRandom:
    return SeededRandom(5, torch.device("cpu"))


@pytest.fixture
def fly(draws: SeededRandom) -> Callable[..., tuple[FlightDraws, FlightSettings]]:
    """Draws a flight of some robots; settings that are named replace those of `EXACT`."""

    def drawn(robots: int = 4, **changes: Any) -> tuple[FlightDraws, FlightSettings]:
        settings = replace(EXACT, **changes)
        return draw_flight(robots, settings, draws), settings

    return drawn


@pytest.fixture
def small() -> ScanTrainSettings:
    """A training that takes a second a round."""
    return ScanTrainSettings(
        map=MapSettings(cells=16),
        flight=replace(SMALL, raster_m=0.04, samples=24, images=4,
            families=("flat", "stairs", "stones")),
        network=NetworkSettings(channels=(8, 8, 8, 8), deep=1, deep_channels=8), batch=4, round=3,
    )  # fmt: skip
