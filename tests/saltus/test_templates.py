"""Laws of templates: they read and write what the codec does,
to the bit, and refuse what it refuses.
"""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samples import message_of

from saltus.errors import MessageError
from saltus.wire import codec, schemas
from saltus.wire.cdr import STORE
from saltus.wire.codec import (
    _TEMPLATES,
    decode_message,
    encode_message,
    reference_bytes,
    reference_message,
)
from saltus.wire.messages import Message, MotionPlan

KINDS = list(_TEMPLATES)
kinds = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
FLIPS = st.lists(st.tuples(st.integers(0, 10**6), st.integers(1, 255)), min_size=1, max_size=4)


def outcome(read: Any, data: bytes) -> Any:
    """Outcome of decoding bytes: the fields, or the reason of the refusal."""
    try:
        message = read(data)
    except MessageError as error:
        return error.reason
    except Exception:
        return "malformed"
    return [
        (type(v), v.dtype, v.shape, v.tobytes()) if isinstance(v, np.ndarray) else (type(v), v)
        for v in (getattr(message, f.name) for f in dataclasses.fields(message))
    ]


def learned(kind: type[Message]) -> bytes:
    """Bytes of a message of which there is a template."""
    data = reference_bytes(message_of(kind))
    for _ in range(3):
        decode_message(kind, data)
    assert any(t.read(data) is not None for t in _TEMPLATES[kind]._by_length[len(data)])
    return data


@kinds
@pytest.mark.parametrize("seed", range(20))
def test_messages_are_those_of_the_reference(kind: type[Message], seed: int) -> None:
    message = message_of(kind, seed)
    data = reference_bytes(message)
    for _ in range(3):  # by the reference, and then by a template
        assert encode_message(message) == data
        assert outcome(lambda d: decode_message(kind, d), data) == outcome(
            lambda d: reference_message(kind, d), data
        )


@kinds
@given(flips=FLIPS)
@settings(max_examples=100, deadline=None)
def test_flipped_bytes_have_the_outcome_of_the_reference(
    kind: type[Message], flips: list[tuple[int, int]]
) -> None:
    data = bytearray(learned(kind))
    for position, mask in flips:
        data[position % len(data)] ^= mask
    assert outcome(lambda d: decode_message(kind, d), bytes(data)) == outcome(
        lambda d: reference_message(kind, d), bytes(data)
    )


@kinds
def test_every_byte_is_judged(kind: type[Message]) -> None:
    data = learned(kind)
    for position in np.linspace(0, len(data) - 1, 600).astype(int):
        for mask in (0x80, 0xFF):
            changed = bytearray(data)
            changed[position] ^= mask
            assert outcome(lambda d: decode_message(kind, d), bytes(changed)) == outcome(
                lambda d: reference_message(kind, d), bytes(changed)
            )


@kinds
def test_arrays_of_a_template_are_read_only(kind: type[Message]) -> None:
    message = decode_message(kind, learned(kind))
    for value in vars(message).values():
        assert not isinstance(value, np.ndarray) or not value.flags.writeable


def test_messages_of_another_writer_are_read_as_by_the_reference() -> None:
    wire = codec._TABLES[MotionPlan].encode(message_of(MotionPlan))
    wire.header.frame_id = "a_frame_of_its_own"
    data = bytes(STORE.serialize_cdr(wire, schemas.TYPE_NAME[MotionPlan]))
    expected = outcome(lambda d: reference_message(MotionPlan, d), data)
    for _ in range(4):
        assert outcome(lambda d: decode_message(MotionPlan, d), data) == expected


def test_there_are_no_more_templates_than_allowed() -> None:
    plan = message_of(MotionPlan)
    for number in range(300):
        again = dataclasses.replace(plan, reason=f"reason {number}")
        assert [encode_message(again) for _ in range(3)] == [reference_bytes(again)] * 3
        assert decode_message(MotionPlan, encode_message(again)).reason == again.reason
    assert len(_TEMPLATES[MotionPlan]._templates) <= 64
