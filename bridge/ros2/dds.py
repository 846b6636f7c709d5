"""ROS 2 by DDS: Cyclone DDS without ROS, with the names of `rmw_cyclonedds` and `rmw_fastrtps`.

A topic `/odom` is `rt/odom` on DDS. A type's hash is in the endpoint's user data. The topic
`ros_discovery_info` says which node owns an endpoint. Payloads are CDR and pass unchanged.

Sources: design.ros2.org, "Topic and Service name mapping to DDS"; github.com/ros2/rmw_dds_common
and rmw_fastrtps, branch jazzy.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Iterable, Sequence
from enum import Enum
from typing import Annotated, Any, get_args, get_origin, get_type_hints
from uuid import UUID
from xml.sax.saxutils import quoteattr

from cyclonedds import idl
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import (
    DDSException,
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from pycdr2 import IdlStruct
from pycdr2.types import array, bounded_str, sequence

from armadico.bridge.lines import TransportError
from armadico.bridge.ros2 import cdr
from armadico.bridge.ros2.frames import Frame, Wanted
from armadico.bridge.ros2.graph import Endpoint, resolve
from armadico.bridge.ros2.samples import Address
from armadico.bridge.ros2.types import Gid, NodeEntitiesInfo, ParticipantEntitiesInfo

NAMELESS_S = 3.0
"""Time for an endpoint's node name to arrive; an endpoint without one then is no ROS 2 node."""

OLDER_S = 2.0
"""Wait for nodes of an older ROS 2 to announce themselves before this node does."""

BATCH = 100
"""Samples that are read at once."""

_PREFIX = "rt"
_DISCOVERY = "ros_discovery_info"
_EVERYTHING = ViewState.Any | SampleState.Any | InstanceState.Any
_PADDING = 4  # a payload may have fewer bytes of padding at its end
_BLOCK_NS = 100_000_000  # wait for a slow reliable reader; samples that it cannot take are lost
_POLICIES = {
    3: "presentation",
    4: "deadline",
    5: "latency budget",
    6: "ownership",
    8: "liveliness",
    10: "partition",
    12: "destination order",
    23: "data representation",
}
_NAMED = {2, 11, 24}  # durability, reliability and type, by `judge`

_marks: Any = idl.types  # classes that are subscripted
_domains: dict[int, tuple[str, Domain]] = {}


class Form(Enum):
    """How the nodes of the domain announce their endpoints."""

    UNKNOWN = 0
    PRESENT = 1  # Iron and later
    OLDER = 2  # Humble: its nodes stop discovering when they receive the present form


class DdsWire:
    """One participant of a domain."""

    def __init__(self, address: Address, node: str) -> None:
        """Join the domain, as a node of that name."""
        domain = address.domain
        try:
            if address.interface:
                _bind(domain, address.interface)
            # Without an enclave a program is no ROS 2 node to rmw_fastrtps and rmw_cyclonedds.
            self._participant = DomainParticipant(domain, qos=Qos(Policy.Userdata(b"enclave=/;")))
        except DDSException as error:
            raise TransportError(f"cannot join DDS domain {domain}: {_why(error)}") from error
        try:
            self._publications = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
            self._subscriptions = BuiltinDataReader(self._participant, BuiltinTopicDcpsSubscription)
            self._waitset = WaitSet(self._participant)
            self._nodes_in = self._reader(_DISCOVERY, ParticipantEntitiesInfo, _LATCHED)
            self._nodes_out = self._writer(_DISCOVERY, ParticipantEntitiesInfo, _LATCHED)
        except DDSException as error:
            self.close()
            raise TransportError(f"cannot join DDS domain {domain}: {_why(error)}") from error
        self._namespace, self._node = address.namespace, node
        self._readers: dict[str, Any] = {}
        self._writers: dict[str, Any] = {}
        self._conditions: list[ReadCondition] = []
        self._remote: dict[UUID, tuple[float, bool, Any]] = {}
        self._owners: dict[bytes, dict[bytes, str]] = {}  # of endpoints, by participant
        self._announced = True
        self._form = Form.UNKNOWN
        self._joined_at = time.monotonic()

    # Samples --------------------------------------------------------------------------------------

    def want(self, topics: Sequence[Wanted]) -> None:
        """Make readers and writers; those made before end."""
        for condition in self._conditions:
            self._waitset.detach(condition)
        self._conditions, self._readers, self._writers = [], {}, {}
        try:
            for want in topics:
                kind = cdr.known().get(want.type)
                if kind is None:
                    raise TransportError(f"{want.topic}: type {want.type} is not known here")
                name = _PREFIX + resolve(self._namespace, want.topic)
                qos = (want.reliable, want.latched, want.depth)
                if want.writes:
                    self._writers[want.topic] = self._writer(name, kind, qos)
                    continue
                reader = self._readers[want.topic] = self._reader(name, kind, qos)
                condition = ReadCondition(reader, _EVERYTHING)
                self._conditions.append(condition)
                self._waitset.attach(condition)
            self._announced = False
        except DDSException as error:
            raise TransportError(f"DDS refuses: {_why(error)}") from error

    def publish(self, topic: str, payload: bytes) -> None:
        writer = self._writers.get(topic)
        if writer is None:
            return
        try:
            writer.write(writer.topic.data_type.of(payload))
            if not self._announced:  # a wire that only publishes may never poll the nodes
                self._update_nodes()
        except DDSException as error:
            if error.code != DDSException.DDS_RETCODE_TIMEOUT:  # a slow reader
                raise TransportError(f"DDS does not send {topic}: {_why(error)}") from error

    def receive(self, timeout_s: float) -> list[Frame]:
        try:
            if not self._readers:
                time.sleep(timeout_s)
                return []
            self._waitset.wait(int(timeout_s * 1e9))
            self._update_nodes()
            return [
                (topic, sample.payload)
                for topic, reader in self._readers.items()
                for sample in reader.take(BATCH)
                if sample.sample_info.valid_data
            ]
        except DDSException as error:
            raise TransportError(f"DDS broke: {_why(error)}") from error

    def close(self) -> None:
        """Leave the domain, after reliable samples were delivered."""
        # Deleting the reference is not enough: built-in readers and conditions refer to each other.
        self._participant.__del__()

    # Other nodes ----------------------------------------------------------------------------------

    def others(self) -> Iterable[Endpoint]:
        self._poll()
        owners = {gid: node for nodes in self._owners.values() for gid, node in nodes.items()}
        for key, (since, writes, found) in self._remote.items():
            if not found.topic_name.startswith(f"{_PREFIX}/"):
                continue  # services, and topics that are not ROS 2's
            node = owners.get(key.bytes)
            if node is None and time.monotonic() - since < NAMELESS_S:
                continue
            reliability, durability = found.qos[Policy.Reliability], found.qos[Policy.Durability]
            yield Endpoint(
                topic=found.topic_name[len(_PREFIX) :],
                type=cdr.from_dds_name(found.type_name),
                node=node or f"a program without a name ({_short(found)})",
                writes=writes,
                reliable=isinstance(reliability, Policy.Reliability.Reliable),
                latched=durability != Policy.Durability.Volatile,
            )

    def complaints(self) -> Sequence[str]:
        """Policies that do not match, apart from those that `judge` reports."""
        found = []
        for topic, reader in self._readers.items():
            status = reader.get_requested_incompatible_qos_status()
            found.append((topic, "requested", status))
        for topic, writer in self._writers.items():
            found.append((topic, "offered", writer.get_offered_incompatible_qos_status()))
        return [
            f"QoS of {topic}: the {_POLICIES.get(s.last_policy_id, 'policy')} that is {what} here"
            " does not match"
            for topic, what, s in found
            if s.total_count and s.last_policy_id not in _NAMED
        ]

    def _poll(self) -> None:
        own = self._participant.guid
        for writes, reader in ((True, self._publications), (False, self._subscriptions)):
            for found in reader.take(BATCH):
                if found.sample_info.instance_state != InstanceState.Alive:
                    self._remote.pop(found.key, None)
                elif found.participant_key != own:
                    self._remote.setdefault(found.key, (time.monotonic(), writes, found))
        self._update_nodes()

    def _update_nodes(self) -> None:
        """Read which node has which endpoints; announce ours once no older ROS 2 is present."""
        for sample in self._nodes_in.take(BATCH):
            if sample.sample_info.valid_data:
                self._on_entities(sample.payload)
        if self._form is Form.UNKNOWN and time.monotonic() - self._joined_at >= OLDER_S:
            self._form = Form.PRESENT
        if self._form is Form.PRESENT and not self._announced:
            self._announced = True
            self._announce()

    def _on_entities(self, payload: bytes) -> None:
        try:
            info = cdr.decode(ParticipantEntitiesInfo, payload)
        except ValueError:
            return
        if len(payload) - len(cdr.encode(info)) >= _PADDING:  # Humble's message has more fields
            self._form = Form.OLDER
            return
        if self._form is Form.UNKNOWN:
            self._form = Form.PRESENT
        # A node that ends withdraws its names first; its endpoints may be present long after.
        alive = {key.bytes for key in self._remote}
        before = self._owners.get(bytes(info.gid.data), {})
        kept = {gid: name for gid, name in before.items() if gid in alive}
        self._owners[bytes(info.gid.data)] = kept | {
            bytes(gid.data): f"{node.node_namespace.rstrip('/')}/{node.node_name}"
            for node in info.node_entities_info_seq
            for gid in (*node.reader_gid_seq, *node.writer_gid_seq)
        }

    def _announce(self) -> None:
        """Publish which node has the readers and writers of this process."""
        node = NodeEntitiesInfo(
            node_namespace=resolve("", f"/{self._namespace.strip('/')}"),
            node_name=self._node,
            reader_gid_seq=[_gid(each.guid) for each in self._readers.values()],
            writer_gid_seq=[_gid(each.guid) for each in self._writers.values()],
        )
        info = ParticipantEntitiesInfo(_gid(self._participant.guid), [node])
        kind = self._nodes_out.topic.data_type
        self._nodes_out.write(kind.of(cdr.encode(info)))

    # Readers and writers --------------------------------------------------------------------------

    def _reader(self, name: str, kind: type[IdlStruct], qos: _Quality) -> DataReader[Any]:
        topic = Topic(self._participant, name, passing(kind))
        return DataReader(self._participant, topic, qos=_qos(kind, qos))

    def _writer(self, name: str, kind: type[IdlStruct], qos: _Quality) -> DataWriter[Any]:
        topic = Topic(self._participant, name, passing(kind))
        return DataWriter(self._participant, topic, qos=_qos(kind, qos))


_Quality = tuple[bool, bool, int]  # reliable, latched, depth
_LATCHED: _Quality = (True, True, BATCH)


def _qos(kind: type[IdlStruct], quality: _Quality) -> Qos:
    reliable, latched, depth = quality
    return Qos(
        Policy.Reliability.Reliable(_BLOCK_NS) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
        Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        Policy.Userdata(f"typehash={cdr.type_hash(kind)};".encode()),
    )


@functools.cache
def passing(kind: type[IdlStruct]) -> Any:
    """The same type for Cyclone, field by field, whose samples are the bytes that came."""
    made = _same(kind)

    def of(payload: bytes) -> object:
        sample = made.__new__(made)
        sample.payload = payload
        return sample

    made.of = staticmethod(of)
    made.deserialize = staticmethod(of)
    made.deserialize_key = staticmethod(of)  # for an instance that has ended
    made.serialize = lambda self, use_version_2=None: self.payload  # noqa: ARG005
    return made


@functools.cache
def _same(kind: type[IdlStruct]) -> Any:
    name = cdr.dds_name(kind)
    hints = get_type_hints(kind, include_extras=True)
    return idl.make_idl_struct(
        name.rpartition("::")[2],
        name.replace("::", "."),
        {field: _field(hint) for field, hint in hints.items() if not field.startswith("_")},
    )


def _field(hint: object) -> object:
    if isinstance(hint, type) and issubclass(hint, IdlStruct):
        return _same(hint)
    mark = get_args(hint)[1] if get_origin(hint) is Annotated else None
    if isinstance(mark, array):
        return _marks.array[_field(mark.subtype), mark.length]
    if isinstance(mark, sequence):
        return _marks.sequence[_field(mark.subtype)]
    if isinstance(mark, bounded_str):
        return _marks.bounded_str[mark.max_length]
    return hint


def _bind(domain: int, interface: str) -> None:
    """Bind a domain to one network interface; Cyclone accepts that once per process."""
    before = _domains.get(domain)
    if before is not None:
        if before[0] != interface:
            text = f"domain {domain} is joined by {before[0]!r} in this process, not {interface!r}"
            raise TransportError(text)
        return
    # The loopback has no multicast: processes are found by unicast.
    peers = '<Peers><Peer address="127.0.0.1"/></Peers>' if interface == "lo" else ""
    text = (
        '<CycloneDDS><Domain Id="any"><General><Interfaces>'
        f"<NetworkInterface name={quoteattr(interface)}/></Interfaces></General>"
        f"<Discovery><ParticipantIndex>auto</ParticipantIndex>{peers}</Discovery>"
        "</Domain></CycloneDDS>"
    )
    _domains[domain] = interface, Domain(domain, text)


def _gid(guid: UUID) -> Gid:
    return Gid(data=guid.bytes)


def _short(found: Any) -> str:
    return str(found.participant_key)[:18]


def _why(error: DDSException) -> str:
    return str(error).removeprefix("[DDSException] ")
