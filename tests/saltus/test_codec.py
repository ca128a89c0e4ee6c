"""Laws of the codec, over every kind of message."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore
from samples import message_of

from saltus.errors import MessageError
from saltus.grid import LINE
from saltus.wire import cdr, codec, messages, schemas
from saltus.wire.codec import Envelope, decode_message, encode_message
from saltus.wire.messages import GroundTruth, Heightmap, Message, RobotState


def assert_equal(a: Any, b: Any) -> None:
    assert type(a) is type(b)
    for field in dataclasses.fields(a):
        left, right = getattr(a, field.name), getattr(b, field.name)
        if isinstance(left, np.ndarray):
            assert left.dtype == right.dtype
            np.testing.assert_array_equal(left, right)
        else:
            assert left == right, field.name
            assert type(left) is type(right), field.name


KINDS = list(schemas.TYPE_NAME)
kinds = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
BAD_VALUES = [
    (kind, field, bad)
    for kind, fields in schemas.FIELDS.items()
    for field in fields
    if field.wire == "float64"
    for bad in (np.nan, -np.inf, np.inf, 1e300)
    if not field.low <= bad <= field.high  # the age of an image that never came is infinite
]


def test_every_message_has_a_type() -> None:
    assert set(KINDS) == set(messages.Message.__args__)


@pytest.mark.parametrize("type_name", schemas.STANDARD)
def test_standard_types_are_those_of_ros(type_name: str) -> None:
    assert (
        cdr.ros2msg_definition(type_name)
        == get_typestore(Stores.ROS2_JAZZY).generate_msgdef(type_name, ros_version=2)[0]
    )


@kinds
@pytest.mark.parametrize("seed", range(5))
def test_round_trip(kind: type[Message], seed: int) -> None:
    message = message_of(kind, seed)
    assert_equal(decode_message(kind, encode_message(message)), message)
    assert encode_message(decode_message(kind, encode_message(message))) == encode_message(message)


@kinds
def test_fields_on_the_wire_are_the_fields_of_the_message(kind: type[Message]) -> None:
    if kind in schemas.FIELDS:
        assert {f.name for f in schemas.FIELDS[kind]} | {"time_ns"} == {
            f.name for f in dataclasses.fields(kind)
        }


@kinds
def test_truncated_or_longer_bytes_are_refused(kind: type[Message]) -> None:
    data = encode_message(message_of(kind))
    for cut in range(len(data)):
        with pytest.raises(MessageError):
            decode_message(kind, data[:cut])
    with pytest.raises(MessageError, match="malformed"):
        decode_message(kind, data + b"\0")


@kinds
@given(data=st.binary(max_size=2000))
@settings(max_examples=100, deadline=None)
def test_random_bytes_raise_nothing_but_message_errors(kind: type[Message], data: bytes) -> None:
    for candidate in (data, cdr.CDR_LITTLE_ENDIAN + data):
        with pytest.raises(MessageError):
            decode_message(kind, candidate)


@pytest.mark.sample(4)
@kinds
@given(
    flips=st.lists(st.tuples(st.integers(0, 10**6), st.integers(1, 255)), min_size=1, max_size=8)
)
@settings(max_examples=100, deadline=None)
def test_flipped_bytes_give_a_message_or_a_message_error(
    kind: type[Message], flips: list[tuple[int, int]]
) -> None:
    data = bytearray(encode_message(message_of(kind)))
    for position, mask in flips:
        data[position % len(data)] ^= mask
    try:
        message = decode_message(kind, bytes(data))
    except MessageError:
        return
    encode_message(message)


@kinds
def test_bytes_of_another_kind_are_refused(kind: type[Message]) -> None:
    for other in KINDS:
        if other is not kind:
            with pytest.raises(MessageError):
                decode_message(kind, encode_message(message_of(other)))


@pytest.mark.parametrize(
    ("kind", "field", "bad"), BAD_VALUES, ids=lambda x: getattr(x, "__name__", None)
)
def test_values_that_are_not_finite_or_not_plausible_are_refused(
    kind: type[Message], field: schemas.MessageField, bad: float
) -> None:
    message = message_of(kind)
    if field.shape is None:
        value: Any = bad
    else:
        value = getattr(message, field.name).copy()
        value.flat[-1] = bad
    with pytest.raises(MessageError) as caught:
        decode_message(kind, encode_message(dataclasses.replace(message, **{field.name: value})))
    assert caught.value.reason == ("range" if np.isfinite(bad) else "not_finite")
    assert field.name in str(caught.value)


def fields_with(what: str) -> list[tuple[type[Message], schemas.MessageField]]:
    """Fields of all messages for which the table says one thing more."""
    return [
        (kind, field)
        for kind, fields in schemas.FIELDS.items()
        for field in fields
        if getattr(field, what) is not None
    ]


@pytest.mark.parametrize(("kind", "field"), fields_with("enum"))
def test_unknown_enum_values_are_refused(kind: type[Message], field: schemas.MessageField) -> None:
    with pytest.raises(MessageError, match="enum"):
        decode_message(
            kind, encode_message(dataclasses.replace(message_of(kind), **{field.name: 99}))
        )


@pytest.mark.parametrize(("kind", "field"), fields_with("shape"))
def test_wrong_shapes_are_not_sent(kind: type[Message], field: schemas.MessageField) -> None:
    message = message_of(kind)
    array = getattr(message, field.name)
    for wrong in (array[..., :-1], array[None], np.array(["a"])):
        with pytest.raises(MessageError):
            encode_message(dataclasses.replace(message, **{field.name: wrong}))


def test_rows_of_unequal_number_are_refused() -> None:
    message = message_of(messages.JointLog)
    for rows in (0, 4, schemas.JOINT_ROWS_MAX + 1):
        with pytest.raises(MessageError, match="shape"):
            decode_message(
                messages.JointLog,
                encode_message(dataclasses.replace(message, kp=np.zeros((rows, 12)))),
            )


@pytest.mark.parametrize(
    "change",
    [
        {"depth": np.zeros((721, 4), np.uint16)},
        {"depth": np.zeros((4, 1281), np.uint16)},
        {"depth": np.zeros((0, 4), np.uint16)},
        {"depth_unit_m": 0.0},
        {"depth_unit_m": np.nan},
        {"fx": 0.0},
        {"fx": 1e5},
        {"fy": 3500.0},
        {"fy": -200.0},
        {"cx": np.inf},
        {"frame_id": -1},
        {"time_ns": -(10**12)},
    ],
)
def test_depth_frames_that_cannot_be_are_refused(change: dict[str, Any]) -> None:
    frame = dataclasses.replace(message_of(messages.DepthFrame), **change)
    with pytest.raises(MessageError):
        decode_message(messages.DepthFrame, encode_message(frame))


def test_the_largest_image_travels() -> None:
    frame = dataclasses.replace(
        message_of(messages.DepthFrame), depth=np.ones((720, 1280), np.uint16)
    )
    assert_equal(decode_message(messages.DepthFrame, encode_message(frame)), frame)


def test_huge_payloads_are_refused_before_they_are_read() -> None:
    with pytest.raises(MessageError, match="size"):
        decode_message(messages.DepthFrame, bytes(codec.PAYLOAD_MAX + 1))


@given(
    st.integers(1, 2**63 - 1), st.integers(-(2**63), 2**63 - 1), st.binary(min_size=16, max_size=16)
)
def test_envelope_round_trip(sequence: int, capture_ns: int, boot_id: bytes) -> None:
    envelope = Envelope(sequence, capture_ns, boot_id)
    assert Envelope.from_bytes(envelope.to_bytes()) == envelope


@given(st.binary(max_size=40).filter(lambda data: len(data) != 33))
def test_other_attachments_are_refused(data: bytes) -> None:
    with pytest.raises(MessageError, match="envelope"):
        Envelope.from_bytes(data)


FORMER = [(kind, place) for kind, texts in schemas.FORMER.items() for place in range(len(texts))]


@pytest.mark.parametrize(("kind", "place"), FORMER)
@pytest.mark.parametrize("seed", range(3))
def test_messages_of_before_lack_nothing_today(kind: type[Message], place: int, seed: int) -> None:
    """Heights of before messages carried their grid stood on the line.

    What is new is as if nobody knew it.
    """
    name = cdr.FORMER[kind][place]
    former: Any = cdr.STORE.types[name]
    kept = {f.name for f in dataclasses.fields(former) if f.init} - {"header"}
    message = message_of(kind, seed)
    lacking = {
        f.name: f.default_factory() if callable(f.default_factory) else f.default
        for f in dataclasses.fields(kind)
        if f.name not in kept and f.name not in ("time_ns", "x")
    }
    if "y" in {f.name for f in dataclasses.fields(kind)} - kept:
        on_points = ("height", "half_width_90")
        heights = {
            n: np.resize(getattr(message, n), LINE.size) for n in on_points if hasattr(message, n)
        }
        lacking |= heights | {"x": np.array(LINE.x)}
    message = dataclasses.replace(message, **lacking)
    wire = codec._TABLES[kind].encode(message)
    data = cdr.STORE.serialize_cdr(former(wire.header, **{n: getattr(wire, n) for n in kept}), name)
    assert codec.of_today(kind, place, bytes(data)) == encode_message(message)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_position_has_three_coordinates_or_none(count: int) -> None:
    state = message_of(RobotState)
    for known in (np.zeros(0), np.ones(3)):
        sent = dataclasses.replace(state, position_base_in_odometry=known)
        np.testing.assert_array_equal(
            decode_message(RobotState, encode_message(sent)).position_base_in_odometry, known
        )
    with pytest.raises(MessageError, match="shape"):
        encode_message(dataclasses.replace(state, position_base_in_odometry=np.ones(count)))


@given(st.integers(0, 20))
def test_any_number_of_feet_stands(count: int) -> None:
    feet = np.random.default_rng(count).normal(size=(count, 3))
    state = dataclasses.replace(message_of(RobotState), standing_feet=feet)
    np.testing.assert_array_equal(
        decode_message(RobotState, encode_message(state)).standing_feet, feet
    )


def test_points_that_no_image_has_shown_are_infinitely_old() -> None:
    heightmap = message_of(Heightmap)
    ages = np.full(len(heightmap.height), np.inf)
    assert np.isinf(
        decode_message(Heightmap, encode_message(dataclasses.replace(heightmap, age_s=ages))).age_s
    ).all()
    for wrong in (-ages, np.full(len(ages), np.nan), ages[1:]):
        with pytest.raises(MessageError):
            decode_message(Heightmap, encode_message(dataclasses.replace(heightmap, age_s=wrong)))


@pytest.mark.parametrize("kind", [Heightmap, GroundTruth])
def test_heights_that_stand_on_no_grid_are_refused(kind: type[Message]) -> None:
    message = dataclasses.replace(message_of(kind), x=np.array([0.0, 0.1]), y=np.array([0.0]))
    points = (f.name for f in schemas.FIELDS[kind] if f.shape == (-1,))
    heights = {name: np.zeros(2) for name in points} | {"x": message.x, "y": message.y}
    assert (
        len(decode_message(kind, encode_message(dataclasses.replace(message, **heights))).height)
        == 2
    )
    for wrong in (
        {"height": np.zeros(3)},
        {"x": np.array([0.1, 0.1])},
        {"x": np.zeros(0), "height": np.zeros(0)},
        {
            "y": np.linspace(-1.0, 1.0, schemas.POINTS_MAX),
            "height": np.zeros(2 * schemas.POINTS_MAX),
        },
    ):
        with pytest.raises(MessageError, match=r"shape|range"):
            decode_message(kind, encode_message(dataclasses.replace(message, **(heights | wrong))))
