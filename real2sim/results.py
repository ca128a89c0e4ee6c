"""Results of a comparison with the simulator: of one sensor, of one log, and of all logs."""

from dataclasses import dataclass, field

from saltus.effects.profile import Profile
from saltus.real2sim.patch import PatchEvidence, ProfilePatch
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.screening.align import ClockOffset
from saltus.real2sim.screening.channel_scales import LogFault
from saltus.real2sim.search.findings import SearchFindings
from saltus.real2sim.verdict import Verdict
from saltus.recordings.run_log import RunLog


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorResult:
    """The problem of one sensor and what the search found in it."""

    problem: Problem
    findings: SearchFindings
    log: RunLog
    """Log of the problem. If several logs pose it, they follow each other in this one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LogExamination:
    """Everything that was found in one log."""

    log: RunLog
    faults: tuple[LogFault, ...]
    offsets: tuple[ClockOffset, ...] = ()
    comparisons: tuple[SensorResult, ...] = ()
    """Comparisons of several logs stand with the first of them."""
    lacking: dict[str, str] = field(default_factory=dict)
    """Sensors of which the log poses no problem, and why."""
    brief: dict[str, str] = field(default_factory=dict)
    """Sensors in `lacking` of which the log shows too little to test anything, and why."""
    untestable: dict[str, str]
    """Effects that no sensor of the log shows, and why."""
    failures: tuple[str, ...] = ()
    """Sensors that could not be compared, and why."""

    @property
    def is_bad(self) -> bool:
        """True where the log is too damaged to be fitted."""
        return any(fault.is_fatal for fault in self.faults)


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgement:
    """The verdict on all logs and everything that it stands on."""

    verdict: Verdict
    patch: ProfilePatch
    examinations: tuple[LogExamination, ...]
    evidence: tuple[PatchEvidence, ...]
    profile: Profile
    """Effects that the simulator had already."""

    @property
    def not_compared(self) -> dict[str, str]:
        """Sensors of which no log poses a problem, and why the first does not."""
        first, *others = (each.lacking for each in self.examinations)
        return {
            sensor: why for sensor, why in first.items() if all(sensor in other for other in others)
        }
