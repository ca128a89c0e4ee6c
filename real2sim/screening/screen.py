"""Finds faults of a run log before anything is fitted to it.

A damaged log looks like effects: columns in degrees, swapped joints, or gains other than the
claimed ones. Every check compares the log with itself or with simple geometry, so that strong
effects of the library (delays to 25 ms, gains off by 20 %, friction, 0.1 rad of bias) do not
trigger it.

A recording may end at any moment, also in the middle of a step, where a joint that lags behind
looks like one that moves the other way. So what is read off a motion is believed only of a log that
is long enough, and only where it shows a fault without its last second as well. What single rows
show is believed at once.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from saltus.effects.effect import map_arrays
from saltus.real2sim.problem.log import table_times
from saltus.real2sim.screening.base_faults import pose_faults, rig_faults
from saltus.real2sim.screening.channel_scales import LogFault
from saltus.real2sim.screening.clock_faults import MIN_ROWS, clock_faults
from saltus.real2sim.screening.depth_faults import depth_faults
from saltus.real2sim.screening.joint_faults import joint_faults, unit_faults
from saltus.recordings.run_claims import claimed_segments
from saltus.recordings.run_log import RunLog

LEAST_S = 1.5
"""Least length of a log whose motion is judged: two and a half times the window over which slow
motion is averaged (`screening.joints.SLOW_S`, taken twice). The longest healthy cut of 24 runs that
was accused of a flipped sign had 1.38 s."""
END_S = 1.0
"""End of a log that is judged apart. A joint has settled this long after a step: what only the end
shows may be a step that is cut."""
AT_ONCE = {
    "degrees", "time_unit", "dead_channel", "quaternion_norm", "base_unit", "no_camera",
    "image_size", "frames_backwards", "two_clocks",
}  # fmt: skip
"""Faults that single rows show, or half a second in which nothing is read."""


def screen_log(log: RunLog) -> list[LogFault]:
    """Faults of a log, fatal ones first."""
    faults = clock_faults(log)
    if not any(fault.is_fatal for fault in faults):
        faults += [*cut_faults(log), *_of_contents(log)]
    return sorted(faults, key=lambda fault: not fault.is_fatal)


def _of_contents(log: RunLog) -> list[LogFault]:
    """Faults of what the columns hold; those that only the end of the log shows are no damage."""
    if len(log.joints.time_s) < MIN_ROWS:
        return pose_faults(log)
    if _is_short(log):
        return [*believed_units(log), *pose_faults(log)]
    end_s = float(log.joints.time_s[-1])
    found = _by_motion(log)
    if all(fault.name in AT_ONCE for fault in found if fault.is_fatal):
        return found
    is_everywhere = any(fault.is_fatal for fault in _by_motion(log_until(log, end_s - END_S)))
    return (
        found
        if is_everywhere
        else [fault if fault.name in AT_ONCE else _of_end(fault) for fault in found]
    )


def believed_units(log: RunLog) -> list[LogFault]:
    """Faults of units.

    Of a log too short for its motion to be judged, those that single rows show.
    """
    return [fault for fault in unit_faults(log) if not _is_short(log) or fault.name in AT_ONCE]


def _is_short(log: RunLog) -> bool:
    return float(log.joints.time_s[-1] - log.joints.time_s[0]) < LEAST_S


def _of_end(fault: LogFault) -> LogFault:
    return replace(fault, text=f"{fault.text} (only the end of the log shows it)", is_fatal=False)


def _by_motion(log: RunLog) -> list[LogFault]:
    poses = rig_faults(log)
    # images are judged by the measured poses
    return [*joint_faults(log), *poses, *([] if poses else depth_faults(log))]


LATE_S = 0.1
"""Time by which a segment may go on beyond the last row: a hole in a log (`clock.MAX_GAP_S`)."""
EARLIER_S = 0.5
"""Time by which a table may end before that of the joints: a camera at 5 Hz may be 0.3 s late."""


def cut_faults(log: RunLog) -> Iterator[LogFault]:
    """Says that a log is cut, where it shows; never fatal, as what is there may be whole."""
    end_s = float(log.joints.time_s[-1])
    if said := log.meta.get("cut"):
        yield LogFault(name="cut", text=f"the recording is cut: {said}", is_fatal=False)
    planned = claimed_segments(log.meta)
    gone = [s for s in planned if float(s["t0"]) >= end_s]
    broken = [s for s in planned if float(s["t0"]) < end_s < float(s["t1"]) - LATE_S]
    if gone or broken:
        last_s = max(float(s["t1"]) for s in planned)
        parts = [f"'{s['name']}' breaks off" for s in broken]
        parts += [f"{len(gone)} of {len(planned)} segments are missing"] if gone else []
        text = (
            f"the log is cut: it ends at {end_s:.2f} s, its segments at {last_s:.2f} s: "
            f"{', '.join(parts)}"
        )
        yield LogFault(name="cut", text=text, is_fatal=False)
    for name, time_s in table_times(log).items():
        if len(time_s) and end_s - time_s[-1] > EARLIER_S:
            text = f"{name}: ends {end_s - time_s[-1]:.2f} s before the joints: is it cut?"
            yield LogFault(name="cut", text=text, is_fatal=False)


def log_until(log: RunLog, end_s: float) -> RunLog:
    """The rows of all tables before a time on the log's clock.

    Another table than that of the joints may be gone.
    """
    kept = {name: time_s < end_s for name, time_s in table_times(log).items()}
    tables: dict[str, Any] = {
        name: map_arrays(lambda values, own=own: values[own], getattr(log, name))
        if own.any() or name == "joints"
        else None
        for name, own in kept.items()
    }
    return replace(log, **tables)
