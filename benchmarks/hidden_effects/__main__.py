"""Command line of the benchmark of hidden effects: generate, identify, follow up, score."""

import argparse
import json
from pathlib import Path

from benchmarks.hidden_effects import cases, confusion, followup, identify, score
from benchmarks.hidden_effects.generate import generate
from benchmarks.hidden_effects.plan import KINDS, make_plan


def main() -> None:
    """Runs one of the parts."""
    options = _options()
    if options.part == "generate":
        runs = make_plan(options.seed, options.runs, tuple(options.kinds), tuning=options.tuning)
        generate(runs, options.out, options.truth, tuning=options.tuning, jobs=options.jobs)
    elif options.part == "identify":
        identify.identify(options.logs, options.out, identify.command, options.jobs, options.second)
    elif options.part == "followup":
        followup.followup(cases.read_cases(options.verdicts, options.truth), options.out)
    else:
        marked = cases.read_cases(options.verdicts, options.truth)
        again = None if options.followup is None else cases.read_cases(options.followup, options.truth)
        table = score.table(marked, again)
        (options.verdicts / "score.json").write_text(json.dumps(table, indent=1))
        confusion.write_confusion(marked, options.verdicts)
        print(json.dumps(table) if options.json else _text(table))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hidden_effects")
    parts = parser.add_subparsers(dest="part", required=True)
    make = parts.add_parser("generate", help="write logs, and the truth about them elsewhere")
    make.add_argument("--seed", type=int, required=True)
    make.add_argument("--runs", type=int, default=200)
    make.add_argument("--out", type=Path, required=True)
    make.add_argument("--truth", type=Path, required=True, help="a folder that the identifier does not read")
    make.add_argument("--jobs", type=int, default=2)
    make.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    make.add_argument("--tuning", action="store_true", help="other motions and colours of noise")
    look = parts.add_parser("identify", help="let real2sim look at every log, and seal its verdicts")
    look.add_argument("logs", type=Path)
    look.add_argument("--out", type=Path, required=True)
    look.add_argument("--jobs", type=int, default=2)
    look.add_argument(
        "--with", dest="second", type=Path, help="second logs of some of the robots: both are read as one"
    )
    more = parts.add_parser("followup", help="have robots do what was proposed for them; opens the truth")
    more.add_argument("verdicts", type=Path)
    more.add_argument("truth", type=Path)
    more.add_argument("--out", type=Path, required=True)
    mark = parts.add_parser("score", help="compare sealed verdicts with the truth")
    mark.add_argument("verdicts", type=Path)
    mark.add_argument("truth", type=Path)
    mark.add_argument("--followup", type=Path, help="verdicts on robots that did what was proposed")
    mark.add_argument("--json", action="store_true")
    return parser.parse_args()


def _text(table: dict) -> str:
    lines = []
    for name, row in table.items():
        if "value" not in row:
            lines += [f"{name} {part}: {json.dumps(values)}" for part, values in row.items()]
            continue
        value = "-" if row["value"] is None else f"{row['value']:.3f}"
        interval = row.get("wilson95")
        between = f"  [{interval[0]:.3f}, {interval[1]:.3f}]" if interval else ""
        lines.append(f"{name:34s} {value:>8s}{between}  n = {row['count']}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
