"""The body problem: a robot on the ground, replayed in short windows from its measured state.

Residuals are what motion capture and encoders measured minus what the simulator makes of the logged
commands, under the claimed body and ground with effects added. Payload, centre of mass and inertia
show in how the body sinks, leans and turns; ground and soles in slip, touchdown and rebound. Drives
are between commands and body: their effects are candidates too, as a weak motor looks like a heavy
trunk.
"""

from copy import copy
from dataclasses import replace
from functools import cache

import numpy as np

from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT
from saltus.effects.motors import TorqueSaturation
from saltus.effects.profile import Profile
from saltus.errors import RecordingError
from saltus.real2sim.problem.body.candidates import (
    CALF,
    FRICTION_RANGE,
    BodyClaims,
    body_candidates,
    on_top_of,
    rig_of,
)
from saltus.real2sim.problem.body.noise import (
    SIGNALS,
    BodyNoise,
    BodyWhitening,
    StartNoise,
    WindowStarts,
    read_body_noise,
    signal_errors,
)
from saltus.real2sim.problem.body.replay import (
    BodyReplay,
    BodySimulation,
    PassiveTorque,
    TorqueLimit,
    finer_solvers,
    likeliest_solver,
)
from saltus.real2sim.problem.body.windows import BLOCKS, BodyWindows, body_windows
from saltus.real2sim.problem.joints.torque_curve import fitted_to
from saltus.real2sim.problem.log import (
    boxes_of,
    claimed_model,
    robot_of,
    segments_of,
    torque_limits,
)
from saltus.real2sim.problem.problem import LARGEST_RESIDUAL, LEAST_SIGMA, Candidate, Problem
from saltus.recordings.run_log import RunLog
from saltus.sim.free_robots import ContactSolver

LATE = BLOCKS * 2 // 3
"""Block from which on errors of the start should have faded."""
DRAWS, PAIRS = 8, 5
"""Random starts, and small changes of the robot, each there and back: variances within a half."""
USUAL = {
    "payload_mass.mass": 0.3,
    "com_offset.x": 0.005,
    "com_offset.y": 0.005,
    "com_offset.z": 0.005,
    "base_inertia.scale": 0.2,
    "contact_compliance.softness": 1.0,
    "soft_feet.torsion": 0.01,
    "soft_feet.rolling": 0.005,
    "torque_gain.gain": 0.03,
    "viscous_friction.coefficient": 0.05,
    "coulomb_friction.torque": 0.1,
    "drive_rate.continuous": 1.0,
    "contact_solver.creep": 0.3,
}
"""Effects of usual size, about which the error of a start is still linear."""
SMALL_CHANGES = {
    "payload_mass.mass": 0.05,
    "com_offset.x": 0.001,
    "com_offset.y": 0.001,
    "com_offset.z": 0.001,
    "base_inertia.scale": 0.05,
    "contact_compliance.softness": 0.15,
    "contact_solver.creep": 0.2,
}
"""Changes of a robot that a log of half a minute hardly shows: a hundredth of its mass, a
millimetre."""
QUARTER_TO_NONE, HALF_TO_QUARTER = 4.0 / 3.0, 1.5
"""The error of a contact's simulation grows with its step: what a quarter of the step changes,
times the first, is what none at all would; what half of the step changes, times the second, is what
a quarter does."""
JUDGED_BY = 8
"""Windows by which ways to compute contacts are judged: they differ everywhere."""
SCANNED = 8
SMALLEST_LESS = 0.02
"""Coefficients this close to the claimed one are not told from it by scanning."""
SLIP_QUANTILE = 0.97
"""Part of the time under load in which the ground must hold a foot, for the coefficient at which
feet would slip."""
TYPICAL = {
    "payload_mass.mass": 1.0,
    "com_offset.x": 0.02,
    "base_inertia.scale": 0.2,
    "contact_compliance.softness": 3.0,
    "soft_feet.rolling": 0.01,
    "torque_gain.gain": 0.1,
    "battery_sag.loss_at_end": 0.1,
    "command_delay.delay": 0.005,
    "torque_saturation.loss": 0.4,
    "viscous_friction.coefficient": 0.1,
    "coulomb_friction.torque": 0.3,
}
"""A change of usual size (published ranges of domain randomisation; compliance that doubles the
time constant)."""
IN_WORDS = {
    "payload_mass": "1 kg",
    "com_offset": "2 cm",
    "base_inertia": "20 % of the trunk's inertia",
    "foot_friction": "half the coefficient",
    "contact_compliance": "a contact of twice the time constant",
    "soft_feet": "1 cm of friction against rolling",
    "torque_gain": "10 % of torque",
    "battery_sag": "10 % of torque lost by the end",
    "command_delay": "5 ms",
    "torque_saturation": "a loss of 40 % beyond 6 Nm",
    "viscous_friction": "0.1 Nm s/rad",
    "coulomb_friction": "0.3 Nm",
}


class BodyProblem(Problem):
    """The problem of a robot's trunk on the ground: which masses, contacts and frictions make it
    move as its log says; one block "trunk".

    Args:
        log: With base "free", `base.csv` and the joints of a quadruped in the order of `JOINTS`.

    Raises:
        RecordingError: the log does not have that, or no stretch of it is long enough.
        ModelError: its robot is no quadruped.
    """

    name = "body"
    blocks = ("trunk",)
    places = ({"trunk": "trunk", "feet": "feet", "joints": "all"},)
    simulator_disagreement = 0.3
    """Share by which simulators may disagree; differences of right ways to compute contacts are in
    the noise already."""
    held = (TorqueSaturation.name,)

    def __init__(self, log: RunLog) -> None:
        if log.base is None or log.meta.get("base") != "free" or len(log.meta["joints"]) != 12:
            raise RecordingError(
                "the body shows only where a quadruped stands free and base.csv says how its base "
                "moves"
            )
        self.segments = segments_of(log)
        self._windows = body_windows(log, self.segments)
        self.model, self._held = claimed_model(log), tuple[TorqueLimit | PassiveTorque, ...]()
        self._robot, self._claims = robot_of(log), BodyClaims.of(log)
        # Until it is known where feet slip
        self.candidates = self._candidates(0.5 * self._claims.friction)
        self._boxes = boxes_of(log)
        self._span_s = float(log.joints.time_s[0]), float(log.joints.time_s[-1])
        self._index()
        noise = read_body_noise(log)
        self._ground = self._likeliest(noise)
        self._replay = self._replayed(self._ground)
        self._prepare(noise, has_gyro=log.imu is not None)

    def holding(self, profile: Profile) -> tuple[Problem, Profile]:
        """See `Problem`: limits and pulls of the drives; a fitted saturation adds to theirs."""
        problem = copy(self)
        problem._held = tuple(
            fitted_to(effect, self.model)
            if isinstance(effect, TorqueSaturation)
            else effect.fitted(self._robot)
            for effect in profile.actuator
            if isinstance(effect, TorqueLimit | PassiveTorque)
        )
        problem._replay = problem._replayed(problem._ground)
        for saturation in (
            effect for effect in problem._held if isinstance(effect, TorqueSaturation)
        ):
            problem.candidates = tuple(
                on_top_of(saturation, candidate, self._calf_limit)
                if candidate.effect == saturation.name
                else candidate
                for candidate in self.candidates
            )
        told = tuple(
            effect
            for effect in profile.actuator
            if not isinstance(effect, TorqueLimit | PassiveTorque)
        )
        return problem, replace(profile, actuator=told)

    def residuals(self, unknowns: Floats) -> Floats:
        """Whitened residuals, shape (n, 1, m)."""
        rig = self._rig(unknowns[:, 0])
        fineness = unknowns[:, 0, self.names.index("contact_solver.fineness"), None, None, None]
        whitened = self._whiten(
            self._errors(self._replay.states(rig)) + fineness * self._time_step_error
        )
        return np.clip(whitened.reshape(len(unknowns), 1, -1), -LARGEST_RESIDUAL, LARGEST_RESIDUAL)

    def _candidates(self, slips_at: float) -> tuple[Candidate, ...]:
        return body_candidates(self._claims, slips_at, self._calf_limit)

    @property
    def _calf_limit(self) -> float:
        return float(torque_limits(self._robot)[CALF])

    def _index(self) -> None:
        """Segment, signal and time of each residual."""
        windows, signals = self._windows, len(SIGNALS)
        shape = (len(windows.start_s), BLOCKS, signals)
        self.signals = SIGNALS
        self.segment = np.broadcast_to(windows.segment[:, None, None], shape).ravel()
        self.signal = np.broadcast_to(np.arange(signals), shape).ravel()
        self.time_s = np.broadcast_to(windows.block_s[..., None], shape).ravel()

    def _prepare(self, noise: BodyNoise, *, has_gyro: bool) -> None:
        """Noise, the candidates, and what they could not show."""
        tangential, normal = self._replay.foot_forces(self._rig())
        loaded = normal > 0.2 * np.max(np.median(normal, axis=(0, 1)))
        ratio = np.where(loaded, tangential / np.maximum(normal, 1e-9), 0.0)
        demand = float(np.quantile(ratio[loaded], SLIP_QUANTILE)) if loaded.any() else 0.0
        slips_at = min(0.9 * demand, 0.9 * self._claims.friction)
        self.candidates = self._candidates(slips_at)
        self._whiten = self._whitening(noise, has_gyro=has_gyro)
        self.candidates = self._candidates(self._slipperiest(slips_at))
        self.untestable = self._untestable(ratio, normal)

    def _untestable(self, ratio: Floats, normal: Floats) -> dict[str, str]:
        """Effects that would not be seen, with the reason.

        Args:
            ratio: Tangential over normal force of feet under load, 0 where there is none, shape (w,
                steps, 4).
            normal: Normal force [N], same shape.
        """
        friction = self._claims.friction
        sizes = self.visibility(TYPICAL | {"foot_friction.less": 0.5 * friction})
        unseen = {
            name.partition(".")[0]: sigma for name, sigma in sizes.items() if sigma < LEAST_SIGMA
        }
        return {
            effect: f"{_because(effect, friction, ratio, normal)}{IN_WORDS[effect]} would move all "
            f"residuals by {sigma:.1f} sigma"
            for effect, sigma in unseen.items()
        }

    def _slipperiest(self, otherwise: float) -> float:
        """The coefficient of friction below the claimed one with which the log agrees best;
        `otherwise` if none helps.

        Where slip begins, residuals bend sharply: a search that steps by derivatives must begin
        close.
        """
        column, most = (
            self.names.index("foot_friction.less"),
            max(self._claims.friction - FRICTION_RANGE[0], 0.0),
        )
        best, grid = 0.0, np.linspace(0.0, most, SCANNED)
        for _ in range(3):
            sets = np.repeat(self.absent[None, None], len(grid), axis=0)
            sets[:, 0, column] = grid
            best = float(grid[np.argmin(np.sum(self.residuals(sets) ** 2, axis=(1, 2)))])
            step = grid[1] - grid[0]
            if best == 0.0 and step < SMALLEST_LESS:
                break
            grid = np.clip(best + np.linspace(-0.75, 0.75, SCANNED) * step, 0.0, most)
        return self._claims.friction - best if best > SMALLEST_LESS else otherwise

    def _rig(self, unknowns: Floats | None = None) -> BodySimulation:
        """Rig to simulate; without effects where no unknowns are given, shape (n, unknowns)."""
        return rig_of(self.names, self._claims, self.absent[None] if unknowns is None else unknowns)

    def _likeliest(self, noise: BodyNoise) -> ContactSolver:
        windows = self._windows
        some = slice(None, None, max(1, len(windows.start_s) // JUDGED_BY))

        @cache
        def replayed(solver: ContactSolver) -> BodyReplay:
            return self._replayed(solver, windows.taken(some))

        def squares(solver: ContactSolver, others: Floats) -> Floats:
            rig = self._rig(np.tile(self.absent, (len(others), 1)))
            softer, rougher, rolling = others.T
            rig.body.contact_time_constant.T[:] *= softer
            rig.body.friction.T[:] *= rougher
            rig.body.rolling.T[:] += rolling
            error = signal_errors(windows.measured[some], replayed(solver).states(rig))
            return np.asarray(np.mean(noise.plain(_finite(error)) ** 2, axis=(2, 3)))

        return likeliest_solver(squares)

    def _whitening(self, noise: BodyNoise, *, has_gyro: bool) -> BodyWhitening:
        """Moves the starts of the windows to where they are likeliest.

        What is then unknown of errors.
        """
        windows, rig = self._windows, self._rig()
        spread = StartNoise.of(noise, has_gyro=has_gyro)
        single = np.eye(spread.sigma.size)[:, None, :].repeat(len(windows.start_s), axis=1)
        slopes = self._moved(spread, single)
        claimed = self._errors(self._replay.states(rig))
        effects = self._errors(self._replay.states(self._rig(self.one_by_one(USUAL)[1:]))) - claimed
        starts = WindowStarts.of(noise, claimed[0], slopes, effects)
        qpos, qvel = spread.moved(windows.qpos, windows.qvel, starts.likeliest[None])
        self._windows = replace(windows, qpos=qpos[0], qvel=qvel[0])
        self._replay = self._replayed(self._ground)
        draws = starts.drawn(DRAWS, np.random.default_rng(0))
        draws[..., spread.is_free] = 0.0  # far off, but to no effect
        missed = self._moved(spread, draws) - np.einsum("kwd,dwbs->kwbs", draws, slopes)
        measured = -np.einsum("wd,dwbs->wbs", starts.likeliest, slopes)
        unrepeated = (
            np.mean(missed**2, axis=0) + self._from_small_changes() + self._from_time_steps()
        )
        lasting = np.sum(noise.plain(slopes[~spread.is_free])[:, :, LATE:] ** 2, axis=0).mean(
            axis=(1, 2)
        )
        return BodyWhitening(noise, slopes, measured, unrepeated, lasting, windows.segment)

    def _from_small_changes(self) -> Floats:
        """Mean square of what small changes of the robot change beyond first order,
        shape (w, BLOCKS, 33).

        When a foot lifts, lands or slips can hang on less than anyone knows of the robot; no model
        can be judged by it.
        """
        small = np.array([SMALL_CHANGES.get(name, 0.0) for name in self.names])
        change = small * np.random.default_rng(1).standard_normal((PAIRS, len(small)))
        sets = self.absent + np.concatenate([0.0 * small[None], change, -change])
        error = self._errors(self._replay.states(self._rig(sets)))
        return np.asarray(
            np.mean((0.5 * (error[1 : PAIRS + 1] + error[PAIRS + 1 :]) - error[0]) ** 2, axis=0)
        )

    def _from_time_steps(self) -> Floats:
        """Square of what a finer step of time changes beyond first order,
        (w, BLOCKS, 33); keeps the first order.
        """
        rig = self._rig()
        claimed = self._errors(self._replay.states(rig))[0]
        half, quarter = (
            self._errors(self._replayed(way).states(rig))[0] - claimed
            for way in finer_solvers(self._ground)
        )
        self._time_step_error = QUARTER_TO_NONE * quarter
        return np.asarray((quarter - HALF_TO_QUARTER * half) ** 2)

    def _moved(self, spread: StartNoise, by: Floats) -> Floats:
        """Change of errors when starts are off `by` so many standard deviations,
        shape (k, w, BLOCKS, 33).
        """
        windows = self._windows
        claims = self._rig(np.tile(self.absent, (len(by), 1)))
        states = self._replay.states(claims, *spread.moved(windows.qpos, windows.qvel, by))
        return self._errors(states) - self._errors(self._replay.states(self._rig()))

    def _replayed(self, solver: ContactSolver, windows: BodyWindows | None = None) -> BodyReplay:
        windows, position = windows or self._windows, self._claims.payload_position
        return BodyReplay(
            self._robot, windows, self._boxes, self._span_s, solver, position, self._held
        )

    def _errors(self, states: Floats) -> Floats:
        """Shape (n, w, BLOCKS, 33); a simulation that diverged is as far off as can be."""
        return _finite(signal_errors(self._windows.measured, states))


def _finite(error: Floats) -> Floats:
    return np.nan_to_num(error, nan=1e3, posinf=1e3, neginf=-1e3)


def _because(effect: str, friction: float, ratio: Floats, normal: Floats) -> str:
    """The physical reason, where there is one."""
    if effect == "foot_friction":
        return f"no slip: max |Ft|/Fn {float(ratio.max()):.2f} < {friction}; "
    flight_s = PHYSICS_DT * float(np.sum(np.all(normal <= 0.0, axis=-1)))
    if effect == "base_inertia" and flight_s < 0.1:
        return f"{flight_s:.2f} s of flight; "
    lifts = int(np.sum(np.diff((normal > 0.0).astype(np.int8), axis=1) > 0))
    if effect == "contact_compliance" and lifts < 4:
        return f"{lifts} touchdowns of a foot; "
    return ""
