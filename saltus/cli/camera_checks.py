"""Checks of a robot's camera, by a recording in which it stands and then moves on level ground."""

from pathlib import Path
from typing import TYPE_CHECKING

from saltus.errors import RecordingError

if TYPE_CHECKING:
    from saltus.controller.robot.unitree.listening import PreflightCheck

OFF_DEG, OFF_MM = 1.5, 10.0
"""Place of a camera against the claimed one: what the networks bear (docs/tutorials/camera.md)."""
LATE_MS = 10.0
"""Images may be this late: half of the time between two of them, in which a trunk that bounds turns
by a degree."""


def camera_checks(path: Path) -> "list[PreflightCheck]":
    """Place and lateness of the camera that took a recording."""
    from saltus.controller.robot.unitree.listening import PreflightCheck
    from saltus.recordings.recording import read_recording
    from saltus.render.calibrate import calibrate_camera
    from saltus.render.calibrate_plot import place_rows
    from saltus.render.lateness import measure_lateness
    from saltus.wire.messages import DepthFrame, RobotState

    found, passed, late, in_time = "not looked for", False, "not looked for", False
    try:
        place = calibrate_camera(path)
        off = {row.name: (row.found - row.claimed, row.unit) for row in place_rows(place)}
        found = ", ".join(f"{name} {by:+.1f} {unit}" for name, (by, unit) in off.items())
        allowed = {"deg": OFF_DEG, "mm": OFF_MM}
        passed = all(abs(by) <= allowed[unit] for by, unit in off.values())
        recording = read_recording(path)
        frames, states = recording.of(DepthFrame), recording.of(RobotState)
        late_ms = 1e3 * measure_lateness(frames, states, recording.robot, place.found).late_s
        late, in_time = f"{late_ms:+.0f} ms against their times", abs(late_ms) <= LATE_MS
    except RecordingError as error:
        if found == "not looked for":
            found = str(error)
        else:
            late = str(error)
    return [
        PreflightCheck(
            name="camera", passed=passed, found=found,
            allowed=f"{OFF_DEG:g} deg, {OFF_MM:g} mm off its claimed place",
            cure=f"saltus render calibrate {path} writes the place: give it to saltus router "
            "as --camera",
        ),
        PreflightCheck(
            name="lateness", passed=in_time, found=late, allowed=f"{LATE_MS:g} ms",
            cure="whoever publishes the images must subtract it from their times",
        ),
    ]  # fmt: skip
