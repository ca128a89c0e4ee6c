"""Proprioception, images and true heights of many robots:
kept on a device, then cut into episodes on the host.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from saltus.arrays import Singles
from saltus.depth import MODEL_CAMERA
from saltus.depth_camera import DepthCamera
from saltus.effects.signals import DepthImage
from saltus.heightmap.data.delivery import TICK_S
from saltus.heightmap.data.episode import Episode, uninterrupted_spans
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.policy.bounds import ACTIONS
from saltus.policy.policy_features import PROPRIOCEPTION_SIZE


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedBatch:
    """A batch of robots, robot by robot."""

    terrain: Sequence[str]
    """Kind of each robot's."""
    starts: NDArray[np.bool_]
    """True where a robot starts anew with a tick, shape (n, ticks)."""
    proprioception: Singles
    """Shape (n, ticks, some)."""
    height: Singles
    """[m], shape (n, ticks, points)."""
    frame_tick: NDArray[np.int32]
    """At which images are taken, shape (frames,)."""
    depth: Mapping[str, NDArray[np.uint16]]
    """Images of each camera [mm], shape (n, frames, 48, 16)."""
    there: Mapping[str, NDArray[np.bool_]]
    """True where they were given out, shape (n, frames): some cameras hold or lose theirs."""
    state: Singles | None = None
    """Inputs of the policy besides heights, shape (n, ticks, some); where they are kept."""
    plan: Singles | None = None
    """Normalised plans of the policy on true heights, shape (n, ticks, 10); where they are kept."""

    def episodes(self, camera: str) -> Iterator[Episode]:
        """All runs from a start to the next that are long enough,
        with the images of one of the cameras.
        """
        taken = self.frame_tick
        for robot, starts in enumerate(self.starts):
            for run in uninterrupted_spans(starts):
                frames = np.arange(*np.searchsorted(taken, (run.start, run.stop)))
                frames = frames[self.there[camera][robot, frames]]
                yield Episode(
                    terrain=self.terrain[robot],
                    proprioception=self.proprioception[robot, run],
                    height=self.height[robot, run],
                    state=None if self.state is None else self.state[robot, run],
                    plan=None if self.plan is None else self.plan[robot, run],
                    depth=self.depth[camera][robot, frames],
                    frame_tick=taken[frames] - np.int32(run.start),
                )


class DeviceRecording:
    """Room on the device for one batch, used again for the next; all cameras have one rate."""

    def __init__(
        self,
        robots: int,
        ticks: int,
        points: int,
        cameras: Mapping[str, DepthCamera],
        device: torch.device,
        *,
        plans: bool = False,
    ) -> None:
        def room(*row: int, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.empty(robots, *row, dtype=dtype, device=device)

        self._camera = next(iter(cameras.values()))
        self._frame_tick = self._camera.exposures(ticks)
        frames = len(self._frame_tick), MODEL_CAMERA.height, MODEL_CAMERA.width
        self._proprioception = room(ticks, len(PROPRIOCEPTION))
        self._height = room(ticks, points)
        self._plans = (
            {"state": room(ticks, PROPRIOCEPTION_SIZE), "plan": room(ticks, len(ACTIONS))}
            if plans
            else {}
        )
        self._starts = room(ticks, dtype=torch.bool)
        # The bits of 16 bits without a sign, which few operations of torch know.
        self._depth = {camera: room(*frames, dtype=torch.int16) for camera in cameras}
        self._there = {camera: room(frames[0], dtype=torch.bool) for camera in cameras}

    def add(
        self,
        tick: int,
        proprioception: Tensor,
        height: Tensor,
        starts: Tensor,
        images: Mapping[str, DepthImage],
    ) -> None:
        """One tick of all robots; images [mm] where it is their time."""
        frame = self._camera.taken_by(tick) - 1
        self._proprioception[:, tick] = proprioception
        self._height[:, tick] = height
        self._starts[:, tick] = starts
        for camera, image in images.items():
            self._depth[camera][:, frame] = image.depth.to(torch.int16)
            self._there[camera][:, frame] = image.time_s == tick * TICK_S

    def add_plans(self, tick: int, state: Tensor, plan: Tensor) -> None:
        """Adds what the policy saw of all robots besides heights,
        and its normalised plans on true ones.
        """
        self._plans["state"][:, tick], self._plans["plan"][:, tick] = state, plan

    def to_host(self, terrain: Sequence[str]) -> RecordedBatch:
        """A copy of what is there, for robots on the given kinds of terrain."""
        return RecordedBatch(
            terrain=terrain,
            starts=_copied(self._starts),
            proprioception=_copied(self._proprioception),
            height=_copied(self._height),
            frame_tick=self._frame_tick,
            depth={
                camera: _copied(images).view(np.uint16) for camera, images in self._depth.items()
            },
            there={camera: _copied(there) for camera, there in self._there.items()},
            **{name: _copied(rows) for name, rows in self._plans.items()},
        )


def _copied(tensor: Tensor) -> np.ndarray:
    return tensor.to("cpu", copy=True).numpy()
