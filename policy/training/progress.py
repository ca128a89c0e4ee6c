"""Progress of a training: one line for people, a table for programs, curves for tensorboard."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path

import torch
from torch.utils.tensorboard import SummaryWriter

from saltus.policy.csv_tables import append_table
from saltus.policy.env.episode import TALLY
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.jump_rewards import TERMS
from saltus.policy.training.files import PROGRESS
from saltus.policy.training.learner import Learner

_SHORT = {
    "flat": "fl", "stairs": "st", "stepping_stones": "sn", "step": "up", "gap": "gp",
    "stairs_down": "sd",
    "step_down": "dn", "pyramid": "py", "irregular": "ir", "hurdles": "hu", "ditch": "di",
}  # fmt: skip


class TallyReader(ABC):
    """Reads an environment's tallies and starts them again.

    Continues `progress.csv` and the curves of a folder.
    """

    def __init__(self, folder: Path, learner: Learner) -> None:
        self._learner = learner
        self._table = folder / PROGRESS
        self._curves = SummaryWriter(str(folder), purge_step=learner.iteration)
        self._last_steps = learner.steps

    def report(self, losses: dict[str, float], seconds: float, total_seconds: float) -> str:
        """Writes a row and its curves, `seconds` after the last one; returns the line."""
        learner = self._learner
        row = {
            "iteration": float(learner.iteration),
            "steps": float(learner.steps),
            "seconds": total_seconds,
            "steps_per_s": (learner.steps - self._last_steps) / max(seconds, 1e-9),
            "learning_rate": learner.ppo.learning_rate,
            "std": learner.std,
            **losses,
            **self.counts(max((learner.steps - self._last_steps) / learner.robots, 1.0)),
        }
        self._last_steps = learner.steps
        self._write(row)
        return self.line(row)

    @abstractmethod
    def counts(self, steps: float) -> dict[str, float]:
        """Columns that the environment adds, of so many steps of each robot; it counts anew."""

    @abstractmethod
    def line(self, row: dict[str, float]) -> str:
        """A row for people."""

    def add(self, values: dict[str, float], iteration: int) -> None:
        """Adds points to tensorboard's curves."""
        for name, value in values.items():
            self._curves.add_scalar(name, value, iteration)

    def close(self) -> None:
        """Finishes the curves."""
        self._curves.close()

    def _write(self, row: dict[str, float]) -> None:
        append_table(self._table, [{name: f"{value:.6g}" for name, value in row.items()}])
        self.add(
            {name if "/" in name else f"train/{name}": value for name, value in row.items()},
            int(row["iteration"]),
        )


def mean_rewards(sums: torch.Tensor, names: Sequence[str], per_second: float) -> dict[str, float]:
    """Columns of the reward and its terms.

    Args:
        sums: Over steps, of the mean over robots of each term; set to 0 here.
        names: Of the terms.
        per_second: What makes the sums those of a second.
    """
    means = (per_second * sums).tolist()
    sums.zero_()
    return {f"reward/{name}": value for name, value in zip(names, means, strict=True)} | {
        "reward": sum(means)
    }


class JumpTally(TallyReader):
    """The tallies of jumping robots."""

    def __init__(self, folder: Path, env: JumpEnv, learner: Learner) -> None:
        super().__init__(folder, learner)
        self._env = env

    def counts(self, steps: float) -> dict[str, float]:
        """Rewards by term, and level, way, speed and ends on each kind of terrain."""
        sums = self._env.episodes.term_sums
        return {
            "crowded": self._env.crowded_share(),
            **mean_rewards(sums, TERMS, 100.0 / steps),
            **self._terrains(),
        }

    def line(self, row: dict[str, float]) -> str:
        """A row for people."""
        kinds = [name.removesuffix("/level") for name in row if name.endswith("/level")]
        terrains = [
            f"{_SHORT.get(kind, kind)} L{row[f'{kind}/level']:.2f} {row[f'{kind}/way_m']:.1f}m "
            f"{row[f'{kind}/speed']:.2f}m/s ok{100 * row[f'{kind}/finished']:.0f}%"
            for kind in kinds
        ]
        return (
            f"it {row['iteration']:.0f} {row['steps'] / 1e6:.1f}M {row['seconds']:.0f}s "
            f"{row['steps_per_s'] / 1e3:.1f}k/s "
            f"rew {row['reward']:.2f} std {row['std']:.2f} lr {row['learning_rate']:.0e} | "
            + " | ".join(terrains)
        )

    def _terrains(self) -> dict[str, float]:
        memory, tally = self._env.memory, self._env.episodes.tally
        values: dict[str, float] = {}
        for k, kind in enumerate(self._env.config.curriculum.shares):
            level = memory.level[memory.kind == k]
            if not len(level):
                continue
            counts = dict(zip(TALLY, tally[k].tolist(), strict=True))
            episodes = max(counts.pop("episodes"), 1.0)
            values[f"{kind}/level"] = float(level.mean())
            values[f"{kind}/top"] = float(torch.quantile(level, 0.9))
            values[f"{kind}/speed"] = counts["way_m"] / max(counts["time_s"], 1e-9)
            values |= {f"{kind}/{name}": count / episodes for name, count in counts.items()}
        tally.zero_()
        return values
