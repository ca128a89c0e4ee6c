"""Finds faults of a run log before anything is fitted to it.

A damaged log looks like effects: columns in degrees, swapped joints, or gains other than the claimed ones. Every check
compares the log with itself or with simple geometry, so that strong effects of the library (delays to 25 ms, gains off
by 20 %, friction, 0.1 rad of bias) do not trigger it.
"""

from saltus.real2sim.screening.clock import clock_faults
from saltus.real2sim.screening.depth import depth_faults
from saltus.real2sim.screening.fault import Fault
from saltus.real2sim.screening.joints import joint_faults
from saltus.real2sim.screening.rig import rig_faults
from saltus.recordings.run_log import RunLog


def screen(log: RunLog) -> list[Fault]:
    """Faults of a log, fatal ones first."""
    faults = clock_faults(log)
    if not any(fault.is_fatal for fault in faults):
        poses = rig_faults(log)
        # images are judged by the measured poses
        faults += [*joint_faults(log), *poses, *([] if poses else depth_faults(log))]
    return sorted(faults, key=lambda fault: not fault.is_fatal)
