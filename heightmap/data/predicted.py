"""The heightmap service for many robots at once, in roll-outs: rendered images, late as in each trial, one network."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Singles
from saltus.depth import MODEL_CAMERA, depth_in_millimetres
from saltus.effects.camera import drawn_around
from saltus.effects.effect import map_arrays
from saltus.effects.heightmap_shift import refuse_shift
from saltus.effects.image_pixels import to_images
from saltus.effects.profile import Profile
from saltus.effects.signals import DepthImage
from saltus.heightmap.data.late_images import LateImages
from saltus.heightmap.data.robot_cameras import IdealCameras, RobotCameras, StereoCameras
from saltus.heightmap.service.features import proprioception_of_states
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.sight import Network, Sight
from saltus.models import model_path
from saltus.render.process import random_stream
from saltus.render.stereo.camera import StereoConfig
from saltus.robots.legs import LegKinematics
from saltus.setup import Setup
from saltus.sim.state import PlantState
from saltus.states import RobotStates
from saltus.terrain.stack import TerrainStack
from saltus.trial import Trial


@dataclass(frozen=True, kw_only=True)
class PredictedHeightsFactory:
    """Makes `PredictedHeights` for a batch; can be sent to another process."""

    model: Path | None = None
    """ONNX file; by default the shipped model."""

    def __call__(self, setups: Sequence[Setup]) -> "PredictedHeights":
        """A source of heights for one batch; errors of stereo matching are made by the fast chain.

        Raises:
            ConfigError: the profile shifts true heights.
            ModelError: the model cannot be used.
        """
        network = HeightmapNetwork(setups[0].robot, model_path("heightmap", self.model))
        return PredictedHeights(network, *seen_by(setups))


def seen_by(setups: Sequence[Setup]) -> tuple[RobotCameras, Sequence[Trial], Profile]:
    """The cameras of a batch, their trials and the profile of all."""
    camera, robot, profile = setups[0].camera, setups[0].robot, setups[0].profile
    terrains, trials = TerrainStack([setup.terrain for setup in setups]), [setup.trial for setup in setups]
    if camera.ideal:
        return IdealCameras(camera, robot, terrains, profile), trials, profile
    rngs = [random_stream(trial.seed) for trial in trials]
    return StereoCameras(camera, robot, terrains, profile, StereoConfig.of(camera), rngs), trials, profile


class LeggedNetwork(Network, Protocol):
    """A network of robots with these legs."""

    legs: LegKinematics


class PredictedHeights:
    """Answers that the heightmap service of each robot would give, with the camera of its trial.

    A robot gets the very images, at the very steps, that the camera process gives to it in lockstep. The network runs
    on all robots in one call.
    """

    def __init__(
        self, network: LeggedNetwork, cameras: RobotCameras, trials: Sequence[Trial], profile: Profile
    ) -> None:
        refuse_shift(profile.heightmap, "a predictor")
        self._network, self._cameras = network, cameras
        self._images = late_images(profile, trials)
        self._sight = Sight(network, depth_in_millimetres(self._images.in_hand.depth))
        self.depth: NDArray[np.float32] | None = None
        """Images that the cameras take at this step [m], shape (n, 48, 16); None where it is not
        the time."""

    def heights(self, states: RobotStates, truth: PlantState, fresh: NDArray[np.bool_]) -> Floats:
        """One tick of all services; shape (n, 30)."""
        time_s, exposes = states.time_s, self._cameras.camera.exposes(states.step)
        self.depth = self._cameras.expose(truth, time_s) if exposes else None
        exposed = None
        if self.depth is not None:
            exposed = DepthImage(depth=self.depth, time_s=np.full(len(fresh), float(time_s)))
        arrived, in_hand = self._images.step(exposed, time_s, fresh), self._images.in_hand
        sent = replace(in_hand, depth=depth_in_millimetres(in_hand.depth))
        heights = self._sight.step(arrived, sent, time_s, self._features(states), fresh)
        return np.asarray(heights, np.float64)

    def _features(self, states: RobotStates) -> Singles:
        """Inputs of the network about the robots besides their images, shape (n, some)."""
        vectors: Singles = proprioception_of_states(states, self._network.legs)
        return vectors

    @property
    def half_width_90(self) -> Floats:
        """Half of the 90 % interval of the newest heights [m], shape (n, 30)."""
        return np.asarray(self._sight.half_width_90, np.float64)

    @property
    def captured_s(self) -> Floats:
        """Capture time of the image in use of each robot [s], shape (n,); minus infinity before the first."""
        return np.asarray(self._sight.captured_s)


def late_images(profile: Profile, trials: Sequence[Trial]) -> LateImages:
    """Cameras as each trial draws them, with the random numbers of the camera process."""
    latency_s, jitter_s = np.array([(trial.camera_delay_s, trial.camera_jitter_s) for trial in trials]).T
    camera = drawn_around(profile.camera, latency_s=latency_s, jitter_s=jitter_s)
    chain = to_images(replace(profile, camera=camera), MODEL_CAMERA.fx).camera_chain
    states = [chain.init((), random_stream(trial.seed)) for trial in trials]
    state = map_arrays(lambda *keys: np.stack(keys), *states)
    depth = np.empty((len(trials), MODEL_CAMERA.height, MODEL_CAMERA.width), np.float32)
    return LateImages(chain, state, DepthImage(depth=depth, time_s=np.empty(len(trials))))
