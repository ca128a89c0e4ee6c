"""Reads channels as a stranger does: with the definition that each brings itself,
and rosbags and mcap alone.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore


class PlainReader:
    """Decodes CDR by `ros2msg` schemas, and knows no type before."""

    def __init__(self) -> None:
        self._stores: dict[str, Any] = {}

    def decode(self, type_name: str, definition: str, payload: bytes) -> Any:
        if type_name not in self._stores:
            store = self._stores[type_name] = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(definition, type_name))
        return self._stores[type_name].deserialize_cdr(payload, type_name)


def messages_of(path: Path) -> Iterator[tuple[str, str, Any, bytes]]:
    """Topic, type, message and payload of all that a file of MCAP holds."""
    reader = PlainReader()
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            yield (
                channel.topic, schema.name,
                reader.decode(schema.name, schema.data.decode(), message.data), message.data
            )  # fmt: skip
