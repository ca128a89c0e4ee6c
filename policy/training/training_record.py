"""Files in a training's folder: checkpoint, configuration,
commit, curves, how the deployed stack did.
"""

import contextlib
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from saltus.config import to_toml
from saltus.policy.csv_tables import carry_on
from saltus.policy.training.background_evaluation import (
    BackgroundEvaluation,
    EvaluationRow,
    evaluation_line,
    missing_packages,
)
from saltus.policy.training.files import CHECKPOINT, COMMIT, PROGRESS
from saltus.policy.training.learner import Learner
from saltus.policy.training.progress import TallyReader

REPORT_S = 10.0
SAVE_S = 120.0
EVALUATION_TRIALS = 8
LOG, RESULTS = "log.txt", "evaluation.csv"


class TrainingRecord:
    """Writes checkpoints, reports and curves into a folder when they are due.

    `say` prints a line for people as well. `progress` is made once tables of a training that is
    resumed lie in the folder; `saved` is called with each checkpoint that was written. The run
    began at `start_s` on the monotonic clock, less what the checkpoint that it resumes had cost;
    log and tables beside that one are continued. Every `evaluate_s` the deployed stack is evaluated
    on `kinds` of terrain, never where that is 0.
    """

    def __init__(
        self,
        folder: Path,
        config: object,
        learner: Learner,
        progress: Callable[[], TallyReader],
        *,
        commit: str,
        start_s: float,
        evaluate_s: float = 0.0,
        kinds: Sequence[str] = (),
        say: Callable[[str], None],
        resumed: Path | None = None,
        saved: Callable[[Path], None] | None = None,
        save_s: float = SAVE_S,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        if resumed is not None:
            _carry_on(resumed.parent, folder, learner.iteration)
        self.checkpoint = folder / CHECKPOINT
        """Where the checkpoint lies."""
        self._learner, self._start_s, self._say, self._log = learner, start_s, say, folder / LOG
        self._after_saving, self._save_s = saved, save_s
        self._extra: Mapping[str, str] = {"config": to_toml(config), "commit": commit}
        (folder / "config.toml").write_text(self._extra["config"], encoding="utf-8")
        (folder / COMMIT).write_text(commit + "\n", encoding="utf-8")
        self._progress = progress()
        self._reported = self._saved = time.monotonic()
        self.evaluation = self._evaluations(folder, kinds, evaluate_s) if evaluate_s > 0.0 else None
        """Evaluation that runs beside the training; None where none does."""
        # A folder with a table in it has a checkpoint, which no other training writes over
        self.save()

    def say(self, line: str) -> None:
        """Tells people, and the log."""
        self._say(line)
        # A line of the log is not worth the training.
        with contextlib.suppress(OSError), self._log.open("a", encoding="utf-8") as log:
            log.write(line + "\n")

    def step(self, losses: dict[str, float]) -> None:
        """After an iteration: reports, saves and evaluates what is due."""
        now = time.monotonic()
        if now - self._reported > REPORT_S:
            self.say(self._progress.report(losses, now - self._reported, now - self._start_s))
            self._reported = now
        evaluates = self.evaluation is not None and self.evaluation.due(now)
        if evaluates or now - self._saved > self._save_s:
            self.save()
        if self.evaluation is not None:
            if evaluates:
                self.evaluation.start(self.checkpoint, now)
            self._tell(self.evaluation.finished())

    def close(self) -> None:
        """Ends what is still running."""
        if self.evaluation is not None:
            self._tell(self.evaluation.finished())
            self.evaluation.close()
        self._progress.close()

    def save(self) -> None:
        """Writes the checkpoint."""
        now = time.monotonic()
        self._learner.save(self.checkpoint, {**self._extra, "seconds": now - self._start_s})
        if self._after_saving is not None:
            self._after_saving(self.checkpoint)
        self._saved = now

    def _tell(self, rows: list[EvaluationRow]) -> None:
        if not rows:
            return
        self.say(evaluation_line(rows))
        for row in rows:
            values = {name: value for name, value in asdict(row).items() if name in _CURVES}
            self._progress.add(
                {f"deployed/{row.course}/{name}": value for name, value in values.items()},
                row.iteration,
            )

    def _evaluations(
        self, folder: Path, kinds: Sequence[str], every_s: float
    ) -> BackgroundEvaluation | None:
        missing = missing_packages()
        if missing:
            self.say(
                f"no evaluation with the deployed stack: not installed here: {', '.join(missing)}"
            )
            return None
        return BackgroundEvaluation(
            folder / RESULTS, kinds, every_s=every_s, trials=EVALUATION_TRIALS
        )


def _carry_on(before: Path, folder: Path, iteration: int) -> None:
    """Continues log and tables of the resumed training, as far as its checkpoint."""
    before, folder = before.resolve(), folder.resolve()
    for table in (PROGRESS, RESULTS):
        carry_on(before / table, folder / table, iteration)
    if before != folder and (before / LOG).exists():
        shutil.copyfile(before / LOG, folder / LOG)


_CURVES = ("success_rate", "way_share", "mean_speed_mps", "time_p50_s")
