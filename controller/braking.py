"""Brings a bounding robot to walking pace without a planner:
a plan that the controller makes itself.

At 1.8 m/s the capture point is 0.3 m ahead of the hips: no single contact can stop the robot. It
goes on bounding on the schedule of the gait while the reference of forward velocity is zero, which
the stance legs follow within their friction cones; one or two contacts of each pair later it is
slow enough to be caught on sprung legs. It does not see: the ground is taken to be the plane
through the places where its feet last stood, which on stairs is their slope.
"""

from dataclasses import dataclass, replace
from typing import Protocol

from saltus.arrays import Constant, Flags, Legs, Scalars, Vectors, namespace
from saltus.constants import PHYSICS_DT
from saltus.controller.gait import GaitSignal
from saltus.controller.leg_controller import Diagnostics
from saltus.controller.yaw_frame import CentroidalReference, reference_of
from saltus.footholds import SWING_RATIO
from saltus.plan import Plan, swing_lift
from saltus.robots.robot import Robot
from saltus.robots.similarity import Similarity

_FRONT, _REAR = 0, 2  # a leg of each pair
_SHORTEST_BASE = (
    0.2  # distance of the pairs' footholds along x below which a slope is not read from them [m]
)


@dataclass(frozen=True, kw_only=True)
class BrakingConfig:
    """Numbers of the braking plan for a robot of the reference's size (`Similarity`).

    From the scripted planner, then by trial over landings at every phase of the gait (`saltus bench
    landing`, figures in docs/reliability.md).
    """

    stepping_frequency_hz: float = 3.46
    """Frequency of the scripted planner: the schedule goes on without a break."""
    height_m: float = 0.37
    """Towards which the stance legs lift the base [m]: weight and the next landing keep it
    below."""
    height_gain: float = 4.4
    """Vertical velocity by error of height [1/s]."""
    climb_gain: float = 3.0
    """Vertical velocity by slope times forward velocity."""
    pitch_rate: float = 1.2
    """The front legs push the nose up at this rate, the rear legs push it down [rad/s]."""
    pitch_gain: float = 5.9
    """Pitch rate by the angle between body and slope [1/s]."""
    slope_limit: float = 0.8
    """Steepest slope that is believed: stairs of 20 cm."""
    reach_s: float = 0.06
    """Feet land this much times the velocity ahead of Raibert's point [s]: they brake."""
    rear_reach_m: float = 0.0275
    """The rear feet land this much further ahead [m]; scripted planner."""
    clearance_m: float = 0.13
    """Clearance of the foot over the ground on the way [m]: stairs of 6 cm, and their edges."""
    landing_height_m: float = 0.02
    """Height over the expected ground at which a swing ends [m]: a step that is higher is not run
    into."""
    lift_until: float = 0.2
    """Progress of the swing at which a foot is up."""
    lower_from: float = 0.65
    """Progress of the swing at which a foot begins to come down."""
    slow_mps: float = 0.5
    """Speed below which sprung legs catch the body: the capture point is 8 cm ahead. The pitch rate
    counts as the speed that it gives the hips: legs of which one pair hangs in the air do not stop
    it."""

    def of_size(self, size: Similarity) -> "BrakingConfig":
        """The numbers of a robot of another size."""
        lengths = ("height_m", "rear_reach_m", "clearance_m", "landing_height_m")
        rates = ("stepping_frequency_hz", "height_gain", "pitch_rate", "pitch_gain")
        return replace(
            size.scaled(self, lengths, ("slow_mps",), rates), reach_s=self.reach_s * size.time
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class BrakingState:
    """State of the braking plan between ticks, with what is known of the ground below the feet."""

    foothold: Legs
    """Where each foot last stood for certain, by dead reckoning: relative to the base now, yaw
    frame [m], (..., 4, 3). """


class MovingBody(Protocol):
    """Motion of the body: the part of `saltus.controller.yaw_frame.YawFrameBody` that braking
    needs.
    """

    @property
    def pitch(self) -> Scalars:
        """[rad], shape (...)."""

    @property
    def velocity(self) -> Vectors:
        """Yaw frame [m/s], shape (..., 3)."""

    @property
    def angular_velocity(self) -> Vectors:
        """Yaw frame [rad/s], shape (..., 3)."""


class LastTick(Protocol):
    """Parts of the last tick that a braking plan follows from; `Diagnostics` has them."""

    @property
    def body(self) -> MovingBody:
        """The robot."""

    @property
    def gait(self) -> GaitSignal:
        """Schedule of the gait."""


class Braking:
    """Makes plans that brake; for any leading batch dimensions."""

    def __init__(
        self,
        robot: Robot,
    ) -> None:
        size = Similarity.of_robot(robot)
        self.config = BrakingConfig().of_size(size)
        hip_x = float(robot.neutral_foot[0])
        self._landing_limit = float(robot.landing_reach[0])
        self._shortest_base = _SHORTEST_BASE * size.length
        self._hip_x = {_FRONT: hip_x, _REAR: -hip_x}
        self._legs_x = Constant([hip_x, hip_x, -hip_x, -hip_x])
        self._up = Constant([0.0, 0.0, 1.0])

    def init(self, foot_yaw: Legs) -> BrakingState:
        """Memory of robots that stand.

        Foot positions relative to the base, yaw frame [m], shape (..., 4, 3).
        """
        return BrakingState(foothold=foot_yaw)

    def observe(self, diagnostics: Diagnostics, state: BrakingState) -> BrakingState:
        """Remembers where feet stand; to be called once a tick, in every mode."""
        xp = namespace(state.foothold)
        body = diagnostics.body
        moved = state.foothold - body.velocity[..., None, :] * PHYSICS_DT
        return BrakingState(
            foothold=xp.where(diagnostics.gait.trusted[..., None], body.foot_yaw, moved)
        )

    def is_slow(self, last: LastTick) -> Flags:
        """True where sprung legs can catch the body. Bool, shape (...)."""
        body = last.body
        x, y, hips = (
            body.velocity[..., 0],
            body.velocity[..., 1],
            self._hip_x[_FRONT] * body.angular_velocity[..., 1],
        )
        return x * x + y * y + hips * hips < self.config.slow_mps**2

    def reference(
        self, last: LastTick, base_height: Scalars, heading: Scalars, state: BrakingState
    ) -> CentroidalReference:
        """The reference of the braking plan.

        Args:
            last: Its tick.
            base_height: over the feet in stance [m], shape (...).
            heading: yaw to hold [rad], shape (...).
            state: the ground.
        """
        xp = namespace(base_height)
        config, body, contact = self.config, last.body, last.gait.contact
        slope = self._slope(state)
        front = contact[..., _FRONT]
        zero = xp.zeros_like(slope)
        forward = body.velocity[..., 0]
        stance_x = xp.where(front, zero + self._hip_x[_FRONT], zero + self._hip_x[_REAR])
        height = base_height + stance_x * slope  # over the ground under the base
        push = xp.where(front, zero - config.pitch_rate, zero + config.pitch_rate)
        plan = Plan(
            stepping_frequency_hz=zero + config.stepping_frequency_hz,
            velocity_x=zero,
            velocity_z=config.height_gain * (config.height_m - height)
            + config.climb_gain * slope * forward,
            pitch_rate=push - config.pitch_gain * (body.pitch + slope),  # nose down is positive
            foot_residual_front=self._residual(last, base_height, slope, state, _FRONT, 0.0),
            foot_residual_rear=self._residual(
                last, base_height, slope, state, _REAR, config.rear_reach_m
            ),
        )
        return reference_of(plan, heading)

    def catching(self, reference: CentroidalReference, state: BrakingState) -> CentroidalReference:
        """The reference for sprung legs: with feet along the slope of the ground."""
        rise = self._slope(state)[..., None] * self._legs_x.like(state.foothold)
        return replace(reference, foot_residual=rise[..., None] * self._up.like(rise))

    def _slope(self, state: BrakingState) -> Scalars:
        """Slope of the ground between the footholds of the front and the rear feet, shape (...)."""
        xp = namespace(state.foothold)
        pairs = xp.mean(xp.reshape(state.foothold, (*state.foothold.shape[:-2], 2, 2, 3)), axis=-2)
        ahead = pairs[..., 0, :] - pairs[..., 1, :]
        limit = self.config.slope_limit
        return xp.clip(
            ahead[..., 2] / xp.clip(ahead[..., 0], self._shortest_base, None), -limit, limit
        )

    def _residual(
        self,
        last: LastTick,
        base_height: Scalars,
        slope: Scalars,
        state: BrakingState,
        leg: int,
        shift: float,
    ) -> Vectors:
        """Residual of one pair of feet, shape (..., 3)."""
        xp = namespace(slope)
        config, swing = self.config, last.gait.progress[..., leg]
        forward = last.body.velocity[..., 0]
        period = 1.0 / config.stepping_frequency_hz
        limit = self._landing_limit
        step = xp.clip(forward * (0.5 * (1.0 - SWING_RATIO) * period), -limit, limit)
        reach = shift + config.reach_s * forward
        landing_x = (
            self._hip_x[leg] + step + reach + forward * (1.0 - swing) * (SWING_RATIO * period)
        )
        middle = xp.mean(state.foothold, axis=-2)
        # The swing stays at -base_height
        ground = middle[..., 2] + slope * (landing_x - middle[..., 0]) + base_height
        over, down = (
            xp.clip(ground, 0.0, None) + config.clearance_m,
            ground + config.landing_height_m,
        )
        lift = swing_lift(swing, over, down, config.lift_until, config.lower_from)
        return xp.stack([reach, xp.zeros_like(reach), lift], axis=-1)
