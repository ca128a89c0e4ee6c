"""Measures a recorded run: its digest, and how often messages came and how old they were."""

import hashlib
from dataclasses import dataclass

import numpy as np

from saltus.errors import RecordingError
from saltus.recordings.recording import Recording
from saltus.wire.topics import TOPICS

DIGEST_TOPICS = ("heightmap/heightmap", "policy/plan", "policy/joints", "controller/state")


@dataclass(frozen=True, kw_only=True)
class TopicTiming:
    """How often a topic came and how old it was."""

    count: int
    lost: int
    """Messages that the sender counted and the recording does not have."""
    rate_hz: float
    age_p50_ms: float
    age_p99_ms: float


def run_digest(recording: Recording) -> str:
    """sha256 over capture time and payload of heightmaps, plans and robot states, in order.

    None may be missing.

    Two lockstep runs of one seed give the same digest.

    Raises:
        RecordingError: a message is missing.
    """
    total = hashlib.sha256()
    for topic in DIGEST_TOPICS:
        sequence: dict[bytes, int] = {}
        for _, envelope, payload in recording.payloads(topic):
            expected = sequence.get(envelope.boot_id, 0) + 1
            if envelope.sequence != expected:
                raise RecordingError(
                    f"{recording.path}: {topic} {expected} is missing, {envelope.sequence} came"
                )
            sequence[envelope.boot_id] = envelope.sequence
            total.update(topic.encode() + envelope.capture_ns.to_bytes(8, "little") + payload)
    return total.hexdigest()


def rates_and_ages(recording: Recording) -> dict[str, TopicTiming]:
    """Rate and age of each recorded stream.

    Age is arrival at the recorder minus capture, in the run's clock: in lockstep the simulated time
    of arrival.
    """
    timings = {}
    for topic in recording.topics():
        rows = [
            (arrival, e.capture_ns, e.boot_id, e.sequence)
            for arrival, e, _ in recording.payloads(topic)
        ]
        if len(rows) < 2 or TOPICS[topic].rate_hz == 0.0:
            continue
        arrival_ns, capture_ns = (
            np.array(column, dtype=np.int64) for column in list(zip(*rows, strict=True))[:2]
        )
        span_s = 1e-9 * float(arrival_ns[-1] - arrival_ns[0])
        p50, p99 = np.percentile(1e-6 * (arrival_ns - capture_ns), [50, 99])
        timings[topic] = TopicTiming(
            count=len(rows),
            lost=_lost([(boot_id, sequence) for _, _, boot_id, sequence in rows]),
            rate_hz=(len(rows) - 1) / span_s if span_s > 0 else 0.0,
            age_p50_ms=float(p50),
            age_p99_ms=float(p99),
        )
    return timings


def _lost(senders: list[tuple[bytes, int]]) -> int:
    highest: dict[bytes, int] = {}
    for boot_id, sequence in senders:
        highest[boot_id] = max(sequence, highest.get(boot_id, 0))
    return sum(highest.values()) - len(senders)
