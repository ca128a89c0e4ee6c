"""Episodes, on which predictors are trained.

To make one takes no package that only training needs.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Singles
from saltus.effects.camera import NOMINAL_LATENCY
from saltus.effects.image_delivery import CameraLatency
from saltus.heightmap.settings import MIN_TICKS


@dataclass(frozen=True, kw_only=True, eq=False)
class Episode:
    """One robot, one run, without interruption, at 100 Hz.

    Images are as the camera gives them out: they travel later, when they are trained on.
    """

    terrain: str
    proprioception: Singles
    """See `saltus.heightmap.service.proprioception_vector`, shape (ticks, n)."""
    height: Singles
    """True heights relative to the base [m], shape (ticks, 30)."""
    depth: NDArray[np.uint16]
    """[mm], shape (frames, 48, 16); 0 is invalid, 65535 "nothing within range"."""
    frame_tick: NDArray[np.int32]
    """Tick at which each image was taken, ascending, shape (frames,)."""
    state: Singles | None = None
    """Inputs of the policy besides heights, see `saltus.policy.policy_features`, shape (ticks, n);
    in few datasets."""
    plan: Singles | None = None
    """Plan of the policy on true heights, as `ActionBounds` normalises it, shape (ticks, 10); where
    `state` is."""
    latency: CameraLatency = NOMINAL_LATENCY
    """How long images travel; a shard has one for all."""


def uninterrupted_spans(starts: NDArray[np.bool_]) -> list[slice]:
    """Spans of at least `MIN_TICKS` from one start to the next;
    `starts` says which ticks are one, shape (ticks,).
    """
    first = np.flatnonzero(starts)
    last = np.append(first[1:], len(starts))
    return [slice(int(a), int(b)) for a, b in zip(first, last, strict=True) if b - a >= MIN_TICKS]
