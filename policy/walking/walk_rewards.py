"""The reward of walking, term by term, of one policy step, as in legged_gym and IsaacLab."""

from dataclasses import dataclass, fields

from saltus.arrays import Array, Joints, Places, Scalars, namespace
from saltus.policy.joints.description import LEAST_COMMAND
from saltus.policy.walking.description import POLICY_HZ
from saltus.policy.walking.settings import WalkRewardSettings

TERMS = tuple(f.name for f in fields(WalkRewardSettings))
SHARPNESS = 0.25  # (m/s)^2 or (rad/s)^2: squared error at which tracking earns 1/e; legged_gym's
SLOW = 0.4, 1.0  # m/s: commands between which the tolerance of the velocity grows; ours
UNEVEN_M = 0.1  # m between the highest and the lowest ground below the feet of a stand; ours
AIR_TIME_S = 0.5  # a step that lasts longer earns, a shorter one costs; legged_gym's


@dataclass(frozen=True, kw_only=True, eq=False)
class WalkRewardInputs:
    """Inputs of the terms of the walking policy's reward; arrays with a leading dimension of
    robots.
    """

    command: Places
    """Ahead, to the left [m/s], turning [rad/s], shape (n, 3)."""
    velocity: Places
    """Velocity of the base in the frame of commands, shape (n, 3)."""
    angular_velocity: Places
    """Base frame [rad/s], shape (n, 3)."""
    gravity: Places
    """Direction of gravity in the base frame, shape (n, 3)."""
    torque: Joints
    """[Nm], shape (n, 12)."""
    joint_acceleration: Joints
    """Mean over the step [rad/s^2], shape (n, 12)."""
    joint_offset: Joints
    """From the standing pose [rad], shape (n, 12)."""
    action: Joints
    last_action: Joints
    """This and the one before it, shape (n, 12)."""
    landed_after_s: Array
    """Time in the air of feet that touch the ground since this step, 0.5 s of others [s].

    Shape (n, 4).
    """
    foot_touching: Array
    """Bool, shape (n, 4)."""
    foot_ground: Array
    """Height of the ground below each foot [m], shape (n, 4)."""
    foot_speed_squared: Array
    """Horizontal [m^2/s^2], shape (n, 4)."""
    leg_touching: Array
    """Thigh or calf touches the ground, bool, shape (n, 8)."""
    foot_missed: Array
    """The foot stands in a trench that it should have stepped over, bool, shape (n, 4)."""
    foot_beside_drop: Array
    """The foot stands close to where the ground drops, bool, shape (n, 4)."""
    failed: Array
    """The episode ended with a fall, bool, shape (n,)."""


def walk_reward_terms(config: WalkRewardSettings, given: WalkRewardInputs) -> Array:
    """All terms, weighted, in the order of `TERMS`, of one policy step; shape (n, len(TERMS))."""
    xp = namespace(given.velocity)
    zero = xp.zeros_like(given.velocity[:, 0])

    def squared(values: Array) -> Scalars:
        return xp.sum(values * values, axis=-1)

    def count(flags: Array) -> Scalars:
        return xp.sum(xp.where(flags, 1.0 + 0.0 * zero[:, None], 0.0), axis=-1)

    asked = xp.sqrt(squared(given.command))
    # At 0.5 m/s, legged_gym's 0.25 pays robots that stand before a step 37 % of the whole
    tolerance = SHARPNESS * xp.clip(xp.sqrt(squared(given.command[:, :2])), *SLOW)
    moves = xp.where(asked > LEAST_COMMAND, 1.0 + zero, zero)
    hips = xp.stack([given.joint_offset[:, 3 * leg] for leg in range(4)], -1)
    slipping = xp.where(
        given.foot_touching, given.foot_speed_squared, 0.0 * given.foot_speed_squared
    )
    turning = given.angular_velocity[:, 2] - given.command[:, 2]
    between = xp.max(given.foot_ground, axis=-1) - xp.min(given.foot_ground, axis=-1)
    level = xp.clip(1.0 - between / UNEVEN_M, 0.0, 1.0)
    values = {
        "linear_velocity": xp.exp(
            -squared(given.velocity[:, :2] - given.command[:, :2]) / tolerance
        ),
        "turning": xp.exp(-turning * turning / SHARPNESS),
        "vertical_velocity": given.velocity[:, 2] ** 2,
        "roll_pitch_rate": squared(given.angular_velocity[:, :2]),
        "tilt": squared(given.gravity[:, :2]),
        "torque": squared(given.torque),
        "joint_acceleration": squared(given.joint_acceleration),
        "action_rate": squared(given.action - given.last_action),
        "air_time": moves * xp.sum(given.landed_after_s - AIR_TIME_S, axis=-1),
        "slip": xp.sum(slipping, axis=-1),
        "collision": count(given.leg_touching),
        "missed": count(given.foot_missed),
        "edge": count(given.foot_beside_drop),
        "hip": squared(hips),
        "still": (1.0 - moves) * level * xp.sum(xp.abs(given.joint_offset), axis=-1),
        "end": xp.where(given.failed, 1.0 + zero, zero),
    }
    return xp.stack([getattr(config, name) * values[name] / POLICY_HZ for name in TERMS], -1)


def total_reward(terms: Array) -> Scalars:
    """The reward, shape (n,): the sum of the terms, not below 0 but for the end of an episode.

    Where living cost more than an early end, robots would learn to fall; legged_gym's
    `only_positive_rewards`.
    """
    xp, end = namespace(terms), TERMS.index("end")
    going = xp.sum(terms, axis=-1) - terms[:, end]
    return xp.clip(going, 0.0, None) + terms[:, end]
