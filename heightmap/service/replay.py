"""Runs the heightmap service over recorded depth again."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from saltus.heightmap.level_robot import LevelRobot
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.service import HeightmapService
from saltus.wire.messages import DepthFrame, Heightmap, RobotState
from saltus.wire.topics import CAMERA_LATENCY_S, CAMERA_PERIOD_S, depth_topic


class Predictor(Protocol):
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
        states: Recorded states, in order of time and in the clock of the frames; or a stand-in, which has one state
            for each frame.
        arrival_ns: When each frame could first be used; 50 ms after its capture, as on the robot, where not given. The
            fastest frame says how late the camera is.

    Returns:
        One heightmap for each state.
    """
    if isinstance(states, LevelRobot):
        states = states.states(network.robot, frames)
    if arrival_ns is None:
        arrival_ns = [frame.time_ns + round(1e9 * CAMERA_LATENCY_S) for frame in frames]
    fastest_ns = min((arrival - frame.time_ns for arrival, frame in zip(arrival_ns, frames, strict=True)), default=0)
    return replay_predictor(HeightmapService(network, depth_topic(1e-9 * fastest_ns)), frames, states, arrival_ns)


def replay_standing(network: HeightmapNetwork, frames: Sequence[DepthFrame], level: LevelRobot) -> list[Heightmap]:
    """The heightmap after each image of a camera that stands still, from a model that is warm.

    Before a robot that stands the time between images tells nothing: they are shown at the camera's rate, and all of
    them again and again until the model has seen as many as its warm-up takes.
    """
    service = HeightmapService(network)
    passes = 1 - -network.warmup_frames // len(frames)
    shown = [
        replace(frame, time_ns=round(1e9 * CAMERA_PERIOD_S * i), frame_id=i)
        for i, frame in enumerate([*frames] * passes)
    ]
    arrival_ns = [frame.time_ns + round(1e9 * CAMERA_LATENCY_S) for frame in shown]
    answers = replay_predictor(service, shown, level.states(network.robot, shown), arrival_ns)[-len(frames) :]
    return [replace(answer, frame_id=frame.frame_id) for answer, frame in zip(answers, frames, strict=True)]


def replay_predictor(
    predictor: Predictor, frames: Sequence[DepthFrame], states: Sequence[RobotState], arrival_ns: Sequence[int]
) -> list[Heightmap]:
    """The same for any predictor; it has not been used before."""
    heightmaps = []
    following = 0
    for state in states:
        newest = None
        while following < len(frames) and arrival_ns[following] <= state.time_ns:
            newest = frames[following]
            following += 1
        heightmaps.append(predictor.step(state, newest, state.time_ns))
    return heightmaps
