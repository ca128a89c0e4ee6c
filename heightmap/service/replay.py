"""Runs the heightmap service over recorded depth again."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, islice
from typing import Protocol

from saltus.heightmap.level_robot import LevelRobot
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.service import HeightmapService
from saltus.wire.messages import DepthFrame, Heightmap, RobotState
from saltus.wire.topics import CAMERA_LATENCY_S, CAMERA_PERIOD_S, depth_topic


class HeightPredictor(Protocol):
    """Anything that answers each robot state with a heightmap, as a `HeightmapService` does."""

    def step(self, state: RobotState, frame: DepthFrame | None, now_ns: int) -> Heightmap:
        """Advances by one tick; `frame` has arrived since the last call."""
        ...


def replay_frames(
    network: HeightmapNetwork,
    frames: Sequence[DepthFrame],
    states: Sequence[RobotState] | LevelRobot,
    arrival_ns: Sequence[int] | None = None,
) -> list[Heightmap]:
    """The heightmap at every robot state.

    Args:
        network: Of the service.
        frames: In order of capture.
        states: Recorded states, in order of time and in the clock of the frames; or a stand-in,
            which has one state for each frame.
        arrival_ns: When each frame could first be used; 50 ms after its capture, as on the robot,
            where not given. The fastest frame says how late the camera is.

    Returns:
        One heightmap for each state.
    """
    if isinstance(states, LevelRobot):
        states = states.states(network.robot, frames)
    if arrival_ns is None:
        arrival_ns = [frame.time_ns + round(1e9 * CAMERA_LATENCY_S) for frame in frames]
    fastest_ns = min(
        (arrival - frame.time_ns for arrival, frame in zip(arrival_ns, frames, strict=True)),
        default=0,
    )
    return replay_predictor(
        HeightmapService(network, depth_topic(1e-9 * fastest_ns)), frames, states, arrival_ns
    )


def replay_level(
    network: HeightmapNetwork, frames: Iterable[DepthFrame], level: LevelRobot
) -> Iterator[tuple[DepthFrame, Heightmap]]:
    """Yields each frame with the heightmap ahead of a robot that stands still and level.

    Frames must come in order of capture; each is answered as if it had arrived `CAMERA_LATENCY_S`
    after its exposure. No frame is held longer than that takes.
    """
    service, still, latency_ns = (
        HeightmapService(network),
        level.state(network.robot),
        round(1e9 * CAMERA_LATENCY_S),
    )
    for step, frame in enumerate(frames):
        now_ns = frame.time_ns + latency_ns
        yield frame, service.step(replace(still, step=step, time_ns=now_ns), frame, now_ns)


def replay_standing(
    network: HeightmapNetwork, read: Callable[[], Iterable[DepthFrame]], level: LevelRobot
) -> Iterator[tuple[DepthFrame, Heightmap]]:
    """Each image of a camera that stands still with the heightmap after it,
    from a model that is warm.

    Before a robot that stands the time between images tells nothing: they are shown at the
    camera's rate, the first of them before all, again and again until the model has seen as many
    as its warm-up takes.

    Args:
        network: Of the service.
        read: Reads the images from the first one on, each time that it is called.
        level: The robot.
    """
    shown: deque[DepthFrame] = deque()

    def evenly() -> Iterator[DepthFrame]:
        for i, frame in enumerate(chain(islice(_again(read), network.warmup_frames), read())):
            shown.append(frame)
            yield replace(frame, time_ns=round(1e9 * CAMERA_PERIOD_S * i), frame_id=i)

    for even, answer in replay_level(network, evenly(), level):
        frame = shown.popleft()
        if even.frame_id >= network.warmup_frames:
            yield frame, replace(answer, frame_id=frame.frame_id)


def _again(read: Callable[[], Iterable[DepthFrame]]) -> Iterator[DepthFrame]:
    """Images from the beginning again after the end; none where there is none."""
    frame = None
    while True:
        for frame in read():
            yield frame
        if frame is None:
            return


def replay_predictor(
    predictor: HeightPredictor,
    frames: Iterable[DepthFrame],
    states: Iterable[RobotState],
    arrival_ns: Iterable[int],
) -> list[Heightmap]:
    """Heightmaps of any predictor, not used before, for recorded images and states.

    No frame is held longer than it takes to answer it.
    """
    heightmaps = []
    arriving = zip(frames, arrival_ns, strict=True)
    following = next(arriving, None)
    for state in states:
        newest = None
        while following is not None and following[1] <= state.time_ns:
            newest, following = following[0], next(arriving, None)
        heightmaps.append(predictor.step(state, newest, state.time_ns))
    return heightmaps
