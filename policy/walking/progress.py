"""Progress of a walking training: a line for people, a row of a table, curves."""

from pathlib import Path

from saltus.policy.training.learner import Learner
from saltus.policy.training.progress import TallyReader, mean_rewards
from saltus.policy.walking.description import POLICY_HZ
from saltus.policy.walking.walk_env import TALLY, WalkEnv
from saltus.policy.walking.walk_rewards import TERMS


class WalkTally(TallyReader):
    """The tallies of walking robots."""

    def __init__(self, folder: Path, env: WalkEnv, learner: Learner) -> None:
        super().__init__(folder, learner)
        self._env = env

    def counts(self, steps: float) -> dict[str, float]:
        """Rewards by term, and level, falls, errors of velocities and way on each ground."""
        env = self._env
        values = {
            "crowded": env.crowded_share(),
            **mean_rewards(env.term_sums, TERMS, POLICY_HZ / steps),
        }
        for k, kind in enumerate(env.config.ground.shares):
            level = env.memory.level[env.memory.kind == k]
            if not len(level):
                continue
            sums = dict(zip(TALLY, env.tally[k].tolist(), strict=True))
            robot_steps = max(sums["steps"], 1.0)
            values |= {
                f"{kind}/level": float(level.mean()),
                f"{kind}/failed": sums["failed"] / max(sums["episodes"], 1.0),
                f"{kind}/speed_error": sums["speed_error"] / robot_steps,
                f"{kind}/turn_error": sums["turn_error"] / robot_steps,
                f"{kind}/way": sums["way_m"] / max(sums["asked_m"], 1e-9),
            }
        env.tally.zero_()
        return values

    def line(self, row: dict[str, float]) -> str:
        """A row for people."""
        grounds = [
            f"{kind} L{row[f'{kind}/level']:.1f} fell{100 * row[f'{kind}/failed']:.0f}% "
            f"v{row[f'{kind}/speed_error']:.2f} w{row[f'{kind}/turn_error']:.2f} "
            f"way{100 * row[f'{kind}/way']:.0f}%"
            for kind in self._env.config.ground.shares
            if f"{kind}/level" in row
        ]
        return (
            f"it {row['iteration']:.0f} {row['steps'] / 1e6:.1f}M {row['seconds']:.0f}s "
            f"{row['steps_per_s'] / 1e3:.1f}k/s rew {row['reward']:.2f} std {row['std']:.2f} "
            f"lr {row['learning_rate']:.0e} crowded {row['crowded']:.4f} | " + " | ".join(grounds)
        )
