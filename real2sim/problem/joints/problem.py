"""The problem of the joints: which effects in drives
and encoders make a held robot move as its log says.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Indices
from saltus.effects.motors import TorqueSaturation, TorqueSpeedLimit
from saltus.effects.profile import Profile
from saltus.errors import RecordingError
from saltus.real2sim.problem.joints.candidates import JointCandidates, saturation_beside
from saltus.real2sim.problem.joints.drives import (
    JointDrives,
    Kinks,
    lost_to_saturation,
    saturation_loss,
)
from saltus.real2sim.problem.joints.excitation import (
    NoiseScaledSignal,
    encoder_steps,
    reach_of,
    untestable_effects,
)
from saltus.real2sim.problem.joints.noise import learned_whitening, noise_of_repeats
from saltus.real2sim.problem.joints.replay import SIGNALS, replay_windows
from saltus.real2sim.problem.joints.torque_curve import corners_of
from saltus.real2sim.problem.joints.uniform_log import (
    motions_of,
    twice_as_fine,
    uniform_rows,
    windows_of,
)
from saltus.real2sim.problem.log import claimed_gains, claimed_model, segments_of, torque_limits
from saltus.real2sim.problem.problem import LARGEST_RESIDUAL, Candidate, Problem
from saltus.recordings.run_log import RunLog
from saltus.robots.robot import LINKS, Robot
from saltus.sim.held_robot import HeldRobot

SAMPLE_S = 0.016
"""Rows are averaged over this long: motions of 10 Hz keep 96 %, and a log of 30 s has 2000 samples
a signal."""
FLOOR = {"q": 1e-4, "dq": 5e-3, "tau_est": 2e-2}
"""Smallest noise of a sample to believe in [rad], [rad/s], [Nm]: the replay itself is as good as
that."""
STOP = 0.01  # rad: nearer than this to its limit a joint may touch
TOGETHER = 32
"""Sets that are simulated together: their arrays then stay in the cache of a core."""
SLOW = (
    ("coulomb_friction", "stiction"),
    ("backlash",),
    ("armature", "viscous_friction"),
    ("base_roll",),
)
"""Effects that make the replay of all who are simulated with them slower."""


class JointProblem(Problem):
    """Joints of a robot whose base is held; each leg is a block.

    Args:
        log: With `meta["base"]` "fixed".

    Attributes:
        model: The robot, or the MJCF that the log names.
        reach: How far the log goes at each place of the legs.
        limit: Torque limit of each place [Nm], shape (places,).

    Raises:
        RecordingError: a base that moves, or too few rows.
        ModelError: a robot that cannot be read or lacks a joint.
    """

    name = "joints"
    _assumed: Kinks = ()
    _holds_limit = False
    _is_fine = False
    held = (TorqueSaturation.name,)

    def __init__(self, log: RunLog) -> None:
        if log.meta.get("base") != "fixed":
            raise RecordingError(
                f"the joints need a held base, the log claims base {log.meta.get('base')!r}"
            )
        names = list(log.meta["joints"])
        self.model = claimed_model(log)
        self._robot = HeldRobot(self.model, names, _base_quaternion(log))
        self._rows = uniform_rows(log)
        kp, kd = claimed_gains(log)
        branches = self._robot.branches
        self._motion, self._finer_motion = motions_of(self._rows, self._robot, kp, kd)
        # [rad]
        self._asked = self._rows.q_des + (kd * self._rows.dq_des + self._rows.tau_ff) / np.maximum(
            kp, 1.0
        )
        self._averaged = max(1, round(SAMPLE_S / self._rows.dt_s))
        self.samples_per_residual = float(self._averaged)
        self._windows = windows_of(self._rows, branches, self._motion.every, self._averaged)
        self._finer_windows = twice_as_fine(self._windows)
        self.segments = segments_of(log)
        self._place_samples()
        places, self.blocks, self.places = _named(names, branches)
        self.reach = reach_of(self._rows, kp, kd, self._robot, self._steps)
        self.untestable = untestable_effects(log, self._rows, self.reach)
        if self._motion.sway is None:
            self.untestable["base_roll"] = (
                "the log has not all joints of the robot: what moves its base is not known"
            )
        limits = _torque_limits(self.model, branches)
        self.limit = limits[0]
        self._candidates = JointCandidates(places, limits, self.reach, tuple(self.untestable))
        self.candidates = self._with_saturations()
        self._name_samples(places)
        self._learn_noise()

    def residuals(self, unknowns: Floats) -> Floats:
        """Whitened residuals, shape (n, blocks, m), of unknowns of shape (n, blocks, unknowns)."""
        out = np.empty((len(unknowns), len(self.blocks), len(self.segment)))
        key = sum(2**i * self._candidates.has(effects, unknowns) for i, effects in enumerate(SLOW))
        for value in np.unique(key):  # sets that need the same parts of the replay
            members = np.flatnonzero(key == value)
            for start in range(0, len(members), TOGETHER):
                part = members[start : start + TOGETHER]
                out[part] = self._whitened(
                    replace(self._drives(unknowns[part]), kinks=self._assumed)
                )
        return out

    def residuals_with_kinks(self, unknowns: Floats, corners: Floats, slopes: Floats) -> Floats:
        """Residuals with saturations in pieces, shape (sets, blocks x m).

        Args:
            unknowns: Of all else, shape (sets, blocks, unknowns).
            corners: Torque from which on each piece takes [Nm], shape (places, pieces).
            slopes: What share it takes, shape (sets, blocks, places, pieces).
        """
        drives = replace(self._drives(unknowns), kinks=_kinks(corners, slopes))
        return self._whitened(drives).reshape(len(slopes), -1)

    def with_saturation(self, corners: Floats, slopes: Floats) -> "JointProblem":
        """The problem on a simulator that has a saturation in pieces already.

        A fitted one adds to it.

        Args:
            corners: Torque from which on each piece takes [Nm], shape (blocks, places, pieces).
            slopes: What share it takes, same shape.
        """
        problem = copy(self)
        problem._assumed = _kinks(corners, slopes[None])
        problem.candidates = problem._with_saturations()
        return problem

    def holding(self, profile: Profile) -> tuple[Problem, Profile]:
        """See `Problem`: no unknown can represent a measured curve.

        The plant limits speeds once a step.
        """
        problem = copy(self)
        for saturation in (
            effect for effect in profile.actuator if isinstance(effect, TorqueSaturation)
        ):
            problem = problem.with_saturation(*corners_of(saturation, self.model, self.places))
        problem._holds_limit = any(
            isinstance(effect, TorqueSpeedLimit) for effect in profile.actuator
        )
        told = tuple(
            effect for effect in profile.actuator if not isinstance(effect, TorqueSaturation)
        )
        return problem, replace(profile, actuator=told)

    def replayed_alike(self, effects: Sequence[str]) -> Problem:
        """See `Problem`: play is replayed in steps half as long."""
        if self._is_fine or "backlash" not in effects:
            return self
        problem = copy(self)
        problem._is_fine = True
        return problem

    def columns_of(self, effect: str, place: str) -> slice:
        """Where the unknowns of an effect at a place of a leg stand."""
        return self._candidates.columns[effect, list(self.places[0]).index(place)]

    def _with_saturations(self) -> tuple[Candidate, ...]:
        """The candidates, those of a saturation with knee and plateau
        of what is fitted and what is assumed.
        """
        places = list(self.places[0])

        def with_assumed(candidate: Candidate) -> Candidate:
            if candidate.effect != "torque_saturation":
                return candidate
            place = places.index(candidate.where)
            return saturation_beside(
                candidate,
                partial(saturation_loss, self._assumed, place),
                lost_to_saturation,
                float(self.limit[place]),
            )

        return tuple(with_assumed(candidate) for candidate in self._candidates.listed)

    def _drives(self, unknowns: Floats) -> JointDrives:
        return replace(
            self._candidates.drives(unknowns, self._motion.dt_s), holds_limit=self._holds_limit
        )

    def _whitened(self, drives: JointDrives) -> Floats:
        # (samples, signals, branches, joints, sets)
        white = self._whitening.white(self._apart(drives), self._fresh)[self._kept]
        if self._grid.exists:
            grid = self._grid.residuals(drives.encoder_quantisation, drives.count)[self._kept]
            white = np.concatenate([white, grid[:, None]], axis=1)
        white = np.nan_to_num(
            white, nan=LARGEST_RESIDUAL, posinf=LARGEST_RESIDUAL, neginf=-LARGEST_RESIDUAL
        )
        white = np.clip(white, -LARGEST_RESIDUAL, LARGEST_RESIDUAL)
        white[:, : len(self._signals)][self._missing[self._kept]] = 0.0
        return white.transpose(4, 2, 1, 3, 0).reshape(drives.count, len(self.blocks), -1)

    def _apart(self, drives: JointDrives) -> Floats:
        """Measured minus simulated [rad], [rad/s], [Nm],
        shape (samples, signals, branches, joints, sets).
        """
        motion, windows = self._motion, self._windows
        if drives.backlash is not None or self._is_fine:
            # a rotor alone is ten times as fast as with its leg: it crosses a gap in a few steps
            motion, windows, drives = (
                self._finer_motion,
                self._finer_windows,
                drives.twice_as_fine(),
            )
        simulated = replay_windows(motion, windows, drives, self._averaged)
        made = [simulated[SIGNALS.index(signal)] for signal in self._signals]
        flat = np.stack([m.reshape(-1, *m.shape[2:])[self._sample] for m in made], axis=1)
        apart = self._measured[..., None] - flat
        apart[self._missing] = 0.0
        return np.asarray(apart)

    def _place_samples(self) -> None:
        """Which rows make a sample, what was measured there, and which samples lie in a segment."""
        windows, rows, size = self._windows, self._rows, self._averaged
        every = self._motion.every
        means = windows.length // (every * size)
        first = (windows.start + windows.warm_up)[:, None] // every + size * np.arange(means)
        is_whole = (first + size - 1) * every <= windows.last[:, None]
        self._sample = np.flatnonzero(is_whole.reshape(-1))
        start = first[is_whole]
        within = start[:, None] + np.arange(size)
        time_s = rows.time_s[within].mean(axis=1)
        self._signals = tuple(s for s in SIGNALS if getattr(rows, s) is not None)
        branches = self._robot.branches
        measured = {s: getattr(rows, s) for s in self._signals} | {
            "q": np.where(rows.q_is_known, rows.q, np.nan)
        }
        signals = [measured[s][within].mean(axis=1)[:, branches] for s in self._signals]
        self._measured = np.stack(signals, axis=1)  # (samples, signals, branches, joints)
        self._missing = ~np.isfinite(self._measured) | self._after_a_stop()[:, None, :, None]
        self._measured = np.nan_to_num(self._measured)
        self._time = time_s
        self._steps = encoder_steps(rows)
        self._grid = NoiseScaledSignal(rows, self._steps, within, branches)
        self._fresh = np.flatnonzero(np.diff(start, prepend=-size) != size)
        index = np.full(len(time_s), -1)
        for i, segment in enumerate(self.segments):
            index[(time_s >= segment.start_s) & (time_s < segment.end_s)] = i
        self._kept = np.flatnonzero(index >= 0)
        self._segment = index[self._kept]

    def _after_a_stop(self) -> NDArray[np.bool_]:
        """Samples after a leg has come near a stop of a joint,
        until its window ends: shape (samples, branches).

        The replay has no stops.
        """
        windows, rows, robot = self._windows, self._rows, self._robot
        near = np.asarray((rows.q < robot.lower + STOP) | (rows.q > robot.upper - STOP))
        of_leg = np.asarray(near[:, robot.branches].any(axis=2))
        every, means = self._motion.every, windows.length // (self._motion.every * self._averaged)
        first = windows.start // every
        behind = np.zeros((len(first), means, of_leg.shape[1]), dtype=bool)
        for i, start in enumerate(first):
            whole = of_leg[start : start + (windows.warm_up + windows.length) // every]
            hit = np.logical_or.accumulate(whole)[
                windows.warm_up // every + self._averaged - 1 :: self._averaged
            ]
            behind[i, : len(hit)] = hit[:means]
        return np.asarray(behind.reshape(-1, of_leg.shape[1])[self._sample])

    def _name_samples(self, places: Sequence[str]) -> None:
        kinds = (*self._signals, *(("grid",) if self._grid.exists else ()))
        count = len(kinds) * len(places)
        self.signals = tuple(f"{signal}_{place}" for signal in kinds for place in places)
        self.signal = np.repeat(np.arange(count), len(self._kept))
        self.segment = np.tile(self._segment, count)
        self.time_s = np.tile(self._time[self._kept], count)

    def _learn_noise(self) -> None:
        floor = np.array([FLOOR[s] for s in self._signals])[:, None, None] * np.ones(
            self._measured.shape[2:]
        )
        rows, branches = self._rows, self._robot.branches
        signals = np.stack([getattr(rows, s)[:, branches] for s in self._signals], axis=1)
        pieces = noise_of_repeats(
            rows.time_s, np.nan_to_num(signals), self._asked, self.segments, self._averaged
        )
        is_coarse = np.array([step is not None for step in self._steps])[branches]
        nothing = np.zeros((1, len(self.blocks), self._candidates.count))
        claimed = self._apart(self._candidates.drives(nothing, self._motion.dt_s))[..., 0]
        self._whitening = learned_whitening(pieces, claimed, floor, is_coarse)


def _kinks(corners: Floats, slopes: Floats) -> Kinks:
    return tuple(
        (slopes[..., k].transpose(1, 2, 0), corners[..., k, None]) for k in range(corners.shape[-1])
    )


def _base_quaternion(log: RunLog) -> Sequence[float]:
    if log.base is None or not len(log.base.values):
        return (1.0, 0.0, 0.0, 0.0)
    mean = np.nanmedian(log.base.values[:, 3:7], axis=0)
    return tuple((mean / np.linalg.norm(mean)).tolist())


def _torque_limits(model: Robot | Path, branches: Indices) -> Floats:
    """Torque limits of all joints [Nm], shape (branches, joints).

    Legs of three joints all have the limits of one leg; joints of other branches have the smallest.
    """
    limits = torque_limits(model)
    if branches.shape[1] == len(LINKS):
        return np.tile(limits[: len(LINKS)], (len(branches), 1))
    return np.full(branches.shape, limits.min())


def _named(
    names: Sequence[str], branches: Indices
) -> tuple[tuple[str, ...], tuple[str, ...], tuple[dict[str, str], ...]]:
    """Places within a branch, names of the branches, and for each which joint a place is."""
    split = [
        [names[j].removesuffix("_joint").rpartition("_") for j in branch] for branch in branches
    ]
    places = tuple(place for _, _, place in split[0])
    if any(tuple(place for _, _, place in joints) != places for joints in split) or len(
        set(places)
    ) < len(places):
        places = tuple(f"joint{i}" for i in range(branches.shape[1]))
    blocks = tuple(joints[0][0] or f"branch{i}" for i, joints in enumerate(split))
    found = [dict(zip(places, [names[j] for j in branch], strict=True)) for branch in branches]
    return places, blocks, tuple(found)
