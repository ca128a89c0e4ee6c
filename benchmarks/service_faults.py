"""Effects of faults of the camera's stream on the heights:
error over time after each, on runs of the whole stack.

The learned policy crosses long stairs with a D435i in lockstep; states, images and arrival times of
these runs go through the service once as they were, and once for each fault and moment.

    saltus bench service_faults -- --runs 6 --picture service_faults.png
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._command import progress
from benchmarks._measuring import recorded_run
from benchmarks._pictures import Pictured, save, subplots
from saltus.arrays import Floats
from saltus.config import RunConfig, TerrainConfig
from saltus.heightmap.evaluation.comparison import ComparedRun, read_compared_run
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.service import HeightmapService
from saltus.resources import shipped_file
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.wire.messages import ControllerMode, DepthFrame, HeightmapStatus, RobotState

# Nine seconds: a pause of 3 s, and time after it
STAIRS = TerrainConfig(terrain="stairs", rise_m=0.08, steps=60)
TICK_S = 0.01
# The robot has been running for a second; a third of a cycle apart
FIRST_S, MOMENTS, APART_S = (
    2.5,
    6,
    0.17,
)
LOSSES = (0.01, 0.05, 0.2, 0.5)
SHOWN_S = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1.0)
BEFORE_S, AFTER_S = 0.6, 1.2
NORMAL = (
    1.1  # an error at most 10 % above that of an undisturbed run, as for the warm-up of a model
)
# Ticks of the running mean of the plot and the table: error varies within a cycle of the gait
WINDOW = 5


@dataclass(frozen=True, kw_only=True)
class Benchmark(Pictured):
    runs: int = 4
    """Runs of the stack, half a minute each."""

    def measure(self) -> dict[str, Any]:
        """Errors [mm] at some times after the end of each fault."""
        runs = [run for run in map(record, progress(range(self.runs))) if long_enough(run)]
        curves = measure(runs)
        if self.picture is not None:
            draw(curves, self.picture)
        return {
            "loss_rms_ratio": loss_ratios(runs),
            "after_s": SHOWN_S,
            "runs": len(runs),
            "short_runs": self.runs - len(runs),
            "faults": {name: curve.figures for name, curve in curves.items()},
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Call:
    """One call of the service."""

    state: RobotState
    frame: DepthFrame | None


Fault = Callable[[Sequence[Call], int], tuple[list[Call], int]]
"""Calls of a clean run and the tick at which the fault begins to the calls with it and the tick at
which it is over."""


def next_image(calls: Sequence[Call], at: int) -> int:
    """The first tick from `at` on with an image."""
    return next(tick for tick in range(at, len(calls)) if calls[tick].frame is not None)


def painted(value: float) -> Fault:
    """One image with the same value [depth units] in all pixels; over with the image after it."""

    def fault(calls: Sequence[Call], at: int) -> tuple[list[Call], int]:
        bad = next_image(calls, at)
        frame = calls[bad].frame
        assert frame is not None
        depth = np.full(frame.depth.shape, value, np.float32)
        spoilt = replace(calls[bad], frame=replace(frame, depth=depth))  # type: ignore[arg-type]
        return [*calls[:bad], spoilt, *calls[bad + 1 :]], next_image(calls, bad + 1)

    return fault


def lost(count: int) -> Fault:
    """So many images do not arrive."""

    def fault(calls: Sequence[Call], at: int) -> tuple[list[Call], int]:
        left, changed = count, list(calls)
        for tick in range(at, len(calls)):
            if calls[tick].frame is not None:
                if left == 0:
                    return changed, tick
                changed[tick] = replace(calls[tick], frame=None)
                left -= 1
        raise ValueError(f"the run is over before {count} images are lost")

    return fault


def paused(seconds: float) -> Fault:
    """The service gets nothing at all, neither states nor images; the robot goes on."""

    def fault(calls: Sequence[Call], at: int) -> tuple[list[Call], int]:
        end = at + round(seconds / TICK_S)
        return [*calls[:at], *calls[end:]], next_image(calls, end)

    return fault


def duplicated(calls: Sequence[Call], at: int) -> tuple[list[Call], int]:
    """Everything of one second comes twice at once,
    and all of it once more when the second is over.
    """
    end = at + round(1.0 / TICK_S)
    second = list(calls[at:end])
    twice = [call for call in second for _ in range(2)]
    return [*calls[:at], *twice, *second, *calls[end:]], end


FAULTS: dict[str, Fault] = {
    "one NaN image": painted(np.nan),
    "one image without a valid pixel": painted(0.0),
    "20 lost images": lost(20),
    "a pause of 3 s": paused(3.0),
    "a duplicated second": duplicated,
}


def calls_of(run: ComparedRun) -> list[Call]:
    """Returns what the service was called with."""
    calls, following = [], 0
    for state in run.states.values():
        newest = None
        while following < len(run.frames) and run.arrival_ns[following] <= state.time_ns:
            newest = run.frames[following]
            following += 1
        calls.append(Call(state=state, frame=newest))
    return calls


def answers(
    network: HeightmapNetwork, calls: Sequence[Call], run: ComparedRun
) -> tuple[Floats, Floats]:
    """Error [m] and status at each step; not a number where the service was not asked."""
    service = HeightmapService(network)
    error, status = np.full((2, max(run.states) + 1), np.nan)
    now_ns = 0
    for call in calls:
        now_ns = max(now_ns, call.state.time_ns)
        heightmap = service.step(call.state, call.frame, now_ns)
        truth = run.truths.get(heightmap.step)
        status[heightmap.step] = heightmap.status
        if truth is not None:
            error[heightmap.step] = np.mean(np.abs(heightmap.height - truth.height))
    return error, status


@dataclass(frozen=True, kw_only=True, eq=False)
class Curves:
    """Errors around the end of one fault, over all runs and moments; shape (trials, ticks)."""

    error: Floats
    clean: Floats
    status: Floats

    @property
    def mean(self) -> tuple[Floats, Floats]:
        """With the fault and without, over the trials, smoothed [m]."""
        return smoothed(self.error), smoothed(self.clean)

    @property
    def normal_s(self) -> float:
        """From when on the mean error stays within 10 % of that without the fault."""
        error, clean = (part[round(BEFORE_S / TICK_S) :] for part in self.mean)
        above = np.flatnonzero(~(error <= NORMAL * clean))
        return TICK_S * (above[-1] + 1) if len(above) else 0.0

    @property
    def ok_s(self) -> float:
        """When the status of the last trial is OK again, for good."""
        bad = np.flatnonzero(
            np.any(self.status[:, round(BEFORE_S / TICK_S) :] != HeightmapStatus.OK, axis=0)
        )
        return TICK_S * (bad[-1] + 1) if len(bad) else 0.0

    @property
    def figures(self) -> dict[str, Any]:
        """Mean errors [mm] at the times that are shown, and times to normal [s]."""
        places = [round((BEFORE_S + after) / TICK_S) for after in SHOWN_S]
        error, clean = (
            [round(1e3 * float(part[place]), 1) for place in places] for part in self.mean
        )
        return {"error_mm": error, "clean_mm": clean, "normal_s": self.normal_s, "ok_s": self.ok_s}


def smoothed(error: Floats) -> Floats:
    """Mean over trials and over the last ticks; where some trial has no answer there is none."""
    mean = np.mean(error, axis=0)
    padded = np.concatenate([np.full(WINDOW - 1, np.nan), mean])
    windows = np.lib.stride_tricks.sliding_window_view(padded, WINDOW)
    known = np.isfinite(windows)
    total = np.where(known, windows, 0.0).sum(-1)
    return np.where(np.isfinite(mean), total / np.maximum(known.sum(-1), 1), np.nan)


def shipped_network() -> HeightmapNetwork:
    """The network of the shipped model."""
    return HeightmapNetwork(load_robot(DEFAULT_ROBOT), shipped_file("models/heightmap.onnx"))


def measure(runs: Sequence[ComparedRun]) -> dict[str, Curves]:
    """All faults at all moments of all runs."""
    network = shipped_network()
    around = np.arange(-round(BEFORE_S / TICK_S), round(AFTER_S / TICK_S))
    found: dict[str, list[tuple[Floats, Floats, Floats]]] = {name: [] for name in FAULTS}
    for run in runs:
        calls = calls_of(run)
        clean, _ = answers(network, calls, run)
        for name, fault in FAULTS.items():
            for moment in range(MOMENTS):
                disturbed, end = fault(calls, round((FIRST_S + APART_S * moment) / TICK_S))
                error, status = answers(network, disturbed, run)
                place = calls[end].state.step + around
                found[name].append((error[place], clean[place], status[place]))
    return {
        name: Curves(error=np.array(e), clean=np.array(c), status=np.array(s))
        for name, trials in found.items()
        for e, c, s in [zip(*trials, strict=True)]
    }


def loss_ratios(runs: Sequence[ComparedRun]) -> dict[float, float]:
    """RMS error with a share of the images lost at random,
    over that with none, while the robot runs.
    """
    network, rng = (
        shipped_network(),
        np.random.default_rng(0),
    )
    squares = dict.fromkeys((0.0, *LOSSES), 0.0)
    for run in runs:
        calls = calls_of(run)
        running = [step for step, state in run.states.items() if state.mode == ControllerMode.RUN]
        for share in squares:
            kept = [replace(call, frame=None) if rng.uniform() < share else call for call in calls]
            error, _ = answers(network, kept, run)
            squares[share] += float(np.nansum(error[running] ** 2))
    return {share: float(np.sqrt(squares[share] / squares[0.0])) for share in LOSSES}


def draw(curves: dict[str, Curves], out: Path) -> None:
    """One panel for each fault."""
    figure, axes = subplots(len(curves), 1, figsize=(8.0, 9.0), sharex=True, sharey=True)
    for axis, (name, curve) in zip(axes, curves.items(), strict=True):
        error, clean = curve.mean
        time_s = TICK_S * np.arange(len(error)) - BEFORE_S
        share_ok = np.mean(curve.status == HeightmapStatus.OK, axis=0)
        axis.fill_between(
            time_s,
            0,
            1,
            where=share_ok < 1.0,
            transform=axis.get_xaxis_transform(),
            color="0.92",
            step="post",
        )
        axis.plot(time_s, 1e3 * clean, "--", color="0.3", label="without the fault")
        axis.plot(time_s, 1e3 * error, color="tab:orange", label="with it")
        axis.axvline(0.0, color="0.6", linewidth=0.8)
        axis.set_title(name, loc="left", fontsize=10)
        axis.set_ylabel("error [mm]")
    axes[0].legend(loc="upper right", ncols=2, fontsize=8)
    axes[0].set_ylim(bottom=0.0)
    axes[-1].set_xlabel("time since the end of the fault [s]; grey: status of some run not OK")
    save(figure, out)


def record(seed: int) -> ComparedRun:
    """A run of the stack."""
    return read_compared_run(
        recorded_run(
            RunConfig(
                robot="go1",
                grid="line",
                terrain=STAIRS,
                camera="d435i",
                planner="learned",
                seed=seed,
            )
        )
    )


def long_enough(run: ComparedRun) -> bool:
    """True where the robot was still running when the last of the longest faults was over."""
    needed_s = FIRST_S + MOMENTS * APART_S + 3.0 + AFTER_S
    return len(run.states) > needed_s / TICK_S and len(run.truths) > needed_s / TICK_S
