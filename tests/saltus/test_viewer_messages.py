"""Derived messages: plain readers decode them,
and they say what the messages say that they are made of.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plain_reader import PlainReader, messages_of
from recorded import MS, STEPS, TERRAIN, raw, run_messages, run_samples, write
from samples import KINEMATICS, ROBOT, message_of

from saltus.constants import FORCE_M_PER_N
from saltus.controller.gait import STANCE_RATIO
from saltus.controller.swing import SwingLegs
from saltus.controller.yaw_frame import observe_body, reference_of
from saltus.footholds import Footholds
from saltus.grid import SCAN, HeightGrid
from saltus.plan import plan_of
from saltus.recordings import ros_messages as ros
from saltus.recordings import viewer
from saltus.recordings.viewer import RobotFrames, Viewer
from saltus.robots.legs import LegKinematics
from saltus.robots.loading import load_robot
from saltus.robots.shipped import shipped_robots
from saltus.rotations import rotation_matrix
from saltus.sim.visual_shapes import looks_of
from saltus.wire.messages import Done, Event, HeightmapStatus, PlanStatus
from saltus.wire.schemas import TYPE_NAME
from saltus.wire.topics import TOPICS

SIGMA = 1.645  # half of the 90 % interval of a normal distribution, in standard deviations
EVENT = Event(time_ns=5 * MS, process="heightmap", code="depth_lost", detail="nothing for 110 ms")
DONE = Done(time_ns=5 * MS, step=0, process="render")
UNHEARD = ("operator/command", "policy/joints")  # topics on which a run of jumps says nothing


def one_of(derived: Any, topic: str) -> Any:
    """The last message of a topic, decoded by its own definition."""
    message = [each for each in derived if each.topic == topic][-1]
    return PlainReader().decode(
        message.type_name, ros.stored_definition(message.type_name), message.payload
    )


def derive(steps: int, *without: str) -> list[viewer.ViewerMessage]:
    made = Viewer(ROBOT, TERRAIN)
    derived = list(made.first())
    for step in range(steps):
        for key, message in run_messages(step):
            if key not in without:
                derived += made.derive(key, message, message.time_ns + 3 * MS)
    return derived


def test_plain_readers_decode_every_channel_of_a_recording(tmp_path: Path) -> None:
    scans = [dict(run_messages(step))["heightmap/heightmap"] for step in range(viewer.EVERY)]
    recording = write(
        tmp_path / "run.mcap",
        [
            *run_samples(), raw("event/heightmap", EVENT, 1), raw("done/render", DONE, 1),
            *(raw(topic, message_of(TOPICS[topic].message), 1) for topic in UNHEARD),
            *(raw("scan/heightmap", scan, number) for number, scan in enumerate(scans, start=1)),
        ],
    )  # fmt: skip
    read: dict[str, list[Any]] = {}
    types = {}
    for topic, type_name, message, _ in messages_of(recording.path):
        read.setdefault(topic, []).append(message)
        types[topic] = type_name
    assert {topic: types.get(topic) for topic in viewer.TOPICS} == {
        t: n for t, (n, _) in viewer.TOPICS.items()
    }
    for name, row in TOPICS.items():
        found = [types[topic] for topic in types if topic[1:].startswith(name)]
        assert found == [TYPE_NAME[row.message]]
    assert {name for name in types if not name.startswith("/viewer/")} == {
        "/event/heightmap",
        "/status/controller",
        "/done/render",
        *(f"/{n}" for n, r in TOPICS.items() if r.publisher != "*"),
    }
    assert [len(read[topic]) for topic in ("/viewer/robot", "/viewer/terrain")] == [1, 1]
    (line,) = read["/viewer/log"]
    assert (line.name, line.msg, line.function) == (
        "heightmap",
        "depth_lost nothing for 110 ms",
        "depth_lost",
    )


@pytest.mark.parametrize("status", HeightmapStatus)
def test_a_grid_map_has_the_heights_where_the_package_looks_for_them(
    status: HeightmapStatus,
) -> None:
    """Place of cell (i, j) as in grid_map_core: from the far left corner back and to the right."""
    heightmap: Any = replace(dict(run_messages(3))["heightmap/heightmap"], status=status)
    grid = PlainReader().decode(
        "grid_map_msgs/msg/GridMap",
        ros.stored_definition("grid_map_msgs/msg/GridMap"),
        ros.payload_of(ros.grid_map(heightmap)),
    )
    info = grid.info
    rows, columns = round(info.length_x / info.resolution), round(info.length_y / info.resolution)
    assert (grid.header.frame_id, grid.layers, grid.basic_layers) == (
        "base_yaw",
        ["elevation", "variance", "half_width"],
        ["elevation"],
    )
    layers = {}
    for name, array in zip(grid.layers, grid.data, strict=True):
        sizes = {each.label: (each.size, each.stride) for each in array.layout.dim}
        assert sizes == {"column_index": (columns, rows * columns), "row_index": (rows, rows)}
        # column-major
        assert [each.label for each in array.layout.dim] == [
            "column_index",
            "row_index",
        ]
        layers[name] = array.data.reshape(columns, rows).T
    x = info.pose.position.x + 0.5 * info.length_x - info.resolution * (np.arange(rows) + 0.5)
    y = info.pose.position.y + 0.5 * info.length_y - info.resolution * (np.arange(columns) + 0.5)
    np.testing.assert_allclose(x[::-1], heightmap.x, atol=1e-9)
    assert y.mean() == pytest.approx(0.0)
    usable = status in (HeightmapStatus.OK, HeightmapStatus.DEGRADED)
    for column in range(columns):
        wanted = heightmap.height if usable else np.full(rows, np.nan)
        np.testing.assert_allclose(layers["elevation"][::-1, column], wanted, rtol=1e-6)
        np.testing.assert_allclose(
            layers["variance"][::-1, column], (heightmap.half_width_90 / SIGMA) ** 2, rtol=1e-6
        )


GRIDS = [
    SCAN,
    HeightGrid(x=(-0.4, 0.0, 0.4), y=(-0.2, 0.0, 0.2)),
    HeightGrid(x=(0.3,), y=(-0.1, 0.0, 0.1)),
]


@pytest.mark.parametrize("grid", GRIDS)
def test_a_grid_map_of_any_grid_has_its_plane_at_every_cell(grid: HeightGrid) -> None:
    """A plane is the same however it is interpolated."""
    x, y = grid.points.T
    heightmap: Any = replace(
        dict(run_messages(3))["heightmap/heightmap"], x=np.array(grid.x), y=np.array(grid.y),
        height=0.3 * x - 0.2 * y, half_width_90=0.02 + 0.0 * x,
        age_s=np.where(x > 0.2, np.inf, 0.5 + y),
    )  # fmt: skip
    message = ros.grid_map(heightmap)
    info, columns, rows = message.info, *(each.size for each in message.data[0].layout.dim)
    layers = {
        n: a.data.reshape(columns, rows).T
        for n, a in zip(message.layers, message.data, strict=True)
    }
    assert (rows, columns) == (
        round(info.length_x / info.resolution),
        round(info.length_y / info.resolution),
    )
    x = info.pose.position.x + 0.5 * info.length_x - info.resolution * (np.arange(rows) + 0.5)
    y = info.pose.position.y + 0.5 * info.length_y - info.resolution * (np.arange(columns) + 0.5)
    held = np.clip(x, grid.x[0], grid.x[-1])  # a line is as wide as two cells
    np.testing.assert_allclose(layers["elevation"], 0.3 * held[:, None] - 0.2 * y[None], atol=1e-6)
    np.testing.assert_allclose(layers["half_width"], 0.02, atol=1e-7)
    assert np.isnan(layers["age"][x > 0.2 + info.resolution]).all()
    assert np.isfinite(layers["age"][x < 0.2 - info.resolution]).all()
    cloud = ros.height_points(heightmap)
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "half_width_90", "age"]


def test_clouds_have_predicted_and_true_heights_at_the_same_points() -> None:
    derived, step = derive(STEPS), STEPS - STEPS % viewer.EVERY - 1
    sent: Any = dict(run_messages(step))
    heightmap, truth = sent["heightmap/heightmap"], sent["plant/truth"]
    for topic, columns in (
        (
            "/viewer/heightmap",
            (heightmap.x, 0.0 * heightmap.x, heightmap.height, heightmap.half_width_90),
        ),
        ("/viewer/true_heights", (heightmap.x, 0.0 * heightmap.x, truth.height)),
    ):
        cloud = one_of(derived, topic)
        table = cloud.data.view(np.float32).reshape(cloud.width, -1)
        assert [field.name for field in cloud.fields] == ["x", "y", "z", "half_width_90"][
            : len(columns)
        ]
        np.testing.assert_allclose(table, np.stack(columns, axis=-1), rtol=1e-6)
        assert cloud.header.frame_id == "base_yaw"
        assert 10**9 * cloud.header.stamp.sec + cloud.header.stamp.nanosec == heightmap.time_ns


def test_a_scan_beside_is_a_cloud_of_its_own_and_changes_nothing_else() -> None:
    step = viewer.EVERY - 1
    scan: Any = replace(
        dict(run_messages(step))["heightmap/heightmap"],
        x=np.array(SCAN.x), y=np.array(SCAN.y), height=0.1 * SCAN.points[:, 0],
        half_width_90=np.full(SCAN.size, 0.02), age_s=np.full(SCAN.size, 0.1),
    )  # fmt: skip
    alone, both, beside = Viewer(ROBOT, TERRAIN), Viewer(ROBOT, TERRAIN), list[Any]()
    for now in range(STEPS):
        for key, message in run_messages(now):
            one, other = (
                [(each.topic, each.payload) for each in made.derive(key, message, message.time_ns)]
                for made in (alone, both)
            )
            assert one == other
        beside += both.derive("scan/heightmap", replace(scan, time_ns=now), now)
    assert {message.topic for message in beside} == {"/viewer/scan"}


@pytest.mark.parametrize("name", shipped_robots())
def test_frames_of_legs_are_where_the_model_has_them_and_feet_are_at_their_ends(name: str) -> None:
    robot, rng = load_robot(name), np.random.default_rng(1)
    looks, legs = looks_of(robot), LegKinematics(robot)
    for _ in range(20):
        joints = rng.uniform(-1.5, 1.5, 12)
        turned = looks.turns(joints)[1:]
        links = RobotFrames(robot).links(0, joints)
        assert [link.child_frame_id for link in links] == list(looks.parents)[1:]
        for link, quaternion in zip(links, turned, strict=True):
            r = link.transform.rotation
            assert abs(np.dot([r.w, r.x, r.y, r.z], quaternion)) == pytest.approx(1.0, abs=1e-9)
        chain: dict[str, tuple[Any, Any]] = {"base": (np.zeros(3), np.eye(3))}
        for link in links:
            t, r = link.transform.translation, link.transform.rotation
            place, rotation = chain[link.header.frame_id]
            chain[link.child_frame_id] = (
                place + rotation @ np.array([t.x, t.y, t.z]),
                rotation @ rotation_matrix(np.array([r.w, r.x, r.y, r.z]))
            )  # fmt: skip
        ends = {
            part.body: part
            for part in looks.primitives
            if part.body.endswith("calf") and part.kind == "ball"
        }
        feet = [
            chain[f"{leg}_calf"][0] + chain[f"{leg}_calf"][1] @ ends[f"{leg}_calf"].position
            for leg in ("FR", "FL", "RR", "RL")
        ]
        # The model's feet may be 1 mm aside
        np.testing.assert_allclose(feet, legs.position(joints), atol=2e-3)


@pytest.mark.parametrize("name", shipped_robots())
def test_primitives_fill_what_triangles_enclose(name: str) -> None:
    looks = looks_of(load_robot(name))
    for body, shapes in looks.shapes.items():
        corners = np.concatenate([shape.vertices for shape in shapes])
        lows, highs = [], []
        for part in looks.primitives:
            if part.body == body:
                rotation, half = rotation_matrix(part.quaternion), 0.5 * part.size
                if part.kind == "box":
                    reach = np.abs(rotation) @ half
                elif part.kind == "ball":
                    reach = np.linalg.norm(rotation * half, axis=1)
                else:
                    reach = (
                        np.linalg.norm(rotation[:, :2] * half[:2], axis=1)
                        + np.abs(rotation[:, 2]) * half[2]
                    )
                lows.append(part.position - reach)
                highs.append(part.position + reach)
        # triangles have 16 sides: they lie within what is round, by 2 % of its radius
        np.testing.assert_allclose(np.min(lows, axis=0), corners.min(axis=0), atol=2e-3)
        np.testing.assert_allclose(np.max(highs, axis=0), corners.max(axis=0), atol=2e-3)


def test_planned_feet_are_where_the_leg_controller_swings_them() -> None:
    """For any state and plan: the end of its own path with the plan's residual,
    on the predicted heights.
    """
    swing, footholds = SwingLegs(ROBOT), Footholds(ROBOT)
    for step in range(STEPS):
        sent: Any = dict(run_messages(step))
        rng = np.random.default_rng(step)
        contact = rng.random(4) < 0.5
        state = replace(sent["controller/state"], leg_contact=contact)
        plan = replace(
            sent["policy/plan"], stepping_frequency_hz=rng.uniform(1.0, 4.0),
            foot_residual_front=rng.normal(size=3), foot_residual_rear=rng.normal(size=3),
        )  # fmt: skip
        body = observe_body(state, KINEMATICS)
        stance_s = np.asarray(STANCE_RATIO / plan.stepping_frequency_hz)
        path = swing.nominal_path(
            body, body.foot_yaw, np.ones(4), stance_s, np.asarray(state.base_height)
        )
        wanted = path + reference_of(plan_of(plan), body.yaw).foot_residual
        planned = footholds.planned(state, plan, None)
        np.testing.assert_allclose(planned[~contact], wanted[~contact], atol=1e-12)
        assert np.isnan(planned[contact]).all()
        heightmap = sent["heightmap/heightmap"]
        on_ground = footholds.planned(state, plan, heightmap)[~contact]
        np.testing.assert_allclose(on_ground[:, :2], wanted[~contact, :2], atol=1e-12)
        np.testing.assert_allclose(
            on_ground[:, 2], np.interp(on_ground[:, 0], heightmap.x, heightmap.height)
        )


def test_markers_show_forces_stance_and_planned_feet() -> None:
    made, sent = Viewer(ROBOT, TERRAIN), dict(run_messages(4))
    truth: Any = replace(sent["plant/truth"], foot_force=np.array([60.0, 0.0, 30.0, 0.0]))  # type: ignore[arg-type]
    state: Any = replace(sent["controller/state"], leg_contact=np.array([True, False, True, False]))  # type: ignore[arg-type]
    derived = []
    for _ in range(viewer.EVERY):
        for key, message in (
            ("plant/truth", truth),
            ("policy/plan", sent["policy/plan"]),
            ("controller/state", state),
        ):
            derived += list(made.derive(key, message, message.time_ns))
    feet = observe_body(state, KINEMATICS).foot_yaw
    stance, force = one_of(derived, "/viewer/contacts").markers
    target, way = one_of(derived, "/viewer/plan").markers

    def places(marker: Any) -> np.ndarray:
        return np.array([[p.x, p.y, p.z] for p in marker.points])

    np.testing.assert_allclose(places(stance), feet[[0, 2]], atol=1e-12)
    np.testing.assert_allclose(places(force)[0::2], feet[[0, 2]], atol=1e-12)
    lengths = places(force)[1::2] - places(force)[0::2]
    np.testing.assert_allclose(
        lengths, [[0, 0, 60 * FORCE_M_PER_N], [0, 0, 30 * FORCE_M_PER_N]], atol=1e-12
    )
    planned = Footholds(ROBOT).planned(state, sent["policy/plan"], None)[[1, 3]]  # type: ignore[arg-type]
    np.testing.assert_allclose(places(target), planned, atol=1e-12)
    np.testing.assert_allclose(places(way)[1::2], planned, atol=1e-12)
    np.testing.assert_allclose(places(way)[0::2], feet[[1, 3]], atol=1e-12)


def test_numbers_are_those_of_the_newest_messages() -> None:
    derived, step = derive(STEPS), STEPS - STEPS % viewer.EVERY - 1
    # the numbers come with a state, before the heightmap of the same step
    sent: Any = dict(run_messages(step))
    before: Any = dict(run_messages(step - 1))
    numbers = one_of(derived, "/viewer/numbers")
    truth, errors = (
        sent["plant/truth"],
        np.abs(before["heightmap/heightmap"].height - before["plant/truth"].height),
    )
    assert numbers.speed == pytest.approx(np.hypot(*truth.velocity_base_in_world[:2]))
    assert numbers.x == truth.position_base_in_world[0]
    assert (numbers.height_error_mm, numbers.height_error_max_mm) == pytest.approx(
        (1e3 * errors.mean(), 1e3 * errors.max())
    )
    assert numbers.half_width_90_mm == pytest.approx(
        1e3 * before["heightmap/heightmap"].half_width_90.mean()
    )
    assert (numbers.mode, numbers.plan_status, numbers.heightmap_status) == (
        1,
        PlanStatus.GO,
        HeightmapStatus.OK,
    )
    assert (numbers.plan_age_ms, numbers.heightmap_age_ms) == pytest.approx((13.0, 13.0))
    assert [
        numbers.foot_force_fr,
        numbers.foot_force_fl,
        numbers.foot_force_rr,
        numbers.foot_force_rl,
    ] == [*truth.foot_force]
    assert numbers.base_height == pytest.approx(0.27)


def test_a_robot_without_truth_stands_at_the_origin_and_nothing_true_is_said() -> None:
    derived = derive(STEPS, "plant/truth", "policy/plan", "heightmap/heightmap", "camera/depth")
    assert not any(message.topic == "/viewer/true_heights" for message in derived)
    base = one_of(derived, "/viewer/tf").transforms[0]
    state: Any = dict(run_messages(STEPS - 1))["controller/state"]
    t, r = base.transform.translation, base.transform.rotation
    assert (base.header.frame_id, base.child_frame_id) == ("world", "base")
    np.testing.assert_allclose([t.x, t.y, t.z], [0.0, 0.0, state.base_height])
    np.testing.assert_allclose([r.w, r.x, r.y, r.z], state.quaternion_base_in_world)
    numbers = one_of(derived, "/viewer/numbers")
    assert np.isnan(
        [numbers.x, numbers.height_error_mm, numbers.plan_age_ms, numbers.foot_force_fr]
    ).all()
    assert (numbers.plan_status, numbers.heightmap_status) == (viewer.NEVER, viewer.NEVER)
