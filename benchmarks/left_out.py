"""What real2sim says of an effect that its library lacks: each run's true effect is taken out before the search.

    python -m benchmarks.left_out LOGS TRUTH [--out left_out.json]

LOGS and TRUTH are folders of `benchmarks.hidden_effects generate`. Runs with one effect of the library at three times
the one-sigma size or more are searched. Counted are "unexplained", "no gap", and, where another effect is named instead
of the true one, whether the finding is marked with a remainder: more of the gap is left than two right simulations of
one robot leave (`saltus.real2sim.search.decide.REMAINDER_RMS`).
"""

import argparse
import json
from collections import Counter
from pathlib import Path
from typing import Any

from saltus.real2sim.pipeline import examine, judge
from saltus.real2sim.problem.log import load
from saltus.real2sim.results import Examination
from saltus.real2sim.search.decide import REMAINDER_RMS

LARGE = 3.0
"""Times the size at which an effect's residual is one sigma: from here on it must be found."""


def main() -> None:
    """Prints a line for each run, and the counts as JSON on the last line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--out", type=Path, help="JSON with all results")
    options = parser.parse_args()
    results = []
    for path in sorted(options.truth.glob("*.json")):
        truth = json.loads(path.read_text())
        if _counts(truth):
            results.append(_searched(options.logs / path.stem, str(truth["effects"][0]["name"])))
            print("{run}  without {without:20} {outcome:22} {named}".format(**results[-1]), flush=True)
    counts = dict(Counter(result["outcome"] for result in results))
    if options.out is not None:
        options.out.write_text(json.dumps({"counts": counts, "runs": results}, indent=1) + "\n")
    print(json.dumps(counts))


def _counts(truth: Any) -> bool:
    if not isinstance(truth, dict) or truth.get("category") != "one" or truth["quiet"]:
        return False
    return min(truth["multiples"]) >= LARGE - 1e-6


def _searched(log: Path, effect: str) -> dict[str, Any]:
    examined = examine(load([log]), without=(effect,))
    verdict = judge((examined,), ()).verdict
    outcome: str = verdict.verdict
    if outcome in ("named", "set"):
        outcome = "false, with remainder" if _remains(examined) else "false and confident"
    return {
        "run": log.name,
        "without": effect,
        "outcome": outcome,
        "named": ", ".join(dict.fromkeys([e.name for e in verdict.effects] + [n for s in verdict.sets for n in s])),
        "remainder_sigma": max((each.findings.remainder for each in examined.comparisons), default=0.0),
    }


def _remains(examined: Examination) -> bool:
    """Whether a sensor whose gap was explained keeps structure above what right simulations differ by."""
    return any(
        each.findings.remainder > REMAINDER_RMS * each.problem.samples_per_residual**0.5
        for each in examined.comparisons
        if each.findings.verdict in ("named", "set")
    )


if __name__ == "__main__":
    main()
