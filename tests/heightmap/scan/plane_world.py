"""A world of one plane, cameras that see it, and a network that says what the map says."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper

from saltus.depth import Intrinsics, depth_frame
from saltus.heightmap.scan.network_inputs import MEASURED, MEMORY, NUMBERS
from saltus.heightmap.scan.predictor import FORMAT
from saltus.heightmap.scan.settings import MapSettings
from saltus.robots.mount import Mount
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix
from saltus.states import standing_state
from saltus.wire.messages import DepthFrame, RobotState

HALF_WIDTH_M = 0.02
LENS = Intrinsics(width=64, height=48, fx=40.0, fy=40.0, cx=32.0, cy=24.0)
STEP_NS = 10_000_000
LATENCY_NS = 50_000_000
BEGIN_NS = 10**12


def map_network(path: Path, half_width_m: float = HALF_WIDTH_M) -> Path:
    """An ONNX file whose heights are the map's, filled."""
    side = MapSettings().side
    cells = ["batch", side, side]
    inputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        for name, shape in (
            ("filled", cells), ("measured", ["batch", len(MEASURED), side, side]),
            ("memory", ["batch", len(MEMORY), side, side]), ("numbers", ["batch", len(NUMBERS)]),
        )
    ]  # fmt: skip
    outputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, cells)
        for name in ("height", "half_width")
    ]
    constants = [
        helper.make_tensor("none", TensorProto.FLOAT, [], [0.0]),
        helper.make_tensor("some", TensorProto.FLOAT, [], [half_width_m]),
    ]
    nodes = [
        helper.make_node("Mul", ["filled", "none"], ["height"]),
        helper.make_node("Add", ["height", "some"], ["half_width"]),
    ]
    model = helper.make_model(
        helper.make_graph(nodes, "map", inputs, outputs, constants),
        opset_imports=[helper.make_opsetid("", 17)],
    )
    model.ir_version = 8
    fields: dict[str, Any] = {
        "format": FORMAT, "measured": MEASURED, "memory": MEMORY, "numbers": NUMBERS,
        "map": MapSettings().to_toml(),
    }  # fmt: skip
    helper.set_model_props(model, {name: json.dumps(value) for name, value in fields.items()})
    onnx.save(model, path)
    return path


@dataclass(frozen=True, kw_only=True)
class PlaneWorld:
    """Ground z = slope_x * x + slope_y * y, and a robot
    that goes over it at a constant velocity.
    """

    slope: tuple[float, float] = (0.0, 0.0)
    height: float = 0.3
    """Height of the base above the ground at the start [m]."""
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    attitude: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw [rad]."""

    def position(self, time_ns: int) -> np.ndarray:
        """Position of the base [m]."""
        return np.array([0.0, 0.0, self.height]) + 1e-9 * (time_ns - BEGIN_NS) * np.array(
            self.velocity
        )

    @property
    def quaternion(self) -> np.ndarray:
        return np.asarray(quaternion_from_roll_pitch_yaw(*map(np.asarray, self.attitude)))

    def state(self, step: int, robot: Any, **changes: Any) -> RobotState:
        """State of a robot that knows nothing of its feet."""
        known = replace(
            standing_state(robot), step=step, time_ns=BEGIN_NS + step * STEP_NS,
            leg_trusted=np.zeros(4, np.bool_),
            quaternion_base_in_world=self.quaternion,
            velocity_base_in_world=np.array(self.velocity),
            base_height=self.height,
        )  # fmt: skip
        return replace(known, **changes)

    def frame(
        self, mount: Mount, time_ns: int, frame_id: int, lens: Intrinsics = LENS
    ) -> DepthFrame:
        """The image of a camera that was taken at a time."""
        base = rotation_matrix(self.quaternion)
        centre, turn = (
            self.position(time_ns) + base @ np.asarray(mount.position),
            base @ mount.rotation,
        )
        v, u = np.mgrid[: lens.height, : lens.width] + 0.5
        rays = (
            np.stack([(u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy, np.ones_like(u)], -1)
            @ turn.T
        )
        normal = np.array([-self.slope[0], -self.slope[1], 1.0])
        fall = rays @ normal
        with np.errstate(divide="ignore"):
            depth = np.where(fall < 0.0, -(centre @ normal) / fall, np.inf)
        pixels = np.where(depth < 6.0, np.rint(1e3 * np.minimum(depth, 60.0)), 0).astype(np.uint16)
        return depth_frame(lens, pixels, time_ns=time_ns, frame_id=frame_id)

    def truth(self, points_xy: np.ndarray, time_ns: int) -> np.ndarray:
        """Heights of points of the yaw frame relative to the base [m], shape (n,)."""
        cos, sin = np.cos(self.attitude[2]), np.sin(self.attitude[2])
        base = self.position(time_ns)
        x = base[0] + cos * points_xy[:, 0] - sin * points_xy[:, 1]
        y = base[1] + sin * points_xy[:, 0] + cos * points_xy[:, 1]
        return np.asarray(self.slope[0] * x + self.slope[1] * y - base[2])
