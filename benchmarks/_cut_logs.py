"""Ten logs that are cut: joints, body, camera and jumps, without effects and with one.

The cut is what a full disk or an empty battery leaves: all rows up to a moment, and a meta.json
that knows nothing of it.
"""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.moving_logs import jumped
from saltus.effects.body import ComOffset
from saltus.effects.camera import CameraPitch
from saltus.effects.delay_line import CommandDelay
from saltus.effects.image_delivery import CameraLatency
from saltus.effects.joint_loads import CoulombFriction
from saltus.effects.motors import ActuatorLag
from saltus.effects.profile import IDEAL, Profile
from saltus.real2sim.experiments.menu import experiment_named
from saltus.real2sim.experiments.run import run_experiment
from saltus.recordings.run_log import RunLog, write_run_log
from saltus.robots.loading import load_robot
from saltus.robots.shipped import DEFAULT_ROBOT

CALVES = (0.0, 0.0, 0.3) * 4
JUMP_SEED = 1


def _performed(experiment: str, profile: Profile, folder: Path) -> None:
    robot = load_robot(DEFAULT_ROBOT)
    write_run_log(
        run_experiment(experiment_named(experiment), robot, profile, seed=1), folder, robot
    )


def _jumped(terrain: str, profile: Profile, folder: Path) -> None:
    """A run whose log claims none of the profile's effects."""
    file = folder.with_suffix(".toml")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(profile.to_toml(), encoding="utf-8")
    jumped(terrain, JUMP_SEED, folder, str(file) if profile.effects else "ideal")
    meta = json.loads((folder / "meta.json").read_text(encoding="utf-8"))
    meta["camera"]["latency"] = 0.0
    (folder / "meta.json").write_text(json.dumps(meta), encoding="utf-8")


LOGS: dict[str, Callable[[Path], None]] = {
    "joints": partial(_performed, "joint_tour", IDEAL),
    "joints_friction": partial(
        _performed, "joint_tour", Profile(actuator=(CoulombFriction(torque=CALVES),))
    ),
    "joints_delay": partial(
        _performed, "joint_chirp", Profile(actuator=(CommandDelay(delay=0.006),))
    ),
    "body": partial(_performed, "squat", IDEAL),
    "body_com": partial(_performed, "squat", Profile(body=(ComOffset(x=0.02),))),
    "camera": partial(_performed, "heave_and_pitch", IDEAL),
    "camera_late": partial(
        _performed, "heave_and_pitch", Profile(camera=(CameraLatency(latency=0.03),))
    ),
    "camera_pitch": partial(_performed, "height_step", Profile(camera=(CameraPitch(offset=0.03),))),
    "jumps": partial(_jumped, "stairs", IDEAL),
    "jumps_lag": partial(
        _jumped, "stepping_stones", Profile(actuator=(ActuatorLag(time_constant=0.004),))
    ),
}
"""By name, what writes each into a folder."""


def made(name: str, logs: Path) -> Path:
    """The folder of a log; it is made if it is not there yet, whole or not at all."""
    folder = logs / name
    if not folder.exists():
        part = logs / f"{name}.part"
        LOGS[name](part)
        part.rename(folder)
    return folder


def length_s(log: RunLog) -> float:
    """From the first row of joints to the last."""
    return float(np.ptp(log.joints.time_s))
