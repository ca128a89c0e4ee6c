"""Effects of a depth camera as unknowns, with coordinates in which 0 means absent."""

import math
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.depth import BASELINE_M
from saltus.real2sim.problem.problem import Candidate, Estimate, Unknown, estimates

FLOOR = 1.3e-3  # 1/m: noise of a D435 over z^2 (plane fits on real frames)


def _unknown(name: str, low: float, high: float, scale: float) -> Unknown:
    return Unknown(name=name, low=low, high=high, scale=scale)


def _candidate(effect: str, *unknowns: Unknown, is_nuisance: bool = False) -> Candidate:
    return Candidate(effect=effect, where="camera", unknowns=unknowns, is_nuisance=is_nuisance)


def camera_candidates(latency_s: float) -> tuple[Candidate, ...]:
    """All effects of a camera, nuisances last.

    Args:
        latency_s: claimed.
    """
    return (
        _candidate("camera_latency", _unknown("latency", -latency_s, 0.3, 1e-3)),
        # lag in frames, (1 - alpha) / alpha: what an image is behind by in the mean is linear in it
        _candidate("temporal_smear", _unknown("lag", 0.0, 24.0, 0.05)),
        _candidate("camera_pitch", _unknown("offset", -0.2, 0.2, 1e-3)),
        _candidate("camera_height", _unknown("offset", -0.1, 0.1, 1e-3)),
        _candidate("camera_fov", _unknown("scale", -0.2, 0.25, 3e-3)),
        _candidate("depth_scale", _unknown("scale", -0.2, 0.25, 3e-3)),
        _candidate("depth_bias", _unknown("bias", -0.1, 0.1, 1e-3)),
        # of what lies beyond the end, how much is cut; where the end is, images say themselves
        _candidate("range_clip", _unknown("share", 0.0, 1.0, 0.05)),
        # variance: noise adds up in it
        _candidate("depth_noise", _unknown("variance", 0.0, 400.0, 0.2)),
        _candidate("edge_holes", _unknown("width", 0.0, 30.0, 0.3)),
        _candidate("hole_fill", _unknown("reach", 0.0, 30.0, 0.3)),
        # the square root of a share has a scatter that does not depend on the share
        _candidate("frame_drop", _unknown("angle", 0.0, 1.2, 0.03)),
        _candidate(
            "noise_floor",
            _unknown("level", math.log(0.02), math.log(1.6), 0.05),
            _unknown("constant", math.log(0.03), math.log(5.0), 0.1),
            is_nuisance=True,
        ),
        _candidate("arrival_jitter", _unknown("share", 0.0, 1.0, 0.1), is_nuisance=True),
    )


@dataclass(frozen=True, kw_only=True)
class CameraEffects:
    """One set of unknowns by name; the defaults are a camera as claimed."""

    latency: float = 0.0
    """Added to the claimed one [s]."""
    lag: float = 0.0
    """(1 - alpha) / alpha of a temporal filter."""
    pitch: float = 0.0
    height: float = 0.0
    tangent_scale: float = 1.0
    depth_scale: float = 1.0
    bias: float = 0.0
    clip_share: float = 0.0
    clip_m: float = math.inf
    noise_variance: float = 0.0
    """Added to that of depth, in units of the usual one, (1.3e-3 z^2)^2."""
    hole_width: float = 0.0
    fill_reach: float = 0.0
    drop_angle: float = 0.0
    floor_level: float = 0.0
    """Logarithm of the noise that grows with the square of depth, in units of the usual one."""
    floor_log_mm: float = 0.0
    """Logarithm of the noise that does not grow [mm]."""
    jitter_share: float = 0.0

    @classmethod
    def of(cls, candidates: tuple[Candidate, ...], values: Floats, clip_m: float) -> "CameraEffects":
        """Reads a vector of unknowns of `candidates`, shape (unknowns,), where measured depth ends at `clip_m`."""
        given = {"clip_m": clip_m}
        names = [(c.effect, u.name) for c in candidates for u in c.unknowns]
        for name, value in zip(names, values.tolist(), strict=True):
            field, offset = _FIELDS[name]
            given[field] = offset + value
        return cls(**given)


_FIELDS: dict[tuple[str, str], tuple[str, float]] = {
    ("camera_latency", "latency"): ("latency", 0.0),
    ("temporal_smear", "lag"): ("lag", 0.0),
    ("camera_pitch", "offset"): ("pitch", 0.0),
    ("camera_height", "offset"): ("height", 0.0),
    ("camera_fov", "scale"): ("tangent_scale", 1.0),
    ("depth_scale", "scale"): ("depth_scale", 1.0),
    ("depth_bias", "bias"): ("bias", 0.0),
    ("range_clip", "share"): ("clip_share", 0.0),
    ("depth_noise", "variance"): ("noise_variance", 0.0),
    ("edge_holes", "width"): ("hole_width", 0.0),
    ("hole_fill", "reach"): ("fill_reach", 0.0),
    ("frame_drop", "angle"): ("drop_angle", 0.0),
    ("noise_floor", "level"): ("floor_level", 0.0),
    ("noise_floor", "constant"): ("floor_log_mm", 0.0),
    ("arrival_jitter", "share"): ("jitter_share", 0.0),
}
"""Field of `CameraEffects` for each unknown, and its value where the unknown is 0."""


def physical(
    candidate: Candidate, values: Floats, latency_s: float, focal_px: float, ends_m: tuple[float, float]
) -> dict[str, Estimate]:
    """Parameters in the schema's names and units.

    Args:
        candidate: one of `camera_candidates`.
        values: of its unknowns.
        latency_s: claimed.
        focal_px: claimed, of the images of the log.
        ends_m: farthest depth with all and with nothing cut.
    """
    clip_m, farthest_m = ends_m
    effects = CameraEffects.of((candidate,), np.asarray(values, dtype=np.float64), clip_m)
    parameters = {
        "camera_latency": {"latency": latency_s + effects.latency},
        "temporal_smear": {"alpha": 1.0 / (1.0 + effects.lag)},
        "camera_pitch": {"offset": effects.pitch},
        "camera_height": {"offset": effects.height},
        "camera_fov": {"scale": effects.tangent_scale},
        "depth_scale": {"scale": effects.depth_scale},
        "depth_bias": {"bias": effects.bias},
        "range_clip": {"max": farthest_m + effects.clip_share * (clip_m - farthest_m)},
        "depth_noise": {"subpixel_sigma": FLOOR * math.sqrt(effects.noise_variance) * focal_px * BASELINE_M},
        "edge_holes": {"width": effects.hole_width},
        "hole_fill": {"reach": effects.fill_reach},
        "frame_drop": {"fraction": math.sin(effects.drop_angle) ** 2},
    }
    # of a nuisance its unknowns are its parameters
    own = {unknown.name: float(value) for unknown, value in zip(candidate.unknowns, values, strict=True)}
    return estimates(candidate.effect, parameters.get(candidate.effect, own))
