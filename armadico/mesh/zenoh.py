"""The mesh between processes: the only module that knows Zenoh.

Callbacks run on Zenoh's own reception thread and must return soon: a slow one stops reception for
the whole process. Most put what they are given into a queue. They are handed bytes; the owner of
the queue reads them with `ZenohMesh.read`, so a value that is overtaken there is never decoded.
"""

from __future__ import annotations

import atexit
import json
import logging
import os
import random
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Final

# One worker of Zenoh's for everything, where there would be five: what they do for a message of
# ours is little, and handing it on woke each process 20 times a cycle. Read on loading Zenoh.
os.environ.setdefault(
    "ZENOH_RUNTIME",
    "(rx: (worker_threads: 1), tx: (handover: rx), acc: (handover: rx),"
    " net: (handover: rx), app: (handover: rx))",
)

import zenoh

from armadico.core.messages import Message, encode
from armadico.core.services import TOKEN
from armadico.mesh.base import Monotonic, Reader, Receiver
from armadico.mesh.linger import release_links
from armadico.mesh.repair import Repair
from armadico.mesh.topology import MeshError, Topology, any_port, one_way, rooted

logger = logging.getLogger("armadico.mesh")

CLOSE_S: Final = 1.0
"""A session that does not close within this is left behind (closing may block for 10 s)."""

ATTEMPT_MS: Final = 1000
"""How long one attempt to reach a router goes on."""

SETTINGS: Final[dict[str, Any]] = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    # One end of a pair connects: the greater id, which `one_way` makes the later in the table too.
    "scouting/gossip/autoconnect_strategy": {
        "peer": {"to_router": "always", "to_peer": "greater-zid"}
    },
    # The lease is what the *others* wait before they take this process for gone.
    "transport/link/tx/lease": 1000,
    "transport/link/tx/keep_alive": 4,
    "connect/retry": {
        "period_init_ms": 200,
        "period_max_ms": 500,
        "period_increase_factor": 1.5,
    },
    # Or an attempt that began while a cable was out goes on for 10 s, less and less often.
    "transport/unicast/open_timeout": 2000,
    "transport/shared_memory/enabled": False,
    "timestamping/enabled": False,
    # Seeds that are not there yet are no reason to wait: links come up in the background.
    "open/return_conditions/connect_scouted": False,
    "open/return_conditions/declares": False,
}
"""Set on every process. Times in ms, as Zenoh has them."""


class Call:
    """A query that waits for its answer; one that is let go of unanswered is simply over."""

    __slots__ = ("_namespace", "_query", "key", "payload")

    def __init__(self, query: zenoh.Query, namespace: str, key: str) -> None:
        self._query = query
        self._namespace = namespace
        self.key = key
        self.payload = b"" if query.payload is None else query.payload.to_bytes()

    def reply(self, key: str, message: Message) -> None:
        """Answer, from a key that the query's covers, and be done with it."""
        self._query.reply(rooted(self._namespace, key), encode(message))
        self._query.drop()  # type: ignore[no-untyped-call]


class ZenohMesh(Reader, Monotonic):
    """One process's session, within one robot's namespace: a `Mesh`.

    Zenoh's own namespace would hold what robots share, too (`rooted`): keys are placed here.
    """

    def __init__(self, namespace: str, where: Topology) -> None:
        super().__init__()
        self.namespace = namespace
        self._where = where
        self._session: zenoh.Session | None = None
        self._repair: Repair | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._kept: list[Any] = []  # declarations live as long as somebody holds them
        self._tokens: dict[str, zenoh.LivelinessToken] = {}

    def __enter__(self) -> ZenohMesh:
        self.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    # Joining and leaving -------------------------------------------------------------------------

    def open(self) -> None:
        """Join. Raises `MeshError` if none of the endpoints can be listened on, or no router comes.

        Peers that are not there yet are no reason to wait, nor to fail: they come in any order.
        """
        if self._where.client:
            self._attach()
        else:
            self._listen()
        atexit.register(self._end)
        links = _direct(self._linked)
        self._keep(self._open.info.declare_link_events_listener(links, history=True))

    def _listen(self) -> None:
        """Bind the first endpoints that are free."""
        failures = []
        *well_known, last = self._where.attempts
        for endpoints in (*well_known, last):
            try:
                self._session = zenoh.open(self._config(endpoints))
            except zenoh.ZError as error:
                failures.append(f"{', '.join(endpoints)}: {_reason(error)}")
            else:
                vacant = well_known if endpoints is last else ()
                self._repair = Repair(self, self._where.connect, vacant)
                self._repair.begin()
                return
        raise MeshError("cannot listen on " + "; ".join(failures))

    def _attach(self) -> None:
        """Wait for the router, which may come after its clients."""
        end = time.monotonic() + self._where.patience_s
        said = False
        while self._session is None:
            try:
                self._session = zenoh.open(self._config(()))
            except zenoh.ZError:
                if not said:
                    logger.warning("waiting for the router %s", ", ".join(self._where.connect))
                said = True
                if time.monotonic() >= end:
                    raise MeshError(
                        f"no router answers at {', '.join(self._where.connect)}"
                    ) from None

    def close(self, deadline: float = CLOSE_S) -> bool:
        """Leave; False if that took longer than `deadline` (s), and goes on by itself."""
        session = self._taken()
        if session is None:
            return True
        # Closing may block for long, and there is no time-out to give it. The end of a program
        # waits for it: a thread that comes back to an interpreter that has ended aborts it.
        closing = threading.Thread(target=self._leave, args=(session,), name="closing")
        closing.start()
        closing.join(deadline)
        return not closing.is_alive()

    def _taken(self) -> zenoh.Session | None:
        """The session to be closed, without its tokens; none if it has been closed."""
        session, self._session = self._session, None
        for token in self._tokens.values():
            token.undeclare()  # type: ignore[no-untyped-call]
        self._tokens.clear()
        atexit.unregister(self._end)
        return session

    def _end(self) -> None:
        """Close what a program has left open: Zenoh's threads would never let its process end."""
        session = self._taken()
        if session is not None:
            self._leave(session)

    def met(self) -> set[str]:
        """The ids of the peers that it has a link with; of none when it has left."""
        session = self._session
        return set() if session is None else _met(session)

    def open_beside(self, listen: tuple[str, ...] | None) -> _Beside | None:
        try:
            return _Beside(self._config(listen or (any_port(self._where.attempts[-1][0]),)))
        except zenoh.ZError:
            return None

    # Talking -------------------------------------------------------------------------------------

    def publish(self, key: str, message: Message, data: bytes | None = None) -> None:
        """See `Mesh`. One priority for all: or a stop and a speed could change places."""
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = self._open.declare_publisher(
                self._rooted(key),
                congestion_control=zenoh.CongestionControl.DROP,
                allowed_destination=zenoh.Locality.REMOTE,
            )
        publisher.put(encode(message) if data is None else data)

    def has_said(self, key: str) -> bool:
        """See `Mesh`: the first time a key has to be declared."""
        return key in self._publishers

    def subscribe(self, pattern: str, receiver: Receiver) -> None:
        where, root = self._placed(pattern)

        def arrived(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr)
            if "*" in key:
                own = key.startswith(where[:root])
                self.refuse(key[root:] if own else key, "published by wildcard")
            else:
                receiver(key[root:], sample.payload.to_bytes())

        self._keep(self._open.declare_subscriber(where, _direct(arrived)))

    def ask(
        self,
        key: str,
        request: Message,
        timeout: float,
        each: Receiver,
        done: Callable[[], None],
    ) -> None:
        """See `Mesh`; both are called on Zenoh's thread."""
        where, root = self._placed(key)

        def replied(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                each(str(reply.ok.key_expr)[root:], reply.ok.payload.to_bytes())

        self._open.get(
            where,
            zenoh.handlers.Callback(replied, done, indirect=False),
            payload=encode(request),
            timeout=timeout,
            target=zenoh.QueryTarget.ALL,
            congestion_control=zenoh.CongestionControl.DROP,  # never wait for one that hangs
            consolidation=zenoh.ConsolidationMode.NONE,
        )

    def answer(self, key: str, receiver: Callable[[Call], None]) -> None:
        where, root = self._placed(key)

        def asked(query: zenoh.Query) -> None:
            receiver(Call(query, self.namespace, str(query.key_expr)[root:]))

        self._keep(self._open.declare_queryable(where, _direct(asked)))

    # Liveliness ----------------------------------------------------------------------------------

    def declare_alive(self, name: str, instance: str) -> None:
        key = TOKEN.format(name=name, instance=instance)
        self._tokens[key] = self._open.liveliness().declare_token(self._rooted(key))

    def watch_alive(self, changed: Callable[[str, str, bool], None]) -> None:
        where, root = self._placed(TOKEN.format(name="*", instance="*"))

        def arrived(sample: zenoh.Sample) -> None:
            chunks = str(sample.key_expr)[root:].split("/")
            if len(chunks) == 3 and "*" not in chunks:
                changed(chunks[1], chunks[2], sample.kind == zenoh.SampleKind.PUT)

        self._keep(
            self._open.liveliness().declare_subscriber(where, _direct(arrived), history=True)
        )

    # Inside --------------------------------------------------------------------------------------

    @property
    def _open(self) -> zenoh.Session:
        if self._session is None:
            raise MeshError("the mesh has not been joined, or has been left")
        return self._session

    def _rooted(self, key: str) -> str:
        return rooted(self.namespace, key)

    def _placed(self, key: str) -> tuple[str, int]:
        """A key or pattern as the network has it, and how much longer that is: cut off again."""
        where = self._rooted(key)
        return where, len(where) - len(key)

    def _keep(self, declaration: Any) -> None:
        self._kept.append(declaration)

    def _leave(self, session: zenoh.Session) -> None:
        if self._repair is not None:
            self._repair.close()
        session.close()  # type: ignore[no-untyped-call]

    def _linked(self, event: zenoh.LinkEvent) -> None:
        release_links()
        if event.kind == zenoh.SampleKind.DELETE and self._repair is not None:
            self._repair.lost(str(event.link.zid), str(event.link.dst))

    def _config(self, listen: tuple[str, ...]) -> zenoh.Config:
        config = zenoh.Config()
        connect, rank = one_way(listen, self._where.connect)
        own: dict[str, Any] = {
            "id": _session_id(rank),
            "listen/endpoints": list(listen),
            "connect/endpoints": list(connect),
        }
        if self._where.client:
            own |= {"mode": "client", "connect/timeout_ms": ATTEMPT_MS}
        if self._where.multicast:
            own |= {"scouting/multicast/enabled": True}
        for key, value in (SETTINGS | own).items():
            config.insert_json5(key, json.dumps(value))
        return config


class _Beside:
    def __init__(self, config: zenoh.Config) -> None:
        """Raises `zenoh.ZError` if it cannot listen."""
        self._session = zenoh.open(config)
        released = _direct(lambda _event: release_links())
        self._links = self._session.info.declare_link_events_listener(released, history=True)

    def met(self) -> set[str]:
        return _met(self._session)

    def close(self) -> None:
        self._links.undeclare()  # type: ignore[no-untyped-call]
        try:
            self._session.close()  # type: ignore[no-untyped-call]
        except zenoh.ZError as error:  # after 10 s, on a machine with too much to do
            logger.debug("a session beside is left behind: %s", error)


def _met(session: zenoh.Session) -> set[str]:
    return {str(peer) for peer in session.info.peers_zid()}


def _session_id(rank: int) -> str:
    """A new id, hexadecimal. Zenoh compares ids by the last byte first: that is the rank."""
    return f"{random.SystemRandom().getrandbits(120) | 1 << 119:030x}{rank:02x}"


def _direct(callback: Callable[[Any], None]) -> Any:
    """Call on the thread that received it: one hop less than through a thread of its own."""
    return zenoh.handlers.Callback(callback, indirect=False)


REASONS: Final = {
    "address already in use": "another process has that port; name one that is free, or none",
    "cannot assign requested address": "that is no address of this machine",
    "permission denied": "ports below 1024 are not for everybody",
}
"""The system's error when it cannot listen, in words that help."""


def _reason(error: Exception) -> str:
    said = str(error)
    for system, words in REASONS.items():
        if system in said.lower():
            return words
    return said.partition(" at /")[0].partition("\n")[0]
