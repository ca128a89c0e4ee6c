"""A planner made by hand: bounding with rules that read the heightmap.

Bodies: the reference of vertical velocity and pitch rate is a straight line over the progress of a
    stance, one for
each contact mode, corrected towards a height above the ground and a pitch along its slope. Feet:
each pair lands on the point nearest its neutral point that is away from edges and trenches, and
clears what lies between. The planner has no memory: a plan follows from one observation and one
heightmap.
"""

from dataclasses import dataclass, replace

import numpy as np

from saltus.arrays import Array, Constant, namespace, smooth_step
from saltus.constants import GRAVITY
from saltus.grid import HeightGrid
from saltus.loop.planner import Observation
from saltus.plan import Plan, swing_lift
from saltus.policy.height_line import HeightLine
from saltus.robots.robot import Robot
from saltus.robots.similarity import Similarity

STANCE_RATIO, SWING_RATIO = 0.4, 0.6  # of a cycle; the controller's gait
FRONT, REAR = 0, 2  # a leg of each pair
VELOCITY_GAIN = (
    10.0  # the controller's, from velocity errors to accelerations, of the reference's size [1/s]
)

# Bounds of the action: original, but for the residual's lower bound in z, which is 0 there: the
# nominal swing stays at the height of the feet that stand, and on stairs the rear feet must land
# below the front feet, by at most 0.38 m times the slope of the steepest stairs that the course
# knows at low difficulty (0.3).
FREQUENCY_RANGE_HZ = (0.5, 4.0)
VELOCITY_X_LIMIT = 3.0
VELOCITY_Z_LIMIT = 3.0
PITCH_RATE_LIMIT = 6.0
RESIDUAL_LOW = (-0.2, -0.07, -0.12)
RESIDUAL_HIGH = (0.2, 0.07, 0.4)

_LOW, _HIGH = Constant(RESIDUAL_LOW), Constant(RESIDUAL_HIGH)

FloatOrArray = float | Array
"""A number, or one for each robot of a batch, shape (n,): planner randomisation of training
data."""


@dataclass(frozen=True, kw_only=True)
class ScriptedParameters:
    """All numbers of the planner by rules, for a robot of the reference's size
    (`saltus.robots.similarity`).

    Found by CMA-ES in the batched plant, with the effects of that robot's profile and everything
    that a trial draws: 62 generations of 60 candidates, each on flat ground and on stairs of 6, 6,
    6, 7 and 8 cm, from numbers that were tuned by hand. The search is gone (docs/history.md,
    "Policy"). `saltus bench planner` measures what they are worth.
    """

    stepping_frequency_hz: FloatOrArray = 3.46
    velocity_x: FloatOrArray = 2.03
    """On level ground [m/s]."""
    front_velocity_z: FloatOrArray = 0.365
    """Middle of the stance of the front legs [m/s]."""
    front_velocity_z_slope: FloatOrArray = -1.15
    """Change over that stance [m/s]."""
    rear_velocity_z: FloatOrArray = 0.665
    rear_velocity_z_slope: FloatOrArray = 0.208
    front_pitch_rate: FloatOrArray = -0.793
    """Middle of the stance of the front legs, nose down positive [rad/s]."""
    front_pitch_rate_slope: FloatOrArray = -3.64
    """Change over that stance [rad/s]: the front legs push the nose up."""
    rear_pitch_rate: FloatOrArray = 0.746
    rear_pitch_rate_slope: FloatOrArray = 5.31
    height_m: FloatOrArray = 0.277
    """Height of the base above the ground."""
    height_gain: FloatOrArray = 5.49
    """Vertical velocity by error of height [1/s]."""
    ceiling_m: FloatOrArray = 0.362
    """Height above which the base is not to rise [m]: a leg reaches 0.38 m, and must reach the
    ground when it lands."""
    ceiling_gain: FloatOrArray = 4.36
    """Largest vertical velocity by distance to that height [1/s]."""
    lever: FloatOrArray = 0.628
    """Share of the height that the standing feet have over the ground under the base that is known
    to the estimator."""
    climb_gain: FloatOrArray = 2.44
    """Vertical velocity by slope times speed."""
    pitch: FloatOrArray = -0.0161
    """On level ground [rad]."""
    pitch_per_slope: FloatOrArray = -0.521
    """Pitch along the slope of the ground."""
    pitch_gain: FloatOrArray = 5.88
    """Pitch rate by error of pitch [1/s]."""
    coupling: FloatOrArray = 0.277
    """Share of the pitch rate that the wanted support brings about anyway that is asked for."""
    front_landing_x: FloatOrArray = 0.00425
    """Shift of the landing point of the front feet [m]."""
    rear_landing_x: FloatOrArray = 0.0275
    clearance_m: FloatOrArray = 0.116
    """Clearance of the sole above the highest terrain on the way."""
    landing_depth_m: FloatOrArray = 0.00369
    """How far below the ground a foot aims when it lands."""
    lift_until: FloatOrArray = 0.208
    """Progress of the swing at which a foot is up."""
    lower_from: FloatOrArray = 0.655
    """Progress of the swing at which a foot begins to come down."""
    edge_margin_m: FloatOrArray = 0.0606
    """Distance from a landing point within which edges matter, the nearer the more."""
    edge_cost: FloatOrArray = 0.0543
    """Detour that is worth an edge at a landing point, about [m]."""
    height_trust: FloatOrArray = 0.196
    """Share of the heightmap's offset to the ground under the standing feet that is believed."""

    def of_robot(self, robot: Robot) -> "ScriptedParameters":
        """The numbers of a robot of another size, whose hips may be above or below its base."""
        scaled = Similarity.of_robot(robot).scaled(self, LENGTHS, SPEEDS, RATES)
        hips_m = float(robot.hip_anchor[:, 2].mean())
        return replace(
            scaled, height_m=scaled.height_m - hips_m, ceiling_m=scaled.ceiling_m - hips_m
        )


LENGTHS = (
    "height_m", "ceiling_m", "front_landing_x", "rear_landing_x", "clearance_m", "landing_depth_m",
    "edge_margin_m",
    "edge_cost",
)  # fmt: skip
SPEEDS = (
    "velocity_x", "front_velocity_z", "front_velocity_z_slope", "rear_velocity_z",
    "rear_velocity_z_slope"
)  # fmt: skip
RATES = (
    "stepping_frequency_hz", "front_pitch_rate", "front_pitch_rate_slope", "rear_pitch_rate",
    "rear_pitch_rate_slope",
    "height_gain", "ceiling_gain", "pitch_gain",
)  # fmt: skip
"""Quantities that grow with the length of the legs, with its square root, and with its inverse
square root."""

# How landing points are weighed, in metres of detour.
CANDIDATES = np.linspace(-0.2, 0.2, 33)
# Where edges around a landing point are looked for [m]
EDGE_DISTANCES = (
    0.03,
    0.06,
    0.09,
    0.12,
    0.15,
)
EDGE_HEIGHT = 0.05  # a height difference of this much is an edge; the lowest stair of the courses
TRENCH_DEPTH = 0.10  # ground that is this much lower than the ground in stance is no place to land
TRENCH_COST = 3.0  # per metre of depth
# Distances from a trench [m], and how much of its cost they have
TRENCH_MARGINS = (
    (0.04, 0.6),
    (0.08, 0.3),
)
ASIDE = (
    0.0,
    *(
        side
        for distance in (*EDGE_DISTANCES, *dict(TRENCH_MARGINS))
        for side in (distance, -distance)
    ),
)
"""Where heights are read around a landing point [m]: all at once, as most of a reading is
overhead."""
# A choice between two landing points that are as good must not be made anew every 10 ms. The cost
# of a change of mind is below that of a detour, or a foot that lags behind its path would pull its
# own aim back.
COMMITMENT = 0.6  # metres of detour that a change of mind by one metre costs
COMMIT_FROM, COMMIT_UNTIL = 0.45, 0.7  # progress of the swing over which that cost grows
# Where the slope is measured: both foot pairs and the next landing [m]
SLOPE_FROM, SLOPE_TO = (
    -0.25,
    0.55,
)
LIFT_MARGIN = 0.04  # terrain this far before and behind the way of a foot counts as well [m]


class ScriptedPlanner:
    """Plans jumps by rules, without a network, for any batch of robots, numpy or torch."""

    def __init__(
        self, robot: Robot, grid: HeightGrid, parameters: ScriptedParameters | None = None
    ) -> None:
        self._line = HeightLine(grid)
        self.parameters = (parameters or ScriptedParameters()).of_robot(robot)
        size = Similarity.of_robot(robot)
        self._landing_limit = float(robot.landing_reach[0])
        self._candidates = Constant(CANDIDATES * size.length)
        self._lift_margin = LIFT_MARGIN * size.length
        self._slope_range = SLOPE_FROM * size.length, SLOPE_TO * size.length
        self._mass, self._foot_radius = robot.mass, robot.foot_radius
        self._hip_x: list[float] = robot.hip_anchor[:, 0].tolist()
        # The controller's model of the body: its inertia, and the greatest acceleration of a pair
        # of feet.
        self._pitch_inertia, self._max_lift = (
            float(robot.inertia[1]),
            2.0 * float(robot.foot_force[1]) / robot.mass,
        )
        self._velocity_gain = VELOCITY_GAIN / size.time

    def step(self, observation: Observation, heights: Array, fresh: object = False) -> Plan:
        """Plans the next 10 ms, within the bounds, from the present alone.

        See `saltus.policy.planner.Planner`.
        """
        del fresh
        p = self.parameters
        ground = _filled(heights, observation.base_height)
        offset = self._offset(observation, ground)[..., None]
        heights, ground = heights + offset, ground + offset
        incline = self._line.slope(ground, *self._slope_range)
        velocity_z, pitch_rate = self._body(observation, incline)
        same = 0.0 * observation.pitch  # spreads a number over the batch
        plan = Plan(
            stepping_frequency_hz=p.stepping_frequency_hz + same,
            velocity_x=p.velocity_x + same,
            velocity_z=velocity_z,
            pitch_rate=pitch_rate,
            foot_residual_front=self._residual(
                observation, heights, ground, FRONT, p.front_landing_x
            ),
            foot_residual_rear=self._residual(observation, heights, ground, REAR, p.rear_landing_x),
        )
        return bounded(plan)

    def _body(self, observation: Observation, incline: Array) -> tuple[Array, Array]:
        """References of vertical velocity and pitch rate, each of shape (...)."""
        p = self.parameters
        xp = namespace(incline)
        front, rear = observation.contact[..., FRONT], observation.contact[..., REAR]
        moment = (
            xp.where(front, observation.progress[..., FRONT], observation.progress[..., REAR]) - 0.5
        )
        velocity_z = xp.where(
            front,
            p.front_velocity_z + p.front_velocity_z_slope * moment,
            p.rear_velocity_z + p.rear_velocity_z_slope * moment,
        )
        pitch_rate = xp.where(
            front,
            p.front_pitch_rate + p.front_pitch_rate_slope * moment,
            p.rear_pitch_rate + p.rear_pitch_rate_slope * moment,
        )
        # At the start all legs stand: the body only gathers speed.
        bounding = xp.astype(~(front & rear), incline.dtype)
        # The height is measured over the standing feet, which on a slope are above or below the
        # ground under the base.
        stance_x = xp.where(
            front, 0.0 * incline + self._hip_x[FRONT], 0.0 * incline + self._hip_x[REAR]
        )
        height = observation.base_height + p.lever * stance_x * incline
        rise = p.height_gain * (p.height_m - height)
        ceiling = p.ceiling_gain * (p.ceiling_m - height)
        climb = p.climb_gain * incline * observation.velocity[..., 0]
        velocity_z = xp.minimum(bounding * velocity_z + rise, ceiling) + climb
        pitch_rate = pitch_rate + p.coupling * self._rate_of_support(observation, velocity_z)
        pitch_error = p.pitch + p.pitch_per_slope * incline - observation.pitch
        return velocity_z, bounding * pitch_rate + p.pitch_gain * pitch_error

    def _rate_of_support(self, observation: Observation, velocity_z: Array) -> Array:
        """Pitch rate to ask for, so that the controller does not
        take weight off the feet to hold the pitch.
        """
        xp = namespace(velocity_z)
        x = xp.mean(xp.reshape(observation.foot[..., 0], (*velocity_z.shape, 2, 2)), axis=-1)
        stance_x = xp.where(observation.contact[..., FRONT], x[..., 0], x[..., 1])
        lift = GRAVITY + self._velocity_gain * (velocity_z - observation.velocity[..., 2])
        acceleration = (
            -stance_x * self._mass * xp.clip(lift, 0.0, self._max_lift) / self._pitch_inertia
        )
        return observation.angular_velocity[..., 1] + acceleration / self._velocity_gain

    def _offset(self, observation: Observation, heights: Array) -> Array:
        """Returns what to add to the heights so
        that the ground under the standing feet is where those feet are.
        """
        xp = namespace(heights)
        standing = xp.astype(observation.contact, heights.dtype)
        count = xp.sum(standing, axis=-1)
        seen = xp.sum(self._line.height_at(heights, observation.foot[..., 0]) * standing, axis=-1)
        stood_on = xp.sum((observation.foot[..., 2] - self._foot_radius) * standing, axis=-1)
        seen_anywhere = xp.mean(self._line.height_at(heights, observation.foot[..., 0]), axis=-1)
        offset = xp.where(
            count > 0.0,
            (stood_on - seen) / xp.clip(count, 1.0, None),
            -observation.base_height - seen_anywhere,
        )
        return (1.0 - self.parameters.height_trust) * offset

    def _residual(
        self, observation: Observation, heights: Array, ground: Array, leg: int, shift: FloatOrArray
    ) -> Array:
        """Residual of one pair of feet, shape (..., 3);
        `ground` is what `heights` are without trenches.
        """
        p = self.parameters
        xp = namespace(heights)
        swing = observation.progress[..., leg]
        forward = observation.velocity[..., 0]
        limit = self._landing_limit
        step = xp.clip(forward * (0.5 * STANCE_RATIO / p.stepping_frequency_hz), -limit, limit)
        travel = forward * (1.0 - swing) * (SWING_RATIO / p.stepping_frequency_hz)
        neutral = self._hip_x[leg] * xp.cos(observation.pitch) + step + shift + travel
        foot_x = xp.mean(observation.foot[..., leg : leg + 2, 0], axis=-1)
        # How far the foot already is from its nominal path; that path leaves the hip at half time.
        begun = foot_x - (neutral - travel - step * (1.0 - smooth_step(2.0 * swing - 1.0)))
        resolve = COMMITMENT * xp.clip(
            (swing - COMMIT_FROM) / (COMMIT_UNTIL - COMMIT_FROM), 0.0, 1.0
        )
        detour = self._detour(observation, heights, neutral, begun, resolve)
        landing = neutral + detour
        start, end = (
            xp.minimum(foot_x, landing) - self._lift_margin,
            xp.maximum(foot_x, landing) + self._lift_margin,
        )
        # The controller's swing stays at the height of its ground
        nominal_z = -observation.base_height
        over = (
            self._line.highest_between(ground, start, end)
            + self._foot_radius
            + p.clearance_m
            - nominal_z
        )
        down = (
            self._line.height_at(ground, landing[..., None])[..., 0]
            + self._foot_radius
            - p.landing_depth_m
            - nominal_z
        )
        lift = swing_lift(swing, over, down, p.lift_until, p.lower_from)
        residual = xp.stack([shift + detour, 0.0 * lift, lift], axis=-1)
        return xp.where(observation.contact[..., leg, None], 0.0 * residual, residual)

    def _detour(
        self, observation: Observation, heights: Array, neutral: Array, begun: Array, resolve: Array
    ) -> Array:
        """How far to land from the neutral point [m];
        `resolve` is the cost of leaving the detour that has begun.
        """
        p = self.parameters
        xp = namespace(heights)
        candidates = self._candidates.like(heights)
        x = neutral[..., None] + candidates
        seen = self._line.height_at(heights, xp.concat([x + aside for aside in ASIDE], axis=-1))
        read = {
            aside: seen[..., k * x.shape[-1] : (k + 1) * x.shape[-1]]
            for k, aside in enumerate(ASIDE)
        }
        there = read[0.0]
        relief = 0.0 * there
        for distance in EDGE_DISTANCES:
            near = xp.clip(1.0 - distance / (p.edge_margin_m + 0.0 * neutral), 0.0, None)[..., None]
            for side in (distance, -distance):
                relief = relief + near * xp.clip(abs(read[side] - there) / EDGE_HEIGHT, 0.0, 1.0)
        floor = -observation.base_height[..., None] - TRENCH_DEPTH
        depth = xp.clip(floor - there, 0.0, None)
        for distance, share in TRENCH_MARGINS:
            for side in (distance, -distance):
                depth = xp.maximum(depth, share * xp.clip(floor - read[side], 0.0, None))
        change = resolve[..., None] * abs(candidates - begun[..., None])
        edge_cost = (p.edge_cost + 0.0 * neutral)[..., None]
        cost = abs(candidates) + change + edge_cost * relief + TRENCH_COST * depth
        return candidates[xp.argmin(cost, axis=-1)]


def bounded(plan: Plan) -> Plan:
    """The nearest plan within the bounds."""
    xp = namespace(plan.velocity_x)
    low, high = _LOW.like(plan.velocity_x), _HIGH.like(plan.velocity_x)
    return Plan(
        stepping_frequency_hz=xp.clip(plan.stepping_frequency_hz, *FREQUENCY_RANGE_HZ),
        velocity_x=xp.clip(plan.velocity_x, -VELOCITY_X_LIMIT, VELOCITY_X_LIMIT),
        velocity_z=xp.clip(plan.velocity_z, -VELOCITY_Z_LIMIT, VELOCITY_Z_LIMIT),
        pitch_rate=xp.clip(plan.pitch_rate, -PITCH_RATE_LIMIT, PITCH_RATE_LIMIT),
        foot_residual_front=xp.clip(plan.foot_residual_front, low, high),
        foot_residual_rear=xp.clip(plan.foot_residual_rear, low, high),
    )


def _filled(heights: Array, base_height: Array) -> Array:
    """Heights with trenches filled up to the ground in stance:
    the body crosses them as if they were not there.
    """
    xp = namespace(heights)
    level = -base_height[..., None]
    return xp.where(heights < level - TRENCH_DEPTH, level, heights)
