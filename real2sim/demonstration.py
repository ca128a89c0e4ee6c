"""The whole cycle on a simulated robot: hide an effect,
run an experiment, find the effect, apply it, look again.

The search sees the run logs only: it knows as much of the robot as the owner of a real one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from saltus.effects.delay_line import CommandDelay
from saltus.effects.effect import Effect
from saltus.effects.encoders import EncoderBias, VelocityFilter
from saltus.effects.joint_loads import Armature, CoulombFriction, Stiction, ViscousFriction
from saltus.effects.motors import ActuatorLag, BatterySag, TorqueGain, TorqueSaturation
from saltus.effects.profile import IDEAL, Profile
from saltus.errors import SaltusError
from saltus.real2sim.cycle.finding import search_until_told
from saltus.real2sim.experiments.menu import Experiment, experiment_named
from saltus.real2sim.experiments.run import run_experiment
from saltus.real2sim.pipeline import find_in_logs
from saltus.real2sim.progress import ProgressListener
from saltus.real2sim.results import Judgement
from saltus.recordings.run_log import write_run_log
from saltus.robots.robot import Robot

FIRST = "joint_tour"
CALVES = np.arange(12) % 3 == 2
KINDS = ("all joints", "hip", "thigh", "calf")

_Draw = Callable[[np.random.Generator, np.ndarray], Effect]


def _spread(where: np.ndarray, value: float, null: float = 0.0) -> tuple[float, ...]:
    return tuple(np.where(where, value, null).tolist())


# Every effect of drives and encoders, with sizes within the published ranges for robots of this
# size, but for
# - backlash, the torque-speed limit and encoder quantisation: the plant crosses a gap, holds a
#   limit or hunts between two encoder steps within a few of its time steps, which no other
#   simulation repeats to within the noise of a sensor, so that a small gap remains after the
#   patch;
# - the delay of feed-forward torque alone: the first experiment has no such torque.
_HIDDEN: tuple[_Draw, ...] = (
    lambda rng, at: CoulombFriction(torque=_spread(at, rng.uniform(0.2, 0.5))),
    lambda rng, at: Stiction(
        breakaway=_spread(at, rng.uniform(0.3, 0.6)), stribeck_velocity=rng.uniform(0.05, 0.15)
    ),
    lambda rng, at: ViscousFriction(coefficient=_spread(at, rng.uniform(0.1, 0.3))),
    lambda rng, at: Armature(added=_spread(at, rng.uniform(0.003, 0.008))),
    lambda rng, at: EncoderBias(bias=_spread(at, rng.uniform(0.02, 0.05))),
    lambda rng, at: TorqueGain(gain=_spread(at, rng.uniform(0.85, 0.92), 1.0)),
    lambda rng, _: BatterySag(loss_at_end=rng.uniform(0.1, 0.2)),
    lambda rng, _: CommandDelay(delay=rng.uniform(0.003, 0.010)),
    lambda rng, _: ActuatorLag(time_constant=rng.uniform(0.003, 0.008)),
    lambda rng, _: VelocityFilter(time_constant=rng.uniform(0.003, 0.006)),
    lambda rng, _: TorqueSaturation(
        knee=_spread(CALVES, rng.uniform(12.0, 16.0), np.inf),
        plateau=_spread(CALVES, rng.uniform(20.0, 26.0), np.inf),
    ),
)


def demo_robot(seed: int) -> Profile:
    """A robot with one effect; the seed decides which, where, and how large."""
    rng = np.random.default_rng([seed, 6])
    draw = _HIDDEN[rng.integers(len(_HIDDEN))]
    kind = rng.integers(len(KINDS))
    where = np.full(12, True) if kind == 0 else np.arange(12) % 3 == kind - 1
    return Profile(actuator=(draw(rng, where),))


@dataclass(frozen=True, kw_only=True, eq=False)
class Demonstration:
    """Results of `real2sim demo`: the effect that was hidden, what was found, and the gap before
    and after.
    """

    hidden: Profile
    """Effects of the robot."""
    experiments: tuple[Experiment, ...]
    found: Judgement
    """Before the patch."""
    profile: Profile
    """With the patch."""
    again: Judgement
    """After it, on the same logs."""


def demonstrate(
    robot: Robot, out: Path, *, seed: int = 0, progress: ProgressListener | None = None
) -> Demonstration:
    """Hides an effect in a robot, finds it in logs, adds it to the simulator and looks again.

    The seed decides which effect is hidden, where and how large it is, and the noise of the
    sensors. The folder `out`, in which logs and results land, exists.

    Raises:
        SaltusError: no effect that could be applied was found.
    """
    tell = progress or (lambda _stage, _share: None)
    hidden = demo_robot(seed)

    def record(name: str) -> Path:
        log = run_experiment(
            experiment_named(name), robot, hidden, seed=seed, progress=partial(tell, f"run {name}")
        )
        write_run_log(log, out / "logs" / name, robot)
        return out / "logs" / name

    def look(logs: Sequence[Path]) -> Judgement:
        return find_in_logs(
            logs, out / "found", seed=seed, progress=lambda stage, x: tell(f"find: {stage}", x)
        )

    found, logs = search_until_told([record(FIRST)], look, record)
    profile = found.patch.applied_to(IDEAL, robot)
    if profile == IDEAL:
        raise SaltusError(
            f"the demonstration with seed {seed} ends here: {found.verdict.verdict}, nothing to "
            "apply"
        )
    (out / "profile.toml").write_text(profile.to_toml(), encoding="utf-8")
    again = find_in_logs(
        logs,
        out / "again",
        profile=profile,
        seed=seed,
        progress=lambda stage, x: tell(f"again: {stage}", x),
    )
    experiments = tuple(experiment_named(log.name) for log in logs)
    return Demonstration(
        hidden=hidden, experiments=experiments, found=found, profile=profile, again=again
    )
