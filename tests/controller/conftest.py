"""Random robots: whatever the controller may meet, in batches."""

from collections.abc import Callable

import numpy as np
import pytest

from saltus import go1
from saltus.controller.signals import Plan, Sensed, plan_from_values
from saltus.kinematics import quaternion_from_roll_pitch_yaw

Draw = Callable[[np.random.Generator, tuple[int, ...]], tuple[Plan, Sensed]]


def draw_robots(rng: np.random.Generator, batch: tuple[int, ...]) -> tuple[Plan, Sensed]:
    def uniform(low: float, high: float, *shape: int) -> np.ndarray:
        return np.asarray(rng.uniform(low, high, (*batch, *shape)))

    sensed = Sensed(
        quaternion_base_in_world=quaternion_from_roll_pitch_yaw(
            uniform(-0.5, 0.5), uniform(-0.8, 0.8), uniform(-3.1, 3.1)
        ),
        angular_velocity_base=uniform(-4.0, 4.0, 3),
        joint_position=go1.STAND_POSE + uniform(-0.4, 0.4, 12),
        joint_velocity=uniform(-10.0, 10.0, 12),
        velocity_base_in_world=uniform(-2.0, 2.0, 3),
        base_height=uniform(0.15, 0.45),
    )
    plan = plan_from_values(
        stepping_frequency=uniform(0.5, 4.0),
        velocity_x=uniform(-3.0, 3.0),
        velocity_z=uniform(-3.0, 3.0),
        pitch_rate=uniform(-6.0, 6.0),
        foot_residual_front=uniform(-0.2, 0.2, 3),
        foot_residual_rear=uniform(-0.2, 0.2, 3),
        heading=uniform(-3.1, 3.1),
    )
    return plan, sensed


@pytest.fixture
def draw() -> Draw:
    return draw_robots
