"""Sight of robots: the images in use, what the network remembers, and heights that can be used.

One law for one robot or thousands, on numpy or torch: the heightmap service is it for one, with
statuses; roll-outs on processors and on a device are it for a batch.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np

from saltus.arrays import Array, namespace
from saltus.depth import MODEL_CAMERA, model_image
from saltus.effects.signals import DepthImage
from saltus.heightmap.service.quantiles import INTERVAL90, UNKNOWN_HALF_WIDTH_M
from saltus.wire.topics import TOPICS

MAX_HEIGHT_M = 2.0
"""Ditches that a robot jumps over are up to 1 m deep, its base up to 0.6 m above their rims."""
MAX_HIDDEN = 1.0 + 1e-5
"""Each entry of a GRU's state is a weighted mean of values in (-1, 1)."""
BAD_OUTPUTS_TO_FORGET = 3
"""At 100 Hz: one bad output is bridged, three are a fault."""
BLIND_INVALID_PIXELS = 0.8
"""An image with a larger share of them is not used: the last one is better."""
MAX_MISSED_FRAMES = 5
"""After a longer gap the hidden state no longer fits where the robot is."""
LONGEST_GAP_S = (MAX_MISSED_FRAMES + 1.5) / TOPICS["camera/depth"].rate_hz
"""Between two images that are used: after a longer one the hidden state is emptied."""
_FEWEST_PIXELS = (1.0 - BLIND_INVALID_PIXELS) * MODEL_CAMERA.height * MODEL_CAMERA.width
_ROUNDING_S = 1e-6  # times that are meant to be equal may differ by rounding


class NetworkInputs(NamedTuple):
    """Inputs of the line's heightmap network for one tick of n robots."""

    image: Array
    """See `saltus.depth.model_image`, shape (n, 2, 48, 16)."""
    age_s: Array
    """Age of these images [s], shape (n,); infinite before the first."""
    new: Array
    """True where they were not in use a tick ago, bool, shape (n,)."""
    features: Array
    """See `saltus.heightmap.service.proprioception_vector`, shape (n, some)."""
    hidden: Array
    """State of the network, shape (n, hidden size)."""


class NetworkOutputs(NamedTuple):
    """Outputs of the line's heightmap network for n robots, in one array; not checked."""

    values: Array
    """Heights, half widths and hidden state of each robot, shape (n, 2 points + hidden size)."""
    points: int

    @classmethod
    def of(cls, height: Array, half_width_90: Array, hidden: Array) -> "NetworkOutputs":
        """Joins outputs that are arrays of their own."""
        values = namespace(height).concat((height, half_width_90, hidden), axis=-1)
        return cls(values, height.shape[-1])

    @property
    def height(self) -> Array:
        """[m], shape (n, points)."""
        return self.values[:, : self.points]

    @property
    def half_width_90(self) -> Array:
        """Half width 90 of each height, half of the interval that holds 90 % of the errors [m],
        shape (n, points).
        """
        return self.values[:, self.points : 2 * self.points]

    @property
    def hidden(self) -> Array:
        """Shape (n, hidden size)."""
        return self.values[:, 2 * self.points :]


class Network(Protocol):
    """Anything that tells heights from images and remembers, as the line's network does."""

    hidden_size: int
    points: int
    """Number of heights that the network tells."""

    def tick(
        self, image: Array, age_s: Array, new: Array, features: Array, hidden: Array
    ) -> NetworkOutputs:
        """One tick of many robots; arguments are those of `NetworkInputs`."""
        ...


class Sight:
    """Images in use, hidden states and heights of n robots.

    A tick is `step`, or, where others run the network, its parts in turn: `reset`, `show`, `inputs`
    and `judge`. Times are those of one clock, and arrays are replaced, never changed in place.

    Args:
        network: Of all robots.
        blank: Images by whose number, library and device all arrays are, shape (n, 48, 16); what is
            in them is not looked at.
    """

    def __init__(self, network: Network, blank: Array) -> None:
        self.network = network
        xp, count, device = namespace(blank), len(blank), blank.device
        points, size = (count, network.points), (count, network.hidden_size)
        self._blank = model_image(xp.zeros_like(blank))
        low, high = _bounds(network.points, network.hidden_size)
        self._low, self._high = xp.asarray(low, device=device), xp.asarray(high, device=device)
        self.image = self._blank
        """Image that each network is shown: the newest, unless hardly a pixel of it was valid."""
        self.captured_s = xp.full(count, -math.inf, dtype=xp.float64, device=device)
        """When these were taken [s], shape (n,); minus infinity before the first."""
        self.images_seen = xp.zeros(count, dtype=xp.int64, device=device)
        """Images used since a state was last emptied, shape (n,)."""
        self._none = xp.zeros(count, dtype=xp.int64, device=device)
        self.bad_outputs = self._none
        """Outputs in a row that were not plausible, up to `BAD_OUTPUTS_TO_FORGET`, shape (n,)."""
        self.hidden = xp.zeros(size, dtype=xp.float32, device=device)
        self.height = xp.zeros(points, dtype=xp.float32, device=device)
        """The last plausible heights [m], shape (n, points); 0 before the first."""
        self.half_width_90 = xp.full_like(self.height, UNKNOWN_HALF_WIDTH_M)
        """Half of their 90 % intervals [m], shape (n, points)."""

    def step(
        self,
        arrived: Array,
        in_hand: DepthImage,
        time_s: float,
        features: Array,
        fresh: Array,
    ) -> Array:
        """One tick of all robots.

        Args:
            arrived: Whose image in hand has just come, bool, shape (n,).
            in_hand: The newest images that have arrived [mm], shape (n, 48, 16).
            time_s: Now.
            features: See `NetworkInputs`.
            fresh: Robots that start anew, bool, shape (n,): what they saw is void.

        Returns:
            `height`.
        """
        self.reset(fresh)
        new, _ = self.show(arrived, model_image(in_hand.depth), in_hand.time_s)
        self.judge(self.network.tick(*self.inputs(time_s, new, features)))
        return self.height

    def reset(self, fresh: Array) -> None:
        """Forgets everything of some robots, bool, shape (n,)."""
        xp = namespace(fresh)
        self.image = xp.where(fresh[:, None, None, None], self._blank, self.image)
        self.captured_s = xp.where(fresh, -math.inf, self.captured_s)
        self.bad_outputs = xp.where(fresh, 0, self.bad_outputs)
        self.height = xp.where(fresh[:, None], 0.0, self.height)
        self.half_width_90 = xp.where(fresh[:, None], UNKNOWN_HALF_WIDTH_M, self.half_width_90)
        self._empty(fresh)

    def show(self, arrived: Array, image: Array, captured_s: Array) -> tuple[Array, Array]:
        """Takes in images that have arrived, later ones than those before; no others.

        Args:
            arrived: For whom one has, bool, shape (n,).
            image: See `saltus.depth.model_image`, shape (n, 2, 48, 16).
            captured_s: When it was taken [s], shape (n,).

        Returns:
            Whose image in use is new, and whose hidden state was emptied, as nothing had come for
            too long; bool, shape (n,).
        """
        xp = namespace(image)
        new = arrived & (image[:, 1].sum((-2, -1)) >= _FEWEST_PIXELS)
        too_late = captured_s > self.captured_s + (LONGEST_GAP_S + _ROUNDING_S)
        forgets = new & too_late & (self.captured_s > -math.inf)
        self._empty(forgets)
        self.images_seen = self.images_seen + new
        if xp is np and new.all():  # the usual case of one robot: nothing need be chosen
            self.captured_s, self.image = captured_s, image
            return new, forgets
        self.captured_s = xp.where(new, captured_s, self.captured_s)
        self.image = xp.where(new[:, None, None, None], image, self.image)
        return new, forgets

    def inputs(self, time_s: float, new: Array, features: Array) -> NetworkInputs:
        """Returns what the network is to be given at a time; `new` is what `show` returned."""
        age_s = namespace(new).maximum(time_s - self.captured_s, 0.0)
        return NetworkInputs(self.image, age_s, new, features, self.hidden)

    def judge(self, tick: NetworkOutputs) -> Array:
        """Takes in what the network made of the inputs, where it is plausible.

        Elsewhere heights and hidden state stay as they were; after three such outputs in a row
        states are emptied.

        Returns:
            Whose output was plausible, bool, shape (n,).
        """
        values = tick.values
        xp = namespace(values)
        # no comparison with NaN is true, so that this also asks for finite numbers
        plausible = (values >= self._low) & (values <= self._high)
        if xp is np and plausible.all():  # nearly always; of a GPU this is not asked, as that waits
            self.height, self.half_width_90 = tick.height, tick.half_width_90
            self.hidden, self.bad_outputs = tick.hidden, self._none
            return plausible[:, 0]  # as good as any column
        good = xp.all(plausible, axis=-1)
        self.height = xp.where(good[:, None], tick.height, self.height)
        self.half_width_90 = xp.where(good[:, None], tick.half_width_90, self.half_width_90)
        self.hidden = xp.where(good[:, None], tick.hidden, self.hidden)
        self.bad_outputs = xp.where(good, 0, (self.bad_outputs + 1).clip(max=BAD_OUTPUTS_TO_FORGET))
        self._empty(self.bad_outputs == BAD_OUTPUTS_TO_FORGET)
        return good

    def _empty(self, robots: Array) -> None:
        """Empties the hidden state of some robots, bool, shape (n,)."""
        xp = namespace(robots)
        if xp is np and not robots.any():
            return
        self.hidden = xp.where(robots[:, None], 0.0, self.hidden)
        self.images_seen = xp.where(robots, 0, self.images_seen)


def _bounds(points: int, hidden_size: int) -> tuple[Array, Array]:
    """Within what the outputs of a tick are plausible, one after the other."""
    sizes = (points, points, hidden_size)
    low = np.array((-MAX_HEIGHT_M, np.finfo(np.float32).tiny, -MAX_HIDDEN), np.float32)
    high = np.array((MAX_HEIGHT_M, INTERVAL90 * MAX_HEIGHT_M, MAX_HIDDEN), np.float32)
    return np.repeat(low, sizes), np.repeat(high, sizes)
