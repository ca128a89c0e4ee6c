"""What came of comparing run logs with the simulator: by sensor, by log, and in the end."""

from dataclasses import dataclass

from saltus.real2sim.patch import Evidence, Patch
from saltus.real2sim.problem.problem import Problem
from saltus.real2sim.screening.align import ClockOffset
from saltus.real2sim.screening.fault import Fault
from saltus.real2sim.search.findings import Findings
from saltus.real2sim.verdict import Verdict
from saltus.recordings.run_log import RunLog


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """What became of the problem of one sensor."""

    problem: Problem
    findings: Findings
    log: RunLog
    """What the problem is about: of a problem that several logs pose, all of them in sequence."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Examination:
    """All that was found in runs that are read as one log."""

    log: RunLog
    faults: tuple[Fault, ...]
    offsets: tuple[ClockOffset, ...] = ()
    comparisons: tuple[Comparison, ...] = ()
    """What several logs show together is told with the first of them."""
    untestable: dict[str, str]
    """Effects that no sensor of the log shows, and why."""
    failures: tuple[str, ...] = ()
    """Sensors that could not be compared, and why."""

    @property
    def is_bad(self) -> bool:
        """Whether fitting to this log makes no sense."""
        return any(fault.is_fatal for fault in self.faults)


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgement:
    """All that is known in the end."""

    verdict: Verdict
    patch: Patch
    examinations: tuple[Examination, ...]
    evidence: tuple[Evidence, ...]
