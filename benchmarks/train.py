"""How fast the motion policy trains, and where the time goes.

Environment steps per second with learning, and milliseconds per policy step of all robots.
"learning" is the update of the networks, divided by the steps that it learns from.

    saltus bench train -- --robots 16384
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import torch

from benchmarks._command import Command
from saltus.constants import POLICY_STEPS
from saltus.grid import load_grid
from saltus.policy.env.jump_env import JumpEnv
from saltus.policy.env.settings import JumpTrainSettings, for_cpu, for_gpu
from saltus.policy.training.learner import JumpLearner
from saltus.policy.training.train import device_of_this_process, make_engine
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT

_WARM_UPS = 2  # iterations: the first ones allocate, and on a GPU choose their kernels
_REPEATS = 50  # of a stage


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    robots: int | None = None
    """How many train; as many as a training on this device has, by default."""
    device: Literal["auto", "cpu"] = "auto"
    """auto: a GPU where there is one."""
    iterations: int = 5
    """Iterations of the learning."""

    def measure(self) -> dict[str, Any]:
        device = device_of_this_process(self.device).device
        config = for_cpu("go1", "line") if device == "cpu" else for_gpu("go1", "line")
        return measure(
            replace(config, robots=self.robots or config.robots), device, self.iterations
        )


def measure(
    config: JumpTrainSettings, device: str, iterations: int, repeats: int = _REPEATS
) -> dict[str, Any]:
    """Trains for some iterations, then times the stages of a step one by one."""
    engine = make_engine(load_robot(DEFAULT_ROBOT), config.robots, config.env, device)
    env = JumpEnv(engine, config.env, load_grid(config.grid), seed=0, device=device)
    learner = JumpLearner(env, config.learning)
    collecting, learning = _iterations(learner, iterations, device)
    plan, control, sense, finish = env.stages
    horizon = config.learning.horizon

    def ms(stage: Callable[[], object]) -> float:
        return _ms(stage, device, repeats)

    with torch.no_grad():
        times = {
            "physics": ms(engine.step) * POLICY_STEPS,
            "controller": (ms(control) + ms(sense)) * POLICY_STEPS,
            "observation": ms(plan) + ms(finish),
            "policy": ms(learner.act),
            "learning": 1e3 * learning / horizon,
        }
    return {
        "engine": type(engine).__name__,
        "robots": config.robots,
        "steps_per_s": round(config.robots * horizon / (collecting + learning)),
        "ms": {name: round(value, 3) for name, value in times.items()},
    }


def _iterations(learner: JumpLearner, count: int, device: str) -> tuple[float, float]:
    """Seconds of collecting and of learning,
    the mean of `count` iterations after some to warm up.
    """
    collecting = learning = 0.0
    for i in range(count + _WARM_UPS):
        start = _now(device)
        learner.collect()
        middle = _now(device)
        learner.learn()
        if i >= _WARM_UPS:
            collecting += middle - start
            learning += _now(device) - middle
    return collecting / count, learning / count


def _ms(function: Callable[[], object], device: str, count: int) -> float:
    for _ in range(3):
        function()
    start = _now(device)
    for _ in range(count):
        function()
    return 1e3 * (_now(device) - start) / count


def _now(device: str) -> float:
    if device != "cpu":
        torch.cuda.synchronize()
    return time.perf_counter()
