"""The bags themselves: which are read, what of them, and which are refused."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from saltus.recordings.recording_description import BagTopics, RecordingDescription
from saltus.recordings.run_log import RunLog
from strangers.bags import DEPTH, Bag, Images, same_log, write
from strangers.stranger import Stranger, described, truth

MOUNT = {"position": [0.27, 0.0, 0.09], "pitch": 0.52}
HALF = {"width": 32, "height": 24, "fx": 20.0, "fy": 20.0, "cx": 16.0, "cy": 12.0}


def _as(
    name: str,
    bag: Bag,
    says: str = "",
    description: RecordingDescription | None = None,
    **expected: Any,
) -> Stranger:
    return Stranger(
        name=f"bag: {name}",
        write=partial(write, bag),
        description=description or described(camera=MOUNT),
        check=partial(same_log, **expected),
        says=says,
    )


def _no(
    name: str, bag: Bag, says: str, description: RecordingDescription | None = None
) -> Stranger:
    return Stranger(
        name=f"bag: {name}",
        write=partial(write, bag),
        description=description or described(),
        says=says,
    )


def _joints(**signals: Any) -> Callable[[RunLog], RunLog]:
    return lambda log: replace(
        log, joints=replace(log.joints, **{k: v(log) for k, v in signals.items()})
    )


def _rows(table: str, change: Callable[[np.ndarray], None]) -> Callable[[RunLog], RunLog]:
    def changed(log: RunLog) -> RunLog:
        values = getattr(log, table).values.copy()
        change(values)
        return replace(log, **{table: replace(getattr(log, table), values=values)})

    return changed


def _nan(log: RunLog) -> np.ndarray:
    return np.full_like(log.joints.q, np.nan)


def _nan_of_one(log: RunLog) -> np.ndarray:
    return np.where(np.arange(12) == 5, np.nan, log.joints.dq)


def _none(log: RunLog) -> None:
    return None


def _zero(log: RunLog) -> np.ndarray:
    return np.zeros_like(log.joints.q)


def _some_nan(log: RunLog) -> np.ndarray:
    return np.where(np.arange(len(log.joints.q))[:, None] < 3, np.nan, log.joints.dq)


def _fill(columns: slice, value: float) -> Callable[[np.ndarray], None]:
    def fill(values: np.ndarray) -> None:
        values[:, columns] = value

    return fill


def _moved(
    name: str, bag: Bag, move: Callable[[Path], Path], says: str = "", **expected: Any
) -> Stranger:
    """A bag whose files lie otherwise."""
    base = _as(name, bag, says, **expected)
    return replace(base, write=lambda folder: move(write(bag, folder)))


def _without_metadata(path: Path) -> Path:
    (path / "metadata.yaml").unlink()
    return path


def _file(path: Path) -> Path:
    return next(file for file in path.iterdir() if file.suffix in (".mcap", ".db3"))


def _alone(path: Path) -> Path:
    other = path.parent / "elsewhere"
    other.mkdir()
    return Path(shutil.move(_file(path), other))


K = (50.0, 51.0, 30.0, 22.0)
P = (44.0, 45.0, 31.0, 23.0)
OF_K, OF_P = (50.0, 51.0, 30.5, 22.5), (44.0, 45.0, 31.5, 23.5)
LARGE = {"k": (80.0, 80.0, 63.5, 47.5), "info_size": (128, 96)}
COLOUR = Images(
    topic="/color/image_raw",
    info_topic="/color/camera_info",
    encoding="rgb8",
    k=(99.0, 99.0, 9.0, 9.0),
)
MONO = replace(COLOUR, topic="/mono/image_raw", info_topic="/mono/camera_info", encoding="mono8")
SMALL = (2, 5)
LARGE_ONES = tuple(i for i in range(len(truth().depth.depth_mm)) if i not in SMALL)  # type: ignore[union-attr]
COMPRESSED = DEPTH + "/compressedDepth"
NO_DEPTH = ("depth", "camera")

BAGS: tuple[Stranger, ...] = (
    *(
        _as(f"{kind} {packing}", Bag(kind=kind, compression=packing))
        for kind, packing in (
            ("sqlite3", ""),
            ("mcap", ""),
            ("ros1", ""),
            ("ros1", "BZ2"),
            ("ros1", "LZ4"),
        )
    ),
    _as("simulated time, from 0", Bag(start_s=0.0)),
    *(
        _moved(f"{kind} file beside its metadata", Bag(kind=kind), _file)
        for kind in ("sqlite3", "mcap")
    ),
    *(
        _moved(f"{kind} folder without metadata", Bag(kind=kind), _without_metadata)
        for kind in ("sqlite3", "mcap")
    ),
    *(_moved(f"{kind} file alone", Bag(kind=kind), _alone) for kind in ("sqlite3", "mcap")),
    # signals that are not there in fact
    _as(
        "torque is no number",
        Bag(change=_joints(tau_est=_nan)),
        "tau_est is no number throughout",
        lacks=("tau_est",),
    ),
    _as(
        "speed is no number",
        Bag(change=_joints(dq=_nan)),
        "dq is no number throughout",
        lacks=("dq",),
    ),
    _as(
        "speed of one joint is none",
        Bag(change=_joints(dq=_nan_of_one)),
        r"dq of \w+ is no number",
        lacks=("dq",),
    ),
    _as(
        "speed is zero",
        Bag(change=_joints(dq=_zero)),
        "dq is zero throughout while joints move",
        lacks=("dq",),
    ),
    _as("no speed", Bag(change=_joints(dq=_none)), lacks=("dq",)),
    _as(
        "zero quaternion of the IMU",
        Bag(change=_rows("imu", _fill(slice(0, 4), 0.0))),
        "imu: its quaternions are zero",
        tables=("base",),
    ),
    _as(
        "zero quaternion of the base",
        Bag(change=_rows("base", _fill(slice(3, 7), 0.0))),
        "base: its quaternions are zero",
        tables=("imu",),
    ),
    _as(
        "acceleration is no number",
        Bag(change=_rows("imu", _fill(slice(7, 10), np.nan))),
        "imu: acc_x is no number",
        tables=("base",),
    ),
    _no(
        "some speeds are no numbers",
        Bag(change=_joints(dq=_some_nan)),
        "dq: 36 of 1800 values that are no numbers; .*leave_out",
    ),
    _no(
        "no angle is a number",
        Bag(change=_joints(q=_nan)),
        r"angles of '\w+' are no numbers .*\[joint_names\]",
    ),
    _as(
        "some speeds left out",
        Bag(change=_joints(dq=_some_nan)),
        lacks=("dq",),
        description=replace(described(camera=MOUNT), leave_out=("dq",)),
    ),
    *(
        _as(
            f"{name} left out",
            Bag(),
            lacks=(name,),
            description=replace(described(camera=MOUNT), leave_out=(name,)),
        )
        for name in ("tau_est", "q_des", "imu", "base", "depth")
    ),
    _no(
        "what cannot be left out",
        Bag(),
        "leave_out has 'q', which no log may lack",
        replace(described(), leave_out=("q",)),
    ),
    _as(
        "a gripper on the topic of the legs",
        Bag(gripper=True),
        "30 of 180 messages name fewer joints",
    ),
    # images
    _as(
        "an image without a stamp",
        Bag(images=(Images(unstamped=(4,)),)),
        f"{DEPTH}: 1 of 10 messages bear no stamp",
        kept=tuple(i for i in range(10) if i != 4),
    ),
    _as(
        "first images without a stamp",
        Bag(images=(Images(unstamped=(0, 1)),)),
        "2 of 10 messages bear no stamp",
        kept=tuple(range(2, 10)),
    ),
    _as(
        "two sizes",
        Bag(images=(Images(small=SMALL),)),
        "2 of 10 depth images are 32x24",
        kept=LARGE_ONES,
    ),
    _as(
        "two sizes, the smaller one stated",
        Bag(images=(Images(small=SMALL, has_info=False),)),
        "8 of 10 depth images are 64x48",
        kept=SMALL,
        step=2,
        lens=(20.0, 20.0, 16.0, 12.0),
        description=described(camera=MOUNT | HALF),
    ),
    _no(
        "a size that none has",
        Bag(),
        r"\[claims.camera\] is of 9x9 pixels, images are 64x48",
        described(camera={"width": 9, "height": 9}),
    ),
    _as(
        "colour beside depth",
        Bag(images=(Images(), COLOUR)),
        r"no depth, and left out: /color/image_raw \(rgb8\)",
    ),
    _as(
        "colour alone",
        Bag(images=(COLOUR,)),
        r"no depth, and left out: /color/image_raw \(rgb8\)",
        description=described(),
        lacks=NO_DEPTH,
    ),
    _as(
        "mono8 alone",
        Bag(images=(MONO,)),
        r"/mono/image_raw \(mono8\)",
        description=described(),
        lacks=NO_DEPTH,
    ),
    _as(
        "depth without camera_info beside colour",
        Bag(images=(Images(has_info=False), COLOUR)),
        "no camera_info of /camera/depth",
        description=described(),
        lacks=("camera",),
    ),
    _as("camera_info elsewhere", Bag(images=(Images(info_topic="/calibration/depth"),))),
    _no(
        "colour named as depth",
        Bag(images=(Images(), COLOUR)),
        "whose images are rgb8: depth is mono16, 16UC1, 32FC1",
        described(BagTopics(joints="/joint_states", depth="/color/image_raw")),
    ),
    _no(
        "two depth cameras",
        Bag(images=(Images(), Images(topic="/b/depth", info_topic="/b/info"))),
        "name one with --topics.depth",
    ),
    _as(
        "one of two depth cameras",
        Bag(images=(Images(), Images(topic="/b/depth", info_topic="/b/info", k=K))),
        description=described(BagTopics(joints="/joint_states", depth="/b/depth"), camera=MOUNT),
        lens=OF_K,
    ),
    *(
        _as(
            f"{kind} {encoding} {'big' if big else 'little'} endian",
            Bag(kind=kind, images=(Images(encoding=encoding, big_endian=big, padding=6),)),
        )
        for kind in ("mcap", "ros1")
        for encoding in ("16UC1", "mono16", "32FC1")
        for big in (False, True)
    ),
    *(
        _as(
            f"{kind} compressed, {form}",
            Bag(kind=kind, images=(Images(topic=COMPRESSED, compression=form),)),
            atol_mm=tolerance,
        )
        for kind in ("mcap", "ros1")
        for form, tolerance in (
            ("16UC1; compressedDepth", 0),
            ("16UC1; compressedDepth png", 0),
            ("32FC1; compressedDepth png", 2),
        )
    ),
    _as(
        "compressed as PNG",
        Bag(images=(Images(topic=DEPTH + "/compressed", compression="16UC1; png compressed "),)),
    ),
    _as(
        "raw and compressed",
        Bag(
            images=(
                Images(),
                Images(topic=COMPRESSED, compression="16UC1; compressedDepth", has_info=False),
            )
        ),
    ),
    _no(
        "compressed by RVL",
        Bag(images=(Images(topic=COMPRESSED, compression="16UC1; compressedDepth rvl"),)),
        "none of its depth images can be read: .*only PNG is read: have the publisher write PNG",
    ),
    _as(
        "colour compressed as JPEG",
        Bag(images=(Images(), replace(COLOUR, compression="rgb8; jpeg compressed bgr8"))),
        "no depth, and left out",
    ),
    # calibrations
    *(
        _as(
            f"K and P of {topic}",
            Bag(
                images=(
                    Images(
                        topic=topic, k=K, p=P, info_topic=topic.rpartition("/")[0] + "/camera_info"
                    ),
                )
            ),
            says,
            lens=lens,
        )
        for topic, lens, says in (
            ("/camera/depth/image_rect_raw", OF_P, "P is taken"),
            ("/camera/depth/image_rect", OF_P, "P is taken"),
            ("/depth/image", OF_P, "P is taken"),
            ("/camera/depth/image_raw", OF_K, "K is taken"),
        )
    ),
    _as("no P", Bag(images=(Images(k=K, p=(0.0, 0.0, 0.0, 0.0)),)), lens=OF_K),
    _as(
        "no K",
        Bag(
            images=(
                Images(
                    topic="/depth/image_raw",
                    info_topic="/depth/camera_info",
                    k=(0.0, 0.0, 0.0, 0.0),
                    p=P,
                ),
            )
        ),
        lens=OF_P,
    ),
    _as(
        "not calibrated",
        Bag(images=(Images(k=(0.0, 0.0, 0.0, 0.0)),)),
        r"its fx is 0, its fy 0: .*\[claims.camera\]",
        lacks=("camera",),
        description=described(),
    ),
    _as("binning", Bag(images=(Images(**LARGE, binning=2),)), lens=(40.0, 40.0, 32.0, 24.0)),
    _as(
        "a region of interest",
        Bag(images=(Images(**LARGE, roi=(20, 10, 64, 48)),)),
        lens=(80.0, 80.0, 44.0, 38.0),
    ),
    _as(
        "a region of interest, binned",
        Bag(
            images=(
                Images(
                    k=(160.0, 160.0, 127.5, 95.5),
                    info_size=(256, 192),
                    binning=2,
                    roi=(40, 20, 128, 96),
                ),
            )
        ),
        lens=(80.0, 80.0, 44.0, 38.0),
    ),
    _as("the size of the binned image stated", Bag(images=(Images(binning=2),))),
    _as(
        "camera_info for other images",
        Bag(images=(Images(info_size=(640, 480)),)),
        r"for 640x480, the images are 64x48.*\[claims.camera\]",
        lacks=("camera",),
        description=described(),
    ),
)
