"""Effects of a depth camera as unknowns, with coordinates in which 0 means absent."""

import math
from dataclasses import dataclass
from functools import partial

from saltus.arrays import Floats
from saltus.depth import BASELINE_M
from saltus.effects.image_delivery import CameraLatency, FrameDrop, TemporalSmear
from saltus.real2sim.problem.problem import (
    Candidate,
    Unknown,
    UnknownCoordinates,
    make_candidate,
    parameter_unknown,
)

GEOMETRY = 0.95
"""Least share of its gap that an error of geometry closes where it alone is hidden: true ones close
0.985 or more, and rays are exact; a bias beside a scale was imitated to 0.90 by a field of view."""
FLOOR = 1.3e-3  # 1/m: noise of a D435 over z^2 (plane fits on real frames)


_candidate = partial(make_candidate, where="camera")


def camera_candidates(
    latency_s: float, focal_px: float, ends_m: tuple[float, float]
) -> tuple[Candidate, ...]:
    """All effects of a camera, nuisances last, counted from the claimed latency,
    for images of this focal length [px].

    `ends_m` are the farthest depths with all and with nothing cut.
    """
    clip_m, farthest_m = ends_m
    latest_s = CameraLatency.sought("latency")[1]  # beyond the claim
    least_alpha, most_dropped = TemporalSmear.sought("alpha")[0], FrameDrop.sought("fraction")[1]
    sigma_px = FLOOR * focal_px * BASELINE_M  # of the disparity, where the variance of depth is one
    return (
        _candidate(
            "camera_latency",
            Unknown("latency", -latency_s, latest_s, 1e-3),
            coordinates=UnknownCoordinates.less("latency", latency_s),
        ),
        # lag in frames, (1 - alpha) / alpha: what an image is behind by in the mean is linear in it
        _candidate(
            "temporal_smear",
            Unknown("lag", 0.0, 1.0 / least_alpha - 1.0, 0.05),
            coordinates=UnknownCoordinates(
                parameters=lambda x: {"alpha": 1.0 / (1.0 + float(x[0]))},
                unknowns=lambda values: (1.0 / values["alpha"] - 1.0,),
            ),
        ),
        *(
            _candidate(n, parameter_unknown("offset", 1e-3), least_closed=GEOMETRY)
            for n in ("camera_pitch", "camera_height")
        ),
        *(
            _candidate(n, parameter_unknown("scale", 3e-3), least_closed=GEOMETRY)
            for n in ("camera_fov", "depth_scale")
        ),
        _candidate("depth_bias", parameter_unknown("bias", 1e-3), least_closed=GEOMETRY),
        # of what lies beyond the end, how much is cut; where the end is, images say themselves
        _candidate(
            "range_clip",
            Unknown("share", 0.0, 1.0, 0.05),
            coordinates=UnknownCoordinates(
                parameters=lambda x: {"max": farthest_m + float(x[0]) * (clip_m - farthest_m)},
                unknowns=lambda values: (
                    (values["max"] - farthest_m) / min(clip_m - farthest_m, -1e-9),
                ),
            ),
        ),
        # variance: noise adds up in it
        _candidate(
            "depth_noise",
            Unknown("variance", 0.0, 400.0, 0.2),
            coordinates=UnknownCoordinates(
                parameters=lambda x: {
                    "subpixel_sigma": FLOOR * math.sqrt(float(x[0])) * focal_px * BASELINE_M
                },
                unknowns=lambda values: ((values["subpixel_sigma"] / sigma_px) ** 2,),
            ),
        ),
        _candidate("edge_holes", parameter_unknown("width", 0.3)),
        _candidate("hole_fill", parameter_unknown("reach", 0.3)),
        # the square root of a share has a scatter that does not depend on the share; from no loss
        # on residuals change little at first, so a small step would say that no share shows
        _candidate(
            "frame_drop",
            Unknown("angle", 0.0, math.asin(math.sqrt(most_dropped)), 0.2),
            coordinates=UnknownCoordinates(
                parameters=lambda x: {"fraction": math.sin(float(x[0])) ** 2},
                unknowns=lambda values: (math.asin(math.sqrt(values["fraction"])),),
            ),
        ),
        _candidate(
            "noise_floor",
            Unknown("level", math.log(0.02), math.log(1.6), 0.05),
            Unknown("constant", math.log(0.03), math.log(5.0), 0.1),
            is_nuisance=True,
        ),
        _candidate("arrival_jitter", Unknown("share", 0.0, 1.0, 0.1), is_nuisance=True),
    )


@dataclass(frozen=True, kw_only=True)
class CameraEffects:
    """Effects of a camera that one set of unknowns stands for; the defaults are a camera as
    claimed.
    """

    camera_latency: float = 0.0
    """Added to the claimed one [s]."""
    temporal_smear: float = 0.0
    """Lag in frames, (1 - alpha) / alpha."""
    camera_pitch: float = 0.0
    camera_height: float = 0.0
    camera_fov: float = 0.0
    """Scale of tangents less 1."""
    depth_scale: float = 0.0
    """Less 1."""
    depth_bias: float = 0.0
    range_clip: float = 0.0
    """Share that is cut of what lies beyond `clip_m`."""
    clip_m: float = math.inf
    depth_noise: float = 0.0
    """Added to the variance of depth, in units of the usual one, (1.3e-3 z^2)^2."""
    edge_holes: float = 0.0
    hole_fill: float = 0.0
    frame_drop: float = 0.0
    """Angle whose squared sine is the share."""
    noise_floor_level: float = 0.0
    """Logarithm of the noise that grows with the square of depth, in units of the usual one."""
    noise_floor_constant: float = 0.0
    """Logarithm of the noise that does not grow [mm]."""
    arrival_jitter: float = 0.0

    @classmethod
    def of(
        cls, candidates: tuple[Candidate, ...], values: Floats, clip_m: float
    ) -> "CameraEffects":
        """Reads a vector of unknowns of `candidates`, shape (unknowns,),
        where measured depth ends at `clip_m`.
        """
        names = [
            f"{c.effect}_{u.name}" if len(c.unknowns) > 1 else c.effect
            for c in candidates
            for u in c.unknowns
        ]
        return cls(**dict(zip(names, values.tolist(), strict=True)), clip_m=clip_m)
