"""The images of one camera as a service takes them in,
and the worst of what is known about them.
"""

import math
from dataclasses import dataclass, replace

from saltus.heightmap.service.frame_loss import WINDOW_NS, FrameLoss
from saltus.wire.messages import DepthFrame, HeightmapStatus
from saltus.wire.topics import TOPICS, Topic

NO_FRAME = -1
DEPTH = TOPICS["camera/depth"]
DEGRADED_INVALID_PIXELS = 0.3
MAX_FUTURE_S = (
    0.005  # clocks of one machine agree; more than this is not a clock that can be trusted
)
DEGRADED_LOST_SHARE = 0.2  # of the images of the last second; the model is trained with 8 % at most
LOSS_MARGIN_S = 0.020
"""Two ticks of 100 Hz: an image may have arrived a tick before it is taken, and what would be too
late at the next tick is said at this one."""
_TRUST = (
    HeightmapStatus.OK,
    HeightmapStatus.DEGRADED,
    HeightmapStatus.WARMING,
    HeightmapStatus.INVALID,
)
"""From good to bad, unlike their numbers: heights of poor images are of some use, of an empty
hidden state of none."""
_DEGRADED_LOST = DEGRADED_LOST_SHARE * DEPTH.rate_hz * 1e-9 * WINDOW_NS


@dataclass(frozen=True, eq=False)
class ArrivedImage:
    """A depth image that has arrived, with the times that say how old it is."""

    invalid_fraction: float
    time_ns: int
    frame_id: int
    arrival_ns: int


class ImageWatch:
    """Judges the images of one camera: duplicates, older ones,
    and ones from the future or too long ago are no news.

    Args:
        depth: Topic of the images: how old they may be.
        moved: True where heights go on with the robot by odometry from where an image was taken.
            Then an image that came in time holds until the next one is missing; else only until it
            is too old itself.

    Attributes:
        newest: The newest image that was news; None before the first.
        view: The newest that is in use: `newest`, unless hardly a pixel of it is valid.
    """

    def __init__(self, depth: Topic = DEPTH, *, moved: bool = False) -> None:
        self._depth, self._moved = depth, moved
        self._loss = FrameLoss()
        self._started_ns: int | None = None
        self.newest: ArrivedImage | None = None
        self.view: ArrivedImage | None = None

    def begin(self, now_ns: int) -> None:
        """Counts the time without any image from the first call on."""
        if self._started_ns is None:
            self._started_ns = now_ns

    def is_news(self, frame: DepthFrame, now_ns: int) -> bool:
        """True where an image is to be looked at."""
        age_s, newest = (now_ns - frame.time_ns) * 1e-9, self.newest
        if not -MAX_FUTURE_S <= age_s <= self._depth.invalid_age_s:
            return False
        return newest is None or (
            frame.frame_id != newest.frame_id and frame.time_ns > newest.time_ns
        )

    def take(
        self, frame: DepthFrame, invalid_fraction: float, arrival_ns: int, *, used: bool
    ) -> None:
        """Takes note of an image that was news, and of whether it is in use from now on."""
        self.newest = ArrivedImage(invalid_fraction, frame.time_ns, frame.frame_id, arrival_ns)
        self.view = self.newest if used else self.view
        self._loss.accept(frame.frame_id, frame.time_ns)

    def new_camera(self) -> None:
        """Counts images anew, of a camera that has started anew.

        Those of before hold on: pauses are judged as ever.
        """
        if self.newest is not None:
            renumbered = replace(self.newest, frame_id=NO_FRAME)
            self.view = renumbered if self.view is self.newest else self.view
            self.newest = renumbered
        self.forgive()

    def forgive(self) -> None:
        """Forgets what was lost: it does not count for a state that begins now."""
        self._loss = FrameLoss()

    def age_s(self, time_ns: int) -> float:
        """Age of the image in use at a time [s]; infinite before the first."""
        return math.inf if self.view is None else (time_ns - self.view.time_ns) * 1e-9

    def status(self, state_ns: int, now_ns: int, *, warm: bool) -> HeightmapStatus:
        """The worst of what is known about the images, at a robot state of a time.

        An image that is not used is as one that did not come, and DEGRADED at once.
        """
        extra, newest, view = self._depth.max_extra_age_s, self.newest, self.view
        if newest is None or view is None:
            waiting_s = (now_ns - (self._started_ns or 0)) * 1e-9
            return (
                HeightmapStatus.INVALID
                if waiting_s > self._depth.invalid_age_s
                else HeightmapStatus.WARMING
            )
        age_s = (max(now_ns, state_ns) - view.time_ns) * 1e-9
        silent_s = (now_ns - view.arrival_ns) * 1e-9
        is_old = age_s > self._depth.invalid_age_s and not self._moved
        if is_old or silent_s > extra - LOSS_MARGIN_S:
            return HeightmapStatus.INVALID
        if not warm:
            return HeightmapStatus.WARMING
        late = age_s > self._depth.degraded_age_s or silent_s > 0.5 * extra
        patchy = (
            view is not newest
            or view.invalid_fraction > DEGRADED_INVALID_PIXELS
            or self._loss.count(now_ns) > _DEGRADED_LOST
        )
        return HeightmapStatus.DEGRADED if late or patchy else HeightmapStatus.OK


def less_trusted(one: HeightmapStatus, other: HeightmapStatus) -> HeightmapStatus:
    """The one of two that is less to be trusted."""
    return max(one, other, key=_TRUST.index)
