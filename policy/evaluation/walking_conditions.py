"""Conditions under which walking is tried, besides what each trial draws."""

from dataclasses import dataclass, replace

from saltus.trial import Trial
from saltus.wire.topics import CAMERA_LATENCY_S


@dataclass(frozen=True, kw_only=True)
class WalkConditions:
    """Conditions of walking trials beside what the seed draws: pushes, friction, faults of the
    camera.
    """

    push_ns: float = 0.0
    """One push sideways, at a place that the seed draws [Ns]."""
    friction: float | None = None
    """Between feet and ground, in place of the drawn one."""
    camera_late_s: float | None = None
    """From exposure to arrival of images, in place of the drawn time [s]."""

    def trial(self, seed: int, usual_s: float = CAMERA_LATENCY_S) -> Trial:
        """The trial of a seed under them.

        `usual_s` is the time that images of the robot's camera usually take [s]: a trial moves it.
        """
        trial = Trial.draw(seed)
        if self.friction is not None:
            trial = replace(trial, friction=self.friction)
        if self.camera_late_s is not None:
            moved_s = CAMERA_LATENCY_S - usual_s
            trial = replace(trial, camera_delay_s=self.camera_late_s + moved_s)
        return trial
