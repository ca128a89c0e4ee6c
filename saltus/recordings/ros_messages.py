"""Messages in ROS 2's own types, made of ours:
what viewers of recordings read, and other robots.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from saltus.arrays import AnyArray, Floats, Reals
from saltus.constants import NORMAL_90
from saltus.errors import MessageError
from saltus.rotations import quaternion_from_roll_pitch_yaw, quaternion_product, rotation_matrix
from saltus.wire import cdr, codec
from saltus.wire.cdr import make_ros_header
from saltus.wire.messages import Heightmap, HeightmapStatus, RobotState, points_of
from saltus.wire.ros_types import RosHeader, RosMessage, RosQuaternion, RosTime, RosVector
from saltus.wire.schemas import TYPE_NAME

STORE = get_typestore(Stores.ROS2_JAZZY)
GRID_MAP = {
    "grid_map_msgs/msg/GridMapInfo": (
        "float64 resolution\nfloat64 length_x\nfloat64 length_y\ngeometry_msgs/Pose pose\n"
    ),
    "grid_map_msgs/msg/GridMap": (
        "std_msgs/Header header\n"
        "grid_map_msgs/GridMapInfo info\n"
        "string[] layers\n"
        "string[] basic_layers\n"
        "std_msgs/Float32MultiArray[] data\n"
        "uint16 outer_start_index\n"
        "uint16 inner_start_index\n"
    ),
}
"""Definitions of the package grid_map_msgs for ROS 2, which is not among those that every ROS 2
has."""


def add_types(definitions: dict[str, str]) -> None:
    """Takes in definitions, by their names, as `.msg` files have them, of packages of others."""
    for name, text in definitions.items():
        STORE.register(get_types_from_msg(text, name))


add_types(GRID_MAP)

_VECTOR: Callable[..., RosVector] = STORE.types["geometry_msgs/msg/Vector3"]
_POINT: Callable[..., RosVector] = STORE.types["geometry_msgs/msg/Point"]
QUATERNION: Callable[..., RosQuaternion] = STORE.types["geometry_msgs/msg/Quaternion"]
"""`geometry_msgs/msg/Quaternion` of x, y, z, w."""
_TRANSFORM: Callable[..., RosMessage] = STORE.types["geometry_msgs/msg/Transform"]
_STAMPED: Callable[..., RosMessage] = STORE.types["geometry_msgs/msg/TransformStamped"]

BASE, BASE_YAW, WORLD, CAMERA, ODOM = "base", "base_yaw", "world", "camera", "odom"
"""Frames: of the trunk, the same turned by the yaw alone, of the course, of the depth image (z
along its axis), and of the start as the robot itself has added up its way."""
ELEVATION, VARIANCE, HALF_WIDTH, AGE = "elevation", "variance", "half_width", "age"
"""Layers of a GridMap; viewers and planners look for the first by this name."""
LINE_CELLS = 2
"""Cells of a GridMap across a line of heights: viewers draw surfaces between cells."""
CDR_HEADER = 4  # bytes
FLOAT32 = 7  # sensor_msgs/msg/PointField
CUBE, SPHERE, CYLINDER, LINE_LIST, SPHERE_LIST = 1, 2, 3, 5, 7  # visualization_msgs/msg/Marker
ADD, DELETE = 0, 2
USABLE = (HeightmapStatus.OK, HeightmapStatus.DEGRADED)
Rgba = tuple[float, float, float, float]


def stored_definition(type_name: str) -> str:
    """The `ros2msg` schema text of a type with all that it contains."""
    if type_name in TYPE_NAME.values():
        return cdr.ros2msg_definition(type_name)
    return STORE.generate_msgdef(type_name, ros_version=2)[0]


def prepare(type_name: str) -> None:
    """Makes what the first message of a type needs, and would else wait for: 5 to 40 ms of work."""
    STORE.get_msgdef(type_name)


def payload_of(message: RosMessage) -> bytes:
    """A message as CDR."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def hash_of(type_name: str) -> str:
    """The hash of a type and of all that it contains:
    RIHS01_ and 64 hexadecimal digits (REP 2016).
    """
    return str(STORE.hash_rihs01(type_name))


def fields_of(type_name: str) -> list[tuple[str, tuple[str, object]]]:
    """Name and kind of each field: ("base", name), ("type", name), ("array", (kind, n)) or
    ("sequence", (kind, n)).
    """
    return [(name, _kind(description)) for name, description in STORE.fielddefs[type_name][1]]


def _kind(description: tuple[Nodetype, Any]) -> tuple[str, object]:
    node, what = description
    if node == Nodetype.BASE:
        return "base", what[0]
    if node == Nodetype.NAME:
        return "type", what
    return ("array" if node == Nodetype.ARRAY else "sequence"), (_kind(what[0]), what[1])


def decode_ros_message(type_name: str, payload: bytes) -> Any:
    """Reads a message of `STORE` from a stranger's bytes; `MessageError` where they are none."""
    if not CDR_HEADER <= len(payload) <= codec.PAYLOAD_MAX:
        raise MessageError("size", f"{len(payload)} bytes")
    try:
        return STORE.deserialize_cdr(payload, type_name)
    except Exception as error:  # the parser's errors on hostile bytes are of many types
        raise MessageError("malformed", f"{type_name}: {error}") from error


def time_of(stamp: RosTime) -> int:
    """Nanoseconds of a `builtin_interfaces/msg/Time`."""
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def make(type_name: str, **fields: object) -> RosMessage:
    """A message of a type of `STORE`."""
    return STORE.types[type_name](**fields)


def vector(values: ArrayLike) -> RosVector:
    """A `geometry_msgs/msg/Vector3`."""
    return _VECTOR(*np.asarray(values, np.float64).tolist())


def point(values: ArrayLike) -> RosVector:
    """A `geometry_msgs/msg/Point`."""
    return _POINT(*np.asarray(values, np.float64).tolist())


def quaternion(wxyz: ArrayLike) -> RosQuaternion:
    """A `geometry_msgs/msg/Quaternion`, which has w last."""
    w, x, y, z = np.asarray(wxyz, np.float64).tolist()
    return QUATERNION(x, y, z, w)


def place(
    head: RosHeader, child: str, translation: RosVector, rotation: RosQuaternion
) -> RosMessage:
    """A `geometry_msgs/msg/TransformStamped` from the frame of the header to another one."""
    return _STAMPED(head, child, _TRANSFORM(translation, rotation))


def yaw_of(wxyz: Floats) -> tuple[float, float, float, float]:
    """The quaternion that turns by the same yaw and by nothing else."""
    w, x, y, z = (float(v) for v in wxyz)
    half = 0.5 * math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return (math.cos(half), 0.0, 0.0, math.sin(half))


def optical(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Quaternion of the camera frame in the base frame,
    of a camera that is turned so from looking level ahead.
    """
    turned = quaternion_from_roll_pitch_yaw(np.array(roll), np.array(pitch), np.array(yaw))
    w, x, y, z = quaternion_product(
        turned, np.array([0.5, -0.5, 0.5, -0.5])
    ).tolist()  # of level optical axes
    return (w, x, y, z)


def joint_state(time_ns: int, names: Sequence[str], state: RobotState) -> RosMessage:
    """A `sensor_msgs/msg/JointState`."""
    values = (
        np.array(v, np.float64)
        for v in (state.joint_position, state.joint_velocity, state.joint_torque)
    )
    position, velocity, effort = values
    return make(
        "sensor_msgs/msg/JointState", header=make_ros_header(time_ns, ""), name=list(names),
        position=position,
        velocity=velocity, effort=effort,
    )  # fmt: skip


def odometry(time_ns: int, base: str, position: Floats, state: RobotState) -> RosMessage:
    """A `nav_msgs/msg/Odometry` of a frame in `odom`.

    Velocities are in the frame of the base, covariances unknown.
    """
    turned = np.asarray(state.quaternion_base_in_world, dtype=np.float64)
    linear = np.asarray(state.velocity_base_in_world, dtype=np.float64) @ rotation_matrix(turned)
    pose = make("geometry_msgs/msg/Pose", position=point(position), orientation=quaternion(turned))
    twist = make(
        "geometry_msgs/msg/Twist",
        linear=vector(linear),
        angular=vector(state.angular_velocity_base),
    )
    return make(
        "nav_msgs/msg/Odometry", header=make_ros_header(time_ns, ODOM), child_frame_id=base,
        pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )  # fmt: skip


def usable_heights(heightmap: Heightmap) -> Reals:
    """The heights [m], NaN for all where the heightmap itself says that they are not to be used.

    Shape (points,).
    """
    height = np.asarray(heightmap.height)
    return height if heightmap.status in USABLE else np.full_like(height, np.nan)


def points(time_ns: int, frame: str, **columns: ArrayLike) -> RosMessage:
    """A `sensor_msgs/msg/PointCloud2` of one row; `columns` are x,
    y, z and what else each point has, shape (n,).
    """
    table = np.stack([np.asarray(values, np.float32) for values in columns.values()], axis=-1)
    field = STORE.types["sensor_msgs/msg/PointField"]
    fields = [field(name, 4 * i, FLOAT32, 1) for i, name in enumerate(columns)]
    data = table.reshape(-1).view(np.uint8)
    return make(
        "sensor_msgs/msg/PointCloud2", header=make_ros_header(time_ns, frame), height=1,
        width=len(table), fields=fields, is_bigendian=False, point_step=4 * len(fields),
        row_step=data.size, data=data, is_dense=bool(np.isfinite(table).all()),
    )  # fmt: skip


def height_points(heightmap: Heightmap) -> RosMessage:
    """Predicted heights as points in the yaw frame,
    each with half of its 90 % interval, and its age where it is known.

    The age of a point that was never in an image is NaN.
    """
    x, y = points_of(heightmap).T
    ages = {"age": _known_ages(heightmap)} if len(heightmap.age_s) else {}
    return points(
        heightmap.time_ns, BASE_YAW, x=x, y=y, z=usable_heights(heightmap),
        half_width_90=heightmap.half_width_90,
        **ages,
    )  # fmt: skip


def grid_map(heightmap: Heightmap) -> RosMessage:
    """Predicted heights as a `grid_map_msgs/msg/GridMap` in the yaw frame:
    elevation, variance, half_width, age.

    Heights are relative to the base; age [s] is there where it is known, NaN of what was never in
    an image. Cells go backwards and to the right from the one farthest ahead at the left, as the
    package has it. Its cells are squares: values between points that are not as far apart are
    interpolated.
    """
    sides = [np.asarray(side, np.float64) for side in (heightmap.x, heightmap.y)]
    resolution = min(float(side[-1] - side[0]) / (len(side) - 1) for side in sides if len(side) > 1)
    x, y = (_cells(side, resolution) for side in sides)
    sigma = np.asarray(heightmap.half_width_90) / NORMAL_90
    layers = {
        ELEVATION: usable_heights(heightmap),
        VARIANCE: sigma * sigma,
        HALF_WIDTH: heightmap.half_width_90,
    }
    if len(heightmap.age_s):
        layers[AGE] = _known_ages(heightmap)
    shape, middle = (
        (len(sides[0]), len(sides[1])),
        [0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1]), 0.0],
    )
    tables = [np.asarray(values, np.float64).reshape(shape) for values in layers.values()]
    return make(
        "grid_map_msgs/msg/GridMap",
        header=make_ros_header(heightmap.time_ns, BASE_YAW),
        info=make(
            "grid_map_msgs/msg/GridMapInfo", resolution=resolution, length_x=resolution * len(x),
            length_y=resolution * len(y),
            pose=make("geometry_msgs/msg/Pose", position=point(middle),
                orientation=quaternion([1, 0, 0, 0])),
        ),
        layers=list(layers),
        basic_layers=[ELEVATION],
        data=[_column_major(_between(table, sides, (x, y))) for table in tables],
        outer_start_index=0,
        inner_start_index=0,
    )  # fmt: skip


def _known_ages(heightmap: Heightmap) -> Reals:
    ages = np.asarray(heightmap.age_s)
    return np.where(np.isfinite(ages), ages, np.nan)


def _cells(side: Floats, resolution: float) -> Floats:
    """Middles of cells along one side of a grid, descending; `LINE_CELLS` of them across a line."""
    if len(side) == 1:
        return np.asarray(side + resolution * (0.5 * (LINE_CELLS - 1) - np.arange(LINE_CELLS)))
    return np.linspace(side[-1], side[0], round((side[-1] - side[0]) / resolution) + 1)


def _between(table: Floats, sides: Sequence[Floats], cells: Sequence[Floats]) -> Floats:
    """Values (rows, columns) of a grid at the middles of cells,
    interpolated along x, then along y.
    """
    along = np.stack([np.interp(cells[0], sides[0], column) for column in table.T], -1)
    if len(sides[1]) == 1:
        return np.repeat(along, len(cells[1]), axis=-1)
    return np.stack([np.interp(cells[1], sides[1], row) for row in along])


def _column_major(table: Floats) -> RosMessage:
    dimension = STORE.types["std_msgs/msg/MultiArrayDimension"]
    rows, columns = table.shape
    sizes = [dimension("column_index", columns, rows * columns), dimension("row_index", rows, rows)]
    layout = make("std_msgs/msg/MultiArrayLayout", dim=sizes, data_offset=0)
    return make(
        "std_msgs/msg/Float32MultiArray", layout=layout, data=table.T.astype(np.float32).ravel()
    )


def marker(
    time_ns: int, frame: str, name: str, number: int, kind: int, *,
    rgba: Rgba, scale: ArrayLike, position: ArrayLike = (0.0, 0.0, 0.0),
    wxyz: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    places: Sequence[AnyArray] | AnyArray = (), locked: bool = False,
) -> RosMessage:  # fmt: skip
    """A `visualization_msgs/msg/Marker`.

    One of a list of places takes away the earlier one where there are none.
    """
    nothing = kind in (LINE_LIST, SPHERE_LIST) and not len(places)
    image = make(
        "sensor_msgs/msg/CompressedImage",
        header=make_ros_header(0, ""),
        format="",
        data=np.zeros(0, np.uint8),
    )
    return make(
        "visualization_msgs/msg/Marker",
        header=make_ros_header(time_ns, frame), ns=name, id=number, type=kind,
        action=DELETE if nothing else ADD,
        pose=make("geometry_msgs/msg/Pose", position=point(position), orientation=quaternion(wxyz)),
        scale=vector(scale),
        color=make("std_msgs/msg/ColorRGBA", **dict(zip("rgba", rgba, strict=True))),
        lifetime=make("builtin_interfaces/msg/Duration", sec=0, nanosec=0), frame_locked=locked,
        points=[point(place) for place in places], colors=[], texture_resource="",
        uv_coordinates=[], text="",
        mesh_resource="", texture=image,
        mesh_file=make("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )  # fmt: skip


def marker_array(markers: Sequence[RosMessage]) -> RosMessage:
    """A `visualization_msgs/msg/MarkerArray`."""
    return make("visualization_msgs/msg/MarkerArray", markers=markers)
