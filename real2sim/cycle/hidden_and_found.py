"""Hidden and found values side by side, parameter by parameter."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.effects.effect import Effect
from saltus.effects.image_pixels import to_images
from saltus.effects.profile import EFFECTS, Profile
from saltus.real2sim.cycle.folder import CycleFolder
from saltus.real2sim.patch import load_patch
from saltus.real2sim.search.findings import FoundEffect
from saltus.robots.robot import JOINTS

WRONG = "wrong: here the hidden robot is as was known"
SAME = 1e-6  # relative: profiles are written with all their digits, and read back


@dataclass(frozen=True, kw_only=True)
class TruthRow:
    """A row of the table of a cycle's effects: a parameter that was hidden, that was found, or
    both; None where it does not apply.
    """

    effect: str
    parameter: str
    unit: str
    where: str
    known: float | None
    """Before the search."""
    true: float | None
    """Value of the hidden robot."""
    found: float | None
    ci90: tuple[float, float] | None
    remark: str

    @property
    def name(self) -> str:
        """Name of the row in a figure: effect, parameter and place."""
        return (
            f"{self.effect} "
            f"{self.parameter}{'' if self.where in ('all', '') else f' ({self.where})'}"
        )


def truth_rows(folder: CycleFolder) -> list[TruthRow]:
    """Everything that was hidden or found, the former first."""
    patch = load_patch(folder.found / "patch.toml")
    effects, focal_px = patch.effects, patch.range.focal_px

    def read(path: Path) -> Profile:
        """A profile whose pixels are those of the logs, as are those of what was found."""
        return folder.read(path) if focal_px is None else to_images(folder.read(path), focal_px)

    known, hidden = read(folder.known), read(folder.hidden) if folder.hidden.exists() else None
    rows = [] if hidden is None else list(_hidden(folder, known, hidden, effects))
    told = {(row.effect, row.parameter) for row in rows}
    others = (
        (e, name, interval)
        for e in effects
        for name, interval in e.params.items()
        if (e.name, name) not in told
    )
    for effect, name, interval in others:
        before, true = (
            None
            if profile is None
            else float(np.mean(_values(profile, effect.name, name)[_places(effect)]))
            for profile in (known, hidden)
        )
        rows.append(
            TruthRow(
                effect=effect.name, parameter=name, unit=interval.unit, where=_where(effect),
                known=before,
                true=true, found=interval.value, ci90=interval.ci90,
                remark="" if hidden is None else WRONG,
            )
        )  # fmt: skip
    return rows


def _hidden(
    folder: CycleFolder, known: Profile, hidden: Profile, effects: tuple[FoundEffect, ...]
) -> Iterator[TruthRow]:
    for name in {**hidden.effects, **known.effects}:
        for field in fields(EFFECTS[name]):
            if "null" not in field.metadata:
                continue
            if field.metadata["null"] == ():  # a curve is no number: found are knee and plateau
                if _effect(known, name) != _effect(hidden, name):
                    yield TruthRow(
                        effect=name, parameter=field.name, unit=field.metadata["unit"], where="",
                        known=None,
                        true=float("nan"), found=None, ci90=None, remark=_why_not(folder, name),
                    )  # fmt: skip
                continue
            before, true = (_values(profile, name, field.name) for profile in (known, hidden))
            differs = ~np.isclose(before, true, rtol=SAME, atol=0.0)
            for value in np.unique(true[differs]):
                places = np.flatnonzero(differs & (true == value))
                found = _finding(effects, name, field.name, places)
                interval = None if found is None else found.params[field.name]
                yield TruthRow(
                    effect=name,
                    parameter=field.name,
                    unit=field.metadata["unit"],
                    where=_names(places) if field.metadata["per_joint"] else "",
                    known=float(np.mean(before[places])),
                    true=float(value),
                    found=None if interval is None else interval.value,
                    ci90=None if interval is None else interval.ci90,
                    remark=_why_not(folder, name)
                    if interval is None
                    else _judged(interval.ci90, float(value)),
                )


def _finding(
    effects: tuple[FoundEffect, ...], name: str, parameter: str, places: Indices
) -> FoundEffect | None:
    """Finding of an effect at the first of these joints."""
    return next(
        (
            e
            for e in effects
            if e.name == name and parameter in e.params and places[0] in _places(e).tolist()
        ),
        None,
    )


def _judged(ci90: tuple[float, float], true: float) -> str:
    return "found" if ci90[0] <= true <= ci90[1] else "found, the interval misses the truth"


def _why_not(folder: CycleFolder, name: str) -> str:
    verdict = json.loads((folder.found / "verdict.json").read_text(encoding="utf-8"))
    untestable = {each["name"]: each["why"] for each in verdict["untestable"]}
    if name in untestable:
        return f"not found: these logs cannot show it: {untestable[name]}"
    if verdict["misfits"]:
        return f"not found: what is known does not fit these logs: {', '.join(verdict['misfits'])}"
    if sets := [names for names in verdict["sets"] if name in names]:
        return f"not found alone: it is {' or '.join(sets[0])}, which these logs cannot tell apart"
    if verdict["verdict"] == "unexplained":
        return "not found: a gap was seen, and no effects that the search tried together explain it"
    return f"not found: the verdict is {verdict['verdict'].replace('_', ' ')}"


def _values(profile: Profile, name: str, parameter: str) -> Floats:
    """A parameter at the 12 joints; of what is no effect of joints, 12 times the same."""
    return np.broadcast_to(
        np.asarray(getattr(_effect(profile, name), parameter), dtype=np.float64), len(JOINTS)
    )


def _effect(profile: Profile, name: str) -> Effect:
    """Effect of the profile, or the one that changes nothing."""
    return profile.effects.get(name) or EFFECTS[name]()


def _places(effect: FoundEffect) -> Indices:
    names = (effect.where,) if isinstance(effect.where, str) else effect.where
    joints = [JOINTS.index(name) for name in names if name in JOINTS]
    return np.array(joints or range(len(JOINTS)), dtype=np.int64)


def _where(effect: FoundEffect) -> str:
    return effect.where if isinstance(effect.where, str) else _names(_places(effect))


def _names(places: Indices) -> str:
    if len(places) == len(JOINTS):
        return "all"
    names = [JOINTS[i] for i in places]
    for kind, plural in (("hip", "hips"), ("thigh", "thighs"), ("calf", "calves")):
        if names == [joint for joint in JOINTS if joint.endswith(kind)]:
            return plural
    return ", ".join(names)
