"""An operator lays a cover over the lens: all of the image is invalid for so long,
and nothing else changes.
"""

import numpy as np
import pytest
from memory_bus import MemoryBus

from saltus.depth import MODEL_CAMERA, depth_frame
from saltus.render.__main__ import LONGEST_COVER_S, LensCover
from saltus.wire.messages import OPERATOR, Event

S = 1_000_000_000
SEEN = np.full((MODEL_CAMERA.height, MODEL_CAMERA.width), 700, np.uint16)
FRAME = depth_frame(MODEL_CAMERA, SEEN, time_ns=3, frame_id=5)
BLIND = {
    "1": 1.0, "0.25": 0.25, "0": 0.0, "-3": 0.0, "1e9": LONGEST_COVER_S, "inf": LONGEST_COVER_S,
    "nan": 0.0, "": 0.0,
    "long": 0.0,
}  # fmt: skip


@pytest.mark.parametrize(("detail", "covered_s"), BLIND.items())
def test_the_lens_is_covered_for_the_time_that_is_named(detail: str, covered_s: float) -> None:
    bus = MemoryBus("robot/0")
    cover = LensCover(bus)
    assert cover.over(FRAME, 0) is FRAME
    bus.publisher("event", OPERATOR).put(
        Event(time_ns=0, process=OPERATOR, code="blind", detail=detail)
    )
    begin_ns = 10 * S
    first = cover.over(FRAME, begin_ns)
    assert (first.frame_id, first.time_ns, first.depth.shape) == (5, 3, SEEN.shape)
    end_ns = begin_ns + round(covered_s * S)
    for now_ns in (begin_ns, (begin_ns + end_ns) // 2, end_ns - 1, end_ns, end_ns + S):
        covered = cover.over(FRAME, now_ns)
        assert not covered.depth.any() if now_ns < end_ns else covered is FRAME


@pytest.mark.parametrize("code", ["stop", "kill", "unblind", ""])
def test_other_events_do_not_cover_it(code: str) -> None:
    bus = MemoryBus("robot/0")
    cover = LensCover(bus)
    bus.publisher("event", OPERATOR).put(Event(time_ns=0, process=OPERATOR, code=code, detail="1"))
    assert cover.over(FRAME, 0) is FRAME
