"""Recordings that end in the middle: what says so, and what is left of a log up to a moment."""

from collections.abc import Iterator
from dataclasses import replace

from saltus.arrays import Floats
from saltus.real2sim.screening.fault import Fault
from saltus.recordings.run_claims import segments
from saltus.recordings.run_log import DepthTable, RunLog, Table

LATE_S = 0.1
"""By which a segment may go on beyond the last row: a hole in a log (`clock.MAX_GAP_S`)."""
EARLIER_S = 0.5
"""By which a table may end before that of the joints: a camera at 5 Hz may be 0.3 s late."""


def cut_faults(log: RunLog) -> Iterator[Fault]:
    """Says that a log is cut, where it shows; never fatal, as what is there may be whole."""
    end_s = float(log.joints.time_s[-1])
    if said := log.meta.get("cut"):
        yield Fault(name="cut", text=f"the recording is cut: {said}", is_fatal=False)
    planned = segments(log.meta)
    gone = [s for s in planned if float(s["t0"]) >= end_s]
    broken = [s for s in planned if float(s["t0"]) < end_s < float(s["t1"]) - LATE_S]
    if gone or broken:
        last_s = max(float(s["t1"]) for s in planned)
        parts = [f"'{s['name']}' breaks off" for s in broken]
        parts += [f"{len(gone)} of {len(planned)} segments are missing"] if gone else []
        text = f"the log is cut: it ends at {end_s:.2f} s, its segments at {last_s:.2f} s: {', '.join(parts)}"
        yield Fault(name="cut", text=text, is_fatal=False)
    for name, time_s in _other_clocks(log):
        if end_s - time_s[-1] > EARLIER_S:
            text = f"{name}: ends {end_s - time_s[-1]:.2f} s before the joints: is it cut?"
            yield Fault(name="cut", text=text, is_fatal=False)


def _other_clocks(log: RunLog) -> list[tuple[str, Floats]]:
    found = [(n, t.time_s) for n, t in (("imu", log.imu), ("base", log.base), ("feet", log.feet)) if t is not None]
    if log.depth is not None:
        found.append(("depth", log.depth.arrival_s))
    return [(name, time_s) for name, time_s in found if len(time_s)]


def until(log: RunLog, end_s: float) -> RunLog:
    """The rows of all tables before a time on the log's clock; a table without any is gone."""
    kept = log.joints.time_s < end_s
    joints = {name: values[kept] for name, values in vars(log.joints).items() if values is not None}
    return replace(
        log,
        joints=replace(log.joints, **joints),
        imu=_table(log.imu, end_s),
        base=_table(log.base, end_s),
        feet=_table(log.feet, end_s),
        depth=_images(log.depth, end_s),
    )


def _table(table: Table | None, end_s: float) -> Table | None:
    if table is None or not (kept := table.time_s < end_s).any():
        return None
    return Table(time_s=table.time_s[kept], values=table.values[kept])


def _images(depth: DepthTable | None, end_s: float) -> DepthTable | None:
    if depth is None or not (kept := depth.arrival_s < end_s).any():
        return None
    return DepthTable(
        arrival_s=depth.arrival_s[kept],
        capture_s=None if depth.capture_s is None else depth.capture_s[kept],
        frame_id=depth.frame_id[kept],
        depth_mm=depth.depth_mm[kept],
    )
