"""Runs with what is true of them and what was said about them."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.hidden_effects.identify import digest

LARGE = 2.9
"""Multiple of its one-sigma size from which an effect counts: three times, with the rounding of a
search."""
SHOWN = 1.0
"""RMS residual in this log from which its motion is enough: some effects grow slower than in
proportion."""
SEPARABLE = 0.95
LONGEST_SET = 3


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

    @property
    def proposal(self) -> str:
        """Experiment that is proposed for a set in which the truth is.

        Empty where there is none.
        """
        in_sets = {name for one in self.verdict.get("sets", []) for name in one}
        holds = (
            bool(self.true_names)
            and set(self.true_names) <= self.offered
            and bool(in_sets & set(self.true_names))
        )
        if self.said != "set" or not holds:
            return ""
        return str((self.verdict.get("next_experiment") or {}).get("name") or "")

    def counts(self) -> bool:
        """True where every hidden effect is large enough and the motion shows it."""
        multiples, shown = self.truth["multiples"], self.truth["shown_rms"]
        return (
            not self.truth["quiet"]
            and all(m >= LARGE for m in multiples)
            and all(s >= SHOWN for s in shown)
        )

    def separable(self) -> bool:
        """True where every hidden effect differs from all others on these data."""
        return all(max(rivals.values(), default=0.0) < SEPARABLE for rivals in self.truth["rivals"])


def read_cases(verdicts: Path, truth: Path) -> list[Case]:
    """Reads verdicts and, after checking that they are as they were sealed, the truth.

    Raises:
        RuntimeError: a verdict has changed since the hashes were written.
    """
    hashes = json.loads((verdicts / "hashes.json").read_text(encoding="utf-8"))
    for name, expected in hashes.items():
        if digest(verdicts / name / "verdict.json") != expected:
            raise RuntimeError(
                f"the verdict on {name} is not the one that was sealed: identify again"
            )
    return [
        Case(
            truth=json.loads((truth / f"{name}.json").read_text(encoding="utf-8")),
            verdict=json.loads((verdicts / name / "verdict.json").read_text(encoding="utf-8")),
            baselines=_optional(verdicts / name / "baselines.json", {}),
            seconds=_optional(verdicts / name / "seconds.json", None),
        )
        for name in hashes
    ]


def _optional(path: Path, default: Any) -> Any:
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else default
