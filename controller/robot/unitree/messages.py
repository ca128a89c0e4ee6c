"""Messages of a Go2's low level, as its computer holds them: structs of C, with a checksum.

Definitions are those of Unitree's `unitree_go` (BSD-3), in ROS 2's form: DDS is told the types, and
recordings hold them. A struct in memory and its CDR differ in their padding, and the checksum is
over the memory.
"""

import zlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saltus.errors import MessageError
from saltus.recordings import ros_messages as ros

DEFINITIONS = {
    "unitree_go/msg/MotorCmd": (
        "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 tau\nfloat32 kp\n"
        "float32 kd\nuint32[3] reserve\n"
    ),
    "unitree_go/msg/BmsCmd": "uint8 off\nuint8[3] reserve\n",
    "unitree_go/msg/LowCmd": (
        "uint8[2] head\nuint8 level_flag\nuint8 frame_reserve\nuint32[2] sn\nuint32[2] version\n"
        "uint16 bandwidth\nunitree_go/MotorCmd[20] motor_cmd\nunitree_go/BmsCmd bms_cmd\n"
        "uint8[40] wireless_remote\nuint8[12] led\nuint8[2] fan\nuint8 gpio\nuint32 reserve\n"
        "uint32 crc\n"
    ),
    "unitree_go/msg/IMUState": (
        "float32[4] quaternion\nfloat32[3] gyroscope\nfloat32[3] accelerometer\nfloat32[3] rpy\n"
        "uint8 temperature\n"
    ),
    "unitree_go/msg/MotorState": (
        "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 ddq\nfloat32 tau_est\nfloat32 q_raw\n"
        "float32 dq_raw\nfloat32 ddq_raw\nuint8 temperature\nuint32 lost\nuint32[2] reserve\n"
    ),
    "unitree_go/msg/BmsState": (
        "uint8 version_high\nuint8 version_low\nuint8 status\nuint8 soc\nint32 current\n"
        "uint16 cycle\nuint8[2] bq_ntc\nuint8[2] mcu_ntc\nuint16[15] cell_vol\n"
    ),
    "unitree_go/msg/LowState": (
        "uint8[2] head\nuint8 level_flag\nuint8 frame_reserve\nuint32[2] sn\nuint32[2] version\n"
        "uint16 bandwidth\nunitree_go/IMUState imu_state\nunitree_go/MotorState[20] motor_state\n"
        "unitree_go/BmsState bms_state\nint16[4] foot_force\nint16[4] foot_force_est\nuint32 tick\n"
        "uint8[40] wireless_remote\nuint8 bit_flag\nfloat32 adc_reel\nuint8 temperature_ntc1\n"
        "uint8 temperature_ntc2\nfloat32 power_v\nfloat32 power_a\nuint16[4] fan_frequency\n"
        "uint32 reserve\nuint32 crc\n"
    ),
}
SERVICE_DEFINITIONS = {
    "unitree_api/msg/RequestIdentity": "int64 id\nint64 api_id\n",
    "unitree_api/msg/RequestLease": "int64 id\n",
    "unitree_api/msg/RequestPolicy": "int32 priority\nbool noreply\n",
    "unitree_api/msg/RequestHeader": (
        "unitree_api/RequestIdentity identity\nunitree_api/RequestLease lease\n"
        "unitree_api/RequestPolicy policy\n"
    ),
    "unitree_api/msg/Request": (
        "unitree_api/RequestHeader header\nstring parameter\nuint8[] binary\n"
    ),
    "unitree_api/msg/ResponseStatus": "int32 code\n",
    "unitree_api/msg/ResponseHeader": (
        "unitree_api/RequestIdentity identity\nunitree_api/ResponseStatus status\n"
    ),
    "unitree_api/msg/Response": (
        "unitree_api/ResponseHeader header\nstring data\nuint8[] binary\n"
    ),
}
"""Requests to a robot's services and their answers: Unitree's `unitree_api` (BSD-3)."""
ros.add_types(DEFINITIONS | SERVICE_DEFINITIONS)

MOTORS = 12
"""Motors that a Go2 has, of the 20 of its messages: FR, FL, RR, RL, each hip, thigh, calf."""
HEAD = (0xFE, 0xEF)
LEVEL_LOW = 0xFF
"""Value of `level_flag` for commands to motors, past the robot's own gaits."""
SERVO, OFF = 1, 0
"""Modes of a motor: PD law with feed-forward torque in the drive, and without torque."""
ENCAPSULATION = bytes((0, 1, 0, 0))  # CDR, little endian (OMG DDSI-RTPS 10.5)
FORMS = {
    "uint8": "u1", "uint16": "<u2", "int16": "<i2", "uint32": "<u4", "int32": "<i4",
    "float32": "<f4", "float64": "<f8",
}  # fmt: skip
POLYNOMIAL = 0x04C11DB7
"""Polynomial of the checksum; with 32 bits of ones at the start, and nothing inverted at the
end."""
_TURNED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))  # bits of a byte, last first

UnitreeMessage = NDArray[np.void]
"""Messages of one layout, shape (...)."""


class MessageLayout:
    """One of a robot's message types as a C struct and as CDR, the form in which it travels over
    DDS.

    Args:
        type_name: Name in ROS 2, of `DEFINITIONS`, of a type with head and checksum.
    """

    def __init__(self, type_name: str) -> None:
        self.type_name = type_name
        self.dtype = _struct(type_name)
        """Form of a message in memory, as C pads it."""
        pairs = np.array(list(_bytes_of(("type", type_name), 0, [0])))
        self._in_memory, self._in_cdr = pairs.T
        self.size = len(ENCAPSULATION) + int(self._in_cdr[-1]) + 1
        """Bytes of a message as it travels."""

    def blank(self) -> UnitreeMessage:
        """A message whose head is right, and else of zeros, shape ()."""
        message = np.zeros((), self.dtype)
        message["head"], message["level_flag"] = HEAD, LEVEL_LOW
        return message

    def sealed(self, message: UnitreeMessage) -> bytes:
        """CDR of a message of shape (), which is given its checksum."""
        message["crc"] = checksum(message)
        return self.payload(message)

    def payload(self, message: UnitreeMessage) -> bytes:
        """CDR of a message of shape () with the checksum that it has."""
        cdr = np.zeros(self.size - len(ENCAPSULATION), np.uint8)
        cdr[self._in_cdr] = np.frombuffer(message.tobytes(), np.uint8)[self._in_memory]
        return ENCAPSULATION + cdr.tobytes()

    def read(self, payloads: Sequence[bytes]) -> UnitreeMessage:
        """Messages of CDR, shape (len(payloads),), whatever their checksums.

        Raises:
            MessageError: one is of another size or encoding.
        """
        for payload in payloads:
            if len(payload) != self.size or payload[:2] != ENCAPSULATION[:2]:
                raise MessageError("size", f"{self.type_name} of {len(payload)} bytes")
        cdr = np.frombuffer(b"".join(payloads), np.uint8).reshape(-1, self.size)
        memory = np.zeros((len(payloads), self.dtype.itemsize), np.uint8)
        memory[:, self._in_memory] = cdr[:, len(ENCAPSULATION) + self._in_cdr]
        return memory.view(self.dtype)[:, 0]


def checksum(message: UnitreeMessage) -> int:
    """Checksum of a message of shape (): over the words of its memory but the last,
    high bits first.
    """
    words = np.frombuffer(message.tobytes(), "<u4")[:-1]
    # zlib's takes low bits first, and inverts the end
    turned = zlib.crc32(words.byteswap().tobytes().translate(_TURNED)) ^ 0xFFFFFFFF
    return int.from_bytes(turned.to_bytes(4, "little").translate(_TURNED), "big")


def is_intact(message: UnitreeMessage) -> bool:
    """True where the checksum of a message of shape () is the one that it has."""
    return checksum(message) == int(message["crc"])


def _struct(type_name: str) -> np.dtype[np.void]:
    fields = [(name, *_form(kind)) for name, kind in ros.fields_of(type_name)]
    return np.dtype(fields, align=True)


def _form(kind: tuple[str, Any]) -> tuple[Any, ...]:
    """Form of a field's numbers, and its shape."""
    form, what = kind
    if form == "array":
        inner, count = what
        return (*_form(inner), (count,))
    return (np.dtype(FORMS[what]) if form == "base" else _struct(what),)


def _bytes_of(kind: tuple[str, Any], start: int, end: list[int]) -> Iterator[tuple[int, int]]:
    """Place in memory and in CDR of each byte of a field that begins at `start`;
    CDR has grown to `end`.
    """
    form, what = kind
    if form == "base":
        size = np.dtype(FORMS[what]).itemsize
        place = -(-end[0] // size) * size
        end[0] = place + size
        yield from ((start + byte, place + byte) for byte in range(size))
    elif form == "array":
        inner, count = what
        size = _form(inner)[0].itemsize
        for number in range(count):
            yield from _bytes_of(inner, start + number * size, end)
    else:
        struct = _struct(what)
        for name, each in ros.fields_of(what):
            yield from _bytes_of(each, start + struct.fields[name][1], end)  # type: ignore[index]


LOW_COMMAND = MessageLayout("unitree_go/msg/LowCmd")
LOW_STATE = MessageLayout("unitree_go/msg/LowState")
