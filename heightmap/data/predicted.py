"""The heightmap service for many robots at once, in roll-outs: rendered images, late as in each trial, one network."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.config import DEFAULT_ROBOT
from saltus.depth import MILLIMETRE, MODEL_CAMERA, depth_in_millimetres, model_images
from saltus.depth_camera import load_camera
from saltus.effects.profile import Profile, load_profile
from saltus.effects.signals import DepthImage
from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.data.robot_cameras import IdealCameras, RobotCameras, StereoCameras
from saltus.heightmap.service.features import proprioception_of_states
from saltus.heightmap.service.network import HeightmapNetwork, Tick
from saltus.heightmap.service.quantiles import UNKNOWN_HALF_WIDTH_M
from saltus.heightmap.service.service import MAX_HEIGHT_M
from saltus.models import model_path
from saltus.render.process import random_stream
from saltus.render.stereo.camera import StereoConfig
from saltus.robots.loading import load_robot
from saltus.sim.state import PlantState
from saltus.states import RobotStates
from saltus.terrain.stack import TerrainStack
from saltus.trial import Trial


@dataclass(frozen=True, kw_only=True)
class PredictedHeightsFactory:
    """Makes `PredictedHeights` for a batch; can be sent to another process."""

    profile: str = "shipped"
    """Effects of the hardware; those of the camera matter here."""
    model: Path | None = None
    """ONNX file; by default the shipped model."""
    camera: str = "ideal"
    """Name or TOML file; errors of stereo matching are made by the fast chain."""

    def __call__(self, terrains: TerrainStack, trials: Sequence[Trial]) -> "PredictedHeights":
        """A source of heights for one batch.

        Raises:
            ConfigError: there is no such camera.
            ModelError: the model cannot be used.
        """
        camera = load_camera(self.camera)
        robot = camera.mounted_on(load_robot(DEFAULT_ROBOT))
        network = HeightmapNetwork(robot, model_path("heightmap", self.model))
        profile = camera.delivered(load_profile(self.profile, robot))
        cameras: RobotCameras
        if camera.ideal:
            cameras = IdealCameras(camera, robot, terrains, profile)
        else:
            rngs = [random_stream(trial.seed) for trial in trials]
            cameras = StereoCameras(camera, robot, terrains, profile, StereoConfig.of(camera), rngs)
        return PredictedHeights(network, cameras, trials, profile)


class PredictedHeights:
    """What the heightmap service of each robot would answer, with the camera of its trial.

    A robot gets the very images, at the very steps, that the camera process gives to it in lockstep. The network runs
    on all robots in one call. An output that is not plausible is not used: heights and hidden state stay as they were.
    """

    def __init__(
        self, network: HeightmapNetwork, cameras: RobotCameras, trials: Sequence[Trial], profile: Profile
    ) -> None:
        count = len(trials)
        self._network = network
        self._cameras = cameras
        self._arrivals = [_Arrivals(trial, profile) for trial in trials]
        self._image = np.zeros((count, 2, MODEL_CAMERA.height, MODEL_CAMERA.width), np.float32)
        self.captured_s = np.full(count, -np.inf)
        """Capture time of the image in use of each robot [s]; minus infinity before the first."""
        self.half_width_90 = np.full((count, len(HEIGHTMAP_X)), UNKNOWN_HALF_WIDTH_M)
        """Half of the 90 % interval of the newest heights [m], shape (n, 30)."""
        self.depth: NDArray[np.float32] | None = None
        """What the cameras take at this step [m], shape (n, 48, 16); None where it is not the time."""
        self._hidden = np.zeros((count, network.hidden_size), np.float32)
        self._heights = np.zeros((count, len(HEIGHTMAP_X)))
        self._forget(np.ones(count, dtype=np.bool_))

    def heights(self, states: RobotStates, truth: PlantState, fresh: NDArray[np.bool_]) -> Floats:
        """One tick of all services; shape (n, 30)."""
        self._forget(fresh)
        depth = self._cameras.expose(truth, states.time_s) if self._cameras.camera.exposes(states.step) else None
        self.depth = depth
        new = np.zeros(len(fresh), dtype=np.bool_)
        for i, arrivals in enumerate(self._arrivals):
            arrived = arrivals.step(None if depth is None else depth[i], states.time_s)
            if arrived is not None:
                self.captured_s[i], self._image[i] = arrived[0], _as_sent(arrived[1])
                new[i] = True
        features = proprioception_of_states(states, self._network.legs)
        tick = self._network.ticks(self._image, states.time_s - self.captured_s, new, features, self._hidden)
        good = _plausible(tick)
        self._hidden[good], self._heights[good] = tick.hidden[good], tick.height[good]
        self.half_width_90[good] = tick.half_width_90[good]
        return self._heights.copy()

    def _forget(self, mask: NDArray[np.bool_]) -> None:
        """Robots that start anew have seen nothing yet."""
        self._hidden[mask] = 0.0
        self._heights[mask], self.half_width_90[mask] = 0.0, UNKNOWN_HALF_WIDTH_M
        self._image[mask, 0], self._image[mask, 1] = 1.0, 0.0
        self.captured_s[mask] = -np.inf
        for i in np.flatnonzero(mask):
            self._arrivals[i].reset()


def _as_sent(depth: NDArray[np.floating]) -> NDArray[np.float32]:
    """Depth and validity of an image that has arrived, shape (2, 48, 16)."""
    image = model_images(depth_in_millimetres(depth) * MILLIMETRE)  # whole millimetres, as they travel
    return np.stack([image.depth, image.valid]).astype(np.float32)


class _Arrivals:
    """Images of one robot as they arrive: the effects of its camera, with the random numbers of the camera process."""

    def __init__(self, trial: Trial, profile: Profile) -> None:
        self._seed = trial.seed
        self._chain = trial.applied_to(profile).camera_chain
        self._state: tuple[Any, ...] = ()
        self._newest: DepthImage | None = None
        self._under_way: dict[float, NDArray[np.float32]] = {}
        self.reset()

    def reset(self) -> None:
        """Forgets the images under way."""
        self._state = self._chain.init((), random_stream(self._seed))
        self._newest = None
        self._under_way = {}
        self._used_s = -np.inf

    def step(self, image: NDArray[np.float32] | None, time_s: float) -> tuple[float, NDArray[np.floating]] | None:
        """Takes an image that is exposed now, if one is; returns one that has arrived, with its capture time [s]."""
        if image is not None:
            self._under_way[time_s] = image
            # Effects that decide by times alone need no pixels; those stay here.
            pixels = image if self._chain.changes_pixels else np.zeros((1, 1), np.float32)
            self._newest = DepthImage(depth=pixels, time_s=np.asarray(time_s))
        if self._newest is None:
            return None
        seen, self._state = self._chain.step(self._newest, time_s, self._state)
        captured_s = float(seen.time_s)
        if captured_s <= self._used_s:
            return None
        self._used_s = captured_s
        arrived = self._under_way[captured_s]
        self._under_way = {taken: kept for taken, kept in self._under_way.items() if taken > captured_s}
        return captured_s, seen.depth if self._chain.changes_pixels else arrived


def _plausible(tick: Tick) -> NDArray[np.bool_]:
    """Which outputs may be used, shape (n,); a comparison with NaN is false."""
    return np.asarray((np.abs(tick.height) <= MAX_HEIGHT_M).all(-1) & np.isfinite(tick.hidden).all(-1))
