"""Traces of trials, and why they failed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats, Reals
from saltus.constants import LOADED_N, PHYSICS_DT, POLICY_STEPS
from saltus.loop.loop import Moment
from saltus.robots.robot import Robot
from saltus.rotations import roll_pitch_yaw, rotation_matrix
from saltus.terrain.terrain import Terrain
from saltus.trial import Outcome

FailureKind = Literal[
    "", "timeout", "trench", "astray", "edge_hit", "slip", "fall_in_flight", "fall_in_stance"
]

STEP_S = PHYSICS_DT * POLICY_STEPS


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialTrace:
    """One trial of a jumping policy, one row a policy step (100 Hz), from its start to its end; t
    rows.
    """

    pose: Floats
    """Position [m] and quaternion (w, x, y, z) of the base in the world, shape (t, 7)."""
    joint_position: Floats
    """[rad], shape (t, 12)."""
    heights: Floats
    """Heights that the planner saw: terrain relative to the base [m], shape (t, 30)."""
    foot: Floats
    """Centres of the feet in the world [m], shape (t, 4, 3)."""
    stance: NDArray[np.bool_]
    """Scheduled contact, shape (t, 4)."""
    loaded: NDArray[np.bool_]
    """The foot bears more than 5 N, shape (t, 4)."""

    @property
    def time_s(self) -> Reals:
        """Since the start [s], shape (t,)."""
        return np.arange(len(self.pose)) * STEP_S

    @property
    def base(self) -> Floats:
        """Position of the trunk's centre in the world, x and z [m], shape (t, 2)."""
        return self.pose[:, [0, 2]]

    @property
    def pitch(self) -> Floats:
        """Nose down positive [rad], shape (t,)."""
        _, pitch, _ = roll_pitch_yaw(rotation_matrix(self.pose[:, 3:]))
        return np.asarray(pitch)

    @property
    def landings(self) -> Floats:
        """Places where feet came to bear in a stance:
        x and z of their centres [m], shape (landings, 2).
        """
        bears = self.loaded & self.stance
        return np.asarray(self.foot[1:][bears[1:] & ~bears[:-1]][:, [0, 2]])


def traces_of(steps: Sequence[Moment]) -> list[TrialTrace]:
    """Cuts a roll-out into the traces of its first trials."""
    lengths = np.sum([step.running for step in steps], axis=0)
    truths = [step.truth for step in steps]
    base = [
        np.hstack([truth.position_base_in_world, truth.quaternion_base_in_world])
        for truth in truths
    ]
    rows = {
        "pose": np.array(base, np.float32),
        "joint_position": np.array([truth.joint_position for truth in truths], np.float32),
        "heights": np.array([step.heights for step in steps], np.float32),
        "foot": np.array([truth.foot_position_in_world for truth in truths], np.float32),
        "stance": np.array([step.states.leg_contact for step in steps]),
        "loaded": np.array([truth.foot_force for truth in truths]) > LOADED_N,
    }
    return [
        TrialTrace(**{name: row[:n, i] for name, row in rows.items()})
        for i, n in enumerate(lengths)
    ]


BEFORE_END_S = 0.4  # a gait cycle: what happened before it has been survived
SLIP_MPS, SLIP_M = 0.3, 0.05  # a loaded foot that is this fast, for this way, does not hold
WALL_M = 0.02  # sole to wall: what a foot moves in one step
UNDER_M = 0.01  # below the upper side of an edge: a sole rests on it, or rolls over it
SUNK_M = 0.05  # below the ground at both sides of a trench
CAME_FROM_S = 1.0  # two gait cycles: where a foot bore since then is where it came from
# Ways to a side of a trench, the longest as wide as one is: 1.2 m are asked for
ACROSS_M = np.linspace(0.0, 1.5, 31)
IN_AIR_S = 0.05


def failure_of(robot: Robot, outcome: Outcome, trace: TrialTrace, terrain: Terrain) -> FailureKind:
    """Why a trial failed; empty after a success.

    The first that holds of what is known about its last 0.4 s.
    """
    if outcome.success:
        return ""
    if outcome.cause == "time_limit":
        return "timeout"
    last = slice(-round(BEFORE_END_S / STEP_S), None)
    foot, stance, loaded = trace.foot[last], trace.stance[last], trace.loaded[last]
    if _sunk(trace, last, robot.foot_radius, terrain).any():
        return "trench"
    if not all(terrain.arrays.covers(x, y) for x, y in foot[-1, :, :2].tolist()):
        return "astray"
    if (_at_wall(foot, robot.foot_radius, terrain) & ~stance).any():
        return "edge_hit"
    if _slipped(foot[..., 0], loaded).any():
        return "slip"
    in_air = not trace.loaded[-round(IN_AIR_S / STEP_S) :].any()
    return "fall_in_flight" if in_air else "fall_in_stance"


def _sunk(trace: TrialTrace, last: slice, radius: float, terrain: Terrain) -> NDArray[np.bool_]:
    """Feet in a trench: below the ground that they came from,
    which is there again behind and ahead.

    Ground that only leads down or up is none, nor is that between walls. Of the `last` steps, shape
    (t, 4).
    """
    lately = slice(-round(CAME_FROM_S / STEP_S), None)
    ground = terrain.height_at(trace.foot[lately, :, 0], trace.foot[lately, :, 1])
    came_from = np.maximum.accumulate(np.where(trace.loaded[lately], ground, -np.inf), axis=0)[last]
    foot, ground = trace.foot[last], ground[last]
    x, y = foot[..., 0], foot[..., 1]
    places = (
        np.broadcast_arrays(x[..., None] + side * ACROSS_M, y[..., None]) for side in (-1.0, 1.0)
    )
    behind, ahead = (np.maximum.accumulate(terrain.height_at(*place), axis=-1) for place in places)
    # As far apart as a trench may be wide
    sides = np.minimum(behind, ahead[..., ::-1]).max(axis=-1)
    rim = np.minimum(sides, came_from) - SUNK_M
    return np.asarray((ground < rim) & (foot[..., 2] - radius < rim))


def _at_wall(foot: Floats, radius: float, terrain: Terrain) -> NDArray[np.bool_]:
    """Feet in front of a wall that reaches higher than their sole.

    What is less steep than 45 deg is none.

    Shape (t, 4).
    """
    x, y, sole, reach = foot[..., 0], foot[..., 1], foot[..., 2] - radius, radius + WALL_M
    return np.asarray(
        terrain.height_at(x + reach, y)
        > np.maximum(sole + UNDER_M, terrain.height_at(x, y) + reach)
    )


def _slipped(x: Floats, loaded: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which feet slid, shape (4,)."""
    way = np.abs(np.diff(x, axis=0)) * (loaded[1:] & loaded[:-1])
    return np.asarray(np.where(way > SLIP_MPS * STEP_S, way, 0.0).sum(axis=0) > SLIP_M)
