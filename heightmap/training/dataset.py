"""Episodes as the network gets them in training:
on the device, delayed, noisy, cut into windows.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from saltus.arrays import Indices
from saltus.depth import MILLIMETRE, RANGE_M, model_image
from saltus.heightmap.data.delivery import ImageDeliveryModel, draw_delivery
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.model import IMAGE_SHAPE, HeightEstimate, HeightmapModel, Normalisation


@dataclass(frozen=True, kw_only=True)
class ImageNoise:
    """Bounds of what is drawn once a robot and window; the defaults are a camera without faults."""

    scale: float = 0.0
    """Calibration error of the depth, as a share."""
    disparity: float = 0.0
    """Standard deviation of the depth at 1 m [m]; it grows with the square of the depth."""
    edge_loss: float = 0.0
    """Share of invalid pixels along depth edges, where the two imagers see different things."""
    pixel_loss: float = 0.0
    """Share of invalid pixels anywhere."""
    patch_loss: float = 0.0
    """Share of images with an invalid rectangle."""


NO_NOISE = ImageNoise()
# D435i at 424x240: 7.6 mm at 1 m a raw pixel, spatially correlated, so that pooling 5x5 helps
# little over half (datasheet and tuning guide). Depth accuracy 2 % at 2 m. Shares of invalid
# pixels: 6.7 % in a real recording.
TRAINING_NOISE = ImageNoise(
    scale=0.015, disparity=0.006, edge_loss=0.5, pixel_loss=0.05, patch_loss=0.1
)
_EDGE_M = 0.06  # a step in depth between neighbours that counts as an edge
_PATCH = (16, 8)
_AT_ONCE = 16  # episodes: images of some MB, which stay in the cache of a processor


class TrainingWindow(NamedTuple):
    """Ticks of several robots at once; time first."""

    image: Tensor
    """Images of the window, shape (batch, images, 2, 48, 16); image 0 of each robot is blank."""
    in_use: Tensor
    """Index of the image in use, shape (time, batch)."""
    age: Tensor
    new: Tensor
    proprioception: Tensor
    height: Tensor
    """Truth [m], shape (time, batch, 30)."""
    valid: Tensor
    """0 beyond the end of an episode, shape (time, batch)."""
    true_depth: Tensor
    """True where the images are without any error of a camera, bool, shape (batch,)."""
    starts: Tensor
    """True where the hidden state is empty at the beginning, as it is where a robot enters an
    episode, shape (batch,)."""


class EpisodeStore:
    """Episodes on a device, with the windows that can be cut from them.

    `weight` says how often each is chosen, relative to the others, `true_depth` whether its images
    are without any error (as all are by default).
    """

    def __init__(
        self,
        episodes: Sequence[Episode],
        device: torch.device,
        weight: Sequence[float] | None = None,
        true_depth: Sequence[bool] | None = None,
    ) -> None:
        self.episodes = episodes
        self._true_depth = (
            np.ones(len(episodes), np.bool_) if true_depth is None else np.asarray(true_depth)
        )
        self._share = np.cumsum(np.ones(len(episodes)) if weight is None else weight)
        self.device = device
        self._lengths = np.array([len(e.height) for e in episodes])
        self._first_frame = np.cumsum([0, *(len(e.depth) for e in episodes)])
        self._first_tick = np.cumsum([0, *self._lengths])
        self._depth = self._together([e.depth for e in episodes], torch.int16)
        self._proprioception = self._together([e.proprioception for e in episodes], torch.float32)
        self._height = self._together([e.height for e in episodes], torch.float32)

    def normalisation(self) -> Normalisation:
        """Statistics of all ticks. A sensor that hardly varies is not blown up."""
        p, h = self._proprioception, self._height
        return Normalisation(
            p.mean(0), p.std(0).clamp(min=0.02), h.mean(0), h.std(0).clamp(min=0.05)
        )

    def windows(
        self,
        batch: int,
        length: int,
        delivery: ImageDeliveryModel,
        noise: ImageNoise,
        rng: np.random.Generator,
        *,
        forgets: float = 0.0,
    ) -> Iterator[TrainingWindow]:
        """Yields windows for ever: each of `batch` robots runs through random episodes,
        window after window.

        Half of the robots enter an episode in its middle, so that a hidden state is also built up
        in full motion. Of the windows that continue an episode, the share `forgets` begins with an
        empty hidden state all the same.
        """
        slots = _Slots(batch, int(self._lengths.max()))
        self._enter(slots, np.arange(batch), delivery, rng)
        generator = torch.Generator(self.device).manual_seed(int(rng.integers(2**62)))
        while True:
            window = self._cut(slots, length)
            yield window._replace(
                image=with_noise(window.image, noise, generator, window.true_depth)
            )
            slots.position += length
            # None drawn for nothing
            slots.starts[:] = rng.uniform(size=batch) < forgets if forgets else False
            finished = np.flatnonzero(slots.position >= self._lengths[slots.episode])
            if len(finished):
                self._enter(slots, finished, delivery, rng)

    def _enter(
        self, slots: "_Slots", rows: Indices, model: ImageDeliveryModel, rng: np.random.Generator
    ) -> None:
        """Sends robots into other episodes."""
        chosen = np.searchsorted(
            self._share, rng.uniform(0.0, self._share[-1], len(rows)), side="right"
        )
        begin = rng.integers(2, size=len(rows)) * rng.integers(self._lengths[chosen])
        drawn = draw_delivery([self.episodes[i] for i in chosen], model, rng)
        slots.episode[rows], slots.position[rows], slots.starts[rows] = chosen, begin, True
        ticks = drawn.frame.shape[1]
        slots.frame[rows, :ticks], slots.age_s[rows, :ticks], slots.new[rows, :ticks] = drawn

    def _together(self, arrays: Sequence[np.ndarray], kind: torch.dtype) -> Tensor:
        """All rows on the device, images up to the range.

        Some at a time, as large copies on the host take long.
        """
        rows = torch.empty(
            sum(map(len, arrays)), *arrays[0].shape[1:], dtype=kind, device=self.device
        )
        filled = 0
        for first in range(0, len(arrays), _AT_ONCE):
            part = np.concatenate(arrays[first : first + _AT_ONCE])
            if kind == torch.int16:
                part = np.minimum(part, int(RANGE_M / MILLIMETRE), out=part).view(np.int16)
            rows[filled : filled + len(part)] = torch.from_numpy(part)
            filled += len(part)
        return rows

    def _cut(self, slots: "_Slots", length: int) -> TrainingWindow:
        ticks = self._lengths[slots.episode]
        beyond = slots.position[:, None] + np.arange(length)
        rows = np.minimum(beyond, ticks[:, None] - 1)
        frame = np.take_along_axis(slots.frame, rows, 1)
        first, last = np.maximum(frame[:, 0], 0), np.maximum(frame[:, -1], 0)
        span = int((last - first).max()) + 1
        wanted = (
            np.minimum(first[:, None] + np.arange(span), last[:, None])
            + self._first_frame[slots.episode, None]
        )
        tick = self._to((rows + self._first_tick[slots.episode, None]).T)
        return TrainingWindow(
            image=self._images(self._to(wanted)),
            in_use=self._to(np.where(frame >= 0, frame - first[:, None] + 1, 0).T),
            age=self._to(np.take_along_axis(slots.age_s, rows, 1).T),
            new=self._to(np.take_along_axis(slots.new, rows, 1).T),
            proprioception=self._proprioception[tick],
            height=self._height[tick],
            valid=self._to((beyond < ticks[:, None]).T.astype(np.float32)),
            true_depth=self._to(self._true_depth[slots.episode]),
            starts=self._to(slots.starts),
        )

    def _images(self, wanted: Tensor) -> Tensor:
        millimetres = self._depth[wanted]
        blank = torch.zeros_like(millimetres[:, :1])
        image: Tensor = model_image(torch.cat((blank, millimetres), 1))
        return image

    def _to(self, array: np.ndarray) -> Tensor:
        """A copy on the device; a GPU is not waited for."""
        tensor = torch.from_numpy(np.array(array, order="C"))
        if self.device.type != "cuda":
            return tensor.to(self.device)
        return tensor.pin_memory().to(self.device, non_blocking=True)


class _Slots:
    """Robots on their way through episodes of at most `longest` ticks, in rows."""

    def __init__(self, batch: int, longest: int) -> None:
        self.episode = np.zeros(batch, np.int64)
        self.position = np.zeros(batch, np.int64)
        self.starts = np.zeros(batch, np.bool_)
        """True where a robot begins with an empty hidden state: in a new episode, or where it was
        emptied on the way."""
        self.frame = np.zeros((batch, longest), np.int64)
        """Images as they are delivered, see `saltus.heightmap.data.delivery.DeliveredImages`, as
        the two that follow."""
        self.age_s = np.zeros((batch, longest), np.float32)
        self.new = np.zeros((batch, longest), np.float32)


def run_window(
    model: HeightmapModel, window: TrainingWindow, hidden: Tensor
) -> tuple[HeightEstimate, Tensor]:
    """Runs a window; robots that begin a new episode begin with an empty hidden state."""
    batch, images = window.image.shape[:2]
    encoded = model.encode(window.image.flatten(0, 1)).unflatten(0, (batch, images))
    rows = torch.arange(batch, device=hidden.device)
    in_use = encoded[rows, window.in_use]  # (time, batch, features)
    hidden = torch.where(window.starts[:, None], 0.0, hidden)
    return model.ticks(in_use, window.age, window.new, window.proprioception, hidden)


def with_noise(
    image: Tensor, noise: ImageNoise, generator: torch.Generator, true_depth: Tensor | None = None
) -> Tensor:
    """Adds what a stereo camera does to depth:
    error growing with depth, holes at edges and elsewhere.

    Args:
        image: Depth in [0, 1] and validity, shape (batch, images, 2, 48, 16).
        noise: Bounds; each robot of the batch gets its own share of them.
        generator: On the device of `image`.
        true_depth: Robots whose images have no errors of stereo matching yet, bool, shape (batch,);
            all by default.
    """

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, device=image.device)

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=generator, device=image.device)

    batch, images, _, height, width = image.shape
    one = (batch, 1, 1, 1)
    # Whether its errors are still to come
    stereo = 1.0 if true_depth is None else true_depth.float().reshape(one)
    depth, valid = image[:, :, 0], image[:, :, 1]
    metres = depth * RANGE_M
    noisy = metres * (1.0 + noise.scale * normal(*one))
    if noise.disparity > 0.0:
        white = normal(batch, images, height, width)
        # Still unit variance
        smooth = 3.0 * functional.avg_pool2d(normal(batch, images, height, width), 3, 1, 1)
        noisy = noisy + noise.disparity * stereo * uniform(*one) * metres.square() * (
            0.6 * white + 0.8 * smooth
        )
    lost = uniform(batch, images, height, width) < noise.pixel_loss * uniform(*one).square()
    if noise.edge_loss > 0.0:
        share = noise.edge_loss * stereo * uniform(*one)
        lost |= _edges(metres) & (uniform(batch, images, height, width) < share)
    lost |= _patches(batch, images, noise.patch_loss, uniform)
    valid = valid * ~lost
    # "Nothing within range" stays what it is.
    noisy = torch.where(depth >= 1.0, 1.0, (noisy / RANGE_M).clamp(0.0, 1.0))
    return torch.stack((torch.where(valid > 0, noisy, 1.0), valid), 2)


def _patches(batch: int, images: int, share: float, uniform: Callable[..., Tensor]) -> Tensor:
    """Rectangles that are lost in a share of images, bool, shape (batch, images, 48, 16)."""
    height, width = IMAGE_SHAPE[1:]
    top, left = uniform(batch, images, 1) * height, uniform(batch, images, 1) * width
    rows, columns = (torch.arange(n, device=top.device) for n in (height, width))
    in_rows = (rows >= top) & (rows < top + _PATCH[0] * uniform(batch, images, 1))
    in_columns = (columns >= left) & (columns < left + _PATCH[1] * uniform(batch, images, 1))
    return in_rows[..., None] & in_columns[..., None, :] & (uniform(batch, images, 1, 1) < share)


def _edges(metres: Tensor) -> Tensor:
    """Pixels with a neighbour at a very different depth, shape as `metres`."""
    farthest, nearest = metres, metres
    for axis in (-2, -1):
        farthest, nearest = (
            _widened(farthest, torch.maximum, axis),
            _widened(nearest, torch.minimum, axis),
        )
    return farthest - nearest > _EDGE_M


def _widened(values: Tensor, chosen: Callable[[Tensor, Tensor], Tensor], axis: int) -> Tensor:
    """Choice of each value and its two neighbours along an axis.

    Pooling takes twice the time on processors.
    """
    count = values.shape[axis]
    result = values.clone()
    for here, there in ((1, 0), (0, 1)):
        part = result.narrow(axis, here, count - 1)
        part.copy_(chosen(part, values.narrow(axis, there, count - 1)))
    return result
