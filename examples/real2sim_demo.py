"""real2sim from Python: an effect hidden in a robot is found in its log.

One joint is drawn before and after the patch.

Needs matplotlib; `saltus real2sim demo` does the same without the picture.

    python examples/real2sim_demo.py --seed 2 --out runs/real2sim
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import tyro

from saltus.effects.profile import IDEAL, Profile
from saltus.real2sim.demonstration import Demonstration, demonstrate
from saltus.real2sim.experiments.motions import Floats
from saltus.real2sim.experiments.run import SensorNoise, run_experiment
from saltus.real2sim.reporting.verdict_text import verdict_sentence
from saltus.recordings.run_log import RunLog, read_run_log
from saltus.robots.loading import load_robot
from saltus.robots.robot import JOINTS
from saltus.robots.shipped import DEFAULT_ROBOT


def main(*, seed: int = 2, out: Path = Path("runs/real2sim")) -> None:
    """Hides an effect in a simulated robot, finds it, applies the patch, and draws picture.png.

    Args:
        seed: Which effect, where and how large.
        out: Folder for logs, verdicts, patch, profile and the picture.
    """
    shown = demonstrate(load_robot(DEFAULT_ROBOT), out, seed=seed)
    print(f"found: {verdict_sentence(shown.found.verdict)}")
    print(f"with the patch: {verdict_sentence(shown.again.verdict)}")
    draw(shown, read_run_log(out / "logs" / shown.experiments[0].name), out / "picture.png")


def draw(shown: Demonstration, log: RunLog, path: Path) -> None:
    """One joint as measured and as simulated with and without the patch,
    and the gap on segments unseen by any fit.
    """
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    without, patched = _simulated(shown, IDEAL), _simulated(shown, shown.profile)
    miss = np.abs(without - log.joints.q)
    joint = int(miss.mean(axis=0).argmax())
    centre = int(np.convolve(miss[:, joint], np.ones(250), mode="same").argmax())
    rows = slice(max(0, centre - 300), centre + 300)
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(9.0, 3.4), width_ratios=(3, 1), layout="constrained"
    )
    t = log.joints.time_s[rows]
    left.plot(t, log.joints.q[rows, joint], ".", color="0.6", markersize=3, label="measured")
    left.plot(t, without[rows, joint], color="#d1495b", label="simulated as claimed")
    left.plot(t, patched[rows, joint], color="#1f5fa8", label="simulated with the patch")
    left.set(xlabel="time [s]", ylabel=f"{JOINTS[joint]} [rad]", title=_title(shown))
    left.legend(frameon=False)
    gap = shown.found.verdict.gap
    if gap is not None:
        right.bar(
            ["before", "after", "noise"],
            [gap.before, gap.after, gap.floor],
            color=["#d1495b", "#1f5fa8", "0.6"],
        )
        right.set(yscale="log", title="gap, unseen segments")
    figure.savefig(path, dpi=130)


def _title(shown: Demonstration) -> str:
    effect = shown.found.verdict.effects[0]
    value = next(iter(effect.params.values()))
    low, high = value.ci90
    return f"found: {effect.name}, {value.value:.3g} {value.unit} ({low:.3g} to {high:.3g})"


def _simulated(shown: Demonstration, profile: Profile) -> Floats:
    """Angles of a simulated robot without sensor noise that does the same."""
    silent = SensorNoise(q_rad=0.0, dq_rad_s=0.0, tau_nm=0.0)
    return run_experiment(
        shown.experiments[0], load_robot(DEFAULT_ROBOT), profile, noise=silent
    ).joints.q


if __name__ == "__main__":
    tyro.cli(main)
