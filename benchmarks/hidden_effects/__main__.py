"""Command line of the benchmark of hidden effects: generate, identify, score."""

import argparse
from pathlib import Path

from benchmarks.hidden_effects.generate import generate
from benchmarks.hidden_effects.plan import KINDS, make_plan


def main() -> None:
    """Runs one of the three parts."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hidden_effects")
    parts = parser.add_subparsers(dest="part", required=True)
    make = parts.add_parser("generate", help="write logs, and the truth about them elsewhere")
    make.add_argument("--seed", type=int, required=True)
    make.add_argument("--runs", type=int, default=200)
    make.add_argument("--out", type=Path, required=True)
    make.add_argument("--truth", type=Path, required=True)
    make.add_argument("--jobs", type=int, default=2)
    make.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    make.add_argument("--tuning", action="store_true", help="other motions, sizes and colours of noise")
    options = parser.parse_args()
    if options.part == "generate":
        runs = make_plan(options.seed, options.runs, tuple(options.kinds))
        generate(runs, options.out, options.truth, tuning=options.tuning, jobs=options.jobs)


if __name__ == "__main__":
    main()
