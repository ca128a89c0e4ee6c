"""How fast the motion policy trains, and where the time goes.

    python benchmarks/train.py [--robots N] [--device cpu]

Prints one JSON object: engine, robots, environment steps per second with learning, and milliseconds per policy step
of all robots. "learning" is the update of the networks, divided by the steps that it learns from.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace

import torch

from policy.env import JumpEnv
from policy.learner import Learner
from policy.settings import for_cpu, for_gpu
from policy.train import make_engine
from saltus import go1


def main() -> None:
    """Measures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int)
    parser.add_argument("--device", choices=("auto", "cpu"), default="auto")
    parser.add_argument("--iterations", type=int, default=5)
    given = parser.parse_args()
    device = "cuda:0" if given.device == "auto" and torch.cuda.is_available() else "cpu"
    config = for_cpu() if device == "cpu" else for_gpu()
    if given.robots:
        config = replace(config, robots=given.robots)
    torch.set_float32_matmul_precision("high")
    engine = make_engine(config.robots, device)
    env = JumpEnv(engine, config.env, seed=0, device=device)
    learner = Learner(env, config.learning)
    collecting, learning = _iterations(learner, given.iterations, device)
    plan, control, sense, finish = env.stages
    horizon = config.learning.horizon
    with torch.no_grad():
        ms = {
            "physics": _ms(engine.step, device) * go1.POLICY_STEPS,
            "controller": (_ms(control, device) + _ms(sense, device)) * go1.POLICY_STEPS,
            "observation": _ms(plan, device) + _ms(finish, device),
            "policy": _ms(learner.act, device),
            "learning": 1e3 * learning / horizon,
        }
    report = {
        "engine": type(engine).__name__,
        "robots": config.robots,
        "steps_per_s": round(config.robots * horizon / (collecting + learning)),
        "ms": {name: round(value, 3) for name, value in ms.items()},
        "ms_collecting": round(1e3 * collecting / horizon, 3),
    }
    print(json.dumps(report))


def _iterations(learner: Learner, count: int, device: str) -> tuple[float, float]:
    """Seconds of collecting and of learning, the mean of `count` iterations after two to warm up."""
    collecting = learning = 0.0
    for i in range(count + 2):
        start = _now(device)
        learner.collect()
        middle = _now(device)
        learner.learn()
        if i >= 2:
            collecting += middle - start
            learning += _now(device) - middle
    return collecting / count, learning / count


def _ms(function: Callable[[], object], device: str, count: int = 50) -> float:
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
