"""Runs an experiment on a robot through joint commands, and writes down what a robot would log.

The robot is the simulated one with the effects of a profile; its sensors have noise of the usual
size.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from saltus.arrays import Floats, Indices
from saltus.constants import PHYSICS_DT
from saltus.effects.imu import ImuReading
from saltus.effects.profile import Profile
from saltus.joint_command import JointCommand
from saltus.real2sim.experiments.footage import FootageCamera, film_experiment
from saltus.real2sim.experiments.menu import Experiment
from saltus.real2sim.experiments.motions import ExperimentSection
from saltus.real2sim.problem.quaternions import turn_slightly
from saltus.recordings.run_claims import SCHEMA, RigClaims, SegmentClaim, claim_of
from saltus.recordings.run_log import JointTable, LogTable, RunLog
from saltus.robots.robot import JOINTS, Robot
from saltus.sim.plant import CLEARANCE, Plant
from saltus.sim.plant_state import PlantState
from saltus.terrain.terrain import Terrain


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """Standard deviations of white noise, as
    of small quadrupeds whose base is tracked by motion capture.
    """

    q_rad: float = 1e-3
    dq_rad_s: float = 0.05
    tau_nm: float = 0.2
    gyro_rad_s: float = 0.01
    acc_m_s2: float = 0.1
    orientation_rad: float = 0.002
    base_position_m: float = 0.0003
    base_orientation_rad: float = 0.0005
    velocity_m_s: float = 0.02
    foot_n: float = 2.0


class SimulatedSensors:
    """Sensors of a simulated robot in an experiment, with noise."""

    def __init__(self, noise: SensorNoise, rng: np.random.Generator) -> None:
        self._noise = noise
        self._rng = rng

    def joints(
        self,
        time_s: Floats,
        states: Sequence[PlantState],
        sent: Sequence[JointCommand],
        believed: Sequence[Floats],
    ) -> JointTable:
        """Returns what encoders measured, and what commands were sent and what drives believed.

        Args:
            time_s: Of the rows, shape (n,).
            states: Of the robot.
            sent: Commands.
            believed: Torque by the drives' own law [Nm], each of shape (12,).
        """
        return JointTable(
            time_s=time_s,
            q=self._noisy(_stacked(states, "joint_position"), self._noise.q_rad),
            dq=self._noisy(_stacked(states, "joint_velocity"), self._noise.dq_rad_s),
            q_des=_stacked(sent, "position"),
            dq_des=_stacked(sent, "velocity"),
            tau_ff=_stacked(sent, "torque"),
            tau_est=self._noisy(np.array(believed), self._noise.tau_nm),
        )

    def imu(self, time_s: Floats, readings: Sequence[ImuReading]) -> LogTable:
        """The table `imu` of a run log."""
        noise = self._noise
        columns = [
            self._tilted(_stacked(readings, "quaternion_base_in_world"), noise.orientation_rad),
            self._noisy(_stacked(readings, "angular_velocity_base"), noise.gyro_rad_s),
            self._noisy(_stacked(readings, "acceleration_base"), noise.acc_m_s2),
        ]
        return LogTable(time_s=time_s, values=np.concatenate(columns, axis=1))

    def base(self, time_s: Floats, states: Sequence[PlantState]) -> LogTable:
        """The table `base` of a run log: motion capture."""
        noise = self._noise
        columns = [
            self._noisy(_stacked(states, "position_base_in_world"), noise.base_position_m),
            self._tilted(_stacked(states, "quaternion_base_in_world"), noise.base_orientation_rad),
            self._noisy(_stacked(states, "velocity_base_in_world"), noise.velocity_m_s),
        ]
        return LogTable(time_s=time_s, values=np.concatenate(columns, axis=1))

    def feet(self, time_s: Floats, states: Sequence[PlantState]) -> LogTable:
        """The table `feet` of a run log."""
        return LogTable(
            time_s=time_s, values=self._noisy(_stacked(states, "foot_force"), self._noise.foot_n)
        )

    def _noisy(self, values: Floats, sigma: float) -> Floats:
        return values + sigma * self._rng.standard_normal(values.shape)

    def _tilted(self, quaternion: Floats, sigma_rad: float) -> Floats:
        """Quaternions (n, 4) turned by small random rotations."""
        return turn_slightly(
            quaternion, sigma_rad * self._rng.standard_normal((len(quaternion), 3))
        )


def _stacked(samples: Sequence[PlantState | ImuReading | JointCommand], name: str) -> Floats:
    return np.array([getattr(sample, name) for sample in samples], dtype=np.float64)


# A robot that was put on its feet has come to rest: three time constants of its slowest mode
SETTLE_S = 0.6
CARRIED_S = 1.0  # time on the log's clock that passes while somebody puts the robot elsewhere
TIME_DIGITS = 6  # of a clock that counts microseconds
BASE_EVERY = 2  # motion capture at 250 Hz, every second tick
AHEAD_M = 0.6
"""Where the first edge lies at the start: a camera on a trunk, 30 degrees nose down, sees the
ground from 0.5 to 2 m before the base."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Row:
    """The robot at one tick and the command that was sent then."""

    time_s: float
    state: PlantState
    imu: ImuReading
    command: JointCommand
    believed: Floats


@dataclass(kw_only=True, eq=False)
class _Tape:
    """Samples that were recorded."""

    rows: list[_Row] = field(default_factory=list)
    segments: list[SegmentClaim] = field(default_factory=list)


def run_experiment(
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

    The log claims none of the profile's effects but the camera's latency, and of the camera what
    `camera` says, by default that of the robot. `progress` is called with the share of the motion
    that is done.

    Raises:
        UnsafeMotionError: the motion would leave the experiment's limits, or the robot has left
            them.
    """
    sections, terrain = experiment.sections(robot), experiment.terrain()
    for section in sections:
        experiment.limits.check_commands(robot, section.commands, experiment.gains(robot)[0])
    plant = Plant(
        robot, terrain, payload_kg=experiment.payload_kg, chain=profile.actuator_chain,
        body=profile.body_chain,
        imu=profile.imu_chain, held=experiment.base == "fixed",
    )  # fmt: skip
    tape = _move(plant, experiment, robot, sections, terrain, progress)
    rng = np.random.default_rng([seed, 1])
    log = _log(tape, experiment, robot, terrain, SimulatedSensors(noise or SensorNoise(), rng))
    if not experiment.camera:
        return log
    camera = camera or FootageCamera.on(robot)
    log.meta["camera"] = camera.claim()
    rows = tape.rows[:: round(1.0 / (camera.rate_hz * PHYSICS_DT))]
    true = (np.array([row.time_s for row in rows]), [row.state for row in rows])
    return replace(log, depth=film_experiment(robot, camera, profile, terrain, *true, rng))


def _move(
    plant: Plant,
    experiment: Experiment,
    robot: Robot,
    sections: tuple[ExperimentSection, ...],
    terrain: Terrain,
    progress: Callable[[float], None] | None,
) -> _Tape:
    """Plays all sections.

    Those that put the robot elsewhere begin with a rest, unless it is let fall.
    """
    tape = _Tape()
    now = 0.0
    rest = round(SETTLE_S / PHYSICS_DT)
    for index, section in enumerate(sections):
        length = len(section.commands.q_des)
        ticks = np.arange(length)
        if index == 0 or section.ahead_m is not None:
            now += CARRIED_S if index else 0.0
            ahead = AHEAD_M if section.ahead_m is None else section.ahead_m
            x = terrain.first_edge_x - ahead if terrain.edges_x.size else 0.0
            plant.reset(position_x=x, clearance=section.drop_m or CLEARANCE)
            if section.drop_m == 0.0:
                ticks = np.concatenate([np.zeros(rest, dtype=np.int64), ticks])
        begin = now + (len(ticks) - length) * PHYSICS_DT
        for command in _commands(section, ticks, experiment.gains(robot)):
            state, imu = plant.state, plant.imu
            pose = state.quaternion_base_in_world
            experiment.limits.check_state(
                robot, now, pose, state.joint_position, state.joint_velocity
            )
            believed = plant.step(command).joint_torque
            tape.rows.append(
                _Row(time_s=now, state=state, imu=imu, command=command, believed=believed)
            )
            now = round(now + PHYSICS_DT, TIME_DIGITS)
        tape.segments.append(
            {"name": section.name, "t0": begin, "t1": now, "condition": section.condition}
        )
        if progress is not None:
            progress((index + 1) / len(sections))
    return tape


def _commands(
    section: ExperimentSection, ticks: Indices, gains: tuple[float, float]
) -> Iterator[JointCommand]:
    """The commands of a section at some ticks, with these gains at all joints."""
    kp, kd = (np.full(len(JOINTS), gain) for gain in gains)
    of = section.commands
    for tick in ticks:
        yield JointCommand(
            position=of.q_des[tick], velocity=of.dq_des[tick], kp=kp, kd=kd, torque=of.tau_ff[tick]
        )


def _log(
    tape: _Tape,
    experiment: Experiment,
    robot: Robot,
    terrain: Terrain,
    instruments: SimulatedSensors,
) -> RunLog:
    rows = tape.rows
    time_s = np.array([row.time_s for row in rows])
    states = [row.state for row in rows]
    meta = _meta(tape, experiment, robot, terrain)
    joints = instruments.joints(
        time_s, states, [row.command for row in rows], [row.believed for row in rows]
    )
    if experiment.base == "fixed":
        return RunLog(meta=meta, joints=joints)
    return RunLog(
        meta=meta,
        joints=joints,
        imu=instruments.imu(time_s, [row.imu for row in rows]),
        base=instruments.base(time_s[::BASE_EVERY], states[::BASE_EVERY]),
        feet=instruments.feet(time_s, states),
    )


def _meta(tape: _Tape, experiment: Experiment, robot: Robot, terrain: Terrain) -> RigClaims:
    kp, kd = experiment.gains(robot)
    meta: RigClaims = {
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
