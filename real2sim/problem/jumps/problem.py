"""The problem of a robot that jumps: its body and its drives, whatever the ground gives.

A simulation of jumps goes its own way at the first footfall. So nothing is simulated: the measured
motion says which torques and forces it needed, and drives with effects say which there were. Legs
in the air show drives alone; the base shows them beside payload, centre of mass and inertia.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np

from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT
from saltus.effects.body import claimed_body
from saltus.effects.motors import TorqueSaturation
from saltus.effects.profile import Profile
from saltus.errors import RecordingError
from saltus.real2sim.problem.body.candidates import BodyClaims, trunk_candidates
from saltus.real2sim.problem.joints.candidates import (
    LOOP_RATE,
    JointCandidates,
    LogRange,
    saturation_beside,
)
from saltus.real2sim.problem.joints.drives import Kinks, lost_to_saturation, saturation_loss
from saltus.real2sim.problem.joints.excitation import LEAST_SAG_S, MOST, NO_VOLTAGE
from saltus.real2sim.problem.joints.torque_curve import corners_of
from saltus.real2sim.problem.jumps.stretch import BASE, TorqueBalance, stretch_of
from saltus.real2sim.problem.log import (
    boxes_of,
    drive_torque,
    joint_rates,
    robot_of,
    segments_of,
    torque_limits,
)
from saltus.real2sim.problem.problem import LARGEST_RESIDUAL, LEAST_SIGMA, Candidate, Problem
from saltus.real2sim.problem.stream_noise import quiet_sigma
from saltus.recordings.run_log import RunLog
from saltus.robots.robot import JOINTS, LEGS, LINKS
from saltus.sim.measured_robot import MeasuredMotion, MeasuredRobot

BASE_SIGNALS = ("force_x", "force_y", "force_z", "moment_roll", "moment_pitch", "moment_yaw")
FLOOR = np.repeat([1.0, 0.3, 0.03], [3, 3, 12])
"""Smallest noise of a mean over a block to believe in [N], [Nm], [Nm]: under a robot's weight a
foot's place is good to 2 mm, and a drive's torque to a per cent of a swing's."""
NOT_SHOWN = {
    "stiction": "legs do not rest between jumps: slow_triangle shows it",
    "backlash": "encoders sit on one side of the play: joint_tour shows it",
    "encoder_bias": "drives and log read the same encoder: hold_ladder shows it",
    "encoder_quantisation": "drives and log read the same encoder: hold_ladder shows it",
    "velocity_filter": "drives and log read the same velocity: joint_tour shows it",
    "velocity_scale": "drives and log read the same velocity: joint_tour shows it",
    "end_stop": "moments in which a joint is near its stop are left out: "
    "a held robot that leans on it shows it",
    "voltage_sag": NO_VOLTAGE,
    "base_roll": "nothing holds the base: a held robot shows it",
    "foot_friction": "the ground's forces are inferred, not simulated: heave_and_pitch shows it",
    "contact_compliance": "the ground's forces are inferred, not simulated: drop shows it",
    "soft_feet": "the ground's forces are inferred, not simulated: heave_and_pitch shows it",
}
"""Effects of drives, body and ground that no log of jumps shows, and experiments that do."""
USUAL = 5.0
"""Scales of an unknown, small changes that matter, that make a usual size where no start says
it."""
SETS = 16
"""Sets of unknowns that are computed together, so that their arrays stay in the cache."""
BODIES = np.diag([1.0, 1e-3, 1e-3, 1e-3, 1.0])
"""Payload [kg], centre of mass [m] and excess of inertia by which slopes are found; forces are
linear in all."""


class JumpProblem(Problem):
    """The problem of a robot that jumps: which effects balance its equations of motion; one block
    "robot".

    Args:
        log: With base "free", `base.csv`, `imu.csv`, commands, and the joints of a quadruped in the
            order of `JOINTS`.

    Raises:
        RecordingError: no segment of the log is long enough, or its gyroscope is late.
        ModelError: its robot is no quadruped.
    """

    name = "body"
    blocks = ("robot",)
    places = ({"trunk": "trunk", **{joint: joint for joint in JOINTS}},)
    simulator_disagreement = 0.3
    """No contact is simulated."""
    _assumed: Kinks = ()
    held = (TorqueSaturation.name,)

    def __init__(self, log: RunLog) -> None:
        self.model = robot_of(log)
        self._claims = BodyClaims.of(log)
        self.segments = segments_of(log)
        self._robot = MeasuredRobot(self.model, boxes_of(log), self._claims.payload_position)
        found = [stretch_of(log, segment, self._robot) for segment in self.segments]
        self._stretches = [stretch for stretch in found if stretch is not None]
        if not self._stretches:
            raise RecordingError("no segment of the log is long enough to be compared")
        owners = [i for i, stretch in enumerate(found) if stretch is not None]
        body = claimed_body(payload_kg=self._claims.payload_kg)
        self._balances = [TorqueBalance(stretch, self._robot, body) for stretch in self._stretches]
        self._slopes = np.array([self._changed(row) / row.max() for row in BODIES])
        self._limits = torque_limits(self.model).reshape(len(LEGS), len(LINKS))
        self._reach = _reach_of(log, self.model.stand_pose)
        self._index(owners)
        self._weight = self._weights(log)
        self._set_candidates(())
        self.untestable = self._unseen() | NOT_SHOWN
        if (duration_s := float(np.ptp(log.joints.time_s))) < LEAST_SAG_S:
            self.untestable["battery_sag"] = f"the log lasts {duration_s:.1f} < {LEAST_SAG_S:g} s"
        self._set_candidates(tuple(self.untestable))

    def residuals(self, unknowns: Floats) -> Floats:
        """Whitened residuals, shape (n, 1, m)."""
        parts = [
            self._left(unknowns[start : start + SETS, 0]) for start in range(0, len(unknowns), SETS)
        ]
        whitened = (
            np.concatenate(parts) * self._weight if parts else np.empty((0, len(self.time_s)))
        )
        return np.clip(whitened.reshape(len(unknowns), 1, -1), -LARGEST_RESIDUAL, LARGEST_RESIDUAL)

    def with_saturation(self, corners: Floats, slopes: Floats) -> "JumpProblem":
        """The problem of a simulator with a saturation in pieces, as `JointProblem` has it.

        Shapes (1, 12, pieces).
        """
        problem = copy(self)
        shape = (len(LEGS), len(LINKS), 1)
        problem._assumed = tuple(
            (slopes[0, :, k].reshape(shape), corners[0, :, k].reshape(shape))
            for k in range(corners.shape[-1])
        )
        problem._set_candidates(tuple(self.untestable))
        return problem

    def holding(self, profile: Profile) -> tuple[Problem, Profile]:
        """See `Problem`: no unknown can represent a measured curve."""
        problem = self
        for saturation in (
            effect for effect in profile.actuator if isinstance(effect, TorqueSaturation)
        ):
            problem = problem.with_saturation(*corners_of(saturation, self.model, self.places))
        told = tuple(
            effect for effect in profile.actuator if not isinstance(effect, TorqueSaturation)
        )
        return problem, replace(profile, actuator=told)

    def _set_candidates(self, without: Sequence[str]) -> None:
        """Sets the candidates of the drives for each joint, leg by leg, then those of the trunk."""
        self._joints = JointCandidates(
            LINKS, self._limits, self._reach, (LOOP_RATE, *NOT_SHOWN, *without)
        )
        of_joints = [
            self._placed(candidate, leg)
            for leg in range(len(LEGS))
            for candidate in self._joints.listed
        ]
        trunk = trunk_candidates()
        owner = [c.effect for c in trunk for _ in c.unknowns]
        self._trunk = np.flatnonzero([effect not in without for effect in owner])
        self.candidates = (*of_joints, *(c for c in trunk if c.effect not in without))

    def _placed(self, candidate: Candidate, leg: int) -> Candidate:
        """The candidate of a leg's place, at one leg.

        A saturation states itself beside what is assumed.
        """
        place = LINKS.index(candidate.where)
        placed = replace(candidate, where=f"{LEGS[leg]}_{candidate.where}")
        if candidate.effect != "torque_saturation":
            return placed
        known = partial(saturation_loss, self._assumed, place, legs=slice(leg, leg + 1))
        return saturation_beside(placed, known, lost_to_saturation, float(self._limits[leg, place]))

    def _left(self, unknowns: Floats) -> Floats:
        """Returns what drives and bodies leave to explain, shape (n, b, 18)."""
        split = len(LEGS) * self._joints.count
        drives = self._joints.drives(
            unknowns[:, :split].reshape(len(unknowns), len(LEGS), -1), PHYSICS_DT
        )
        strength = self._claims.motor_strength * (
            1.0 if drives.torque_gain is None else 1.0 + drives.torque_gain
        )
        drives = replace(drives, kinks=self._assumed, torque_gain=np.asarray(strength - 1.0))
        each = [
            b.left(s.torque(drives)) for s, b in zip(self._stretches, self._balances, strict=True)
        ]
        left = np.moveaxis(np.concatenate(each), -1, 0)
        return left + np.einsum("np,pbs->nbs", unknowns[:, split:], self._slopes[self._trunk])

    def _changed(self, by: Floats) -> Floats:
        """Returns what another body changes, shape (b, 18)."""
        mass, *shift, excess = by
        body = claimed_body(
            payload_kg=self._claims.payload_kg + mass,
            com_shift=np.array(shift),
            inertia_scale=1.0 + excess,
        )
        return np.concatenate([balance.change(body) for balance in self._balances])

    def _index(self, owners: Sequence[int]) -> None:
        """Segment, signal and time of each residual."""
        times = [stretch.blocks(stretch.time_s).mean(axis=1) for stretch in self._stretches]
        self.signals = (*BASE_SIGNALS, *(f"tau_{joint}" for joint in JOINTS))
        shape = (sum(map(len, times)), len(self.signals))
        self.segment = np.repeat(np.repeat(owners, [len(t) for t in times]), shape[1])
        self.signal = np.broadcast_to(np.arange(shape[1]), shape).ravel()
        self.time_s = np.repeat(np.concatenate(times), shape[1])

    def _weights(self, log: RunLog) -> Floats:
        """One over the noise of each signal, 0 where it says nothing; shape (b, 18)."""
        base, imu = log.base, log.imu
        if base is None or imu is None:
            raise RecordingError("jumps need base.csv and imu.csv")
        measured = (base.values[:, 7:10], imu.values[:, 4:7], joint_rates(log.joints))
        rate = np.repeat([_noise(values) for values in measured], [3, 3, len(JOINTS)])
        parts = []
        for stretch, balance in zip(self._stretches, self._balances, strict=True):
            noise = np.sqrt(2.0) * self._mass() * rate / (stretch.size * PHYSICS_DT)
            variance = np.tile(FLOOR**2 + noise**2, (len(balance.uncertainty), 1))
            variance[:, :BASE] += balance.uncertainty**2
            tells = np.concatenate(
                [np.tile(balance.is_plain[:, None], BASE), balance.is_air.repeat(len(LINKS), 1)], 1
            )
            parts.append(tells / np.sqrt(variance))
        return np.concatenate(parts)

    def _mass(self) -> Floats:
        """Diagonal of the mass matrix of a robot that stands [kg], [kg m^2], shape (18,)."""
        stand = np.concatenate(
            [[0.0, 0.0, self.model.stand_height, 1.0, 0.0, 0.0, 0.0], self.model.stand_pose]
        )
        sped_up = np.concatenate([np.zeros((1, BASE + len(JOINTS))), np.eye(BASE + len(JOINTS))])
        motion = MeasuredMotion(
            position=np.tile(stand, (len(sped_up), 1)), velocity=0.0 * sped_up, acceleration=sped_up
        )
        force = self._robot.forces(motion, claimed_body())
        return np.diag(force[1:] - force[0])

    def _unseen(self) -> dict[str, str]:
        """Effects that would not be seen at a usual size,
        at all places at once, with the reason.
        """
        found = {}
        base = self.residuals(self.absent[None, None])
        for effect in dict.fromkeys(candidate.effect for candidate in self.candidates):
            moved = np.concatenate(
                [_usual(c) if c.effect == effect else c.absent for c in self.candidates]
            )
            sigma = float(np.linalg.norm(self.residuals(moved[None, None]) - base))
            if sigma < LEAST_SIGMA:
                found[effect] = f"a usual size of it would move all residuals by {sigma:.1f} sigma"
        return found


def _usual(candidate: Candidate) -> Floats:
    """Unknowns of an effect of a usual size."""
    sizes = [USUAL * unknown.scale for unknown in candidate.unknowns]
    return np.where(np.asarray(candidate.starts[0]) != 0.0, candidate.starts[0], sizes)


def _noise(values: Floats) -> float:
    """White noise of samples, shape (n, columns),
    by their third differences, which are 0 in flight.
    """
    return quiet_sigma(np.diff(values, n=3, axis=0)) / float(np.sqrt(20.0))


def _reach_of(log: RunLog, stand: Floats) -> tuple[LogRange, ...]:
    """How far a log goes at each place of a leg.

    Springs count from the stand pose, so that logs share them.
    """
    torque, speed = (
        np.quantile(np.abs(values), MOST, axis=0)
        for values in (drive_torque(log), joint_rates(log.joints))
    )
    of_legs = np.stack([speed, torque, stand]).reshape(3, len(LEGS), len(LINKS))
    return tuple(
        LogRange(
            speed=float(speed.max()),
            slowest=float(speed.min()),
            torque=float(torque.max()),
            middle=float(angle.mean()),
            side=1.0,
            end=0.0,
            to_limit=np.inf,
            steps=(),
        )
        for speed, torque, angle in of_legs.transpose(2, 0, 1)
    )
