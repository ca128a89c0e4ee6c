"""One file of a stranger, and what must become of it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rig_logs import body_log

from saltus.recordings.recording_description import BagTopics, RecordingDescription
from saltus.recordings.run_log import JOINT_SIGNALS, RunLog

SECONDS = 0.3  # 150 rows and ten images


@cache
def truth() -> RunLog:
    """The log in all files: twelve joints that move, an IMU,
    motion capture and ten depth images.
    """
    log = body_log(seconds=SECONDS)
    t = log.joints.time_s
    phase, rate = np.arange(12.0), 6.0
    log.joints.q[:] = 0.3 * np.sin(rate * t[:, None] + phase)
    log.joints.dq[:] = 0.3 * rate * np.cos(rate * t[:, None] + phase)
    log.joints.q_des[:] = log.joints.q + 0.01
    return log


@dataclass(frozen=True, kw_only=True)
class Stranger:
    """A file, how it is described, and either what its log must hold
    or what the line of its refusal must say.
    """

    name: str
    write: Callable[[Path], Path]
    description: RecordingDescription = field(default_factory=RecordingDescription)
    check: Callable[[RunLog], None] | None = None
    says: str = ""
    """A regular expression that the refusal, or the notes, must match."""


def described(topics: BagTopics | None = None, **claims: Any) -> RecordingDescription:
    """A description for a bag of the truth."""
    return RecordingDescription(
        claims={"base": "free", **claims}, topics=topics or BagTopics(joints="/joint_states")
    )


def same_joints(
    log: RunLog, *, lacks: tuple[str, ...] = (), rows: slice = slice(None), atol: float = 1e-9
) -> None:
    """The joints are those of the truth, but for signals that the file does not have."""
    true = truth().joints
    np.testing.assert_allclose(
        log.joints.time_s, true.time_s[rows] - true.time_s[rows][0], rtol=0, atol=1e-6
    )
    for signal in JOINT_SIGNALS:
        expected, found = getattr(true, signal), getattr(log.joints, signal)
        if expected is None or signal in lacks:
            assert found is None, signal
        else:
            np.testing.assert_allclose(found, expected[rows], rtol=0, atol=atol, err_msg=signal)
