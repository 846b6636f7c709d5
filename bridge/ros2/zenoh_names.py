"""Names of rmw_zenoh: keys of samples, liveliness tokens, attachments; sans-IO.

Source: github.com/ros2/rmw_zenoh, docs/design.md and liveliness_utils.hpp, branch jazzy.
"""

from __future__ import annotations

import struct

from msgspec import Struct

from armadico.bridge.ros2 import cdr
from armadico.bridge.ros2.frames import Wanted
from armadico.bridge.ros2.graph import Endpoint

SPACE = "@ros2_lv"
NODE, PUBLISHER, SUBSCRIPTION = "NN", "MP", "MS"

GID_BYTES = 16
_ATTACHMENT = struct.Struct(f"<qqB{GID_BYTES}s")
_QOS = "{reliability}:{durability}:1,{depth}:,:,:,,"  # keep last; no deadline, lifespan, lease
_EMPTY = "%"


class Member(Struct, frozen=True):
    """A node of a session."""

    domain: int
    session: str  # Zenoh's id
    namespace: str  # without slashes around it
    name: str

    def token(self) -> str:
        """The node's liveliness token."""
        return self._token(0, NODE)

    def endpoint(self, number: int, topic: str, type_name: str, want: Wanted) -> str:
        """The token of one of its publishers or subscriptions; `topic` is the whole name."""
        qos = _QOS.format(
            reliability=1 if want.reliable else 2,
            durability=1 if want.latched else 2,
            depth=want.depth,
        )
        kind = PUBLISHER if want.writes else SUBSCRIPTION
        hashed = cdr.type_hash(cdr.known()[type_name])
        dds = cdr.dds_name(cdr.known()[type_name])
        return f"{self._token(number, kind)}/{_mangled(topic)}/{dds}/{hashed}/{qos}"

    def _token(self, number: int, kind: str) -> str:
        space = f"{SPACE}/{self.domain}/{self.session}/0/{number}/{kind}"
        return f"{space}/{_EMPTY}/{_mangled(f'/{self.namespace}')}/{self.name}"


def key(domain: int, topic: str, type_name: str) -> str:
    """The key of a topic's samples; `topic` is its whole name."""
    kind = cdr.known()[type_name]
    return f"{domain}/{topic.strip('/')}/{cdr.dds_name(kind)}/{cdr.type_hash(kind)}"


def attachment(sequence: int, time_ns: int, gid: bytes) -> bytes:
    """The attachment of a sample; ROS 2 subscriptions discard samples without one."""
    return _ATTACHMENT.pack(sequence, time_ns, GID_BYTES, gid)


def endpoint(token: str) -> Endpoint | None:
    """The endpoint of a token; None for nodes, services and other texts.

    rmw_zenoh matches endpoints with any QoS, so the endpoint is described as matching.
    """
    parts = token.split("/")
    if len(parts) != 13 or parts[0] != SPACE or parts[5] not in (PUBLISHER, SUBSCRIPTION):
        return None
    _, _, _, _, _, kind, _, namespace, node, topic, dds, _, _ = parts
    writes = kind == PUBLISHER
    return Endpoint(
        topic=topic.replace("%", "/"),
        type=cdr.from_dds_name(dds),
        node=f"{namespace.replace('%', '/').rstrip('/')}/{node}",
        writes=writes,
        reliable=writes,
        latched=writes,
    )


def session(token: str) -> str:
    """The Zenoh id of a token's session; "" if it is no token."""
    parts = token.split("/")
    return parts[2] if len(parts) > 5 and parts[0] == SPACE else ""


def _mangled(name: str) -> str:
    return name.replace("/", "%")
