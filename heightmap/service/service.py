"""The heightmap service: robot states and depth frames in,
one heightmap with a status for every state out.
"""

import numpy as np
from numpy.typing import NDArray

from saltus.depth import MODEL_CAMERA, model_image
from saltus.heightmap.service.frozen_output import FrozenOutput
from saltus.heightmap.service.image_watch import DEPTH, NO_FRAME, ImageWatch, less_trusted
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.proprioception_vector import proprioception_of
from saltus.heightmap.service.sight import (
    BAD_OUTPUTS_TO_FORGET,
    NetworkInputs,
    NetworkOutputs,
    Sight,
)
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus, RobotState
from saltus.wire.topics import Topic

_BLANK = np.zeros((1, MODEL_CAMERA.height, MODEL_CAMERA.width), np.uint16)
_ONE = np.ones(1, np.bool_)


class HeightmapService:
    """Predicts the line of heights of one robot, whose hidden state it holds; one call of `step`
    for each robot state.

    Services may share a network.

    It is the `saltus.heightmap.service.sight.Sight` of one robot, with statuses. The service
    ignores duplicates, frames older than the one in use, frames from the future, and frames that
    are older than `depth` allows.
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
        """True where the hidden state has seen as many images as the model needs,
        whatever their status.
        """
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
        self._images = ImageWatch(self._depth)
        self._started_ns: int | None = None
        self._last: Heightmap | None = None
        self._frozen = FrozenOutput()
        self._sight.reset(_ONE)

    def new_camera(self) -> None:
        """Counts images anew, of a camera that has started anew.

        What was seen holds on: pauses are judged as ever.
        """
        self._images.new_camera()

    def step(self, state: RobotState, frame: DepthFrame | None, now_ns: int) -> Heightmap:
        """Advances by one tick.

        Returns the heightmap at the time of `state`, an old answer for a state that has one.

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

    def prepare(
        self, state: RobotState, frame: DepthFrame | None, now_ns: int
    ) -> NetworkInputs | None:
        """First part of `step`: takes the frame in and says what the network is to be given.

        None where the state was answered already, by `last`.
        """
        if self._last is not None and state.step <= self._last.step:
            return None
        if self._started_ns is None:
            self._started_ns = now_ns
        self._images.begin(now_ns)
        new = ~_ONE if frame is None else self._accept(frame, now_ns)
        features = proprioception_of(state, self._network.legs)[None]
        return self._sight.inputs(self._time_s(state.time_ns), new, features)

    def finish(
        self, state: RobotState, inputs: NetworkInputs, tick: NetworkOutputs, now_ns: int
    ) -> Heightmap:
        """Second part of `step`: judges what the network made of `inputs`, and answers."""
        if self._sight.judge(tick)[0]:
            status = self._input_status(state, now_ns)
            if self._frozen.step(inputs, tick, state.time_ns):
                status = less_trusted(status, HeightmapStatus.DEGRADED)
        else:
            status = self._status_of_bad_output(state, now_ns)
        self._last = self._heightmap(state, status)
        return self._last

    def _time_s(self, time_ns: int) -> float:
        """A time on the clock of `Sight`, which begins where the service did:
        so it is exact to the nanosecond.
        """
        return 1e-9 * (time_ns - (self._started_ns or 0))

    def _accept(self, frame: DepthFrame, now_ns: int) -> NDArray[np.bool_]:
        """Takes a frame in if it is news; whether it is in use now, shape (1,)."""
        if not self._images.is_news(frame, now_ns):
            return ~_ONE
        image = model_image(frame.depth, frame, frame.depth_unit_m)
        invalid_fraction = 1.0 - np.count_nonzero(image[1]) / image[1].size
        new, forgets = self._sight.show(_ONE, image[None], np.array([self._time_s(frame.time_ns)]))
        if forgets[0]:
            self._images.forgive()
        self._images.take(frame, invalid_fraction, now_ns, used=bool(new[0]))
        return new

    def _input_status(self, state: RobotState, now_ns: int) -> HeightmapStatus:
        return self._images.status(state.time_ns, now_ns, warm=self.warm)

    def _status_of_bad_output(self, state: RobotState, now_ns: int) -> HeightmapStatus:
        """Status of bad output of heights that stand in
        for those of an output that cannot be used.
        """
        if self.bad_outputs < BAD_OUTPUTS_TO_FORGET and self._last is not None:
            return less_trusted(HeightmapStatus.DEGRADED, self._input_status(state, now_ns))
        if self.bad_outputs == BAD_OUTPUTS_TO_FORGET:
            self._images.forgive()
        return HeightmapStatus.INVALID

    def _heightmap(self, state: RobotState, status: HeightmapStatus) -> Heightmap:
        view = self._images.view
        return Heightmap(
            time_ns=state.time_ns,
            step=state.step,
            x=self._network.x,
            height=self._sight.height[0],
            half_width_90=self._sight.half_width_90[0],
            status=status,
            depth_age_s=self._images.age_s(state.time_ns),
            frame_id=NO_FRAME if view is None else view.frame_id,
            model_id=self._network.model_id,
        )
