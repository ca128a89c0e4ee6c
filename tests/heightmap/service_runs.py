"""Runs of the heightmap service on frames that may be missing."""

from collections.abc import Callable

import numpy as np
from heightmap_inputs import on_time, states

from saltus.heightmap.service.service import HeightmapService
from saltus.heightmap.service.sight import NetworkOutputs
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus

OK, WARMING = HeightmapStatus.OK, HeightmapStatus.WARMING
DEGRADED, INVALID = HeightmapStatus.DEGRADED, HeightmapStatus.INVALID


def run(
    service: HeightmapService, frames: dict[int, DepthFrame | None], steps: int
) -> list[Heightmap]:
    return [service.step(state, frames.get(state.step), state.time_ns) for state in states(steps)]


def clean(steps: int) -> dict[int, DepthFrame | None]:
    return {step: on_time(step) for step in range(steps)}


class Faulty:
    """A network whose output is bad at chosen ticks."""

    def __init__(self, service: HeightmapService, bad: dict[int, NetworkOutputs]) -> None:
        self._network, self._bad, self._count = service._network, bad, -1
        self.hidden_size, self.points = self._network.hidden_size, self._network.points
        self.x, self.warmup_frames = self._network.x, self._network.warmup_frames
        self.model_id, self.legs = self._network.model_id, self._network.legs
        self.hidden_seen: list[np.ndarray] = []

    def tick(self, *arguments: object) -> NetworkOutputs:
        self._count += 1
        self.hidden_seen.append(arguments[-1])  # type: ignore[arg-type]
        return self._bad.get(self._count) or self._network.tick(*arguments)  # type: ignore[arg-type]


def bad_tick(where: str, value: float) -> NetworkOutputs:
    arrays = {
        "height": np.zeros((1, 30)),
        "half_width_90": np.full((1, 30), 0.1),
        "hidden": np.zeros((1, 256)),
    }
    arrays[where][0, 3] = value
    return NetworkOutputs.of(**arrays)


def without(lost: Callable[[int], bool], steps: int) -> dict[int, DepthFrame | None]:
    """Frames but those whose number is lost."""
    return {step: f for step, f in clean(steps).items() if f is None or not lost(f.frame_id)}
