"""Says what is wrong with a run log before anything is fitted to it.

A false model fits a damaged log as well as a true one: columns in degrees, a joint under another's name or a gain that
was not the drive's look like effects. Every check compares the log with itself or with the plainest geometry, so that
no strong effect of the library (delays to 25 ms, gains 20 % off, friction, 0.1 rad of bias) can set it off.
"""

from saltus.real2sim.screening.clock import clock_faults
from saltus.real2sim.screening.depth import depth_faults
from saltus.real2sim.screening.fault import Fault
from saltus.real2sim.screening.joints import joint_faults
from saltus.real2sim.screening.rig import rig_faults
from saltus.recordings.run_log import RunLog


def screen(log: RunLog) -> list[Fault]:
    """Faults of a log, those first that make fitting senseless."""
    faults = clock_faults(log)
    if not any(fault.is_fatal for fault in faults):
        poses = rig_faults(log)
        # Images are judged from the measured poses
        faults += [*joint_faults(log), *poses, *([] if poses else depth_faults(log))]
    return sorted(faults, key=lambda fault: not fault.is_fatal)
