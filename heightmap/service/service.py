"""The heightmap service: robot states and depth frames in, one heightmap with a status for every state out."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saltus.depth import MODEL_CAMERA, intrinsics_of, model_image
from saltus.grid import HEIGHTMAP_X
from saltus.heightmap.service.features import proprioception_of
from saltus.heightmap.service.frame_loss import WINDOW_NS, FrameLoss
from saltus.heightmap.service.frozen_output import FrozenOutput
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.sight import (
    BAD_OUTPUTS_TO_FORGET,
    Sight,
    Tick,
    TickInputs,
)
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus, RobotState
from saltus.wire.topics import TOPICS, Topic

NO_FRAME = -1
DEGRADED_INVALID_PIXELS = 0.3
MAX_FUTURE_S = 0.005  # clocks of one machine agree; more than this is not a clock that can be trusted
DEGRADED_LOST_SHARE = 0.2  # of the images of the last second; the model is trained with 8 % at most
LOSS_MARGIN_S = 0.020
"""Two ticks of 100 Hz: an image may have arrived a tick before it is taken, and what would be too late at the next tick
is said at this one."""

DEPTH = TOPICS["camera/depth"]
_TRUST = (HeightmapStatus.OK, HeightmapStatus.DEGRADED, HeightmapStatus.WARMING, HeightmapStatus.INVALID)
"""From good to bad, unlike their numbers: heights of poor images are of some use, of an empty hidden state of none."""
_BLANK = np.zeros((1, MODEL_CAMERA.height, MODEL_CAMERA.width), np.uint16)
_ONE = np.ones(1, np.bool_)
_DEGRADED_LOST = DEGRADED_LOST_SHARE * DEPTH.rate_hz * 1e-9 * WINDOW_NS


@dataclass(frozen=True, eq=False)
class _View:
    """An image that has arrived."""

    invalid_fraction: float
    time_ns: int
    frame_id: int
    arrival_ns: int


class HeightmapService:
    """Holds the hidden state of one robot; one call of `step` for each robot state. Services may share a network.

    It is the `saltus.heightmap.service.sight.Sight` of one robot, with statuses. The service ignores
    duplicates, frames older than the one in use, frames from the future, and frames that are older
    than `depth` allows.
    """

    def __init__(self, network: HeightmapNetwork, depth: Topic = DEPTH) -> None:
        self._network, self._depth = network, depth
        self._sight = Sight(network, _BLANK)
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
        """True where the hidden state has seen as many images as the model needs, whatever their status."""
        return bool(self._sight.images_seen[0] >= self._network.warmup_frames)

    @property
    def bad_outputs(self) -> int:
        """Number of outputs of the network in a row that were not plausible."""
        return int(self._sight.bad_outputs[0])

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
        self._loss = FrameLoss()
        self._sight.reset(_ONE)

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
        return self.finish(state, inputs, self._network.tick(*inputs), now_ns)

    def prepare(self, state: RobotState, frame: DepthFrame | None, now_ns: int) -> TickInputs | None:
        """First part of `step`: takes the frame in and says what the network is to be given.

        None where the state was answered already, by `last`.
        """
        if self._last is not None and state.step <= self._last.step:
            return None
        if self._started_ns is None:
            self._started_ns = now_ns
        new = ~_ONE if frame is None else self._accept(frame, now_ns)
        features = proprioception_of(state, self._network.legs)[None]
        return self._sight.inputs(self._time_s(state.time_ns), new, features)

    def finish(self, state: RobotState, inputs: TickInputs, tick: Tick, now_ns: int) -> Heightmap:
        """Second part of `step`: judges what the network made of `inputs`, and answers."""
        if self._sight.judge(tick)[0]:
            status = self._input_status(state, now_ns)
            if self._frozen.step(inputs, tick, state.time_ns):
                status = worse(status, HeightmapStatus.DEGRADED)
        else:
            status = self._status_of_bad_output(state, now_ns)
        self._last = self._heightmap(state, status)
        return self._last

    def _time_s(self, time_ns: int) -> float:
        """A time on the clock of `Sight`, which begins where the service did: so it is exact to the nanosecond."""
        return 1e-9 * (time_ns - (self._started_ns or 0))

    def _accept(self, frame: DepthFrame, now_ns: int) -> NDArray[np.bool_]:
        """Takes a frame in if it is news; whether it is in use now, shape (1,)."""
        age_s = (now_ns - frame.time_ns) * 1e-9
        if not -MAX_FUTURE_S <= age_s <= self._depth.invalid_age_s:
            return ~_ONE
        newest = self._newest
        if newest is not None and (frame.frame_id == newest.frame_id or frame.time_ns <= newest.time_ns):
            return ~_ONE
        image = model_image(frame.depth, intrinsics_of(frame), frame.depth_unit_m)
        invalid_fraction = 1.0 - np.count_nonzero(image[1]) / image[1].size
        self._newest = _View(invalid_fraction, frame.time_ns, frame.frame_id, now_ns)
        new, forgets = self._sight.show(_ONE, image[None], np.array([self._time_s(frame.time_ns)]))
        if new[0]:
            self._view = self._newest
        if forgets[0]:
            self._loss = FrameLoss()  # what was lost before does not count for a state that begins now
        self._loss.accept(frame.frame_id, frame.time_ns)
        return new

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

    def _status_of_bad_output(self, state: RobotState, now_ns: int) -> HeightmapStatus:
        """Status of bad output of heights that stand in for those of an output that cannot be used."""
        if self.bad_outputs < BAD_OUTPUTS_TO_FORGET and self._last is not None:
            return worse(HeightmapStatus.DEGRADED, self._input_status(state, now_ns))
        if self.bad_outputs == BAD_OUTPUTS_TO_FORGET:
            self._loss = FrameLoss()
        return HeightmapStatus.INVALID

    def _heightmap(self, state: RobotState, status: HeightmapStatus) -> Heightmap:
        view = self._view
        return Heightmap(
            time_ns=state.time_ns,
            step=state.step,
            x=HEIGHTMAP_X,
            height=self._sight.height[0],
            half_width_90=self._sight.half_width_90[0],
            status=status,
            depth_age_s=math.inf if view is None else (state.time_ns - view.time_ns) * 1e-9,
            frame_id=NO_FRAME if view is None else view.frame_id,
            model_id=self._network.model_id,
        )


def worse(one: HeightmapStatus, other: HeightmapStatus) -> HeightmapStatus:
    """The one of two that is less to be trusted."""
    return max(one, other, key=_TRUST.index)
