"""Draws by the seed of a simulated run, told apart from what is unknown of its robot.

Each run of Saltus has a payload, a ground, drives and a camera of its own (`saltus.trial`). The log
claims what was drawn of body, drives and ground, so that `find` looks for the rest. The camera's
latency it claims as the profile has it, so that the drawn one is found as an effect.
"""

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from saltus.constants import POLICY_DT
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.profile import load_profile
from saltus.errors import SaltusError
from saltus.real2sim.problem.log import robot_of
from saltus.real2sim.results import Judgement
from saltus.real2sim.search.findings import FoundEffect
from saltus.trial import Trial

EXACT_S = 0.001
"""By which a found latency may be below the drawn one; above it by a tick of images more."""


def drawn_lines(judgement: Judgement) -> list[str]:
    """Returns what the seeds of simulated runs drew, and which effects are not of them; else nothing.

    A line for the draws, one for the effects that are draws, one for those that are not.
    """
    metas = [each.log.meta for each in judgement.examinations]
    trials = {trial.seed: trial for meta in metas if (trial := _trial(meta)) is not None}
    if not trials:
        return []
    lines = [
        f"drawn by the seed of the run ({seed}), and claimed by its log: payload {trial.payload_kg:.3g} kg, "
        f"motor strength {trial.motor_strength:.3g}, friction of the ground {trial.friction:.3g}"
        for seed, trial in trials.items()
    ]
    verdict = judgement.verdict
    told = (*verdict.effects, *verdict.nearest)
    own = [effect for effect in told if is_drawn(effect, metas)]
    for effect in own:
        value = effect.params["latency"].value
        lines.append(f"drawn as well, and not claimed: {effect.name} ({value:.3g} s) is that of the seed")
    if unknown := dict.fromkeys(effect.name for effect in told if effect not in own):
        lines.append(f"not drawn by the seed, so of the robot itself: {', '.join(unknown)}")
    return lines


def is_drawn(effect: FoundEffect, metas: Sequence[dict[str, Any]]) -> bool:
    """True where an effect is what the seed of a run drew of its camera."""
    if effect.name != CameraLatency.name or "latency" not in effect.params:
        return False
    latencies = [_latency_s(meta, trial) for meta in metas if (trial := _trial(meta)) is not None]
    found_s = effect.params["latency"].value
    return any(-EXACT_S <= found_s - drawn_s <= POLICY_DT + EXACT_S for drawn_s in latencies)


def _trial(meta: dict[str, Any]) -> Trial | None:
    """The trial of a simulated run; the log of a real robot claims no motor strength."""
    config = meta.get("config")
    if not isinstance(config, dict) or not isinstance(config.get("seed"), int) or "motor_strength" not in meta:
        return None
    return Trial.draw(config["seed"])


def _latency_s(meta: dict[str, Any], trial: Trial) -> float:
    """The camera's latency of a trial's robot; that of the nominal one without its profile."""
    with suppress(SaltusError):
        robot = robot_of(meta)
        profile = trial.applied_to(load_profile(str(meta["config"].get("profile")), robot))
        return float(next((e.latency for e in profile.camera if isinstance(e, CameraLatency)), 0.0))
    return trial.camera_delay_s
