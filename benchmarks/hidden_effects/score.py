"""How good are verdicts, measured against the truth."""

from typing import Any

import numpy as np

from benchmarks.hidden_effects.cases import LARGE, Case
from benchmarks.hidden_effects.generate import OUTSIDE_PART
from benchmarks.hidden_effects.parameters import parameter_rows
from benchmarks.hidden_effects.shares import median, share


def table(cases: list[Case], followed: list[Case] | None = None) -> dict[str, Any]:
    """Every row of the benchmark's table; see the README for what each counts.

    Args:
        cases: All runs.
        followed: Those of them that did the experiment that was proposed for them, with the new
            verdicts.
    """
    kept = [case for case in cases if case.counts()]
    by = {
        name: [c for c in cases if c.truth["category"] == name]
        for name in ("none", "one", "two", "play", "outside", "damaged")
    }
    one = [c for c in kept if c.truth["category"] == "one"]
    two = [c for c in kept if c.truth["category"] == "two"]
    clear = [c for c in one if c.separable()]
    quiet = [c for c in by["one"] if c.truth["quiet"] and max(c.truth["shown_rms"]) < 1.0]
    seconds = [c.seconds for c in cases if c.seconds is not None]
    right = [c for c in kept if c.true_names and _exact(c, c.named)]
    closed = [(c.verdict.get("gap") or {}).get("closed") for c in right]
    foreign = [
        c for c in by["outside"] if c.counts() and min(c.truth["outside_part"]) >= OUTSIDE_PART
    ]
    return {
        "exact_name_one_effect": share([_exact(c, c.named) for c in clear]),
        "named_or_in_set": share([c.true_names[0] in c.offered for c in one]),
        "both_names_of_a_pair": share(
            [set(c.true_names) <= set(c.named) for c in two if c.separable()]
        ),
        "both_named_or_in_sets": share([set(c.true_names) <= c.offered for c in two]),
        "backlash_alone": share([_exact(c, c.named) for c in by["play"]]),
        "false_alarm_without_effect": share([c.said != "no_gap" for c in by["none"]]),
        "confident_and_wrong": share([_wrong(c) for c in cases]),
        "confident_and_wrong_where_it_counts": share(
            [_wrong(c) for c in (*by["none"], *by["play"], *one, *two, *foreign)]
        ),
        "outside_says_unexplained": share([c.said == "unexplained" for c in foreign]),
        "damaged_says_bad_log": share([c.said == "bad_log" for c in by["damaged"]]),
        "too_quiet_names_nothing_false": share(
            [not _wrong(c) and c.said != "error" for c in quiet]
        ),
        "errors": share([c.said == "error" for c in cases]),
        "right_place": share([_right_place(c) for c in one if _exact(c, c.named)]),
        "small_effects_named_or_in_set": share(
            [
                c.true_names[0] in c.offered
                for c in by["one"]
                if not c.truth["quiet"] and c.truth["multiples"][0] < LARGE
            ]
        ),
        "median_gap_closed": median([float(x) for x in closed if x is not None]),
        "seconds_to_find": {
            **median([float(s) for s in seconds]),
            "max": max(seconds, default=None),
        },
        "shuffled_truth_exact_name": _shuffled(clear),
        "exact_name_by_kind": {
            kind: share([_exact(c, c.named) for c in clear if c.truth["kind"] == kind])
            for kind in ("joints", "camera", "body", "imu")
        },
        "baselines": {
            name: _baseline(name, clear, by["none"])
            for name in ("threshold", "lowest_training_error")
        },
        **({} if followed is None else {"experiment_resolves_set": _resolved(kept, followed)}),
        **parameter_rows([c for c in one if _exact(c, c.named)]),
    }


def _exact(case: Case, names: list[str]) -> bool:
    return set(names) == set(case.true_names)


def _resolved(cases: list[Case], followed: list[Case]) -> dict[str, Any]:
    """Sets with an experiment that became the true names.

    One that could not be done did not help.
    """
    exact = {c.truth["name"]: c.said == "named" and _exact(c, c.named) for c in followed}
    return share([exact.get(c.truth["name"], False) for c in cases if c.proposal])


def _wrong(case: Case) -> bool:
    return bool(set(case.named) - set(case.true_names))


def _right_place(case: Case) -> bool:
    """True where the named joints are those that have the effect.

    Other sensors have one place only.
    """
    if case.truth["kind"] != "joints":
        return True
    true = set(case.truth["effects"][0]["where"])
    said: set[str] = set()
    for effect in case.verdict["effects"]:
        said |= true if effect["where"] == "all" and len(true) == 12 else set(effect["where"])
    return said == true


def _baseline(name: str, clear: list[Case], none: list[Case]) -> dict[str, Any]:
    return {
        "exact_name_one_effect": share(
            [_exact(c, c.baselines[name]) for c in clear if name in c.baselines]
        ),
        "false_alarm_without_effect": share(
            [bool(c.baselines[name]) for c in none if name in c.baselines]
        ),
    }


def _shuffled(cases: list[Case], times: int = 50) -> dict[str, Any]:
    """Exact names against the truth of another run of the same kind of log."""
    rng = np.random.default_rng(0)
    hits = []
    for _ in range(times):
        for kind in ("joints", "camera", "body", "imu"):
            group = [c for c in cases if c.truth["kind"] == kind]
            other = rng.permutation(len(group))
            hits += [
                set(c.named) == set(group[j].true_names) for c, j in zip(group, other, strict=True)
            ]
    return {"value": float(np.mean(hits)) if hits else None, "count": len(cases), "shuffles": times}
