"""Verdicts of `find` on recordings that end in the middle, beside those on the whole ones.

Ten logs (joints, body, camera, jumps; without effects and with one) are cut at random lengths. A
cut may say less than the whole log, never something else: no name that the whole log does not give,
no `bad_log`, and nothing named without segments to test it on. Logs, and each cut's answer, are
kept in --out: a benchmark that was ended goes on there.

    saltus bench cuts -- --cuts 20 --workers 8 --out runs/cuts
"""

import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks._command import Command, progress, tell
from benchmarks._cut_logs import LOGS, length_s, made
from benchmarks.moving_logs import searched
from saltus.errors import ConfigError, nearest_hint
from saltus.files import write_whole
from saltus.real2sim.screening.screen import log_until
from saltus.recordings.run_log import read_run_log, write_run_log

SHORTEST_S = 0.2
ENOUGH_S = 8.0
"""From this length on a cut with test segments should name what the whole log names."""
WHOLE = "whole"


class Case(NamedTuple):
    """A log, or a cut of it."""

    log: str
    cut: str
    """Its number, or `WHOLE`."""
    share: float
    """Share of the time from `SHORTEST_S` to the whole length."""

    @property
    def name(self) -> str:
        return f"{self.log}_{self.cut}"


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    cuts: int = 20
    """Cuts of each log; their lengths are drawn in turn, so that more cuts keep the earlier
    ones."""
    seed: int = 0
    """Seed of the lengths."""
    logs: tuple[str, ...] = tuple(LOGS)
    """Which of the ten."""
    workers: int = 1
    """Logs that are compared at the same time, each on one core."""
    out: Path = Path("runs/cuts")
    """Folder that keeps logs and answers."""

    def measure(self) -> dict[str, Any]:
        if unknown := [name for name in self.logs if name not in LOGS]:
            raise ConfigError(f"there is no log '{unknown[0]}': {nearest_hint(unknown[0], LOGS)}")
        for name in self.logs:
            made(name, self.out / "logs")
        cases = self._cases()
        todo = [case for case in cases if not self._file(case).exists()]
        # each worker starts afresh: what a benchmark's process has loaded is not copied into them
        with ProcessPoolExecutor(self.workers, mp_context=get_context("spawn")) as pool:
            waiting = [pool.submit(answer, case, self.out, self._file(case)) for case in todo]
            for done in progress(as_completed(waiting), total=len(waiting)):
                tell(json.dumps(done.result()))
        rows = [json.loads(self._file(case).read_text(encoding="utf-8")) for case in cases]
        table = {name: counted([row for row in rows if row["log"] == name]) for name in self.logs}
        return {"cuts": self.cuts * len(self.logs), **_added(list(table.values())), "by_log": table}

    def _cases(self) -> list[Case]:
        """The whole logs, then the cuts of all logs in turn: after an hour all have some."""
        draws = {
            name: np.random.default_rng([self.seed, list(LOGS).index(name)]) for name in self.logs
        }
        whole = [Case(name, WHOLE, 1.0) for name in self.logs]
        return whole + [
            Case(name, str(k), float(draws[name].random()))
            for k in range(self.cuts)
            for name in self.logs
        ]

    def _file(self, case: Case) -> Path:
        seed = "" if case.cut == WHOLE else f"{self.seed}_"
        return self.out / "answers" / f"{case.log}_{seed}{case.cut}.json"


def answer(case: Case, out: Path, file: Path) -> dict[str, Any]:
    """Verdict of `find` on a case, also written into a file."""
    folder = out / "logs" / case.log
    log = read_run_log(folder)
    seconds = length_s(log)
    if case.cut != WHOLE:
        seconds = SHORTEST_S + case.share * (seconds - SHORTEST_S)
        folder = out / "cut" / file.stem
        if not (folder / "meta.json").exists():
            write_run_log(log_until(log, float(log.joints.time_s[0]) + seconds), folder)
    row = {"log": case.log, "cut": case.cut, "seconds_of_log": round(seconds, 3)}
    row |= searched(folder, out / "found" / file.stem)
    row["is_tested"] = (
        json.loads((out / "found" / file.stem / "verdict.json").read_text(encoding="utf-8"))["gap"]
        is not None
    )
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, json.dumps(row))
    return row


def counted(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Counts of the cuts of one log; rows as `answer` writes them, one of the whole log."""
    (whole,) = (row for row in rows if row["cut"] == WHOLE)
    cuts = [row for row in rows if row["cut"] != WHOLE]
    known = set(whole["effects"]) | {name for members in whole["sets"] for name in members}
    named = set(whole["effects"])
    long = [row for row in cuts if named and row["is_tested"] and row["seconds_of_log"] >= ENOUGH_S]
    right = [row for row in long if named <= set(row["effects"])]
    other = [row for row in cuts if set(row["effects"]) - known]
    return {
        "whole": whole["verdict"],
        "names": sorted(named),
        "cut": len(cuts),
        "other_names": len(other),
        "bad_log": sum(row["verdict"] == "bad_log" for row in cuts),
        "named_without_test": sum(bool(row["effects"]) and not row["is_tested"] for row in cuts),
        "long": len(long),
        "long_named": len(right),
        "not_right": [row for row in cuts if row in other or (row in long and row not in right)],
    }


def _added(table: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The sums over all logs."""
    counts = ("other_names", "bad_log", "named_without_test", "long", "long_named")
    found: dict[str, Any] = {count: sum(row[count] for row in table) for count in counts}
    return found | {"long_named_share": round(found["long_named"] / max(1, found["long"]), 3)}
