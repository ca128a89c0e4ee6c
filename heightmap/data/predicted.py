"""The heightmap service for many robots at once, in roll-outs: rendered images, late as in each trial, one network."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Singles
from saltus.depth import MODEL_CAMERA, depth_in_millimetres, model_image
from saltus.depth_camera import load_camera
from saltus.effects.camera import drawn_around
from saltus.effects.effect import map_arrays
from saltus.effects.heightmap_shift import refuse_shift
from saltus.effects.image_pixels import to_images
from saltus.effects.profile import Profile
from saltus.effects.signals import DepthImage
from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.data.late_images import LateImages, UsedImages
from saltus.heightmap.data.robot_cameras import IdealCameras, RobotCameras, StereoCameras
from saltus.heightmap.service.features import proprioception_of_states
from saltus.heightmap.service.network import HeightmapNetwork, Tick
from saltus.heightmap.service.quantiles import UNKNOWN_HALF_WIDTH_M
from saltus.heightmap.service.service import MAX_HEIGHT_M
from saltus.models import model_path
from saltus.render.process import random_stream
from saltus.render.stereo.camera import StereoConfig
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.sim.state import PlantState
from saltus.states import RobotStates
from saltus.terrain.stack import TerrainStack
from saltus.trial import Trial


@dataclass(frozen=True, kw_only=True)
class PredictedHeightsFactory:
    """Makes `PredictedHeights` for a batch; can be sent to another process."""

    model: Path | None = None
    """ONNX file; by default the shipped model."""
    camera: str = "ideal"
    """Name or TOML file; errors of stereo matching are made by the fast chain."""

    def __call__(self, terrains: TerrainStack, trials: Sequence[Trial], profile: Profile) -> "PredictedHeights":
        """A source of heights for one batch.

        Raises:
            ConfigError: there is no such camera, or the profile shifts true heights.
            ModelError: the model cannot be used.
        """
        robot = load_camera(self.camera).mounted_on(load_robot(DEFAULT_ROBOT))
        network = HeightmapNetwork(robot, model_path("heightmap", self.model))
        return PredictedHeights(network, *self.seen(terrains, trials, profile))

    def seen(
        self, terrains: TerrainStack, trials: Sequence[Trial], profile: Profile
    ) -> tuple[RobotCameras, Sequence[Trial], Profile]:
        """The cameras of a batch, and the profile as they deliver."""
        camera = load_camera(self.camera)
        robot, profile = camera.mounted_on(load_robot(DEFAULT_ROBOT)), camera.delivered(profile)
        if camera.ideal:
            return IdealCameras(camera, robot, terrains, profile), trials, profile
        rngs = [random_stream(trial.seed) for trial in trials]
        return StereoCameras(camera, robot, terrains, profile, StereoConfig.of(camera), rngs), trials, profile


class Network(Protocol):
    """What tells something of images, and remembers."""

    hidden_size: int
    legs: LegKinematics

    def ticks(self, image: Singles, age_s: Floats, new: NDArray[np.bool_], features: Singles, hidden: Singles) -> Tick:
        """One tick of many robots, see `HeightmapNetwork.ticks`."""
        ...


class PredictedHeights:
    """What the heightmap service of each robot would answer, with the camera of its trial.

    A robot gets the very images, at the very steps, that the camera process gives to it in lockstep. The network runs
    on all robots in one call. An output that is not plausible is not used: heights and hidden state stay as they were.
    """

    def __init__(self, network: Network, cameras: RobotCameras, trials: Sequence[Trial], profile: Profile) -> None:
        refuse_shift(profile.heightmap, "a predictor")
        count = len(trials)
        self._network = network
        self._cameras = cameras
        self._images = late_images(profile, trials)
        blank = model_image(depth_in_millimetres(self._images.in_hand.depth))
        self._used = UsedImages(blank, self._images.in_hand.time_s)
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
        time_s = np.full(len(fresh), float(states.time_s))
        exposed = None if depth is None else DepthImage(depth=depth, time_s=time_s)
        arrived, image = self._images.step(exposed, states.time_s, fresh), self._used.image.copy()
        in_hand = self._images.in_hand
        image[arrived] = model_image(depth_in_millimetres(in_hand.depth[arrived]))
        new, forgets = self._used.step(arrived, image, in_hand.time_s, fresh)
        self._hidden[forgets] = 0.0
        features = self._features(states)
        tick = self._network.ticks(self._used.image, states.time_s - self.captured_s, new, features, self._hidden)
        good = _plausible(tick)
        self._hidden[good], self._heights[good] = tick.hidden[good], tick.height[good]
        self.half_width_90[good] = tick.half_width_90[good]
        return self._heights.copy()

    def _features(self, states: RobotStates) -> Singles:
        """What the network is told of the robots besides their images, shape (n, some)."""
        vectors: Singles = proprioception_of_states(states, self._network.legs)
        return vectors

    @property
    def captured_s(self) -> Floats:
        """Capture time of the image in use of each robot [s], shape (n,); minus infinity before the first."""
        return self._used.captured_s

    def _forget(self, mask: NDArray[np.bool_]) -> None:
        """Robots that start anew have seen nothing yet."""
        self._hidden[mask] = 0.0
        self._heights[mask], self.half_width_90[mask] = 0.0, UNKNOWN_HALF_WIDTH_M


def late_images(profile: Profile, trials: Sequence[Trial]) -> LateImages:
    """Cameras as each trial draws them, with the random numbers of the camera process."""
    latency_s, jitter_s = np.array([(trial.camera_delay_s, trial.camera_jitter_s) for trial in trials]).T
    camera = drawn_around(profile.camera, latency_s=latency_s, jitter_s=jitter_s)
    chain = to_images(replace(profile, camera=camera), MODEL_CAMERA.fx).camera_chain
    states = [chain.init((), random_stream(trial.seed)) for trial in trials]
    state = map_arrays(lambda *keys: np.stack(keys), *states)
    depth = np.empty((len(trials), MODEL_CAMERA.height, MODEL_CAMERA.width), np.float32)
    return LateImages(chain, state, DepthImage(depth=depth, time_s=np.empty(len(trials))))


def _plausible(tick: Tick) -> NDArray[np.bool_]:
    """Which outputs may be used, shape (n,); a comparison with NaN is false."""
    return np.asarray((np.abs(tick.height) <= MAX_HEIGHT_M).all(-1) & np.isfinite(tick.hidden).all(-1))
