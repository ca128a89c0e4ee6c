"""Laws of a Go2's messages: as C and Cyclone DDS 0.10.2 have them, which is what Unitree ships."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from benchmarks.unitree_link.command import HERE
from saltus.controller.robot.unitree.link import ANSWER_TYPE, REQUEST_TYPE
from saltus.controller.robot.unitree.messages import (
    DEFINITIONS,
    LOW_COMMAND,
    LOW_STATE,
    MessageLayout,
    UnitreeMessage,
    checksum,
    is_intact,
)
from saltus.dds_types import type_of
from saltus.errors import MessageError

WITHIN = re.compile(rb"\x14\0\0\0[\xf1\xf2].{14}.{4}", re.S)
"""A type in type information: kind and 14 bytes of its hash (XTypes 7.3.4.9), and its size."""
IDL = HERE / "unitree_go.idl"
SIZES = {LOW_COMMAND.type_name: 812, LOW_STATE.type_name: 1180}
"""Bytes of a struct in C."""
LAYOUTS = pytest.mark.parametrize("layout", [LOW_COMMAND, LOW_STATE], ids=["command", "state"])


def random_messages(
    layout: MessageLayout, count: int, seed: int, limit: int = 256
) -> UnitreeMessage:
    """Messages of random bytes below `limit`."""
    rng = np.random.default_rng(seed)
    head = np.tile(np.array([0, 1, 0, 0], np.uint8), (count, 1))
    body = rng.integers(0, limit, (count, layout.size - 4), np.uint8)
    return layout.read([row.tobytes() for row in np.hstack([head, body])])


def bitwise(messages: UnitreeMessage) -> np.ndarray:
    """The checksum as it is defined, bit by bit, of each message."""
    words = np.stack([np.frombuffer(message.tobytes(), "<u4") for message in messages])
    register = np.full(len(words), 0xFFFFFFFF, np.uint32)
    for column in words[:, :-1].T:
        for bit in range(31, -1, -1):
            top = (register >> np.uint32(31)) ^ (column >> np.uint32(bit) & np.uint32(1))
            register = (register << np.uint32(1)) ^ np.where(
                top, np.uint32(0x04C11DB7), np.uint32(0)
            )
    return register


@LAYOUTS
def test_checksums_equal_those_made_bit_by_bit(layout: MessageLayout) -> None:
    messages = random_messages(layout, 2_000, seed=1)
    found = [checksum(message) for message in messages]
    np.testing.assert_array_equal(found, bitwise(messages))


@LAYOUTS
def test_any_flipped_bit_shows(layout: MessageLayout) -> None:
    sealed = layout.sealed(layout.blank())
    assert is_intact(layout.read([sealed])[0])
    rng = np.random.default_rng(2)
    places = {int(place) for place in np.unique(random_places(layout))}
    for place in rng.choice(sorted(places), 200):
        flipped = bytearray(sealed)
        flipped[place] ^= 1 << int(rng.integers(8))
        assert not is_intact(layout.read([bytes(flipped)])[0])


def random_places(layout: MessageLayout) -> np.ndarray:
    """Bytes of a message that are not padding: those that differ where everything else differs."""
    zero, ones = (
        np.zeros((), layout.dtype),
        np.frombuffer(b"\xff" * layout.dtype.itemsize, layout.dtype)[0],
    )
    before, after = (np.frombuffer(layout.payload(m), np.uint8) for m in (zero, ones))
    return np.flatnonzero(before != after)


@LAYOUTS
def test_messages_travel_as_another_serialiser_writes_them(layout: MessageLayout) -> None:
    """Field by field, with every number: `rosbags` knows nothing of C's layout."""
    store = get_typestore(Stores.EMPTY)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    for message in random_messages(layout, 50, seed=3, limit=0x7F):  # so that all floats are finite
        payload = layout.payload(message)
        other = store.deserialize_cdr(payload, layout.type_name)
        assert bytes(store.serialize_cdr(other, layout.type_name)) == payload
        assert other.crc == message["crc"]
        motors, q = ("motor_cmd", "kd") if layout is LOW_COMMAND else ("motor_state", "tau_est")
        theirs = np.array([getattr(motor, q) for motor in getattr(other, motors)], np.float32)
        np.testing.assert_array_equal(theirs, message[motors][q])


@LAYOUTS
def test_structs_are_as_long_as_in_c(layout: MessageLayout) -> None:
    assert layout.dtype.itemsize == SIZES[layout.type_name]


@LAYOUTS
def test_strange_bytes_are_refused(layout: MessageLayout) -> None:
    good = layout.sealed(layout.blank())
    for bad in (b"", good[:-1], good + b"\0", b"\0\0" + good[2:]):
        with pytest.raises(MessageError):
            layout.read([good, bad])


def test_type_information_equals_that_of_cyclone_0_10_byte_for_byte(tmp_path: Path) -> None:
    """Debian's idlc makes it of IDL that is written down here by itself."""
    subprocess.run(["/usr/bin/idlc", str(IDL)], cwd=tmp_path, check=True)
    source = (tmp_path / "unitree_go.c").read_text(encoding="utf-8")
    for name in (LOW_COMMAND.type_name, LOW_STATE.type_name, REQUEST_TYPE, ANSWER_TYPE):
        kind = type_of(name)
        kind.__idl__.populate()
        kind.__idl__.fill_type_data()
        ours = {"INFO": kind.__idl__.get_type_info(), "MAP": kind.__idl__.get_type_mapping()}
        for what, value in ours.items():
            c_name = kind.__idl_typename__.replace("::", "_")
            literal = re.search(rf"#define TYPE_{what}_CDR_{c_name} .*?\{{(.*?)\}}", source, re.S)
            assert literal is not None
            theirs = bytes(int(byte, 16) for byte in re.findall(r"0x(\w\w)", literal[1]))
            mine = value.serialize(use_version_2=True)[4:]
            if what == "INFO":  # types within types, which idlc lists in another order
                assert len(mine) == len(theirs)
                mine, theirs = (b"".join(sorted(WITHIN.findall(each))) for each in (mine, theirs))
            assert theirs
            assert mine.startswith(theirs)
