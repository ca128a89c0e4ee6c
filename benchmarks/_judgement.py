"""Judges from the recording of a run whose process was killed what the others did about it."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from saltus.constants import POLICY_DT
from saltus.errors import StackError
from saltus.recordings.recording import Recording
from saltus.wire.messages import (
    ControllerMode,
    Event,
    GroundTruth,
    Heightmap,
    HeightmapStatus,
    Message,
    MotionPlan,
    PlanStatus,
    RobotState,
)
from saltus.wire.topics import CAMERA_LATENCY_S, TOPICS, depth_topic

STANDING_HEIGHT_M = 0.18
"""A base above this is on its feet: two thirds of the standing height."""
UPRIGHT_COSINE = 0.87  # 30 degrees
LANDED = (ControllerMode.STOPPED, ControllerMode.DAMP)
AGE_ROUNDING_NS = 1_000_000
"""Ages are told in whole milliseconds."""
FOLLOWING = (ControllerMode.RUN, ControllerMode.COAST)
PRODUCT = {"render": "camera/depth", "heightmap": "heightmap/heightmap", "policy": "policy/plan"}
"""Topic that falls silent when a process dies."""
CONSUMER = {"heightmap": "policy", "policy": "controller"}
"""Process whose event says so; without a camera each heightmap does."""
BLIND = (HeightmapStatus.INVALID, HeightmapStatus.WARMING)
"""Statuses of the service without a camera, and with one that has just begun."""

End = Literal["crossed", "goes on", "stands", "fell"]
"""End of a robot: it has arrived, is on its way, or has landed; or none of these."""


@dataclass(frozen=True, kw_only=True)
class FaultResult:
    """Consequences of a kill."""

    process: str
    running_s: float
    """How long the robot had been running when the process was killed."""
    told_ms: float
    """From the last arrival of the dead process's product to the first message of its consumer that
    says so, before the product comes again; infinite where none does, as where another process goes
    on in time. A product that the consumer alone still had counts (`heard_alone_ns`)."""
    reported_ms: float
    """The same to the supervisor's event that the process died."""
    silence_ms: float
    """The longest time without that product, from this arrival on.

    To the end where it does not come again.
    """
    end: End
    """How the robot is at the end of the recording."""
    stale: int
    """Messages of the whole run that stood on something older than may be used, see
    `stale_uses`."""
    back_s: float
    """From the death noticed to the process being ready again.

    Infinite where it did not come back.
    """


def judge(recording: Recording, process: str, after_s: float) -> FaultResult:
    """Reads from a recording of `kill_during_run` what happened after the last kill."""
    died_ns, ready_ns = _death_and_return(recording, process)
    product = [
        (arrival, e.boot_id, e.capture_ns) for arrival, e, _ in recording.payloads(PRODUCT[process])
    ]
    last_ns = last_before([(arrival, boot_id) for arrival, boot_id, _ in product], died_ns)
    end_ns = recording.of(RobotState)[-1].time_ns
    again_ns = next((arrival for arrival, _, _ in product if arrival > last_ns), end_ns)
    complaints = (
        (told, newest)
        for told, newest in _complaints(recording, process)
        if last_ns < told <= again_ns
    )
    told, newest_ns = next(complaints, (None, None))
    if newest_ns is not None:
        made_ns = max(
            (made for arrival, _, made in product if arrival <= last_ns), default=newest_ns
        )
        last_ns += heard_alone_ns(newest_ns - made_ns, TOPICS[PRODUCT[process]].rate_hz)
    later = [last_ns, *(arrival for arrival, _, _ in product if arrival > last_ns), end_ns]
    return FaultResult(
        process=process,
        running_s=after_s,
        told_ms=1e-6 * (told - last_ns) if told is not None else float("inf"),
        reported_ms=1e-6 * max(0, died_ns - last_ns),
        silence_ms=1e-6 * max(b - a for a, b in pairwise(later)),
        end=end_of(recording),
        stale=stale_uses(recording),
        back_s=1e-9 * (ready_ns - died_ns) if ready_ns is not None else float("inf"),
    )


def last_before(product: Sequence[tuple[int, bytes]], died_ns: int) -> int:
    """Arrival of the last message of the process that died, 0 without one.

    It may be dated after the death, which the supervisor can notice before it reads what came last.

    Args:
        product: Arrival [ns] and sender of each message, in order of arrival.
        died_ns: When the death was noticed.
    """
    dead = [boot_id for arrival, boot_id in product if arrival <= died_ns][-1:]
    return max((arrival for arrival, boot_id in product if [boot_id] == dead), default=0)


def heard_alone_ns(newer_ns: int, rate_hz: float) -> int:
    """How much later than the last recorded message a consumer
    had its last one [ns, whole periods].

    A process sends to its consumer and to the recorder one after the other; who comes first differs
    from run to run. If it is killed between the two, the recorder lacks a message that the consumer
    has.

    Args:
        newer_ns: By how much the newest message that the consumer had was made after the last that
            was recorded.
        rate_hz: Of the messages.
    """
    period_ns = round(1e9 / rate_hz)
    return max(0, (newer_ns + AGE_ROUNDING_NS) // period_ns) * period_ns


def stale_uses(recording: Recording) -> int:
    """How many messages of a run stood on something older than may be used.

    That are heightmaps that say to be good of an image, plans to go on of a good heightmap, and
    states in which the controller follows a plan. Times are those of the robot's states that they
    answer, not of arrivals.
    """
    image = depth_topic(recording.camera.latency_s or CAMERA_LATENCY_S)
    good = [heightmap for heightmap in recording.of(Heightmap) if heightmap.status not in BLIND]
    plans = [plan.time_ns for plan in recording.of(MotionPlan) if plan.status == PlanStatus.GO]
    # What is used now was made a step ago
    heights, step_s = (
        TOPICS["heightmap/heightmap"],
        POLICY_DT,
    )
    states = recording.of(RobotState)
    decided = decided_ns([state.time_ns for state in states])
    followed = [
        time_ns for time_ns, state in zip(decided, states, strict=True) if state.mode in FOLLOWING
    ]
    return (
        sum(heightmap.depth_age_s > image.invalid_age_s for heightmap in good)
        + late_uses(
            plans, [heightmap.time_ns for heightmap in good], heights.invalid_age_s + step_s
        )
        + late_uses(followed, plans, TOPICS["policy/plan"].invalid_age_s + step_s)
    )


def decided_ns(states_ns: Sequence[int]) -> list[int]:
    """When the controller decided the mode that a state tells:
    before it could have the plan that answers this state.

    That was in the step before, also where the controller itself was held up between the two.
    """
    step_ns = round(1e9 * POLICY_DT)
    befores = [*(first - step_ns for first in states_ns[:1]), *states_ns[:-1]]
    return [min(now - 1, before + step_ns) for before, now in zip(befores, states_ns, strict=True)]


def late_uses(uses_ns: Sequence[int], sources_ns: Sequence[int], limit_s: float) -> int:
    """How many uses have no source within the limit before them; times ascend."""
    uses, sources = np.asarray(uses_ns, np.int64), np.asarray([-(2**62), *sources_ns], np.int64)
    newest = sources[np.searchsorted(sources, uses, side="right") - 1]
    return int(np.sum(uses - newest > round(1e9 * limit_s)))


def end_of(recording: Recording) -> End:
    """End of the robot of a run: the controller judges a trial,
    and ends the run where the robot has fallen.
    """
    codes = {event.code for event in recording.of(Event)}
    if "finished" in codes:
        return "crossed"
    if recording.of(RobotState)[-1].mode in LANDED:
        return "stands" if is_upright(recording) else "fell"
    return "fell" if "fell" in codes else "goes on"


def says(event: Message, code: str, process: str) -> bool:
    """True where it is an event of the supervisor about this process."""
    return (
        isinstance(event, Event) and event.code == code and event.detail.startswith(f"{process}:")
    )


def _death_and_return(recording: Recording, process: str) -> tuple[int, int | None]:
    """Death and return of the process that died last."""
    died_ns = ready_ns = None
    for arrival, _, event in recording.messages("event/supervisor"):
        if says(event, "process_died", process):
            died_ns, ready_ns = arrival, None
        elif says(event, "process_ready", process) and ready_ns is None:
            ready_ns = arrival
    if died_ns is None:
        raise StackError(f"the recording does not show that {process} died")
    return died_ns, ready_ns


def _complaints(recording: Recording, process: str) -> Iterable[tuple[int, int | None]]:
    """The consumer's messages that the product is missing:
    arrival, and when the newest it had was made.

    The latter is None where the message names no age.
    """
    if process == "render":
        for arrival, _, heightmap in recording.messages("heightmap/heightmap"):
            if isinstance(heightmap, Heightmap) and heightmap.status in BLIND:
                yield arrival, _before(heightmap.time_ns, heightmap.depth_age_s)
        return
    for arrival, _, event in recording.messages(f"event/{CONSUMER[process]}"):
        if isinstance(event, Event) and event.code in (
            "heightmap_lost",
            "plan_lost",
            "mode_landing",
        ):
            yield arrival, _before(event.time_ns, _age_s(event.detail))


def _before(now_ns: int, age_s: float) -> int | None:
    return now_ns - round(1e9 * age_s) if np.isfinite(age_s) else None


def _age_s(words: str) -> float:
    """The age that a reason names: "no heightmap for 102 ms"."""
    named = re.search(r"(\d+) ms", words)
    return 1e-3 * int(named[1]) if named else float("inf")


def is_upright(recording: Recording, steps: int = 50) -> bool:
    """True where the robot stands, upright and at rest, in the last `steps` of 10 ms."""
    truths = recording.of(GroundTruth)[-steps:]
    _, x, y, _ = np.array([truth.quaternion_base_in_world for truth in truths]).T
    height = -np.array([truth.height for truth in truths])[:, 10]  # the point under the base
    speed = np.linalg.norm([truth.velocity_base_in_world for truth in truths], axis=1)
    cosine = 1 - 2 * (x * x + y * y)
    return bool(
        np.all(cosine > UPRIGHT_COSINE)
        and np.all(height > STANDING_HEIGHT_M)
        and np.median(speed) < 0.1
    )
