"""Depth cameras of many robots: from where robots are to the images that cameras give out.

One law on numpy or torch, whatever renders: Embree and pyrender for recorded motion and roll-outs
on processors, Warp for thousands of robots on a device.
"""

from dataclasses import replace
from typing import Generic, Protocol, TypeVar

from saltus.arrays import Array, namespace
from saltus.constants import POLICY_DT
from saltus.depth import depth_in_millimetres, is_within_model, supersampled_model_camera
from saltus.depth_camera import DepthCamera
from saltus.effects.camera import CameraChain, CameraState
from saltus.effects.signals import DepthImage
from saltus.render.stereo.camera import StereoCamera, StereoState
from saltus.render.stereo.model_view import COLUMNS, ROWS, pool_valid

SAMPLED = supersampled_model_camera(ROWS, COLUMNS)
"""Pixels of stereo cameras: some rays for each pixel of the model."""


Truth = TypeVar("Truth")
Seen = TypeVar("Seen", contravariant=True)
"""Where robots are, as a renderer wants it: a message, a batch of states, a place in a
recording."""


class BatchRenderer(Protocol[Seen]):
    """Images of the cameras of n robots without errors; `truth` says where the robots are."""

    def depth(self, truth: Seen) -> Array:
        """Along the optical axis [m], infinite where nothing is hit, shape (n, height, width)."""
        ...

    def pair(self, truth: Seen) -> tuple[Array, Array]:
        """Depth from left imagers, and whether right ones do not see the point, same shape."""
        ...


class Eyes(Generic[Truth]):
    """The cameras of n robots, each with its memory.

    Args:
        camera: Which one they have.
        renderer: Of the model's camera, of `SAMPLED` where there is a `stereo`; see `whole`.
        chain: What happens to an image until a camera gives it out (`CameraChain.taken`).
        memory: Of that, before the first image.
        stereo: Errors of matching; None for true depth.
        state: Of these.
        whole: Leave the pixels that a stereo camera matched as they are, in place of the model's
            means of them. The renderer's may be the camera's own where it sees more than the model.
    """

    def __init__(
        self,
        camera: DepthCamera,
        renderer: BatchRenderer[Truth],
        chain: CameraChain,
        memory: CameraState,
        stereo: StereoCamera | None = None,
        state: StereoState = (),
        *,
        whole: bool = False,
    ) -> None:
        self.camera, self._renderer, self._stereo = camera, renderer, stereo
        self._chain, self._memory, self._state = chain, memory, state
        self._whole = whole
        is_own = whole and not is_within_model(camera.image)
        self._masked = camera.in_range if is_own else camera.masked
        self._fresh: Array | None = None

    def expose(self, truth: Truth, step: int, fresh: Array) -> DepthImage | None:
        """Takes an image of every robot where it is the time.

        Args:
            truth: See `BatchRenderer`.
            step: Of 10 ms since the first; to be asked for one after the other.
            fresh: Robots that start anew, bool, shape (n,): their cameras forget.

        Returns:
            The newest images that were given out [mm], shape (n, 48, 16), or the renderer's.
        """
        self._fresh = fresh if self._fresh is None else self._fresh | fresh
        if not self.camera.exposes(step):
            return None
        xp, time_s = namespace(fresh), step * POLICY_DT
        times = xp.full(len(fresh), time_s, dtype=xp.float64, device=fresh.device)
        if self._stereo is None:
            depth = self._renderer.depth(truth)
        else:
            pair = self._renderer.pair(truth)
            matched, self._state = self._stereo.step(*pair, times, self._state)
            depth = matched.depth if self._whole else pool_valid(matched.depth, ROWS, COLUMNS)
        exposed = DepthImage(depth=self._masked(depth), time_s=times)
        given, self._memory = self._chain.step(exposed, time_s, self._memory, self._fresh)
        self._fresh = None
        return replace(given, depth=depth_in_millimetres(given.depth))
