"""The heightmap network: a small CNN reads the newest depth image,
a GRU keeps what has left the view.

One call of `step` is one tick at 100 Hz. Beyond the paper's network (original: channels 2, 4, 8,
one GRU layer of 256, three hidden layers of 256 with ELU) it sees which pixels are valid and how
old its image is, and states an interval for every height. Normalisation is part of it: whoever runs
it hands over plain SI units.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from saltus.heightmap.service.quantiles import INTERVAL90
from saltus.heightmap.service.sight import NetworkOutputs
from saltus.heightmap.settings import ModelSettings

MAX_IMAGE_AGE_S = 0.5
"""An image older than this looks like one of this age; the service gives up at a third of it."""
MIN_STD_M, MAX_STD_M = 0.0003, 0.5
"""Bounds of what the file calls `std`: of rounding to the depth unit of a D435i, 1 mm.

The deepest trench.
"""
WIDTHS = 13
"""Widths of intervals that are corrected each by its own: one is 1.86 times the one before, from
MIN_STD_M to MAX_STD_M."""
IMAGE_SHAPE = (2, 48, 16)
"""Image shape of `saltus.depth.model_image`."""


class Normalisation(NamedTuple):
    """Mean and standard deviation of a network's input over the training data."""

    proprioception_mean: Tensor
    """Shape (n,), of a predictor n = len(PROPRIOCEPTION)."""
    proprioception_std: Tensor
    height_mean: Tensor
    """Shape (30,); what imitates plans has as many as they have numbers."""
    height_std: Tensor


class HeightEstimate(NamedTuple):
    """Heights and their intervals as the line's network predicts them, per tick."""

    height: Tensor
    """[m] relative to the base, shape (..., 30)."""
    log_std: Tensor
    """Logarithm of what the file calls `std` [m]: half of the 90 % interval is 1.645 times it
    (`saltus.heightmap.service.quantiles`). Shape (..., 30)."""


class HeightmapModel(nn.Module):
    """The line's heightmap network: depth images and proprioception to heights with intervals."""

    proprioception_mean: Tensor
    proprioception_std: Tensor
    height_mean: Tensor
    height_std: Tensor
    correction: Tensor
    """Shape (WIDTHS,): what is added to the logarithm of an interval of each of these widths, and
    in between linearly; see `saltus.heightmap.training.calibration`."""

    def __init__(self, config: ModelSettings, normalisation: Normalisation) -> None:
        super().__init__()
        self.config, self.hidden_size, self.points = (
            config,
            config.hidden,
            len(normalisation.height_mean),
        )
        a, b, c = config.channels
        self.encoder = nn.Sequential(
            nn.Conv2d(IMAGE_SHAPE[0], a, 5),
            nn.LeakyReLU(),
            nn.MaxPool2d(2),
            nn.Conv2d(a, b, 4),
            nn.LeakyReLU(),
            nn.Conv2d(b, c, 3),
            nn.LeakyReLU(),
            nn.Flatten(),
        )
        image_features = c * 17 * 1  # (48, 16) -> 44x12 -> 22x6 -> 19x3 -> 17x1
        self.gru = nn.GRU(
            image_features + 2 + len(normalisation.proprioception_mean), config.hidden
        )
        widths = (config.hidden, *config.head)
        layers: list[nn.Module] = []
        for inputs, outputs in pairwise(widths):
            layers += [nn.Linear(inputs, outputs), nn.ELU()]
        self.head = nn.Sequential(
            *layers, nn.Linear(widths[-1], 2 * len(normalisation.height_mean))
        )
        for name, value in normalisation._asdict().items():
            self.register_buffer(name, value.to(torch.float32).clone())
        self.register_buffer("correction", torch.zeros(WIDTHS))

    def encode(self, image: Tensor) -> Tensor:
        """Features of images of shape (n, 2, 48, 16): (n, features)."""
        return self.encoder(image)

    def ticks(
        self, encoded: Tensor, age: Tensor, new: Tensor, proprioception: Tensor, hidden: Tensor
    ) -> tuple[HeightEstimate, Tensor]:
        """Runs a window of ticks at once.

        Args:
            encoded: `encode` of the image in use at each tick, shape (time, batch, features).
            age: of that image [s], shape (time, batch).
            new: 1 where it was not in use a tick ago, shape (time, batch).
            proprioception: see `saltus.heightmap.service.proprioception_vector`,
                shape (time, batch, n).
            hidden: state before the window, shape (batch, hidden); zero after a reset.

        Returns:
            The estimate of each tick and the hidden state after the window.
        """
        output, last = self.gru(self._inputs(encoded, age, new, proprioception), hidden[None])
        return self._estimate(output), last[0]

    def step(
        self, image: Tensor, age: Tensor, new: Tensor, proprioception: Tensor, hidden: Tensor
    ) -> tuple[HeightEstimate, Tensor]:
        """One tick: the same law as `ticks`, written out for export.

        Images have shape (batch, 2, 48, 16).
        """
        inputs = self._inputs(self.encode(image), age, new, proprioception)
        weight_input, weight_hidden, bias_input, bias_hidden = self.gru.all_weights[0]
        from_input = functional.linear(inputs, weight_input, bias_input)
        from_hidden = functional.linear(hidden, weight_hidden, bias_hidden)
        reset_input, update_input, new_input = from_input.split(self.config.hidden, -1)
        reset_hidden, update_hidden, new_hidden = from_hidden.split(self.config.hidden, -1)
        reset = torch.sigmoid(reset_input + reset_hidden)
        update = torch.sigmoid(update_input + update_hidden)
        candidate = torch.tanh(new_input + reset * new_hidden)
        hidden = candidate + update * (hidden - candidate)
        return self._estimate(hidden), hidden

    @torch.no_grad()
    def tick(
        self, image: Tensor, age: Tensor, new: Tensor, proprioception: Tensor, hidden: Tensor
    ) -> NetworkOutputs:
        """One tick as a file's network answers it, see `saltus.heightmap.service.sight.Network`."""
        estimate, hidden = self.step(image, age.float(), new.float(), proprioception, hidden)
        return NetworkOutputs.of(estimate.height, INTERVAL90 * estimate.log_std.exp(), hidden)

    def _inputs(self, encoded: Tensor, age: Tensor, new: Tensor, proprioception: Tensor) -> Tensor:
        normal = (proprioception - self.proprioception_mean) / self.proprioception_std
        age = age.clamp(0.0, MAX_IMAGE_AGE_S) / MAX_IMAGE_AGE_S
        # A sensor far outside of what was seen in training must not saturate the hidden state.
        return torch.cat((encoded, age[..., None], new[..., None], normal.clamp(-5.0, 5.0)), -1)

    def _estimate(self, hidden: Tensor) -> HeightEstimate:
        mean, log_std = self.head(hidden).split(self.points, -1)
        height = self.height_mean + self.height_std * mean
        least, most = math.log(MIN_STD_M), math.log(MAX_STD_M)
        log_std = (log_std + self.height_std.log()).clamp(least, most)
        width = (log_std - least) * ((WIDTHS - 1) / (most - least))
        near = functional.relu(
            1.0 - (width[..., None] - torch.arange(WIDTHS, device=width.device)).abs()
        )
        return HeightEstimate(height, (log_std + near @ self.correction).clamp(least, most))
