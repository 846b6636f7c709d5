"""The messages of a ROS bag that is cut or damaged, as far as they can be read.

`CutBag` has the part of rosbags' `AnyReader` that `bags` uses. ROS 1: records from the beginning to
the cut, without the index. SQLite: rows in the order of writing, up to the first page that is
missing. MCAP: whole chunks up to the damage; `mcap recover` may find more.
"""

from __future__ import annotations

import bz2
import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import lz4.frame
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1.reader import Header, RecordType, normalize, read_bytes, read_uint32
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.msg import normalize_msgtype

LARGEST: Final = 256 * 2**20
"""Bytes of a chunk, at most: bounds the memory that a damaged one can claim."""

Definition = tuple[MessageDefinitionFormat, str]
NONE: Final = (MessageDefinitionFormat.NONE, "")
FORMATS: Final = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}


class Topic(NamedTuple):
    """A topic and the kind of its messages."""

    topic: str
    msgtype: str
    definition: Definition


Found = tuple[Topic, int, bytes]  # with the time of reception, ns


class CutBag:
    """The readable messages of a bag; all of them are in memory."""

    def __init__(self, path: Path) -> None:
        """Read a file, or the files of a folder. Raises ValueError if there is no message."""
        files = [path]
        if path.is_dir():
            files = sorted(one for one in path.iterdir() if one.suffix in (".db3", ".mcap"))
        self._found: list[Found] = []
        for file in files:
            read = {".bag": _ros1, ".db3": _sqlite, ".mcap": _mcap}[file.suffix]
            with suppress(Exception):  # the readers can raise anything on damaged bytes
                for one in read(file):
                    self._found.append(one)
        if not self._found:
            raise ValueError("no message can be read")
        self._found.sort(key=lambda one: one[1])
        self.connections = list(dict.fromkeys(topic for topic, _, _ in self._found))
        self._ros1 = path.suffix == ".bag"
        self._types = _types(self.connections)

    def messages(self, connections: list[Topic]) -> Iterator[Found]:
        """The messages of topics in the order of reception."""
        wanted = {*connections}
        return (one for one in self._found if one[0] in wanted)

    def deserialize(self, raw: bytes, kind: str) -> Any:
        """The fields of a message. Raises errors of rosbags, ValueError and others."""
        types = self._types
        return types.deserialize_ros1(raw, kind) if self._ros1 else types.deserialize_cdr(raw, kind)


def _types(topics: list[Topic]) -> Any:
    """The kinds of messages by the definitions of the bag, else those of ROS 2."""
    defined = [topic for topic in topics if topic.definition[0] is not MessageDefinitionFormat.NONE]
    if not defined:
        return get_typestore(Stores.ROS2_HUMBLE)
    found = get_typestore(Stores.EMPTY)
    for topic in defined:
        form, text = topic.definition
        with suppress(Exception):  # the kind is not used, or its messages cannot be read
            msg = form is MessageDefinitionFormat.MSG
            found.register(
                get_types_from_msg(text, topic.msgtype) if msg else get_types_from_idl(text)
            )
    return found


def _ros1(path: Path) -> Iterator[Found]:
    topics: dict[int, Topic] = {}
    with path.open("rb") as file:
        if not file.readline().startswith(b"#ROSBAG V2"):
            raise ValueError("no ROS bag")
        yield from _records(file, topics)


def _records(stream: BinaryIO, topics: dict[int, Topic]) -> Iterator[Found]:
    """The messages of records and of chunks among them; raises at the cut."""
    while True:
        header = Header.read(stream)
        size = read_uint32(stream)
        match header.get_uint8("op"):
            case RecordType.CHUNK:
                packed = stream.read(size)  # fewer bytes at the cut
                inside = _unpacked(header.get_string("compression"), packed)
                with suppress(Exception):  # the chunk ends
                    yield from _records(BytesIO(inside), topics)
            case RecordType.CONNECTION:
                body = BytesIO(size.to_bytes(4, "little") + read_bytes(stream, size))
                about = Header.read(body)
                kind = normalize_msgtype(about.get_string("type"))
                text = about.get_string("message_definition")
                name = normalize(header.get_string("topic"))
                definition = (MessageDefinitionFormat.MSG, text)
                topics[header.get_uint32("conn")] = Topic(name, kind, definition)
            case RecordType.MSGDATA:
                raw = read_bytes(stream, size)
                yield topics[header.get_uint32("conn")], header.get_time("time"), raw
            case _:
                read_bytes(stream, size)


def _unpacked(compression: str, packed: bytes) -> bytes:
    """A chunk, or its beginning."""
    if compression == "bz2":
        return bz2.BZ2Decompressor().decompress(packed, LARGEST)
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, LARGEST))
    return packed


def _sqlite(path: Path) -> Iterator[Found]:
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)) as bag:
        bag.execute("PRAGMA writable_schema=ON")  # else a file shorter than it says is refused
        definitions: dict[str, Definition] = {}
        with suppress(sqlite3.Error):  # older bags have none
            rows = (
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            definitions = {kind: (FORMATS[form], text) for kind, form, text in bag.execute(rows)}
        topics = {
            number: Topic(name, kind, definitions.get(kind, NONE))
            for number, name, kind in bag.execute("SELECT id, name, type FROM topics")
        }
        for topic, t, raw in bag.execute("SELECT topic_id, timestamp, data FROM messages"):
            yield topics[topic], t, raw


def _mcap(path: Path) -> Iterator[Found]:
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, Schema] = {}
    topics: dict[int, Topic] = {}
    with path.open("rb") as file:
        reader = StreamReader(file, validate_crcs=True, record_size_limit=LARGEST)
        for record in reader.records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.schema_id in schemas:
                schema = schemas[record.schema_id]
                form = FORMATS.get(schema.encoding)
                definition = NONE if form is None else (form, schema.data.decode())
                topics[record.id] = Topic(record.topic, schema.name, definition)
            elif isinstance(record, Message) and record.channel_id in topics:
                yield topics[record.channel_id], record.log_time, record.data
