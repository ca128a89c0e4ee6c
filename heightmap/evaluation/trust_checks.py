"""True where the heights of a robot can be trusted,
from a recording in which it stands on level, free ground.

There the truth is known without a second sensor: the ground ahead is as high as the ground under
the feet. What makes heights wrong on a robot shows there, too: images that come rarely, late or
with the wrong time, a camera that sits elsewhere than claimed, a service that does not answer.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.effects.image_delivery import CameraLatency
from saltus.errors import RecordingError
from saltus.heightmap.data.delivery import TRAINING
from saltus.heightmap.service.network import MOUNT_PITCH_ERROR, MOUNT_POSITION_ERROR_M
from saltus.recordings.recording import Recording
from saltus.recordings.timing import TopicTiming, rates_and_ages
from saltus.render.calibrate import FEWEST_FRAMES, fit_place, standing_pairs, stands_on_all_feet
from saltus.wire.messages import DepthFrame, Heightmap, HeightmapStatus, RobotState, points_of
from saltus.wire.topics import CAMERA_LATENCY_S, TOPICS, depth_topic, staleness_of

LEAST_RATE = 0.9
"""Least rate, in parts of the nominal one; trainings lose up to 8 % of the images."""
LEAST_OK = 0.98
"""Share of the heightmaps after the first that is OK."""
MOST_OFF_M = 0.01
"""Twice what the shipped network is off on unseen courses (models/heightmap.md); level ground is
easier."""
WIDEST_M = 0.02
"""Half of the 90 % interval, twice `MOST_OFF_M`."""
SCAN_OFF_M, SCAN_WIDEST_M = 0.015, 0.03
"""`MOST_OFF_M` and `WIDEST_M` of a scan, where it was seen: on all kinds of ground it is 16 mm off
with half-widths of 20 mm, on a real lab floor 7 (docs/scan.md)."""
SCAN_LATENCY_S = (0.02, 0.2)
"""Delays with which the scan's network was trained (`FlightSettings.latency_s`)."""
PLACE = "the camera's place"
MS, MM, DEG = 1e3, 1e3, 180.0 / np.pi


@dataclass(frozen=True, kw_only=True)
class TrustCheck:
    """One check of something that a robot's heights rest on, such as its camera's place, with what
    was seen.
    """

    name: str
    measured: str
    wanted: str
    good: bool
    cure: str
    """Cure, where it is not good."""
    values: dict[str, float]
    """Values that were measured, for programs; the unit is the end of each name."""


def check_standing(recording: Recording) -> list[TrustCheck]:
    """Checks of the heights of a robot that stands in a recording,
    in the order in which to mend them.

    Raises:
        RecordingError: there is no image, no state, or no heightmap in it, or the robot hardly
            stands.
    """
    timing = rates_and_ages(recording)
    state, image = "controller/state", "camera/depth"
    for topic in (state, image, "heightmap/heightmap"):
        if topic not in timing:
            if state in timing:
                _check_clock(recording, timing[state], topic)
            raise RecordingError(f"{recording.path}: no messages of {topic}: start what sends them")
    states = recording.of(RobotState)
    pairs = standing_pairs(recording.of(DepthFrame), states)
    if len(pairs) < FEWEST_FRAMES:
        raise RecordingError(
            f"{recording.path}: {len(pairs)} images of a robot that stands, and {FEWEST_FRAMES} "
            "are needed: its state "
            "must say that it stands on all feet, or be at rest and name none, and images be dated "
            "by the same clock"
        )
    heightmaps = recording.of(Heightmap)
    scan = bool(heightmaps and len(heightmaps[0].age_s))
    return [
        _rate(recording, "states", state, timing[state].rate_hz, TOPICS[state].rate_hz),
        _rate(recording, "images", image, timing[image].rate_hz, recording.camera.rate_hz),
        _age(recording, timing[image], scan=scan),
        *_place(recording, pairs, scan=scan),
        *_heights(heightmaps, states),
    ]


def _check_clock(recording: Recording, timing: TopicTiming, missing: str) -> None:
    """Raises `RecordingError` where states are dated by another clock,
    for which a service answers none of them.
    """
    age_s = timing.age_p50_ms / MS
    if not staleness_of(TOPICS["controller/state"], 0, round(1e9 * age_s)).usable:
        off = f"{abs(age_s):.3f} s {'ahead of' if age_s < 0.0 else 'behind'}"
        raise RecordingError(
            f"{recording.path}: no messages of {missing}: states are {off} the clock of this "
            "computer, and so not "
            "answered: date them by it"
        )


def _rate(
    recording: Recording, name: str, topic: str, rate_hz: float, nominal_hz: float
) -> TrustCheck:
    """How many a second arrived, and how many were lost since the first:
    a sender may have begun long before.
    """
    numbers: dict[bytes, list[int]] = {}
    for _, envelope, _ in recording.payloads(topic):
        numbers.setdefault(envelope.boot_id, []).append(envelope.sequence)
    lost = sum(max(each) - min(each) + 1 - len(each) for each in numbers.values())
    return TrustCheck(
        name=name,
        measured=f"{rate_hz:.1f} Hz, {lost} lost",
        wanted=f"at least {LEAST_RATE * nominal_hz:.0f} Hz",
        good=rate_hz >= LEAST_RATE * nominal_hz,
        cure="send them at their rate; where they get lost, look at the link",
        values={"rate_hz": rate_hz, "lost": lost},
    )


def _age(recording: Recording, timing: TopicTiming, *, scan: bool) -> TrustCheck:
    """Images whose date is wrong show the ground of another moment."""
    usual_s = CAMERA_LATENCY_S if recording.camera.latency_s is None else recording.camera.latency_s
    if scan:
        # Older images are INVALID to the service, however the network was trained
        low_s, high_s = (
            SCAN_LATENCY_S[0],
            min(SCAN_LATENCY_S[1], depth_topic(usual_s).invalid_age_s),
        )
    else:
        low_s, high_s = TRAINING.range_s(CameraLatency(latency=usual_s))
        high_s += TRAINING.jitter_s
    good = MS * low_s <= timing.age_p50_ms and timing.age_p99_ms <= MS * high_s
    early = "date each image with its exposure, not with its arrival"
    late = (
        "images come later than in any training: shorten their way, or name the camera's latency_s"
    )
    return TrustCheck(
        name="age of images",
        measured=f"{timing.age_p50_ms:.0f} ms, 99 %: {timing.age_p99_ms:.0f}",
        wanted=f"{MS * low_s:.0f} to {MS * high_s:.0f} ms",
        good=good,
        cure=early if timing.age_p50_ms < MS * low_s else late,
        values={"age_p50_ms": timing.age_p50_ms, "age_p99_ms": timing.age_p99_ms},
    )


def _place(
    recording: Recording, pairs: list[tuple[DepthFrame, RobotState]], *, scan: bool
) -> Iterator[TrustCheck]:
    """The line's network does not know where the camera sits:
    it has learned which pixel shows which ground.
    """
    wanted = (
        f"within {DEG * MOUNT_PITCH_ERROR:.1f} deg and "
        f"{MM * MOUNT_POSITION_ERROR_M:.0f} mm of its claim"
    )
    try:
        calibration = fit_place(pairs, recording.robot, recording.camera)
    except RecordingError as error:
        yield TrustCheck(
            name=PLACE,
            measured=str(error),
            wanted=wanted,
            good=False,
            cure="stand it on free ground",
            values={},
        )
        return
    claimed, found = calibration.claimed, calibration.found
    pitch, roll = found.pitch - claimed.pitch, found.roll - claimed.roll
    height = found.height - claimed.height
    yield TrustCheck(
        name=PLACE,
        measured=f"pitch {DEG * pitch:+.1f} deg, roll {DEG * roll:+.1f} deg, height "
        f"{MM * height:+.0f} mm",
        wanted=wanted,
        good=max(abs(pitch), abs(roll)) <= MOUNT_PITCH_ERROR
        and abs(height) <= MOUNT_POSITION_ERROR_M,
        cure="saltus render calibrate finds its place; then "
        + (
            "serve with that (--cameras)"
            if scan
            else "move it, or train a predictor for that place"
        ),
        values={"pitch_deg": DEG * pitch, "roll_deg": DEG * roll, "height_mm": MM * height},
    )


def _heights(heightmaps: list[Heightmap], every_state: list[RobotState]) -> Iterator[TrustCheck]:
    states = {state.step: state for state in every_state if stands_on_all_feet(state)}
    maps = [heights for heights in heightmaps if heights.step in states]
    begun = next(
        (i for i, heights in enumerate(maps) if heights.status == HeightmapStatus.OK), len(maps)
    )
    ok = [heights for heights in maps[begun:] if heights.status == HeightmapStatus.OK]
    share = len(ok) / max(len(maps) - begun, 1)
    others = (
        {HeightmapStatus(each.status).name for each in maps[begun:]} - {"OK"}
        if ok
        else {"never OK"}
    )
    yield TrustCheck(
        name="status",
        measured=f"OK in {100 * share:.0f} %"
        + "".join(f", {name.lower()}" for name in sorted(others)),
        wanted=f"OK in {100 * LEAST_OK:.0f} %",
        good=share >= LEAST_OK,
        cure="mend what stands above first; then look at the service's events",
        values={"ok_share": share},
    )
    if ok:
        yield from _precision(
            np.array([heights.height + states[heights.step].base_height for heights in ok]), ok
        )


def _precision(off: Floats, ok: list[Heightmap]) -> Iterator[TrustCheck]:
    """`off`: heights over the ground under the feet [m], shape (heightmaps, points);
    of a scan those that were seen.
    """
    scan = bool(len(ok[0].age_s))
    most_off, widest = (SCAN_OFF_M, SCAN_WIDEST_M) if scan else (MOST_OFF_M, WIDEST_M)
    seen = (
        np.array([np.isfinite(heights.age_s) for heights in ok])
        if scan
        else np.ones(off.shape, np.bool_)
    )
    points = np.flatnonzero(seen.any(axis=0))
    if not len(points):
        yield TrustCheck(
            name="heights", measured="no point of the grid was ever in an image", wanted="some",
            good=False,
            cure="where does the camera look? its TOML says where it sits (saltus "
                 "render calibrate)", values={},
        )  # fmt: skip
        return
    by_point = np.nanmean(np.where(seen, np.abs(off), np.nan)[:, points], axis=0)
    ahead, left = points_of(ok[0])[points[int(by_point.argmax())]]
    where = f"{ahead:.2f} m ahead" + (f", {left:.2f} m to the left" if scan else "")
    share = f" where seen, {100 * len(points) / len(seen[0]):.0f} % of the grid" if scan else ""
    half = float(np.median(np.array([heights.half_width_90 for heights in ok])[seen]))
    yield TrustCheck(
        name="heights",
        measured=f"{MM * by_point.mean():.1f} mm off the ground{share}, at most "
                 f"{MM * by_point.max():.1f} at {where}",
        wanted=f"{MM * most_off:.0f} mm on average",
        good=bool(by_point.mean() <= most_off),
        cure="level ground? right base_height? "
        + ("right mounts of the cameras? no parts of the robot in its images?" if scan else
           "right joint angles? then train a predictor for this robot"),
        values={
            "off_mm": MM * float(by_point.mean()), "most_mm": MM * float(by_point.max()),
            "most_at_m": float(ahead),
        },
    )  # fmt: skip
    yield TrustCheck(
        name="half of the 90 % interval",
        measured=f"{MM * half:.1f} mm, median",
        wanted=f"{MM * widest:.0f} mm",
        good=half <= widest,
        cure="the network has not seen images like these: look at them (saltus watch)",
        values={"half_width_90_mm": MM * half},
    )
