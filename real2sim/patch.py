"""`patch.toml`: the effects that a verdict adds to a profile,
their evidence, and the range in which they hold.

schema = "saltus-patch/1"

[[evidence]]
log = "chirp"
sha256 = "..."

[range]
torque_nm = 33.1

[[effects]]
name = "coulomb_friction"
where = ["FR_calf", "FL_calf"]
[effects.params.torque]
value = 0.31
ci90 = [0.28, 0.34]
unit = "Nm"
"""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from saltus.arrays import Floats
from saltus.config import read_file, read_toml
from saltus.effects.effect import Effect
from saltus.effects.image_pixels import to_robot
from saltus.effects.motors import BatterySag, TorqueSaturation
from saltus.effects.profile import EFFECTS, IDEAL, Profile
from saltus.errors import ConfigError, check_known
from saltus.real2sim.problem.joints.torque_curve import as_knee, with_curve
from saltus.real2sim.search.findings import FoundEffect
from saltus.real2sim.verdict import effect_from_dict, effect_to_dict
from saltus.recordings.run_log import RunLog
from saltus.robots.robot import JOINTS, Robot

SCHEMA = "saltus-patch/1"
PATCH_FILE = "patch.toml"
AS_CLAIMED = ("camera_latency", "range_clip", "foot_friction", "contact_compliance")
"""Effects that are absent at the value that the log claims, not at the library's null value (schema
of run logs)."""


@dataclass(frozen=True, kw_only=True)
class PatchEvidence:
    """A run log that a patch was found in, identified by its contents."""

    log: str
    sha256: str


@dataclass(frozen=True, kw_only=True)
class PatchRange:
    """Range of motion that the logs of a patch cover; outside of it the patch extrapolates.

    None where the log does not say.
    """

    torque_nm: float | None = None
    """Largest commanded torque of a drive."""
    speed_rad_s: float | None = None
    """Largest speed of a joint."""
    depth_m: float | None = None
    """Farthest depth."""
    duration_s: float | None = None
    """Length of the log."""
    focal_px: float | None = None
    """Focal length of the images; effects given in pixels refer to it."""


@dataclass(frozen=True, kw_only=True)
class ProfilePatch:
    """Effects to add to a profile."""

    effects: tuple[FoundEffect, ...]
    evidence: tuple[PatchEvidence, ...]
    range: PatchRange

    def to_toml(self) -> str:
        """The text of `patch.toml`."""
        table = {
            "schema": SCHEMA,
            "evidence": [vars(evidence) for evidence in self.evidence],
            "range": {name: value for name, value in vars(self.range).items() if value is not None},
            "effects": [effect_to_dict(effect) for effect in self.effects],
        }
        return tomli_w.dumps(table)

    def applied_to(self, profile: Profile, robot: Robot) -> Profile:
        """A profile of `robot` with these effects,
        which replace its values of the same effect at the same joints.

        Raises:
            ConfigError: an effect, parameter or joint that this version does not know, or a value
                out of bounds.
        """
        for found in self.effects:
            profile = _with(profile, robot, found, self.range)
        return profile


def patch_from_toml(text: str) -> ProfilePatch:
    """Reads a patch; `ConfigError` says what is wrong with it."""
    table = read_toml(text)
    if table.get("schema") != SCHEMA:
        raise ConfigError(
            f"schema {table.get('schema')!r}: this version reads patches of '{SCHEMA}'"
        )
    try:
        return ProfilePatch(
            effects=tuple(effect_from_dict(entry) for entry in table.get("effects", [])),
            evidence=tuple(PatchEvidence(**entry) for entry in table.get("evidence", [])),
            range=PatchRange(
                **{name: float(value) for name, value in table.get("range", {}).items()}
            ),
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"no patch: {type(error).__name__} {error}") from error


def load_patch(path: Path) -> ProfilePatch:
    """Reads a patch from a file; errors name the file, and the patch beside a file that is none."""
    beside = (path if path.is_dir() else path.parent) / PATCH_FILE
    if path.is_dir() or path.suffix in (".json", ".html"):
        there = "lies beside it" if beside.is_file() and not path.is_dir() else "find writes"
        raise ConfigError(f"{path} is no patch: apply {beside}, which {there}")
    return read_file(path, patch_from_toml)


def patchable_effects(
    effects: Sequence[FoundEffect], profile: Profile = IDEAL
) -> tuple[FoundEffect, ...]:
    """The effects that may go into a profile:
    with values within their bounds and intervals that exclude null.

    A value may be null where `profile` has the effect: it takes the place of another. Joints and
    base are searched each for itself: of an effect that both found in one place the values with the
    narrower intervals go in.
    """
    certain = [
        e
        for e in effects
        if e.name not in EFFECTS or _is_certain(e, may_be_null=e.name in profile.effects)
    ]
    narrowest: dict[tuple[object, ...], FoundEffect] = {}
    for found in sorted(certain, key=_width):
        narrowest.setdefault((found.name, found.where, *found.params), found)
    return tuple(e for e in certain if e in narrowest.values())


def _width(found: FoundEffect) -> float:
    """Width of the intervals of all parameters; only those of the same effect may be compared."""
    return math.prod(interval.ci90[1] - interval.ci90[0] for interval in found.params.values())


def _is_certain(found: FoundEffect, *, may_be_null: bool) -> bool:
    known = {f.name: f.metadata for f in fields(EFFECTS[found.name])}
    crosses = []
    for name, interval in found.params.items():
        null, least, most = (
            known[name].get("null"),
            float(known[name]["low"]),
            float(known[name]["high"]),
        )
        low, high = interval.ci90
        # Where the null value is infinite, an interval that reaches 0 says nothing.
        if not least <= interval.value <= most or (null == np.inf and least > 0.0 >= low):
            return False
        if null is not None:
            crosses.append(found.name not in AS_CLAIMED and low <= null <= high)
    return may_be_null or not all(crosses)


def evidence_of(directory: Path) -> PatchEvidence:
    """Digest of a run log: of the names and contents of its files, in alphabetical order."""
    digest = hashlib.sha256()
    for path in sorted(p for p in directory.iterdir() if p.is_file()):
        digest.update(path.name.encode() + b"\0")
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return PatchEvidence(log=directory.name, sha256=digest.hexdigest())


def patch_range(log: RunLog) -> PatchRange:
    """Range that a log covers."""
    joints = log.joints
    torque = joints.tau_est if joints.tau_est is not None else joints.tau_ff
    return PatchRange(
        torque_nm=_largest(torque),
        speed_rad_s=_largest(joints.dq),
        depth_m=None
        if log.depth is None or not log.depth.depth_mm.size
        else 1e-3 * float(log.depth.depth_mm.max()),
        duration_s=float(joints.time_s[-1] - joints.time_s[0]),
        focal_px=None
        if log.depth is None or not log.meta.get("camera")
        else float(log.meta["camera"]["fx"]),
    )


def _largest(values: Floats | None) -> float | None:
    return None if values is None else round(float(np.nanmax(np.abs(values))), 3)


def _with(profile: Profile, robot: Robot, found: FoundEffect, reach: PatchRange) -> Profile:
    """The profile with one more effect, or with new values of an effect that it has."""
    check_known("unknown effect", found.name, EFFECTS)
    kind = EFFECTS[found.name]
    before = profile.effects.get(found.name, kind())
    after: Effect
    if isinstance(before, TorqueSaturation) and found.curve:
        joints = range(len(JOINTS)) if found.where == "all" else _joints(found)
        after = with_curve(robot, before, joints, found.curve)
    else:
        before = as_knee(robot, before) if isinstance(before, TorqueSaturation) else before
        after = replace(before, **_values(before, found))
    if isinstance(after, BatterySag) and reach.duration_s is not None:
        after = replace(after, duration_s=reach.duration_s)
    if reach.focal_px is not None:
        after = to_robot(after, reach.focal_px)
    after.fitted(robot)  # some values are checked only where the robot's torque limits are known
    return profile.having(after)


def _values(effect: Effect, found: FoundEffect) -> dict[str, Any]:
    """Parameters of an effect after a finding,
    for all joints or for those that the finding names.
    """
    known = {f.name: f.metadata for f in fields(effect) if "low" in f.metadata}
    values: dict[str, Any] = {}
    for name, interval in found.params.items():
        check_known("unknown parameter", name, known, within=f"{effect.name}.")
        if not known[name]["per_joint"] or found.where == "all":
            values[name] = interval.value
            continue
        joints = _joints(found)
        per_joint = np.broadcast_to(
            np.asarray(getattr(effect, name), dtype=np.float64), len(JOINTS)
        ).copy()
        per_joint[joints] = interval.value
        values[name] = tuple(per_joint.tolist())
    return values


def _joints(found: FoundEffect) -> list[int]:
    """Indices of the joints that a finding names."""
    names: Sequence[str] = (found.where,) if isinstance(found.where, str) else found.where
    for name in names:
        check_known(f"'{found.name}' at an unknown joint", name, JOINTS)
    return [JOINTS.index(name) for name in names]
