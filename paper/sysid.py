"""Rows about what the simulator lacks: both effects of the paper are hidden
in a simulated robot and found in its logs.

The dynamometer's table is a hardware measurement of the original's authors; everything else here is
simulation.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from paper.drawing import OTHER, OURS, legend, subplots
from paper.run_figures import Made
from paper.runs import Effort
from saltus.arrays import Floats
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.motors import TorqueSaturation
from saltus.effects.profile import SHIPPED, Profile, load_profile
from saltus.errors import SaltusError
from saltus.real2sim.experiments.menu import experiment_named
from saltus.real2sim.experiments.run import run_experiment
from saltus.real2sim.pipeline import find_in_logs
from saltus.real2sim.results import Judgement
from saltus.recordings.run_log import RunLog, write_run_log
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.robot import Robot
from saltus.robots.shipped import DEFAULT_ROBOT

LATENCY_S = 0.050
"""Paper: "about 50ms"."""
MOST_NM = 35.0
"""Commanded; the end of the dynamometer's table."""
LEAST_NM = 0.5
"""Below it a share of the torque says nothing."""
LAGS_S = np.arange(0.0, 0.1501, 0.001)
"""Delays that are tried."""


def torque_saturation(effort: Effort) -> Made:
    """The table of delivered torque, found in the log of a held robot that takes large steps."""
    robot = load_robot(DEFAULT_ROBOT)
    table = next(
        e for e in load_profile(SHIPPED, robot).actuator if isinstance(e, TorqueSaturation)
    )
    _, judgement = _searched("large_steps", Profile(actuator=(table,)), effort.first_seed, robot)
    effects = judgement.verdict.effects
    curves = [np.array(((0.0, 0.0), *e.curve)) for e in effects if "FR_calf" in e.where and e.curve]
    true = np.array(((0.0, 0.0), *table.curve))
    figure, axis = subplots(1, 1, 3.6)
    axis.plot((0, MOST_NM), (0, MOST_NM), ":", color="0.5", label="no saturation")
    axis.plot(
        *true.T,
        "o-",
        color="0.3",
        markersize=4,
        label="dynamometer's table, hidden in the simulated robot",
    )
    numbers: dict[str, Any] = {
        "verdict": judgement.verdict.verdict,
        "effects": sorted({e.name for e in effects}),
    }
    if curves:
        torque = np.linspace(LEAST_NM, MOST_NM, 500)
        fitted = np.interp(torque, *curves[0].T)
        axis.plot(torque, fitted, color=OURS, label="found in its log")
        numbers["greatest_error_percent"] = round(
            100 * float(np.abs(fitted / np.interp(torque, *true.T) - 1).max()), 2
        )
        numbers["delivered_at_35_nm"] = {
            "table": float(np.interp(MOST_NM, *true.T)),
            "found": round(float(fitted[-1]), 2),
        }
    axis.set_xlabel("torque commanded to a calf [Nm]")
    axis.set_ylabel("delivered [Nm]")
    legend(axis, fontsize=8)
    return Made(
        numbers=numbers, figure=figure, configuration={"experiment": "large_steps"}, most_seeds=1
    )


def camera_latency(effort: Effort) -> Made:
    """Body height of a robot that heaves, from its joints and from its images.

    And what `real2sim` finds.
    """
    robot = load_robot(DEFAULT_ROBOT)
    hidden = Profile(camera=(CameraLatency(latency=LATENCY_S),))
    sine = run_experiment(experiment_named("heave_sine"), robot, hidden, seed=effort.first_seed)
    joints_s, by_joints = _height_by_joints(sine, robot)
    images_s, by_images = _height_by_images(sine)
    lag_s = _lag(images_s, by_images, joints_s, by_joints)
    _, judgement = _searched("heave_and_pitch", hidden, effort.first_seed, robot)
    found = [e.params["latency"] for e in judgement.verdict.effects if e.name == CameraLatency.name]
    numbers: dict[str, Any] = {
        "hidden_ms": 1e3 * LATENCY_S,
        "lag_of_heights_ms": round(1e3 * lag_s, 1),
        "verdict": judgement.verdict.verdict,
    }
    if found:
        numbers["found_ms"] = round(1e3 * found[0].value, 2)
        numbers["found_ci90_ms"] = [round(1e3 * end, 2) for end in found[0].ci90]
    figure, axis = subplots(1, 1, 3.2)
    begin = float(images_s[0]) + 1.0
    axis.plot(joints_s, by_joints, color="0.3", label="from joint angles")
    axis.plot(images_s, by_images, color=OTHER, label="from depth images as they arrive")
    axis.set_xlim(begin, begin + 2.0)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("body height [m]")
    axis.set_title(
        f"images lag by {1e3 * lag_s:.0f} ms; {1e3 * LATENCY_S:.0f} ms were hidden",
        loc="left",
        fontsize=10,
    )
    legend(axis, fontsize=8)
    return Made(
        numbers=numbers,
        figure=figure,
        configuration={"experiments": ["heave_sine", "heave_and_pitch"]},
        most_seeds=1,
    )


def _searched(
    experiment: str, hidden: Profile, seed: int, robot: Robot
) -> tuple[RunLog, Judgement]:
    """The log of a robot with hidden effects, and what is found in it."""
    log = run_experiment(experiment_named(experiment), robot, hidden, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        write_run_log(log, Path(folder) / "log")
        return log, find_in_logs([Path(folder) / "log"], Path(folder), seed=seed, report=False)


def _height_by_joints(log: RunLog, robot: Robot) -> tuple[Floats, Floats]:
    """Height of the base above the soles of a level robot [m], at each time [s]."""
    feet = LegKinematics(robot).position(log.joints.q)
    return log.joints.time_s, robot.foot_radius - np.asarray(feet)[..., 2].mean(axis=-1)


def _height_by_images(log: RunLog) -> tuple[Floats, Floats]:
    """Height of the base above the level ground that images show [m],
    at the times at which they arrive [s].
    """
    claim, depth = log.meta["camera"], log.depth
    if depth is None:
        raise SaltusError("the log has no images")
    rows, columns = depth.depth_mm.shape[1:]
    by = claim["width"] / columns
    x = (np.arange(columns) + 0.5 - claim["cx"] / by) / (claim["fx"] / by)
    y = (np.arange(rows) + 0.5 - claim["cy"] / by) / (claim["fy"] / by)
    # Of a ray with depth 1
    down = np.sin(claim["pitch"]) + np.cos(claim["pitch"]) * y[:, None] + 0.0 * x
    heights = 1e-3 * depth.depth_mm * down
    valid = (depth.depth_mm > 0) & (down > 0.2)
    camera = np.nanmedian(np.where(valid, heights, np.nan), axis=(1, 2))
    return depth.arrival_s, np.asarray(camera - claim["position"][2])


def _lag(late_s: Floats, late: Floats, time_s: Floats, early: Floats) -> float:
    """By how much one curve follows another [s]: where they correlate most."""
    scores = [
        float(np.corrcoef(late, np.interp(late_s - lag, time_s, early))[0, 1]) for lag in LAGS_S
    ]
    return float(LAGS_S[int(np.argmax(scores))])
