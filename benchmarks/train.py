"""How fast the motion policy trains, and where the time goes.

    python benchmarks/train.py [--robots N] [--device cpu]

Prints one JSON object: engine, robots, environment steps per second with learning, and milliseconds per policy step
of all robots. "learning" is the update of the networks, divided by the steps that it learns from.
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch

from saltus.config import DEFAULT_ROBOT
from saltus.constants import POLICY_STEPS
from saltus.policy.env.env import JumpEnv
from saltus.policy.env.settings import TrainConfig, for_cpu, for_gpu
from saltus.policy.training.learner import Learner
from saltus.policy.training.train import device_of_this_process, make_engine
from saltus.robots.loading import load_robot

_WARM_UPS = 2  # iterations: the first ones allocate, and on a GPU choose their kernels
_REPEATS = 50  # of a stage


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int)
    parser.add_argument("--device", choices=("auto", "cpu"), default="auto")
    parser.add_argument("--iterations", type=int, default=5)
    given = parser.parse_args(arguments)
    device = device_of_this_process(given.device).device
    config = for_cpu() if device == "cpu" else for_gpu()
    if given.robots:
        config = replace(config, robots=given.robots)
    print(json.dumps(measure(config, device, given.iterations)))


def measure(config: TrainConfig, device: str, iterations: int, repeats: int = _REPEATS) -> dict[str, Any]:
    """Trains for some iterations, then times the stages of a step one by one."""
    engine = make_engine(load_robot(DEFAULT_ROBOT), config.robots, device)
    env = JumpEnv(engine, config.env, seed=0, device=device)
    learner = Learner(env, config.learning)
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


def _iterations(learner: Learner, count: int, device: str) -> tuple[float, float]:
    """Seconds of collecting and of learning, the mean of `count` iterations after some to warm up."""
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


if __name__ == "__main__":
    main()
