"""`saltus paper`: the paper's tables, figures and claims, made again."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from saltus.cli.output import print_figures, print_json
from saltus.config import check_between
from saltus.errors import SaltusError
from saltus.extras import packages_of
from saltus.flags import Flag, flag_help
from saltus.workers import check_processes

if TYPE_CHECKING:
    from paper.rows import Row

MOST_TRIALS = 10_000
REPORT, TRAIN = "report", "train"


@dataclass(frozen=True, kw_only=True)
class Paper:
    """Makes the paper's tables and figures again from the shipped models:
    lists them, makes one, or a page of all.

    A row is written as PNG and JSON. `report` makes those that are not there yet, and one page of
    all. All of it is measured in simulation. Figures need matplotlib.

    For example:
      saltus paper
      saltus paper staircase
      saltus paper report
      saltus paper train no-feedback --seed 1
    """

    name: Annotated[tyro.conf.Positional[str], flag_help("NAME", "none, list them")] = ""
    """Name of a row; report: a page of all; train: trains an ablation on a GPU."""
    ablation: Annotated[tyro.conf.Positional[str], flag_help("ABLATION", "none")] = ""
    """After train: which one."""
    trials: int = 100
    """Trials of each course; rows that compare starts have five of them."""
    seed: Annotated[int | None, flag_help("INT", "130000, of a training 0")] = None
    """Seed of the first trial, the others have SEED + 1, SEED + 2, ...; or of a training."""
    processes: Annotated[int | None, flag_help("INT", "one for each core")] = None
    """Number of processes that share the trials."""
    out: Path = Path("runs/paper")
    """Folder for the files."""
    trained: Annotated[
        Path | None, flag_help("PATH", "to train runs/paper-train, to measure the published ones")
    ] = None
    """Folder of the ablations' trainings."""
    minutes: float = 30.0
    """Time limit of a policy's training, which goes on where it was interrupted."""
    commit: Annotated[str | None, flag_help("STR", "as git says")] = None
    """Commit of the code that trains, where this machine has no repository."""
    json: Flag = False
    """Print the result as one JSON object on the last line."""

    def run(self) -> int:
        """Lists or makes."""
        if not self.name:
            return self._list()
        if self.name == TRAIN:
            return self._train()
        if self.ablation:
            raise SaltusError(
                f"'{self.ablation}' is not understood: only saltus paper train names two things"
            )
        from paper.making import check_makeable, find_row, is_makeable
        from paper.rows import ROWS

        report = self.name == REPORT
        rows = (
            [row for row in ROWS if is_makeable(row, self.trained)]
            if report
            else [find_row(self.name)]
        )
        check_between(self, trials=(1, MOST_TRIALS))
        check_processes(self.processes)
        for row in rows:
            check_makeable(row, self.out, self.trained)
        results = {row.name: self._made(row, again=not report) for row in rows}
        if report:
            from paper.report import write_report

            print(write_report(results, self.out))
        else:
            (result,) = results.values()
            print_figures(result["numbers"])
            print(self.out / f"{self.name}.png")
        if self.json:
            print_json(results if report else result)
        return 0

    def _train(self) -> int:
        with packages_of("train"):
            from paper.training import NETWORKS, TRAINED, train

            seed, trained = 0 if self.seed is None else self.seed, self.trained or TRAINED
            if self.ablation in NETWORKS:
                from paper.networks import train_network

                print(train_network(self.ablation, seed, trained, self.commit))
            else:
                print(train(self.ablation, seed, trained, self.minutes, self.commit))
        return 0

    def _list(self) -> int:
        from paper.rows import ROWS

        if self.json:
            print_json(
                {
                    "rows": {
                        r.name: {"paper": r.where, "needs": r.needs, "shows": r.shows} for r in ROWS
                    }
                }
            )
            return 0
        for row in ROWS:
            print(f"{row.name:24} {row.where:21} {row.needs:19} {row.shows}")
        return 0

    def _made(self, row: "Row", again: bool) -> dict[str, Any]:
        """Returns what a row came to.

        One that is there is taken as it is, unless it is to be made again.
        """
        from tqdm import tqdm

        from paper.making import made_before, make
        from paper.runs import FIRST_SEED, Effort

        there = None if again else made_before(row, self.out)
        if there is not None:
            return there
        with tqdm(unit="trial", desc=row.name, file=sys.stderr, disable=None) as bar:
            seed = FIRST_SEED if self.seed is None else self.seed
            effort = Effort(
                trials=self.trials, first_seed=seed, processes=self.processes, say=bar.update
            )
            return make(row, effort, self.out, self.trained, again=again)
