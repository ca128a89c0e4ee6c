"""Exposures of a depth camera: of true depth here,
of a stereo camera in `saltus.render.stereo_exposure`.
"""

from typing import Protocol

from saltus.arrays import Reals
from saltus.depth import Intrinsics
from saltus.render.renderer import Renderer
from saltus.wire.messages import GroundTruth


class Exposure(Protocol):
    """A source of depth images."""

    intrinsics: Intrinsics

    def expose(self, truth: GroundTruth) -> Reals:
        """Depth along the optical axis [m], shape (height, width); 0 is invalid, infinite is
        "nothing within range".
        """
        ...


class PerfectExposure:
    """True depth; `claimed` are the intrinsics that the camera reports,
    where they are not those of the renderer.
    """

    def __init__(self, renderer: Renderer, claimed: Intrinsics | None = None) -> None:
        self.intrinsics = claimed or renderer.intrinsics
        self._renderer = renderer

    def expose(self, truth: GroundTruth) -> Reals:
        """See `Exposure`; every pixel is valid."""
        return self._renderer.render(
            truth.position_base_in_world, truth.quaternion_base_in_world, truth.joint_position
        )
