"""ROS 2 by Zenoh, in the form of `rmw_zenoh`: no ROS, no DDS.

The session is apart from the mesh's: it connects to the robot's router, as ROS 2 nodes do.
"""

from __future__ import annotations

import contextlib
import json
import queue
import secrets
import threading
import time
from collections.abc import Iterable, Sequence
from typing import Any, Final

import zenoh
from zenoh import ext

from armadico.bridge.lines import TransportError
from armadico.bridge.ros2 import cdr
from armadico.bridge.ros2 import zenoh_names as names
from armadico.bridge.ros2.frames import Frame, Wanted
from armadico.bridge.ros2.graph import Endpoint, resolve
from armadico.bridge.ros2.samples import Address

CLOSE_S: Final = 1.0
CONNECT_MS: Final = 2000

WAITING: Final = 1000
"""Most samples that wait to be read; the oldest are discarded."""

_SETTINGS: Final[dict[str, object]] = {
    "scouting/multicast/enabled": False,
    "transport/shared_memory/enabled": False,
    "timestamping/enabled": True,  # advanced publishers need it to keep samples
    "connect/timeout_ms": CONNECT_MS,
    "connect/exit_on_failure": True,
}


class ZenohWire:
    """One session, as a client or as the router."""

    def __init__(self, address: Address, node: str, listens: bool) -> None:
        """Join as a node of that name; with `listens`, be the router if there is none."""
        session = (_joined(address.endpoint, "router") if listens else None) or _joined(
            address.endpoint, "client"
        )
        if session is None:
            raise TransportError(
                f"no Zenoh router answers at {address.endpoint}; does `ros2 run rmw_zenoh_cpp"
                " rmw_zenohd` run there?"
            )
        self._session = session
        domain = address.domain
        self._domain, self._namespace, self._node = domain, address.namespace, node
        self._own = str(self._session.info.zid())
        self._samples: queue.Queue[Frame] = queue.Queue(WAITING)
        self._lock = threading.Lock()  # tokens come on Zenoh's thread
        self._tokens: set[str] = set()
        self._declared: list[Any] = []
        self._publishers: dict[str, tuple[zenoh.Publisher | ext.AdvancedPublisher, bytes]] = {}
        self._sequences: dict[str, int] = {}
        self._watcher = self._session.liveliness().declare_subscriber(
            f"{names.SPACE}/{domain}/**",
            zenoh.handlers.Callback(self._changed, indirect=False),
            history=True,
        )

    def want(self, topics: Sequence[Wanted]) -> None:
        """Declare publishers and subscriptions; those declared before end."""
        for want in topics:
            if want.type not in cdr.known():
                raise TransportError(f"{want.topic}: type {want.type} is not known here")
        for declared in self._declared:
            declared.undeclare()
        self._declared, self._publishers, self._sequences = [], {}, {}
        member = names.Member(self._domain, self._own, self._namespace.strip("/"), self._node)
        alive = self._session.liveliness()
        self._declared.append(alive.declare_token(member.token()))
        for number, want in enumerate(topics, 1):
            topic = resolve(self._namespace, want.topic)
            key = names.key(self._domain, topic, want.type)
            if want.writes:
                declared = self._publisher(key, want)
                self._publishers[want.topic] = declared, secrets.token_bytes(names.GID_BYTES)
                self._sequences[want.topic] = 0
            else:
                declared = self._subscriber(key, want)
            token = member.endpoint(number, topic, want.type, want)
            self._declared += (declared, alive.declare_token(token))

    def publish(self, topic: str, payload: bytes) -> None:
        if topic not in self._publishers:
            return
        publisher, gid = self._publishers[topic]
        self._sequences[topic] += 1
        along = names.attachment(self._sequences[topic], time.time_ns(), gid)
        try:
            publisher.put(payload, attachment=along)
        except zenoh.ZError as error:
            raise TransportError(f"Zenoh does not send {topic}: {error}") from error

    def receive(self, timeout_s: float) -> list[Frame]:
        found: list[Frame] = []
        try:
            found.append(self._samples.get(timeout_s > 0, timeout_s or None))
            while True:
                found.append(self._samples.get_nowait())
        except queue.Empty:
            return found

    def close(self) -> None:
        """Leave. Closing may take long: only the end of the program waits for it."""
        closing = threading.Thread(target=self._session.close, name="closing")
        closing.start()
        closing.join(CLOSE_S)

    def others(self) -> Iterable[Endpoint]:
        with self._lock:
            tokens = sorted(self._tokens)
        found = (names.endpoint(token) for token in tokens if names.session(token) != self._own)
        return [each for each in found if each is not None]

    def complaints(self) -> Sequence[str]:
        """None: rmw_zenoh matches endpoints with any QoS."""
        return ()

    def _changed(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT:
                self._tokens.add(token)
            else:
                self._tokens.discard(token)

    def _publisher(self, key: str, want: Wanted) -> zenoh.Publisher | ext.AdvancedPublisher:
        """A publisher; a latched one keeps its last samples for late subscribers."""
        settings: dict[str, Any] = {
            "encoding": zenoh.Encoding.APPLICATION_CDR,
            "congestion_control": zenoh.CongestionControl.DROP,
            "express": True,  # a command is not held back for batching
        }
        if not want.latched:
            return self._session.declare_publisher(key, **settings)
        return ext.declare_advanced_publisher(
            self._session,
            key,
            cache=ext.CacheConfig(max_samples=want.depth),
            publisher_detection=True,
            **settings,
        )

    def _subscriber(self, key: str, want: Wanted) -> Any:
        def arrived(sample: zenoh.Sample) -> None:
            self._keep((want.topic, sample.payload.to_bytes()))

        callback = zenoh.handlers.Callback(arrived, indirect=False)
        if not want.latched:
            return self._session.declare_subscriber(key, callback)
        return ext.declare_advanced_subscriber(
            self._session,
            key,
            callback,
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=want.depth),
        )

    def _keep(self, frame: Frame) -> None:
        with contextlib.suppress(queue.Empty):
            if self._samples.full():
                self._samples.get_nowait()
        with contextlib.suppress(queue.Full):
            self._samples.put_nowait(frame)


def _joined(endpoint: str, mode: str) -> zenoh.Session | None:
    """A session with an endpoint, in a mode; None if it cannot be opened."""
    config = zenoh.Config()
    where = "listen/endpoints" if mode == "router" else "connect/endpoints"
    for setting, value in (_SETTINGS | {"mode": mode, where: [endpoint]}).items():
        config.insert_json5(setting, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        return None
