"""The heightmap service for many robots at once, in roll-outs: rendered images, late as in each trial, one network."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Singles
from saltus.effects.heightmap_shift import refuse_shift
from saltus.effects.profile import Profile
from saltus.heightmap.data.robot_cameras import RobotCameras, robot_cameras
from saltus.heightmap.service.features import proprioception_of_states
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.sight import Network, Sight
from saltus.models import model_path
from saltus.robots.legs import LegKinematics
from saltus.setup import Setup
from saltus.sim.state import PlantState
from saltus.states import RobotStates


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
        return PredictedHeights(network, robot_cameras(setups), setups[0].profile)


class LeggedNetwork(Network, Protocol):
    """A network of robots with these legs."""

    legs: LegKinematics


class PredictedHeights:
    """Answers that the heightmap service of each robot would give, with the camera of its trial.

    A robot gets the very images, at the very steps, that the camera process gives to it in lockstep. The network runs
    on all robots in one call.
    """

    def __init__(self, network: LeggedNetwork, cameras: RobotCameras, profile: Profile) -> None:
        refuse_shift(profile.heightmap, "a predictor")
        self._network, self.cameras = network, cameras
        self._sight = Sight(network, cameras.images.in_hand.depth)

    def heights(self, states: RobotStates, truth: PlantState, fresh: NDArray[np.bool_]) -> Floats:
        """One tick of all services; shape (n, 30)."""
        arrived = self.cameras.step(truth, states.step, fresh)
        in_hand, features = self.cameras.images.in_hand, self._features(states)
        heights = self._sight.step(arrived, in_hand, states.time_s, features, fresh)
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
