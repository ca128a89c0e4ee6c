"""A planner made by hand: bounding with rules that read the heightmap.

Bodies: the reference of vertical velocity and pitch rate is a straight line over the progress of a stance, one for
each contact mode, corrected towards a height above the ground and a pitch along its slope. Feet: each pair lands on
the point nearest its neutral point that is away from edges and trenches, and clears what lies between. The planner
has no memory: a plan follows from one observation and one heightmap.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from policy.action import Action
from policy.observation import Observation
from policy.profile import height_at, highest_between, slope
from saltus import go1
from saltus.messages import Floats

STANCE_RATIO, SWING_RATIO = 0.4, 0.6  # of a cycle; the controller's gait
LANDING_LIMIT = 0.15  # the controller's clip of its landing point [m]
FRONT, REAR = 0, 2  # a leg of each pair
GRAVITY = 9.81
# The controller's model of the body: its gain from velocity errors to accelerations, its inertia, its force limit.
VELOCITY_GAIN, PITCH_INERTIA, MAX_LIFT = 10.0, 0.525, 260.0 / go1.MASS

Value = float | Floats
"""A number, or in a search one number for each robot of a batch, shape (n,)."""


@dataclass(frozen=True, kw_only=True)
class ScriptedParameters:
    """All numbers of the planner."""

    stepping_frequency_hz: Value = 3.44
    velocity_x: Value = 1.67
    """On level ground [m/s]."""
    velocity_x_per_slope: Value = 0.0
    """Change of speed with the slope ahead [m/s]."""
    front_velocity_z: Value = 0.698
    """Middle of the stance of the front legs [m/s]."""
    front_velocity_z_slope: Value = 0.24
    """Change over that stance [m/s]."""
    rear_velocity_z: Value = 0.776
    rear_velocity_z_slope: Value = 1.5
    front_pitch_rate: Value = -1.89
    """Middle of the stance of the front legs, nose down positive [rad/s]."""
    front_pitch_rate_slope: Value = -3.29
    """Change over that stance [rad/s]: the front legs push the nose up."""
    rear_pitch_rate: Value = -1.24
    rear_pitch_rate_slope: Value = 0.924
    height_m: Value = 0.266
    """Of the base above the ground."""
    height_gain: Value = 6.0
    """Vertical velocity by error of height [1/s]."""
    lever: Value = 1.0
    """Share of the height that the standing feet have over the ground under the base that is known to the estimator."""
    climb_gain: Value = 1.54
    """Vertical velocity by slope times speed."""
    pitch: Value = -0.0067
    """On level ground [rad]."""
    pitch_per_slope: Value = -0.46
    """Pitch along the slope of the ground."""
    pitch_gain: Value = 2.92
    """Pitch rate by error of pitch [1/s]."""
    coupling: Value = 0.418
    """Share of the pitch rate that the wanted support brings about anyway that is asked for."""
    front_landing_x: Value = 0.00407
    """Shift of the landing point of the front feet [m]."""
    rear_landing_x: Value = -0.0466
    clearance_m: Value = 0.0772
    """Of the sole above the highest terrain on the way."""
    landing_depth_m: Value = 0.00789
    """How far below the ground a foot aims when it lands."""
    lift_until: Value = 0.324
    """Progress of the swing at which a foot is up."""
    lower_from: Value = 0.629
    """Progress of the swing at which a foot begins to come down."""
    edge_margin_m: Value = 0.099
    """Distance from a landing point within which edges matter, the nearer the more."""
    edge_cost: Value = 0.0157
    """Detour that is worth an edge at a landing point, about [m]."""
    height_trust: Value = 0.408
    """Share of the heightmap's offset to the ground under the standing feet that is believed."""


# How landing points are weighed, in metres of detour.
CANDIDATES = np.linspace(-0.15, 0.15, 25)
EDGE_DISTANCES = (0.03, 0.06, 0.09, 0.12, 0.15)  # where edges around a landing point are looked for [m]
EDGE_HEIGHT = 0.05  # a height difference of this much is an edge; the lowest stair of the courses
TRENCH_DEPTH = 0.10  # ground that is this much lower than the ground in stance is no place to land
TRENCH_COST = 3.0  # per metre of depth
# A choice between two landing points that are as good must not be made anew every 10 ms.
COMMITMENT = (
    0.6  # metres of detour that a change of mind by one metre costs; below 1, or a foot that lags pulls its aim back
)
COMMIT_FROM, COMMIT_UNTIL = 0.45, 0.7  # progress of the swing over which that cost grows
SLOPE_FROM, SLOPE_TO = -0.25, 0.55  # where the slope is measured: both foot pairs and the next landing [m]
LIFT_MARGIN = 0.04  # terrain this far before and behind the way of a foot counts as well [m]


class ScriptedPlanner:
    """Plans for any batch of robots."""

    def __init__(self, parameters: ScriptedParameters | None = None) -> None:
        self.parameters = parameters or ScriptedParameters()

    def step(self, observation: Observation, heights: Floats) -> Action:
        """Plans the next 10 ms.

        Args:
            observation: of the robots, leading dimensions (...).
            heights: Terrain relative to the base [m], shape (..., 30).

        Returns:
            The action, within its bounds.
        """
        p = self.parameters
        heights = heights + self._offset(observation, heights)[..., None]
        incline = slope(heights, SLOPE_FROM, SLOPE_TO)
        front = observation.contact[..., FRONT]
        progress = np.where(front, observation.progress[..., FRONT], observation.progress[..., REAR])
        moment = progress - 0.5
        climb = p.climb_gain * incline * observation.velocity[..., 0]
        # The height is felt over the standing feet, which on a slope are above or below the ground under the base.
        lever = np.where(front, go1.HIP_ANCHOR[FRONT, 0], go1.HIP_ANCHOR[REAR, 0])
        rise = p.height_gain * (p.height_m - p.lever * lever * incline - observation.base_height)
        velocity_z = _by_mode(
            front,
            p.front_velocity_z + p.front_velocity_z_slope * moment,
            p.rear_velocity_z + p.rear_velocity_z_slope * moment,
        )
        pitch_rate = _by_mode(
            front,
            p.front_pitch_rate + p.front_pitch_rate_slope * moment,
            p.rear_pitch_rate + p.rear_pitch_rate_slope * moment,
        )
        # At the start all legs stand: the body only gathers speed.
        bounding = ~(front & observation.contact[..., REAR])
        velocity_z = bounding * velocity_z + rise + climb
        pitch_error = p.pitch + p.pitch_per_slope * incline - observation.pitch
        pitch_rate = pitch_rate + p.coupling * self._rate_of_support(observation, front, velocity_z)
        pitch_rate = bounding * pitch_rate + p.pitch_gain * pitch_error
        shape = observation.pitch.shape
        return Action(
            stepping_frequency_hz=np.broadcast_to(np.asarray(p.stepping_frequency_hz), shape),
            velocity_x=np.broadcast_to(p.velocity_x + p.velocity_x_per_slope * np.abs(incline), shape),
            velocity_z=velocity_z,
            pitch_rate=pitch_rate,
            foot_residual_front=self._residual(observation, heights, FRONT, p.front_landing_x),
            foot_residual_rear=self._residual(observation, heights, REAR, p.rear_landing_x),
        ).bounded()

    def _rate_of_support(self, observation: Observation, front: NDArray[np.bool_], velocity_z: Floats) -> Floats:
        """Pitch rate that the controller must be asked for lest it takes weight off the feet to hold the pitch."""
        mean_x = np.where(front, observation.foot[..., :2, 0].mean(axis=-1), observation.foot[..., 2:, 0].mean(axis=-1))
        lift = GRAVITY + VELOCITY_GAIN * (velocity_z - observation.velocity[..., 2])
        acceleration = -mean_x * go1.MASS * np.clip(lift, 0.0, MAX_LIFT) / PITCH_INERTIA
        return observation.angular_velocity[..., 1] + acceleration / VELOCITY_GAIN

    def _offset(self, observation: Observation, heights: Floats) -> Floats:
        """What to add to the heights so that the ground under the standing feet is where those feet feel it."""
        feet_x = observation.foot[..., 0]
        standing = observation.contact.astype(np.float64)
        count = standing.sum(axis=-1)
        seen = (height_at(heights, feet_x) * standing).sum(axis=-1)
        felt = ((observation.foot[..., 2] - go1.FOOT_RADIUS) * standing).sum(axis=-1)
        felt = np.where(count > 0, felt, -observation.base_height)
        seen = np.where(count > 0, seen, height_at(heights, feet_x).mean(axis=-1))
        return (1.0 - self.parameters.height_trust) * (felt - seen) / np.maximum(count, 1.0)

    def _residual(self, observation: Observation, heights: Floats, leg: int, shift: Value) -> Floats:
        """Residual of one pair of feet, shape (..., 3)."""
        p = self.parameters
        swing = observation.progress[..., leg]
        forward = observation.velocity[..., 0]
        frequency = np.asarray(p.stepping_frequency_hz)
        step = np.clip(0.5 * forward * STANCE_RATIO / frequency, -LANDING_LIMIT, LANDING_LIMIT)
        travel = forward * (1.0 - swing) * SWING_RATIO / frequency
        neutral = go1.HIP_ANCHOR[leg, 0] * np.cos(observation.pitch) + step + shift + travel
        foot_x = observation.foot[..., leg : leg + 2, 0].mean(axis=-1)
        # How far the foot already is from its nominal path; that path leaves the hip at half time.
        begun = foot_x - (neutral - travel - step * (1.0 - _smooth(2.0 * swing - 1.0)))
        resolve = COMMITMENT * np.clip((swing - COMMIT_FROM) / (COMMIT_UNTIL - COMMIT_FROM), 0.0, 1.0)
        landing = neutral + self._detour(observation, heights, neutral, begun, resolve)
        start, end = np.minimum(foot_x, landing) - LIFT_MARGIN, np.maximum(foot_x, landing) + LIFT_MARGIN
        nominal_z = -observation.base_height  # the controller's swing stays at the height of its ground
        over = highest_between(heights, start, end) + go1.FOOT_RADIUS + p.clearance_m - nominal_z
        down = height_at(heights, landing[..., None])[..., 0] + go1.FOOT_RADIUS - p.landing_depth_m - nominal_z
        up = _smooth(swing / p.lift_until)
        low = _smooth((swing - p.lower_from) / (1.0 - np.asarray(p.lower_from)))
        lift = up * (over + (down - over) * low)
        zero = np.zeros_like(lift)
        residual = np.stack([shift + landing - neutral + zero, zero, lift], axis=-1)
        return np.where(observation.contact[..., leg, None], 0.0, residual)

    def _detour(
        self, observation: Observation, heights: Floats, neutral: Floats, begun: Floats, resolve: Floats
    ) -> Floats:
        """How far to land from the neutral point [m]; `resolve` is the cost of leaving the detour that has begun."""
        p = self.parameters
        x = neutral[..., None] + CANDIDATES
        there = height_at(heights, x)
        relief = np.zeros_like(there)
        for distance in EDGE_DISTANCES:
            near = np.clip(1.0 - distance / np.asarray(p.edge_margin_m), 0.0, None)[..., None]
            for side in (distance, -distance):
                relief += near * np.clip(np.abs(height_at(heights, x + side) - there) / EDGE_HEIGHT, 0.0, 1.0)
        depth = np.maximum(-observation.base_height[..., None] - there - TRENCH_DEPTH, 0.0)
        change = resolve[..., None] * np.abs(CANDIDATES - begun[..., None])
        cost = np.abs(CANDIDATES) + change + np.asarray(p.edge_cost)[..., None] * relief + TRENCH_COST * depth
        return CANDIDATES[np.argmin(cost, axis=-1)]


def _by_mode(front: NDArray[np.bool_], front_value: Value, rear_value: Value) -> Floats:
    return np.where(front, front_value, rear_value)


def _smooth(t: Floats) -> Floats:
    """From 0 to 1, at rest at both ends."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
