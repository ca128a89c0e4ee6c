"""Stereo depth for training: poses of many robots in, noisy images of the model out.

Three rays, one under the other, stand for the 25 pixels of the sensor that a pixel of the model averages. All effects
know how far apart their samples are, so that the images have the statistics of the full chain: bias, spread, invalid
pixels and correlation (a test compares them). Depth edges are horizontal in most of what a robot sees ahead, hence one
column and three rows.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.depth import MODEL_CAMERA
from saltus.render.camera import Mount
from saltus.render.renderer import check_poses
from saltus.render.stereo.camera import StereoCamera, StereoConfig, StereoState
from saltus.render.stereo.model_view import COLUMNS, ROWS, pooled, sampled_model_camera
from saltus.render.stereo.optics import Optics
from saltus.render.stereo_embree import StereoEmbree
from saltus.terrain.terrain import Terrain
from saltus.wire.messages import Floats

CHUNK = 64  # images that one thread works on at a time: their arrays of 600 kB stay in its cache


FastState = tuple[tuple[StereoCamera, StereoState], ...]
"""For each chunk of cameras their effects and the states of these."""


class FastStereo:
    """A batch of stereo cameras on one terrain, each reporting the model's 16 x 48 pixels.

    Args:
        terrain: what there is to see.
        config: of the cameras; parameters may be arrays with one value a camera.
        mount: on the trunk.
        legs: whether the robots' legs can be seen.
        threads: to work with; several processes do more (`saltus.render.stereo_processes`).
        rows: rays for each pixel of the model, one under the other; with five rows and five columns this is the native
            chain.
        columns: of rays for each pixel.
    """

    def __init__(
        self,
        terrain: Terrain,
        config: StereoConfig | None = None,
        mount: Mount | None = None,
        *,
        legs: bool = True,
        threads: int = 1,
        rows: int = ROWS,
        columns: int = COLUMNS,
    ) -> None:
        camera = sampled_model_camera(rows, columns)
        self._samples = rows, columns
        self.chunk = max(1, CHUNK * ROWS * COLUMNS // (rows * columns))
        self.optics = Optics.of(camera)
        self.config = config or StereoConfig()
        self._renderer = StereoEmbree(terrain, self.optics, camera, mount, legs=legs, threads=1)
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def init(self, count: int, rng: np.random.Generator) -> FastState:
        """State before the first images, for `count` cameras."""
        parts = [slice(first, min(first + self.chunk, count)) for first in range(0, count, self.chunk)]
        cameras = [StereoCamera(part_of(self.config, part), self.optics) for part in parts]
        return tuple(
            (camera, camera.init((part.stop - part.start,), rng)) for camera, part in zip(cameras, parts, strict=True)
        )

    def step(
        self,
        base_position: Floats,
        base_quaternion: Floats,
        joint_position: Floats,
        time_s: float,
        state: FastState,
    ) -> tuple[NDArray[np.float32], FastState]:
        """One exposure of every camera at `time_s`.

        Args:
            base_position: see `Renderer.render_batch`, as the two that follow.
            base_quaternion: see there.
            joint_position: see there.
            time_s: capture time [s].
            state: what `init` or the last `step` returned.

        Returns:
            Depth [m], 0 where invalid, shape (count, 48, 16), and the next state.
        """
        poses = base_position, base_quaternion, joint_position
        check_poses(*poses)
        model = MODEL_CAMERA
        images = np.empty((len(base_position), model.height, model.width), dtype=np.float32)

        def expose(index: int) -> tuple[StereoCamera, StereoState]:
            camera, memory = state[index]
            part = slice(index * self.chunk, (index + 1) * self.chunk)
            depth, hidden = self._renderer.render_pair_batch(*(pose[part] for pose in poses))
            image, memory = camera.step(depth, hidden, np.full(len(depth), time_s), memory)
            images[part] = pooled(image.depth, *self._samples)
            return camera, memory

        chunks = range(len(state))
        following = tuple(self._pool.map(expose, chunks) if self._pool else map(expose, chunks))
        return images, following


def part_of(config: StereoConfig, part: slice) -> StereoConfig:
    """The config of some of the cameras of a batch: parameters that are arrays are cut."""
    cut: dict[str, Any] = {}
    for effect in config.effects:
        arrays = {f.name: getattr(effect, f.name) for f in fields(effect)}
        own = {name: value[part] for name, value in arrays.items() if isinstance(value, np.ndarray)}
        cut[effect.name] = replace(effect, **own) if own else effect
    return replace(config, **cut)
