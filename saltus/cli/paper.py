"""`saltus paper`: the paper's tables, figures and claims, made again."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from saltus.cli.output import print_figures, print_json
from saltus.config import check_between
from saltus.flags import Flag, shown
from saltus.workers import check_processes

MOST_TRIALS = 10_000


@dataclass(frozen=True, kw_only=True)
class Paper:
    """Makes the paper's tables and figures again from the shipped models: lists them, or makes one of them.

    A row is written as PNG and JSON. All of it is measured in simulation. Figures need matplotlib.

    For example:
      saltus paper
      saltus paper staircase --trials 20
    """

    name: Annotated[tyro.conf.Positional[str], shown("NAME", "none, list them")] = ""
    """Which row."""
    trials: int = 20
    """Of each course; rows that compare starts have five of them."""
    seed: Annotated[int | None, shown("INT", "130000")] = None
    """Of the first trial; the others have SEED + 1, SEED + 2, ..."""
    processes: Annotated[int | None, shown("INT", "one for each core")] = None
    """How many share the trials."""
    out: Path = Path("runs/paper")
    """Folder for the files."""
    json: Flag = False
    """Print the result as one JSON object on the last line."""

    def run(self) -> int:
        """Lists or makes."""
        from saltus.paper.rows import ROWS

        if not self.name:
            rows = {row.name: {"paper": row.where, "needs": row.needs, "shows": row.shows} for row in ROWS}
            if self.json:
                print_json({"rows": rows})
                return 0
            for row in ROWS:
                print(f"{row.name:24} {row.where:21} {row.needs:19} {row.shows}")
            return 0
        from tqdm import tqdm

        from saltus.paper.making import check_makeable, find_row, make
        from saltus.paper.runs import FIRST_SEED, Effort

        row = find_row(self.name)
        check_between(self, trials=(1, MOST_TRIALS))
        check_processes(self.processes)
        check_makeable(row, self.out)
        with tqdm(unit="trial", desc=row.name, file=sys.stderr, disable=None) as bar:
            seed = FIRST_SEED if self.seed is None else self.seed
            effort = Effort(trials=self.trials, first_seed=seed, processes=self.processes, say=bar.update)
            result = make(row, effort, self.out)
        print_figures(result["numbers"])
        print(self.out / f"{row.name}.png")
        if self.json:
            print_json(result)
        return 0
