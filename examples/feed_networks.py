"""The two networks without Saltus, fed as their cards say (models/heightmap.md, models/policy.md).

    pip install numpy onnxruntime
    python examples/feed_networks.py models/heightmap.onnx models/policy.onnx

Here the robot stands still on level ground, and its camera sees just that: put your own readings in
their place.
"""

import argparse
import json
import math
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import onnxruntime

THIGH, CALF, SIDE = 0.213, 0.213, 0.08  # [m]
HIP = np.array(
    [
        [0.1881, -0.04675, 0.0],
        [0.1881, 0.04675, 0.0],
        [-0.1881, -0.04675, 0.0],
        [-0.1881, 0.04675, 0.0],
    ]
)
WIDTH, HEIGHT, FOCAL, RANGE_M = 16, 48, 42.278131, 3.0  # of the network's camera
LONGEST_GAP_S, OLDEST_S, MOST_INVALID = 0.13, 0.17, 0.8


class Body:
    """A robot's reading in its yaw frame.

    Args:
        state: has `quaternion_base_in_world` (w, x, y, z), `angular_velocity_base` [rad/s],
            `velocity_base_in_world` [m/s], `base_height` [m], `joint_position` [rad], and
            `leg_contact`, `leg_progress`, `leg_trusted`.
    """

    def __init__(self, state: Any) -> None:
        w, x, y, z = state.quaternion_base_in_world
        # Of the base, x and y in the world
        ahead = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)])
        # Of the world, in the base
        up = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
        self.roll, self.pitch = math.atan2(up[1], up[2]), math.asin(min(max(-up[0], -1.0), 1.0))
        yaw = math.atan2(ahead[1], ahead[0])
        base_in_yaw = turn_y(self.pitch) @ turn_x(self.roll)
        self.velocity = turn_z(-yaw) @ state.velocity_base_in_world
        self.angular_velocity = base_in_yaw @ state.angular_velocity_base
        self.feet = feet(np.reshape(state.joint_position, (4, 3))) @ base_in_yaw.T  # (4, 3)


def turn_x(angle: float) -> np.ndarray:
    """Rotation about x."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def turn_y(angle: float) -> np.ndarray:
    """Rotation about y."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def turn_z(angle: float) -> np.ndarray:
    """Rotation about z."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def feet(joints: np.ndarray) -> np.ndarray:
    """Feet in the base frame [m], shape (4, 3), of joint angles [rad], shape (4, 3)."""
    a, b, c = joints.T
    side = SIDE * np.array([-1.0, 1.0, -1.0, 1.0])
    x = -THIGH * np.sin(b) - CALF * np.sin(b + c)
    d = THIGH * np.cos(b) + CALF * np.cos(b + c)
    return HIP + np.stack(
        [x, side * np.cos(a) + d * np.sin(a), side * np.sin(a) - d * np.cos(a)], axis=-1
    )


def proprioception(state: Any) -> np.ndarray:
    """Returns what the heightmap network reads of the robot, shape (21,)."""
    body, trusted = Body(state), np.asarray(state.leg_trusted, dtype=float)
    places = (body.feet[:, [0, 2]] * trusted[:, None]).ravel()
    attitude, height = (body.roll, body.pitch), (state.base_height,)
    return np.concatenate([attitude, places, trusted, body.velocity, body.angular_velocity, height])


def features(state: Any, heights: np.ndarray) -> np.ndarray:
    """Returns what the policy reads of now, shape (59,)."""
    body, contact = Body(state), np.asarray(state.leg_contact, dtype=float)
    attitude, height = (body.roll, body.pitch), (state.base_height,)
    motion = (body.velocity, body.angular_velocity)
    return np.concatenate(
        [contact, state.leg_progress, attitude, *motion, height, body.feet.ravel(), heights]
    )


def pooled(
    depth_m: np.ndarray, focal: tuple[float, float], centre: tuple[float, float]
) -> np.ndarray:
    """Returns what the heightmap network sees of an image, shape (2, 48, 16).

    Args:
        depth_m: along the optical axis, rows from the top; infinite where nothing is within range,
            0 where invalid.
        focal: Across and down [px].
        centre: The same, counted from the corner of the first pixel (0.5 more than in ROS).
    """
    valid = depth_m > 0.0
    near = np.where(valid, np.minimum(depth_m / RANGE_M, 1.0), 0.0)
    across = shares(WIDTH, 0.5 * WIDTH, depth_m.shape[1], focal[0], centre[0])
    down = shares(HEIGHT, 0.5 * HEIGHT, depth_m.shape[0], focal[1], centre[1])
    area, total = down @ valid @ across.T, down @ near @ across.T
    seen = area >= 0.5 - 1e-6  # but for rounding
    return np.stack([np.where(seen, total / np.maximum(area, 0.5), 1.0), seen])


def shares(count: int, middle: float, source_count: int, focal: float, centre: float) -> np.ndarray:
    """Share of each pixel that every source pixel covers along one axis,
    shape (count, source_count).
    """
    edges = centre + (np.arange(count + 1) - middle) * focal / FOCAL
    pixel = np.arange(source_count)
    overlap = np.minimum(edges[1:, None], pixel + 1) - np.maximum(edges[:-1, None], pixel)
    return np.maximum(overlap, 0.0) * FOCAL / focal


@dataclass
class Heights:
    """The heightmap network and what it remembers."""

    network: onnxruntime.InferenceSession
    hidden: np.ndarray = field(init=False)
    image: np.ndarray = field(
        default_factory=lambda: np.stack([np.ones((HEIGHT, WIDTH)), np.zeros((HEIGHT, WIDTH))])
    )
    taken_s: float = -math.inf

    def __post_init__(self) -> None:
        (size,) = (given.shape[-1] for given in self.network.get_inputs() if given.name == "hidden")
        self.hidden = np.zeros((1, size), np.float32)

    def step(
        self, now_s: float, state: Any, image: np.ndarray | None = None, taken_s: float = 0.0
    ) -> np.ndarray:
        """Heights and half of their 90 % intervals [m], shape (2, 30).

        Args:
            now_s: Time of `state`; one call every 10 ms.
            state: The robot's reading, see `Body`.
            image: `pooled`, where one has come since the last call.
            taken_s: When it was taken.
        """
        new = image is not None and self._accept(now_s, image, taken_s)
        given = {
            "image": self.image,
            "age": max(now_s - self.taken_s, 0.0),
            "new": float(new),
            "proprioception": proprioception(state),
        }
        inputs = {name: np.asarray(value, np.float32)[None] for name, value in given.items()}
        height, std, self.hidden = self.network.run(None, {**inputs, "hidden": self.hidden})
        return np.stack([height[0], 1.645 * std[0]])

    def _accept(self, now_s: float, image: np.ndarray, taken_s: float) -> bool:
        if (
            taken_s <= self.taken_s
            or now_s - taken_s > OLDEST_S
            or image[1].mean() < 1.0 - MOST_INVALID
        ):
            return False
        if LONGEST_GAP_S < taken_s - self.taken_s < math.inf:  # not before the first
            self.hidden = np.zeros_like(self.hidden)
        self.image, self.taken_s = image, taken_s
        return True


class Policy:
    """The motion policy and what it remembers:
    one object for each time that a robot begins to go.
    """

    def __init__(self, network: onnxruntime.InferenceSession) -> None:
        self.network = network
        metadata = network.get_modelmeta().custom_metadata_map
        self.past_steps, self.low, self.high = (
            json.loads(metadata[name]) for name in ("past_steps", "low", "high")
        )
        self.past: list[np.ndarray] = []

    def step(self, state: Any, heights: np.ndarray) -> np.ndarray:
        """Frequency, velocities ahead and up, pitch rate,
        residuals of front and rear feet, shape (10,); each 10 ms.
        """
        now = features(state, heights)
        known = now[: -len(heights)]
        if not self.past:
            self.past = max(self.past_steps) * [np.concatenate([known, np.zeros(10)])]
        given = np.concatenate([now, *(self.past[steps - 1] for steps in self.past_steps)])
        plan = self.network.run(["plan"], {"features": given[None].astype(np.float32)})[0][0]
        scaled = 2.0 * (plan - self.low) / np.subtract(self.high, self.low) - 1.0
        self.past = [np.concatenate([known, scaled]), *self.past[:-1]]
        return plan


def main() -> None:
    """One second of standing on level ground: heights ahead, and what the policy would do."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("heightmap", help="models/heightmap.onnx")
    parser.add_argument("policy", help="models/policy.onnx")
    options = parser.parse_args()
    heights = Heights(onnxruntime.InferenceSession(options.heightmap))
    policy = Policy(onnxruntime.InferenceSession(options.policy))
    standing = SimpleNamespace(
        quaternion_base_in_world=(1.0, 0.0, 0.0, 0.0), angular_velocity_base=np.zeros(3),
        velocity_base_in_world=np.zeros(3), base_height=0.285,
        joint_position=np.tile([0.0, 0.9, -1.8], 4),
        leg_contact=np.ones(4), leg_progress=np.zeros(4), leg_trusted=np.ones(4),
    )  # fmt: skip
    # Below the horizon, of each row
    down = 0.52 + np.arctan((np.arange(HEIGHT) + 0.5 - 0.5 * HEIGHT) / FOCAL)
    # Along each ray
    reach = np.where(down > 0.0, (0.285 + 0.092) / np.maximum(np.sin(down), 1e-3), np.inf)
    depth_m = np.tile((reach * np.cos(down - 0.52))[:, None], WIDTH)
    image = pooled(depth_m, (FOCAL, FOCAL), (0.5 * WIDTH, 0.5 * HEIGHT))
    for tick in range(100):
        now_s = 0.01 * tick
        height, half_width_90 = heights.step(
            now_s, standing, image if tick % 2 else None, now_s - 0.05
        )
    print("heights", np.round(height[10::5], 3), "+-", np.round(half_width_90[10::5], 3), "m")
    print("plan", np.round(policy.step(standing, height), 2))


if __name__ == "__main__":
    main()
