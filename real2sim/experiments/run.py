"""Runs an experiment on a robot through joint commands, and writes down what a robot would log.

The robot is the simulated one with the effects of a profile; its sensors have noise of the usual size.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.constants import PHYSICS_DT
from saltus.effects.imu import ImuReading
from saltus.effects.profile import Profile
from saltus.joint_command import JointCommand
from saltus.real2sim.experiments.footage import FootageCamera, film
from saltus.real2sim.experiments.instruments import Instruments, SensorNoise
from saltus.real2sim.experiments.menu import Experiment
from saltus.real2sim.experiments.motions import Section
from saltus.recordings.run_claims import SCHEMA, claim_of
from saltus.recordings.run_log import DepthTable, RunLog
from saltus.robots.robot import JOINTS, Robot
from saltus.sim.plant import CLEARANCE, Plant
from saltus.sim.state import PlantState
from saltus.terrain.terrain import Terrain

SETTLE_S = 0.6  # a robot that was put on its feet has come to rest: three time constants of its slowest mode
CARRIED_S = 1.0  # time on the log's clock that passes while somebody puts the robot elsewhere
TIME_DIGITS = 6  # of a clock that counts microseconds
BASE_EVERY = 2  # motion capture at 250 Hz, every second tick
AHEAD_M = 0.6
"""Where the first edge lies at the start: a camera on a trunk, 30 degrees nose down, sees the ground from 0.5 to 2 m
before the base."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Row:
    """The robot at one tick and the command that was sent then."""

    time_s: float
    state: PlantState
    imu: ImuReading
    believed: Floats
    section: int
    tick: int


@dataclass(kw_only=True, eq=False)
class _Tape:
    """Samples that were recorded."""

    rows: list[_Row] = field(default_factory=list)
    segments: list[dict[str, Any]] = field(default_factory=list)


def run(
    experiment: Experiment,
    robot: Robot,
    profile: Profile,
    *,
    seed: int = 0,
    noise: SensorNoise | None = None,
    camera: FootageCamera | None = None,
    progress: Callable[[float], None] | None = None,
) -> RunLog:
    """Runs an experiment on a simulated robot; returns what it logged.

    The log claims none of the profile's effects but the camera's latency, and of the camera what `camera` says, by
    default that of the robot. `progress` is called with the share of the motion that is done.

    Raises:
        UnsafeMotionError: the motion would leave the experiment's limits, or the robot has left them.
    """
    sections, terrain = experiment.sections(robot), experiment.terrain()
    for section in sections:
        experiment.limits.check_commands(robot, section.commands, experiment.gains(robot)[0])
    plant = Plant(
        robot, terrain, payload_kg=experiment.payload_kg, chain=profile.actuator_chain, body=profile.body_chain,
        imu=profile.imu_chain, held=experiment.base == "fixed",
    )  # fmt: skip
    tape = _move(plant, experiment, robot, sections, terrain, progress)
    rng = np.random.default_rng([seed, 1])
    log = _log(tape, experiment, robot, sections, terrain, Instruments(noise or SensorNoise(), rng))
    if not experiment.camera:
        return log
    camera = camera or FootageCamera.on(robot)
    log.meta["camera"] = camera.claim()
    return replace(log, depth=_depth(tape, robot, terrain, camera, profile, rng))


def _move(
    plant: Plant,
    experiment: Experiment,
    robot: Robot,
    sections: tuple[Section, ...],
    terrain: Terrain,
    progress: Callable[[float], None] | None,
) -> _Tape:
    """Plays all sections; those that put the robot elsewhere begin with a rest, unless it is let fall."""
    tape = _Tape()
    now = 0.0
    rest = round(SETTLE_S / PHYSICS_DT)
    for index, section in enumerate(sections):
        length = len(section.commands.q_des)
        ticks = np.arange(length)
        if index == 0 or section.ahead_m is not None:
            now += CARRIED_S if index else 0.0
            _put(plant, section, terrain)
            if section.drop_m == 0.0:
                ticks = np.concatenate([np.zeros(rest, dtype=np.int64), ticks])
        begin = now + (len(ticks) - length) * PHYSICS_DT
        now = _play(plant, experiment, robot, section, index, ticks, now, tape)
        tape.segments.append({"name": section.name, "t0": begin, "t1": now, "condition": section.condition})
        if progress is not None:
            progress((index + 1) / len(sections))
    return tape


def _put(plant: Plant, section: Section, terrain: Terrain) -> None:
    ahead = AHEAD_M if section.ahead_m is None else section.ahead_m
    x = terrain.first_edge_x - ahead if terrain.edges_x.size else 0.0
    plant.reset(position_x=x, clearance=section.drop_m or CLEARANCE)


def _play(
    plant: Plant,
    experiment: Experiment,
    robot: Robot,
    section: Section,
    index: int,
    ticks: Indices,
    now: float,
    tape: _Tape,
) -> float:
    """Sends the commands of `ticks`, one every 2 ms; returns the time afterwards."""
    kp, kd = (np.full(len(JOINTS), gain) for gain in experiment.gains(robot))
    commands = section.commands
    for tick in ticks:
        state, imu = plant.state, plant.imu
        experiment.limits.check_state(
            robot, now, state.quaternion_base_in_world, state.joint_position, state.joint_velocity
        )
        command = JointCommand(
            position=commands.q_des[tick], velocity=commands.dq_des[tick], kp=kp, kd=kd, torque=commands.tau_ff[tick]
        )
        believed = plant.step(command).joint_torque
        tape.rows.append(_Row(time_s=now, state=state, imu=imu, believed=believed, section=index, tick=int(tick)))
        now = round(now + PHYSICS_DT, TIME_DIGITS)
    return now


def _log(
    tape: _Tape,
    experiment: Experiment,
    robot: Robot,
    sections: tuple[Section, ...],
    terrain: Terrain,
    instruments: Instruments,
) -> RunLog:
    rows = tape.rows
    time_s = np.array([row.time_s for row in rows])
    states = [row.state for row in rows]
    sent = [(sections[row.section].commands, row.tick) for row in rows]
    meta = _meta(tape, experiment, robot, terrain)
    joints = instruments.joints(time_s, states, sent, [row.believed for row in rows])
    if experiment.base == "fixed":
        return RunLog(meta=meta, joints=joints)
    return RunLog(
        meta=meta,
        joints=joints,
        imu=instruments.imu(time_s, [row.imu for row in rows]),
        base=instruments.base(time_s[::BASE_EVERY], states[::BASE_EVERY]),
        feet=instruments.feet(time_s, states),
    )


def _meta(tape: _Tape, experiment: Experiment, robot: Robot, terrain: Terrain) -> dict[str, Any]:
    kp, kd = experiment.gains(robot)
    meta: dict[str, Any] = {
        "schema": SCHEMA,
        "robot": claim_of(robot),
        "base": experiment.base,
        "joints": list(JOINTS),
        "kp": kp,
        "kd": kd,
        "control_dt": PHYSICS_DT,
        "excitation": {"text": f"{experiment.name}: {experiment.how}", "segments": tape.segments},
        "terrain": "flat",
        "payload_kg": experiment.payload_kg,
    }
    if terrain.edges_x.size:
        meta["terrain"] = terrain.arrays.to_tables()
    return meta


def _depth(
    tape: _Tape, robot: Robot, terrain: Terrain, camera: FootageCamera, profile: Profile, rng: np.random.Generator
) -> DepthTable:
    """Images from the true poses at the camera's rate."""
    rows = tape.rows[:: round(1.0 / (camera.rate_hz * PHYSICS_DT))]
    states = [row.state for row in rows]
    return film(
        robot,
        camera,
        profile,
        terrain,
        capture_s=np.array([row.time_s for row in rows]),
        position=np.array([state.position_base_in_world for state in states]),
        quaternion=np.array([state.quaternion_base_in_world for state in states]),
        joints=np.array([state.joint_position for state in states]),
        rng=rng,
    )
