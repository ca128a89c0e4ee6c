"""True where a computer keeps up with a real-time run, and at which speed it would."""

import statistics
from dataclasses import dataclass

from saltus.clock import RunClock
from saltus.config import PLAN_TOPICS
from saltus.wire.messages import ProcessStatus
from saltus.wire.topics import TOPICS

SETTLE_S = 0.4
"""Time after the robot's first message in which nothing counts [s of the machine]: the first images
and answers are slow, and the robot stands for a second before it runs."""
WINDOW_S = 2.0
"""A verdict rests on the last so many seconds of the machine: it is to be known within 3 s."""
SHARE_KEPT = 0.9
"""A run keeps up that delivers this share of what the table of topics asks for: without one image
in twenty the heights are off by a fiftieth more (docs/heightmap.md)."""
LATE_WANTED_S = 0.020
"""At the advised speed: nine in ten robots cross when every plan is so late (docs/policy.md)."""
RESERVE = 0.7
"""Share of the speed reached that is advised: the next moment may be busier."""
SPEEDS = (0.8, 0.6, 0.5, 0.4, 0.3, 0.25, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02, 0.01)
"""Speeds that may be advised; a slower run would hardly be waited for."""


@dataclass(frozen=True, kw_only=True)
class RealTimeFactor:
    """How one stream of messages kept up over a while."""

    stream: str
    """Topic and the process that received it."""
    share: float
    """Share of the messages that the table of topics asks for that came: 1 keeps up."""
    reached: float
    """Seconds of the run that were delivered for each second of the machine: `share` of the run's
    speed."""
    late_s: float
    """Delay of messages beyond their period and jitter [s, run's clock]: the worst one in half a
    second, median."""
    kept: bool
    """True where the stream keeps up."""
    speed: float
    """The speed at which it would; the present one where it does."""

    def __str__(self) -> str:
        late = f"up to {1e3 * self.late_s:.0f} ms late"
        return (
            f"this computer reaches {self.reached:.0%} of real time ({self.stream}, {late}): "
            f"try --speed {self.speed:g}"
        )


@dataclass(frozen=True)
class _Period:
    """A period of a stream as its receiver told it, in the run's clock."""

    end_ns: int
    length_s: float
    received: int
    silence_s: float


def _streams(status: ProcessStatus) -> dict[str, tuple[int, int]]:
    """Messages and longest silence [us] of each stream that a process receives.

    A planner that can walk sends plans or joint targets, one of them at a time: they are one
    stream, by the name of those of which more came.
    """
    told = {name: (count, status.silence_us[name]) for name, count in status.received.items()}
    plans = {name: told.pop(name) for name in PLAN_TOPICS if name in told}
    if plans:
        counts, silences = zip(*plans.values(), strict=True)
        told[max(plans, key=plans.__getitem__)] = sum(counts), min(silences)
    return told


class RealTimeMonitor:
    """Adds up what the processes have told lately of the messages that they receive,
    from `robot`'s first word on.

    The processes themselves measure: on a busy computer the supervisor, of which all this is a
    part, may be late though nobody waits for it.
    """

    def __init__(self, clock: RunClock, robot: str) -> None:
        self._clock = clock
        self._robot = robot
        self._settled_ns: int | None = None
        self._told: dict[str, tuple[int, int]] = {}
        self._periods: dict[tuple[str, str], list[_Period]] = {}

    def take(self, status: ProcessStatus, sequence: int) -> None:
        """Takes in what a process says of itself, and its number among what it has said.

        A status counts what came since the one before. Where that one was lost on its way here,
        nobody knows what the process received in the time of both.
        """
        if self._settled_ns is None and status.process == self._robot:
            self._settled_ns = status.time_ns + self._run_ns(SETTLE_S)
        before_ns, before = self._told.get(status.process, (-1, -1))
        self._told[status.process] = status.time_ns, sequence
        if self._settled_ns is None or before_ns < self._settled_ns or sequence != before + 1:
            return
        length_s = 1e-9 * (status.time_ns - before_ns)
        for topic, (received, silence_us) in _streams(status).items():
            period = _Period(status.time_ns, length_s, received, 1e-6 * silence_us)
            # A run in which a process has died asks for no verdict any more: what is old goes here
            # too
            since_ns = status.time_ns - self._run_ns(WINDOW_S)
            recent = [
                p for p in self._periods.get((topic, status.process), []) if p.end_ns > since_ns
            ]
            self._periods[topic, status.process] = [*recent, period]

    def verdict(self) -> RealTimeFactor | None:
        """The stream that kept up worst; None until the run has gone on for long enough."""
        window_ns = self._clock.elapsed_ns() - self._run_ns(WINDOW_S)
        if self._settled_ns is None or window_ns < self._settled_ns:
            return None
        recent = {
            key: [p for p in periods if p.end_ns > window_ns]
            for key, periods in self._periods.items()
        }
        self._periods = {key: periods for key, periods in recent.items() if periods}
        streams = [self._judged(*key, periods) for key, periods in self._periods.items()]
        return min(streams, key=lambda factor: (factor.speed, factor.share), default=None)

    def _judged(self, topic_name: str, process: str, periods: list[_Period]) -> RealTimeFactor:
        topic = TOPICS[topic_name]
        asked = topic.rate_hz * sum(period.length_s for period in periods)
        share = min(1.0, sum(period.received for period in periods) / asked)
        # One as early and the next as late as can be
        longest_s = 1.0 / topic.rate_hz + 2.0 * topic.jitter_s
        late_s = max(0.0, statistics.median(period.silence_s for period in periods) - longest_s)
        # Later than that a message is degraded
        kept = share >= SHARE_KEPT and late_s <= topic.degraded_age_s - topic.nominal_age_s
        speed = self._clock.speed
        if not kept:
            wanted = speed * min(RESERVE * share, LATE_WANTED_S / max(late_s, LATE_WANTED_S))
            speed = next((each for each in SPEEDS if each <= wanted), SPEEDS[-1])
        return RealTimeFactor(
            stream=f"{topic_name} to {process}",
            share=share,
            reached=share * self._clock.speed,
            late_s=late_s,
            kept=kept,
            speed=speed,
        )

    def _run_ns(self, machine_s: float) -> int:
        return round(1e9 * machine_s * self._clock.speed)
