"""Exposures of a depth camera: of true depth here,
and of a stereo camera with its errors.
"""

from typing import Protocol

import numpy as np

from saltus.arrays import Floats, Reals
from saltus.depth import Intrinsics
from saltus.depth_camera import DepthCamera
from saltus.effects.camera import ViewChain
from saltus.render.backends import make_stereo
from saltus.render.camera import RobotCamera
from saltus.render.renderer import Renderer
from saltus.render.stereo.camera import StereoCamera, StereoConfig
from saltus.render.stereo.optics import StereoOptics
from saltus.robots.robot import Robot
from saltus.terrain.terrain import Terrain
from saltus.wire.messages import GroundTruth


class Exposure(Protocol):
    """Anything that takes depth images with a camera: with its errors or without."""

    intrinsics: Intrinsics

    def expose(self, truth: GroundTruth) -> Reals:
        """Depth along the optical axis [m], shape (height, width); 0 is invalid, infinite is
        "nothing within range".
        """
        ...


class PerfectExposure:
    """Gives images of true depth; `claimed` are the intrinsics that the camera reports, where they
    are not those of the renderer.
    """

    def __init__(self, renderer: Renderer, claimed: Intrinsics | None = None) -> None:
        self.intrinsics = claimed or renderer.intrinsics
        self._renderer = renderer

    def expose(self, truth: GroundTruth) -> Reals:
        """See `Exposure`; every pixel is valid."""
        return self._renderer.render(
            truth.position_base_in_world, truth.quaternion_base_in_world, truth.joint_position
        )


CLAIMED_VIEW = ViewChain()


class StereoExposure:
    """The images of a camera with the errors of stereo matching.

    `view` are effects that move the camera, which reports its intrinsics without them; `renderer`
    is the name of the back end.
    """

    def __init__(
        self,
        terrain: Terrain,
        robot: Robot,
        camera: DepthCamera,
        rng: np.random.Generator,
        view: ViewChain = CLAIMED_VIEW,
        renderer: str = "auto",
    ) -> None:
        self.intrinsics = camera.image
        optics = StereoOptics.behind(camera.image, camera)
        self._views = make_stereo(
            renderer, terrain, optics, RobotCamera.on(robot, self.intrinsics).moved(view)
        )
        self._camera = StereoCamera(StereoConfig.of(camera), optics)
        self._state = self._camera.init((), rng)

    def expose(self, truth: GroundTruth) -> Floats:
        """See `Exposure`."""
        depth, hidden = self._views.render_pair(
            truth.position_base_in_world, truth.quaternion_base_in_world, truth.joint_position
        )
        image, self._state = self._camera.step(
            depth, hidden, np.asarray(1e-9 * truth.time_ns), self._state
        )
        return np.asarray(image.depth)
