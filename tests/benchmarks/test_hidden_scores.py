import itertools
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hidden_effects import cases, identify, score, shares


def truth_of(name: str, category: str, effects: list[str], multiple: float = 3.0) -> dict:
    return {
        "name": name, "kind": "joints", "category": category, "quiet": False, "damage": "",
        "effects": [{"name": e, "where": ["FR_calf"], "params": PARAMS[e],
            "size": 1.0} for e in effects],
        "multiples": [multiple] * len(effects), "shown_rms": [multiple] * len(effects),
        "rivals": [{"armature": 0.5} for _ in effects],
        "outside_part": [0.9],
    }  # fmt: skip


PARAMS = {
    "torque_gain": {"gain": 0.9}, "command_delay": {"delay": 0.004},
    "coulomb_friction": {"torque": 0.3},
    "hum": {"size": 1.0}, "backlash": {"width": 0.01},
}  # fmt: skip


def say_the_truth(truth: dict) -> dict:
    verdicts = {"none": "no_gap", "outside": "unexplained", "damaged": "bad_log"}
    kind = verdicts.get(truth["category"], "named")
    effects = [
        {
            "name": e["name"],
            "where": e["where"],
            "params": {
                p: {"value": v, "ci90": [v - 1, v + 1], "unit": ""} for p, v in e["params"].items()
            },
        }
        for e in truth["effects"]
    ]
    return {
        "verdict": kind,
        "effects": effects if kind == "named" else [],
        "sets": [],
        "gap": {"closed": 0.9},
    }


@pytest.fixture
def truths() -> list[dict]:
    names = (f"{number:02x}" for number in itertools.count())
    one = [
        truth_of(next(names), "one", [e])
        for e in ("torque_gain", "command_delay", "coulomb_friction", "backlash") * 4
    ]
    two = [truth_of(next(names), "two", ["torque_gain", "backlash"]) for _ in range(3)]
    other = [truth_of(next(names), "none", []) for _ in range(4)]
    return [
        *one,
        *two,
        *other,
        truth_of(next(names), "outside", ["hum"]),
        truth_of(next(names), "damaged", []),
    ]


def scored(tmp_path: Path, truths: list[dict], say) -> dict:
    logs, truth, verdicts = tmp_path / "logs", tmp_path / "truth", tmp_path / "verdicts"
    truth.mkdir(parents=True)
    for one in truths:
        (logs / one["name"]).mkdir(parents=True)
        (logs / one["name"] / "meta.json").write_text("{}")
        (truth / f"{one['name']}.json").write_text(json.dumps(one))
    by_name = {one["name"]: one for one in truths}

    def find(logs: tuple[Path, ...], out: Path) -> None:
        (out / "verdict.json").write_text(json.dumps(say(by_name[logs[0].name])))

    identify.identify(logs, verdicts, find, jobs=1)
    return score.table(cases.read_cases(verdicts, truth))


def test_who_knows_the_truth_scores_full(tmp_path, truths):
    table = scored(tmp_path, truths, say_the_truth)
    for row in ("exact_name_one_effect", "named_or_in_set", "both_names_of_a_pair",
        "outside_says_unexplained",
                "damaged_says_bad_log", "right_place", "intervals_hold_truth"):  # fmt: skip
        assert table[row]["value"] == 1.0, row
    for row in (
        "false_alarm_without_effect",
        "confident_and_wrong",
        "median_parameter_error",
        "median_delay_error_ms",
    ):
        assert table[row]["value"] == 0.0, row
    assert table["shuffled_truth_exact_name"]["value"] < 0.5


def test_sets_that_an_experiment_resolves_are_counted(tmp_path, truths):
    def unsure(truth: dict) -> dict:
        names = [e["name"] for e in truth["effects"]]
        return {
            "verdict": "set",
            "effects": [],
            "sets": [[*names, "stiction"]],
            "next_experiment": {"name": "drop"},
        }

    table = scored(tmp_path / "first", truths, unsure)
    assert table["named_or_in_set"]["value"] == 1.0
    scored(tmp_path / "second", truths[:8], say_the_truth)
    read = [
        cases.read_cases(tmp_path / part / "verdicts", tmp_path / "first" / "truth")
        for part in ("first", "second")
    ]
    row = score.table(*read)["experiment_resolves_set"]
    # 16 single effects, 3 pairs, an outside effect in a set of its own
    assert (row["hits"], row["count"]) == (
        8,
        20,
    )


def test_a_value_is_compared_with_that_of_the_joints_it_was_stated_for(tmp_path, truths):
    for truth in truths:
        for effect in truth["effects"]:
            (parameter, value), *_ = effect["params"].items()
            effect["where"] = ["FR_hip", "FR_calf"]
            effect["params_at"] = {
                "FR_hip": {parameter: value},
                "FR_calf": {parameter: 3.0 * value},
            }

    def say(truth: dict) -> dict:
        said = say_the_truth(truth)
        each = [
            effect
            | {
                "where": [joint],
                "params": {p: {"value": v, "ci90": [v, v]} for p, v in params.items()},
            }
            for effect, true in zip(said["effects"], truth["effects"], strict=False)
            for joint, params in true["params_at"].items()
        ]
        return said | {"effects": each}

    table = scored(tmp_path, truths, say)
    assert table["median_parameter_error"]["value"] == 0.0
    assert table["intervals_hold_truth"]["value"] == 1.0
    assert table["right_place"]["value"] == 1.0


@pytest.mark.parametrize("always", ["no_gap", "named", "error"])
def test_who_always_says_the_same_does_not(tmp_path, truths, always):
    effects = [{"name": "torque_gain", "where": "all", "params": {}}] if always == "named" else []
    table = scored(tmp_path, truths, lambda _: {"verdict": always, "effects": effects})
    assert table["exact_name_one_effect"]["value"] == (0.25 if always == "named" else 0.0)
    assert table["false_alarm_without_effect"]["value"] == (0.0 if always == "no_gap" else 1.0)
    assert table["outside_says_unexplained"]["value"] == 0.0
    assert (table["confident_and_wrong"]["value"] > 0.5) == (always == "named")


def test_a_verdict_that_changed_after_it_was_sealed_is_refused(tmp_path, truths):
    scored(tmp_path, truths, say_the_truth)
    (tmp_path / "verdicts" / "00" / "verdict.json").write_text('{"verdict": "no_gap"}')
    with pytest.raises(RuntimeError, match="00"):
        cases.read_cases(tmp_path / "verdicts", tmp_path / "truth")


def test_a_finder_that_breaks_is_an_error_not_the_end(tmp_path, truths):
    def broken(truth: dict) -> dict:
        raise ValueError(truth["name"])

    assert scored(tmp_path, truths, broken)["exact_name_one_effect"]["value"] == 0.0


@pytest.mark.parametrize(("hits", "count"), [(0, 10), (10, 10), (50, 100), (194, 200)])
def test_wilson_holds_the_share(hits, count):
    low, high = shares.wilson(hits, count)
    assert 0 <= low <= hits / count <= high + 1e-12
    assert high <= 1 + 1e-12
    # the interval's ends are where the share is 1.96 standard errors away
    for end in (low, high):
        if 1e-12 < end < 1 - 1e-12:
            assert abs(hits / count - end) == pytest.approx(
                shares.Z95 * np.sqrt(end * (1 - end) / count), rel=1e-6
            )


def test_who_is_interrupted_looks_at_no_further_log_and_seals_nothing(tmp_path, monkeypatch):
    looked: list[str] = []
    over = threading.Event()

    class Pool(ThreadPoolExecutor):
        """A log that has begun meanwhile takes until the others have been called off,
        or have not.
        """

        def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
            super().shutdown(wait=False, cancel_futures=cancel_futures)
            over.set()
            super().shutdown(wait=wait)

    def find(logs: tuple[Path, ...], out: Path) -> None:
        looked.append(out.name)
        if len(looked) == 2:
            raise KeyboardInterrupt
        if len(looked) > 2:
            over.wait()
        (out / "verdict.json").write_text(json.dumps({"verdict": "no_gap"}))

    for name in "abcdef":
        (tmp_path / "logs" / name).mkdir(parents=True)
        (tmp_path / "logs" / name / "meta.json").write_text("{}")
    monkeypatch.setattr(identify, "ThreadPoolExecutor", Pool)
    with pytest.raises(KeyboardInterrupt):
        identify.identify(tmp_path / "logs", tmp_path / "out", find, jobs=1)
    assert len(looked) <= 3  # one may have begun meanwhile
    assert not (tmp_path / "out" / "b" / "verdict.json").exists()
    assert not (tmp_path / "out" / "hashes.json").exists()
    identify.identify(tmp_path / "logs", tmp_path / "out", find, jobs=1)
    assert set(looked) == set("abcdef")
