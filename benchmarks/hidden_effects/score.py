"""How good are verdicts, measured against the truth."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_effects.identify import digest

LARGE = 2.9
"""Multiple of its one-sigma size from which an effect counts: three times, with the rounding of a search."""
SHOWN = 1.0
"""RMS residual in this log from which its motion is enough: some effects grow slower than in proportion."""
SEPARABLE = 0.95
LONGEST_SET = 3
Z95 = 1.959964


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run: what is true, and what was said."""

    truth: dict[str, Any]
    verdict: dict[str, Any]
    baselines: dict[str, list[str]]
    seconds: float | None

    @property
    def true_names(self) -> list[str]:
        """Names of the hidden effects."""
        return [effect["name"] for effect in self.truth["effects"]]

    @property
    def said(self) -> str:
        """The kind of verdict."""
        return str(self.verdict["verdict"])

    @property
    def named(self) -> list[str]:
        """Effects that are named, each once; none where the verdict is not about effects."""
        if self.said not in ("named", "set"):
            return []
        return list(dict.fromkeys(effect["name"] for effect in self.verdict.get("effects", [])))

    @property
    def offered(self) -> set[str]:
        """Effects that are named or belong to a set that is short enough."""
        sets = self.verdict.get("sets", []) if self.said in ("named", "set") else []
        return set(self.named) | {name for one in sets if len(one) <= LONGEST_SET for name in one}

    def counts(self) -> bool:
        """Whether every hidden effect is large enough and the motion shows it."""
        multiples, shown = self.truth["multiples"], self.truth["shown_rms"]
        return not self.truth["quiet"] and all(m >= LARGE for m in multiples) and all(s >= SHOWN for s in shown)

    def separable(self) -> bool:
        """Whether every hidden effect differs from all others on these data."""
        return all(max(rivals.values(), default=0.0) < SEPARABLE for rivals in self.truth["rivals"])


def read_cases(verdicts: Path, truth: Path) -> list[Case]:
    """Reads verdicts and, after checking that they are as they were sealed, the truth.

    Raises:
        RuntimeError: a verdict has changed since the hashes were written.
    """
    hashes = json.loads((verdicts / "hashes.json").read_text())
    for name, expected in hashes.items():
        if digest(verdicts / name / "verdict.json") != expected:
            raise RuntimeError(f"the verdict on {name} is not the one that was sealed: identify again")
    return [
        Case(
            truth=json.loads((truth / f"{name}.json").read_text()),
            verdict=json.loads((verdicts / name / "verdict.json").read_text()),
            baselines=_optional(verdicts / name / "baselines.json", {}),
            seconds=_optional(verdicts / name / "seconds.json", None),
        )
        for name in hashes
    ]


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if count == 0:
        return (0.0, 1.0)
    share, z2 = hits / count, Z95**2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = Z95 * np.sqrt(share * (1 - share) / count + z2 / (4 * count**2)) / (1 + z2 / count)
    return (float(middle - half), float(middle + half))


def share(flags: list[bool]) -> dict[str, Any]:
    """A row of the table that is a share of runs."""
    hits = sum(flags)
    low, high = wilson(hits, len(flags))
    return {"value": hits / len(flags) if flags else None, "hits": hits, "count": len(flags), "wilson95": [low, high]}


def table(cases: list[Case]) -> dict[str, Any]:
    """Every row of the benchmark's table; see the README for what each counts."""
    kept = [case for case in cases if case.counts()]
    by = {
        name: [c for c in cases if c.truth["category"] == name] for name in ("none", "one", "two", "outside", "damaged")
    }
    one = [c for c in kept if c.truth["category"] == "one"]
    two = [c for c in kept if c.truth["category"] == "two"]
    clear = [c for c in one if c.separable()]
    quiet = [c for c in by["one"] if c.truth["quiet"] and max(c.truth["shown_rms"]) < 1.0]
    seconds = [c.seconds for c in cases if c.seconds is not None]
    closed = [c.verdict.get("gap", {}).get("closed") for c in one if set(c.named) == set(c.true_names)]
    return {
        "exact_name_one_effect": share([_exact(c, c.named) for c in clear]),
        "named_or_in_set": share([c.true_names[0] in c.offered for c in one]),
        "both_names_of_a_pair": share([set(c.true_names) <= set(c.named) for c in two if c.separable()]),
        "both_named_or_in_sets": share([set(c.true_names) <= c.offered for c in two]),
        "false_alarm_without_effect": share([c.said != "no_gap" for c in by["none"]]),
        "confident_and_wrong": share([bool(set(c.named) - set(c.true_names)) for c in cases]),
        "outside_says_unexplained": share([c.said == "unexplained" for c in by["outside"]]),
        "damaged_says_bad_log": share([c.said == "bad_log" for c in by["damaged"]]),
        "too_quiet_names_nothing_false": share([not set(c.named) - set(c.true_names) for c in quiet]),
        "right_place": share([_right_place(c) for c in one if _exact(c, c.named)]),
        "small_effects_named_or_in_set": share(
            [
                c.true_names[0] in c.offered
                for c in by["one"]
                if not c.truth["quiet"] and c.truth["multiples"][0] < LARGE
            ]
        ),
        "median_gap_closed": _median([float(x) for x in closed if x is not None]),
        "median_seconds": _median([float(s) for s in seconds]),
        "shuffled_truth_exact_name": _shuffled(clear),
        "exact_name_by_kind": {
            kind: share([_exact(c, c.named) for c in clear if c.truth["kind"] == kind])
            for kind in ("joints", "camera", "body", "imu")
        },
        "baselines": {name: _baseline(name, clear, by["none"]) for name in ("threshold", "lowest_training_error")},
        **parameter_rows([c for c in one if _exact(c, c.named)]),
    }


def parameter_rows(cases: list[Case]) -> dict[str, Any]:
    """Errors of parameters, and how often the 90 % intervals hold the truth."""
    relative: list[float] = []
    delays: list[float] = []
    holds: list[bool] = []
    for case in cases:
        effect = case.truth["effects"][0]
        main, null, is_delay = MAIN[effect["name"]]
        for said in case.verdict["effects"]:
            values = _values(said, main, effect["params"])
            if values is None or not _overlap(said["where"], effect["where"]):
                continue
            true = np.array([effect["params"][name] for name in main])
            error = float(np.linalg.norm(values[:, 0] - true))
            (delays if is_delay else relative).append(error if is_delay else error / max(_size(true, null), 1e-12))
            holds += [bool(low <= t <= high) for (_, low, high), t in zip(values, true, strict=True)]
    return {
        "median_parameter_error": _median(relative),
        "median_delay_error_s": _median(delays),
        "intervals_hold_truth": share(holds),
    }


MAIN: dict[str, tuple[tuple[str, ...], float, bool]] = {
    "torque_saturation": (("knee",), 0.0, False),
    "torque_speed_limit": (("no_load",), 0.0, False),
    "command_delay": (("delay",), 0.0, True),
    "feedforward_delay": (("delay",), 0.0, True),
    "actuator_lag": (("time_constant",), 0.0, False),
    "velocity_filter": (("time_constant",), 0.0, False),
    "torque_gain": (("gain",), 1.0, False),
    "viscous_friction": (("coefficient",), 0.0, False),
    "coulomb_friction": (("torque",), 0.0, False),
    "stiction": (("breakaway",), 0.0, False),
    "backlash": (("width",), 0.0, False),
    "armature": (("added",), 0.0, False),
    "battery_sag": (("loss_at_end",), 0.0, False),
    "encoder_bias": (("bias",), 0.0, False),
    "encoder_quantisation": (("step",), 0.0, False),
    "payload_mass": (("mass",), 0.0, False),
    "com_offset": (("x", "y", "z"), 0.0, False),
    "base_inertia": (("scale",), 1.0, False),
    "foot_friction": (("coefficient",), 0.0, False),
    "contact_compliance": (("time_constant",), 0.0, False),
    "imu_bias": (("gyro_x", "gyro_y", "gyro_z", "roll", "pitch"), 0.0, False),
    "imu_latency": (("delay",), 0.0, True),
    "camera_latency": (("latency",), 0.0, True),
    "frame_drop": (("fraction",), 0.0, False),
    "temporal_smear": (("alpha",), 1.0, False),
    "camera_pitch": (("offset",), 0.0, False),
    "camera_height": (("offset",), 0.0, False),
    "camera_fov": (("scale",), 1.0, False),
    "depth_scale": (("scale",), 1.0, False),
    "depth_bias": (("bias",), 0.0, False),
    "depth_noise": (("subpixel_sigma",), 0.0, False),
    "edge_holes": (("width",), 0.0, False),
    "hole_fill": (("reach",), 0.0, False),
    "range_clip": (("max",), 0.0, False),
}
"""For each effect: the parameters that count, the value at which it is absent, whether the error is a time."""


def _exact(case: Case, names: list[str]) -> bool:
    return set(names) == set(case.true_names)


def _size(true: np.ndarray, null: float) -> float:
    """Size of the deviation that is to be found."""
    return float(np.linalg.norm(true - null))


def _values(said: dict[str, Any], main: tuple[str, ...], true: dict[str, Any]) -> np.ndarray | None:
    """Value and interval of each parameter that counts, shape (parameters, 3)."""
    found = said.get("params", {})
    if said.get("name") is None or any(name not in found or name not in true for name in main):
        return None
    return np.array([[found[name]["value"], *found[name].get("ci90", [np.nan, np.nan])] for name in main], dtype=float)


def _overlap(said: Any, true: list[str]) -> bool:
    return said in ("all", "camera", "trunk", "feet", "imu") or bool(set(said) & set(true))


def _right_place(case: Case) -> bool:
    """Whether the named joints are those that have the effect; other sensors have one place only."""
    if case.truth["kind"] != "joints":
        return True
    true = set(case.truth["effects"][0]["where"])
    said: set[str] = set()
    for effect in case.verdict["effects"]:
        said |= true if effect["where"] == "all" and len(true) == 12 else set(effect["where"])
    return said == true


def _baseline(name: str, clear: list[Case], none: list[Case]) -> dict[str, Any]:
    return {
        "exact_name_one_effect": share([_exact(c, c.baselines[name]) for c in clear if name in c.baselines]),
        "false_alarm_without_effect": share([bool(c.baselines[name]) for c in none if name in c.baselines]),
    }


def _shuffled(cases: list[Case], times: int = 50) -> dict[str, Any]:
    """Exact names against the truth of another run of the same kind of log."""
    rng = np.random.default_rng(0)
    hits = []
    for _ in range(times):
        for kind in ("joints", "camera", "body", "imu"):
            group = [c for c in cases if c.truth["kind"] == kind]
            other = rng.permutation(len(group))
            hits += [set(c.named) == set(group[j].true_names) for c, j in zip(group, other, strict=True)]
    return {"value": float(np.mean(hits)) if hits else None, "count": len(cases), "shuffles": times}


def _median(values: list[float]) -> dict[str, Any]:
    return {"value": float(np.median(values)) if values else None, "count": len(values)}


def _optional(path: Path, default: Any) -> Any:
    return json.loads(path.read_text()) if path.exists() else default
