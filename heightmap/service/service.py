"""The heightmap service: robot states and depth frames in, one heightmap with a status for every state out."""

import math
from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Singles
from saltus.depth import MODEL_CAMERA, intrinsics_of, model_image
from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.service.features import proprioception_of
from saltus.heightmap.service.frame_loss import WINDOW_NS, FrameLoss
from saltus.heightmap.service.frozen_output import FrozenOutput
from saltus.heightmap.service.network import HeightmapNetwork, Inputs, Tick
from saltus.heightmap.service.quantiles import INTERVAL90, UNKNOWN_HALF_WIDTH_M
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus, RobotState
from saltus.wire.topics import TOPICS, Topic

MAX_HEIGHT_M = 2.0  # ditches that a robot jumps over are up to 1 m deep, its base up to 0.6 m above their rims
MAX_HIDDEN = 1.0 + 1e-5  # each entry of a GRU's state is a weighted mean of values in (-1, 1)
NO_FRAME = -1
BAD_OUTPUTS_TO_INVALID = 3  # at 100 Hz: one bad output is bridged, three are a fault
DEGRADED_INVALID_PIXELS = 0.3
INVALID_INVALID_PIXELS = 0.8
MAX_MISSED_FRAMES = 5  # after a longer gap the hidden state no longer fits where the robot is
MAX_FUTURE_S = 0.005  # clocks of one machine agree; more than this is not a clock that can be trusted
DEGRADED_LOST_SHARE = 0.2  # of the images of the last second; the model is trained with 8 % at most
LOSS_MARGIN_S = 0.020
"""Two ticks of 100 Hz: an image may have arrived a tick before it is taken, and what would be too late at the next tick
is said at this one."""

DEPTH = TOPICS["camera/depth"]
LONGEST_GAP_S = (MAX_MISSED_FRAMES + 1.5) / DEPTH.rate_hz
"""Between two images that are used: after a longer one the hidden state is emptied."""
_TRUST = (HeightmapStatus.OK, HeightmapStatus.DEGRADED, HeightmapStatus.WARMING, HeightmapStatus.INVALID)
"""From good to bad, unlike their numbers: heights of poor images are of some use, of an empty hidden state of none."""
_BLANK = model_image(np.zeros((MODEL_CAMERA.height, MODEL_CAMERA.width), np.uint16))
"""What the network sees before the first frame: nothing valid."""
_DEGRADED_LOST = DEGRADED_LOST_SHARE * DEPTH.rate_hz * 1e-9 * WINDOW_NS


@dataclass(frozen=True, eq=False)
class _View:
    """An image that has arrived."""

    image: Singles
    """Depth and validity, shape (2, 48, 16)."""
    invalid_fraction: float
    time_ns: int
    frame_id: int
    arrival_ns: int


class HeightmapService:
    """Holds the hidden state of one robot; one call of `step` for each robot state. Services may share a network.

    The service ignores duplicates, frames older than the one in use, frames from the future, and frames that are older
    than `depth` allows. It keeps the last image where the new one has hardly a valid pixel. It replaces the hidden
    state only by one that is finite and plausible; `bad_outputs` is how many in a row were not.
    """

    _hidden: Singles

    def __init__(self, network: HeightmapNetwork, depth: Topic = DEPTH) -> None:
        self._network, self._depth = network, depth
        self._low, self._high = _bounds(self._network.hidden_size)
        self.reset()

    @property
    def model_id(self) -> str:
        """First 16 hexadecimal digits of the model file's sha256."""
        return self._network.model_id

    @property
    def network(self) -> HeightmapNetwork:
        """The network that is to be run between `prepare` and `finish`."""
        return self._network

    @property
    def warm(self) -> bool:
        """Whether the hidden state has seen as many images as the model needs, whatever the status of the last ones."""
        return self._frames >= self._network.warmup_frames

    @property
    def hidden(self) -> Singles:
        """The state of the GRU, shape (hidden size,)."""
        return self._hidden

    @property
    def last(self) -> Heightmap | None:
        """The newest answer."""
        return self._last

    def reset(self) -> None:
        """Forgets everything: for a robot that has started anew."""
        self._view: _View | None = None  # what the network is shown
        self._newest: _View | None = None  # the same, unless hardly a pixel of it is valid
        self._started_ns: int | None = None
        self._last: Heightmap | None = None
        self._frozen = FrozenOutput()
        self._forget()

    def new_camera(self) -> None:
        """Counts images anew, of a camera that has started anew. What was seen holds on: pauses are judged as ever."""
        if self._newest is not None:
            renumbered = replace(self._newest, frame_id=NO_FRAME)
            self._view = renumbered if self._view is self._newest else self._view
            self._newest = renumbered
        self._loss = FrameLoss()

    def step(self, state: RobotState, frame: DepthFrame | None, now_ns: int) -> Heightmap:
        """Advances by one tick; returns the heightmap at the time of `state`, an old answer for a state that has one.

        Args:
            state: Of the robot.
            frame: A frame that has arrived since the last call; None where none has.
            now_ns: The run's clock.
        """
        inputs = self.prepare(state, frame, now_ns)
        if inputs is None:
            assert self._last is not None  # noqa: S101 - only a state that was answered needs no inputs
            return self._last
        return self.finish(state, inputs, self._network.tick(*inputs, self._hidden), now_ns)

    def prepare(self, state: RobotState, frame: DepthFrame | None, now_ns: int) -> Inputs | None:
        """First part of `step`: takes the frame in and says what the network is to be given, beside `hidden`.

        None where the state was answered already, by `last`.
        """
        if self._last is not None and state.step <= self._last.step:
            return None
        if self._started_ns is None:
            self._started_ns = now_ns
        new = frame is not None and self._accept(frame, now_ns)
        features = proprioception_of(state, self._network.legs)
        if self._view is None:
            return Inputs(_BLANK, math.inf, False, features)
        age_s = max(0.0, (state.time_ns - self._view.time_ns) * 1e-9)
        return Inputs(self._view.image, age_s, new, features)

    def finish(self, state: RobotState, inputs: Inputs, tick: Tick, now_ns: int) -> Heightmap:
        """Second part of `step`: judges what the network made of `inputs` and `hidden`, and answers."""
        if self._plausible(tick):
            self._hidden = tick.hidden
            self.bad_outputs = 0
            status = self._input_status(state, now_ns)
            if self._frozen.step(inputs, tick, state.time_ns):
                status = worse(status, HeightmapStatus.DEGRADED)
            heightmap = self._heightmap(state, tick, status)
        else:
            heightmap = self._hold(state, now_ns)
        self._last = heightmap
        return heightmap

    def _plausible(self, tick: Tick) -> bool:
        """No comparison with NaN is true, so that this also asks for finite numbers."""
        values = np.concatenate(tick)
        inside = values >= self._low
        inside &= values <= self._high
        return np.count_nonzero(inside) == inside.size

    def _forget(self) -> None:
        self._hidden = np.zeros(self._network.hidden_size, np.float32)
        self._frames = 0
        self._loss = FrameLoss()  # what was lost before does not count for a state that begins now
        self.bad_outputs = 0

    def _accept(self, frame: DepthFrame, now_ns: int) -> bool:
        """Takes a frame into use if it is news."""
        age_s = (now_ns - frame.time_ns) * 1e-9
        if not -MAX_FUTURE_S <= age_s <= self._depth.invalid_age_s:
            return False
        newest = self._newest
        if newest is not None and (frame.frame_id == newest.frame_id or frame.time_ns <= newest.time_ns):
            return False
        image = model_image(frame.depth, intrinsics_of(frame), frame.depth_unit_m)
        invalid_fraction = 1.0 - np.count_nonzero(image[1]) / image[1].size
        self._newest = _View(image, invalid_fraction, frame.time_ns, frame.frame_id, now_ns)
        blind = self._newest.invalid_fraction > INVALID_INVALID_PIXELS
        if not blind:
            gap_s = 0.0 if self._view is None else (frame.time_ns - self._view.time_ns) * 1e-9
            if gap_s > LONGEST_GAP_S:
                self._forget()
            self._view = self._newest
            self._frames += 1
        self._loss.accept(frame.frame_id, frame.time_ns)
        return not blind

    def _input_status(self, state: RobotState, now_ns: int) -> HeightmapStatus:
        """The worst of what is known about the input."""
        extra = self._depth.max_extra_age_s
        newest, view = self._newest, self._view
        if newest is None:
            waiting_s = (now_ns - (self._started_ns or 0)) * 1e-9
            return HeightmapStatus.INVALID if waiting_s > self._depth.invalid_age_s else HeightmapStatus.WARMING
        if view is None or view is not newest:
            return HeightmapStatus.INVALID
        age_s = (max(now_ns, state.time_ns) - view.time_ns) * 1e-9
        silent_s = (now_ns - view.arrival_ns) * 1e-9
        if age_s > self._depth.invalid_age_s or silent_s > extra - LOSS_MARGIN_S:
            return HeightmapStatus.INVALID
        if not self.warm:
            return HeightmapStatus.WARMING
        late = age_s > self._depth.degraded_age_s or silent_s > 0.5 * extra
        patchy = view.invalid_fraction > DEGRADED_INVALID_PIXELS or self._loss.count(now_ns) > _DEGRADED_LOST
        return HeightmapStatus.DEGRADED if late or patchy else HeightmapStatus.OK

    def _hold(self, state: RobotState, now_ns: int) -> Heightmap:
        """Answers in place of an output that cannot be used: the hidden state stays as it was."""
        self.bad_outputs += 1
        status = worse(HeightmapStatus.DEGRADED, self._input_status(state, now_ns))
        if self.bad_outputs >= BAD_OUTPUTS_TO_INVALID or self._last is None:
            status = HeightmapStatus.INVALID
        if self.bad_outputs >= BAD_OUTPUTS_TO_INVALID:
            self._forget()
            self.bad_outputs = BAD_OUTPUTS_TO_INVALID  # INVALID until an output is good again
        if self._last is not None:
            return replace(
                self._heightmap(state, None, status), height=self._last.height, half_width_90=self._last.half_width_90
            )
        return self._heightmap(state, None, status)

    def _heightmap(self, state: RobotState, tick: Tick | None, status: HeightmapStatus) -> Heightmap:
        view = self._view
        unknown = np.zeros(len(HEIGHTMAP_X), np.float32)
        return Heightmap(
            time_ns=state.time_ns,
            step=state.step,
            x=HEIGHTMAP_X,
            height=unknown if tick is None else tick.height,
            half_width_90=unknown + UNKNOWN_HALF_WIDTH_M if tick is None else tick.half_width_90,
            status=status,
            depth_age_s=math.inf if view is None else (state.time_ns - view.time_ns) * 1e-9,
            frame_id=NO_FRAME if view is None else view.frame_id,
            model_id=self._network.model_id,
        )


def worse(one: HeightmapStatus, other: HeightmapStatus) -> HeightmapStatus:
    """That of the two which is less to be trusted."""
    return max(one, other, key=_TRUST.index)


def _bounds(hidden_size: int) -> tuple[Singles, Singles]:
    """Within what the outputs of a tick are plausible, one after the other."""
    sizes = (len(HEIGHTMAP_X), len(HEIGHTMAP_X), hidden_size)
    low = np.repeat(np.array((-MAX_HEIGHT_M, np.finfo(np.float32).tiny, -MAX_HIDDEN), np.float32), sizes)
    return low, np.repeat(np.array((MAX_HEIGHT_M, INTERVAL90 * MAX_HEIGHT_M, MAX_HIDDEN), np.float32), sizes)
