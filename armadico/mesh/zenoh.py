"""The mesh between processes: the only module that imports Zenoh.

Callbacks run on Zenoh's reception thread and must return soon: a slow one stops reception for the
whole process. Most put their bytes into a queue. The queue's owner decodes them with
`ZenohMesh.read`, so a value that is replaced in the queue is never decoded.

A client may be used before it is linked to its router. Its declarations are made once it is linked,
its publications are dropped, and its queries get no reply. When the link is lost it opens a new
session. Zenoh would link the old session again, but a router that had hung then forwards the
waiting messages under wrong keys, because it uses the old key numbers (measured with 1.10.2: some
hundred messages after each hang of more than the lease).
"""

from __future__ import annotations

import atexit
import ctypes
import json
import logging
import os
import random
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Final

# One worker of Zenoh for everything instead of five: they have little work per message, and handing
# it over woke each process 20 times a cycle. Zenoh reads this variable when it is loaded.
os.environ.setdefault(
    "ZENOH_RUNTIME",
    "(rx: (worker_threads: 1), tx: (handover: rx), acc: (handover: rx),"
    " net: (handover: rx), app: (handover: rx))",
)

import zenoh

from armadico.core.messages import LARGEST_PAYLOAD, Message, encode
from armadico.core.services import TOKEN
from armadico.core.shared import shared
from armadico.mesh import sockets
from armadico.mesh.base import Monotonic, Reader, Receiver
from armadico.mesh.door import Door
from armadico.mesh.linger import release_links
from armadico.mesh.presence import Changed, Presence
from armadico.mesh.refusals import Refusals
from armadico.mesh.topology import MeshError, Topology, rooted, topology

logger = logging.getLogger("armadico.mesh")

CLOSE_S: Final = 1.0  # timeout of closing a session, which may block for 10 s
AGAIN_S: Final = 0.1  # between two attempts of a router to listen, s
QUICK: Final = 10  # so many first checks for a router on this computer
QUICK_S: Final = 0.02  # are at this period, s: one that reopens is back within 0.03 s
WARN_S: Final = 1.5  # after how long without a router a client logs that it waits, s
PROBE_S: Final = 1.0  # timeout of connecting to a router on another computer
TRY_S: Final = 1.0  # how long opening waits for a router, if there is one
ANSWER_S: Final = 0.5  # timeout of querying whether an endpoint leads to the robot's router
PEERS_S: Final = 1.0  # how often a router checks for robots that share keys on this computer, s
NOTED: Final = 1000  # kinds of messages and keys whose rights are checked once
PASSED_ON: Final = b"shared"  # marks another robot's publication, which is not passed on again
ROUTER: Final = "router/{id}"  # the liveliness token of a robot's router

# Zenoh's settings in every process. Times in ms.
SETTINGS: Final[dict[str, object]] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,  # otherwise opening waits for scouting, which is disabled
    # How long *others* wait before this process counts as gone.
    "transport/link/tx/lease": 1000,
    "transport/link/tx/keep_alive": 4,
    "connect/timeout_ms": 2500,  # of one attempt; joining a hanging router takes as long
    "connect/retry": {
        "period_init_ms": 200,
        "period_max_ms": 500,
        "period_increase_factor": 1.5,
    },
    # By default an attempt that began while a cable was out goes on for 10 s.
    "transport/unicast/open_timeout": 2000,
    # Connections that have not introduced themselves, on all listeners together. By default 100,
    # for 10 s each: that many silent ones at the TCP port kept everyone from the Unix socket.
    "transport/unicast/accept_pending": 4096,
    "transport/unicast/accept_timeout": 2000,
    "transport/shared_memory/enabled": False,
    "timestamping/enabled": False,
    "open/return_conditions/connect_scouted": False,
    "open/return_conditions/declares": False,
}

# A router's settings besides. A client chooses itself how large its messages are and whether they
# wait for a receiver that is slow. One of 50 MB that waits (BLOCK) would stop all forwarding for
# more than 10 s, and so would many small ones. Ours are small and never wait.
_KINDS: Final = ["put", "delete", "query"]
ROUTING: Final[dict[str, object]] = {
    "transport/link/rx/max_message_size": 4 * LARGEST_PAYLOAD,  # of one in fragments
    "low_pass_filter": [
        {
            "id": "small",
            "messages": [*_KINDS, "reply"],
            "flows": ["ingress"],
            "key_exprs": ["**"],
            "size_limit": LARGEST_PAYLOAD + len(PASSED_ON),
        }
    ],
    "qos/network": [
        {
            "messages": _KINDS,
            "flows": ["ingress"],
            "key_exprs": ["**"],
            "overwrite": {"congestion_control": "drop", "priority": "data", "express": False},
        }
    ],
}

Declare = Callable[[zenoh.Session], None]  # makes a declaration in a session


class Call:
    """A received query: a `base.Call`."""

    __slots__ = ("_namespace", "_query", "key", "payload")

    def __init__(self, query: zenoh.Query, namespace: str, key: str) -> None:
        self._query = query
        self._namespace = namespace
        self.key = key
        self.payload = b"" if query.payload is None else query.payload.to_bytes()

    def reply(self, key: str, message: Message) -> None:
        data = encode(message)
        try:
            self._query.reply(rooted(self._namespace, key), data)
            self._query.drop()  # type: ignore[no-untyped-call]
        except zenoh.ZError as error:  # the link that it came by is lost
            logger.debug("no reply on %s: %s", key, error)


@dataclass
class Declared:
    """A session's declarations. They exist as long as they are referenced here."""

    publishers: dict[str, zenoh.Publisher] = field(default_factory=dict)
    tokens: dict[str, zenoh.LivelinessToken] = field(default_factory=dict)
    kept: list[object] = field(default_factory=list)

    def clear(self) -> None:
        self.kept.clear()
        self.publishers.clear()
        self.tokens.clear()


class ZenohMesh(Reader, Monotonic):
    """One process's session, within one robot's namespace: a `Mesh`.

    Zenoh's own namespaces are not used, because they would also prefix the keys that robots share
    (`rooted`).
    """

    def __init__(self, namespace: str, where: Topology, *, starts: bool = False) -> None:
        """Prepare without joining.

        `starts`: the robot agent is being started: log a missing one as information only.
        """
        super().__init__()
        self.namespace = namespace
        self.closed = where.door is not None
        # Its identity may publish as such a guest alone: by the last part of keys.
        own = "guest" if where.door is None else where.door.name.rpartition("/")[2]
        self.guest = f"{own}-{random.SystemRandom().getrandbits(64):016x}"
        self.router = ""  # the id of the router that it is linked to, or is; else empty
        self.joined_at = ""  # the endpoint of the router that it was last linked to
        self._level = logging.INFO if starts else logging.WARNING
        self.where = where  # how it joins, at present
        self._lock = threading.RLock()
        self._reopening = threading.Lock()
        self._session: zenoh.Session | None = None
        self._declarations: list[Declare] = []  # to be made in each session
        self._opened = False
        self._joined = threading.Event()
        self._tried = threading.Event()  # after the first attempt to join
        self.hung = ""  # the router that accepted a connection and has not answered yet
        self._refusals = Refusals(namespace, where)
        self._left = threading.Event()
        self._seeking: threading.Thread | None = None
        self._closing: threading.Thread | None = None  # closes a session whose link is lost
        self._declared = Declared()
        self._noted: set[tuple[str, str]] = set()  # checked by the door
        self._agent_watchers: list[Changed] = []
        self._router_watchers: list[Callable[[bool], None]] = []
        self._presence = Presence(self._notify_agent, self._notify_router, reachable=where.router)
        self._peers: PeerLinks | None = None
        self._stop_keeping: Callable[[], None] | None = None  # the door
        self._timer: threading.Timer | None = None

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

    @property
    def door(self) -> Door | None:
        """The identity by which it joins; None: the society is open."""
        return self.where.door

    @property
    def missing(self) -> str:
        """Why the mesh has not been joined, and what to do: for people."""
        own = [str(self._socket())] if self.where.socket else []
        if why := self._refusals.why(self.hung):
            return why
        if self.hung:
            pid = sockets.owner(sockets.lock_of(self._socket())) if [self.hung] == own else None
            who = "the robot agent" if pid is None else f"the robot agent (process {pid})"
            guard = None if pid is None else sockets.guard_now(self.namespace)
            did = "" if guard is None else f"; {guard.did}"
            return f"{who} does not answer at {self.hung}{did}. Continue its process, or restart it"
        if own and sockets.is_deleted(self._socket()):
            return (
                f"the socket {own[0]} was deleted while a robot agent listens on it: end its"
                " society (`armadico down`, or Ctrl-C where it was started) and start it again"
            )
        places = " or ".join([*own, *self.where.connect])
        found = sockets.elsewhere(self.namespace) if own else {}
        also = f". {sockets.shown(found)}" if found else ""
        return f"no robot agent at {places}; start one with `armadico up`{also}"

    def open(self) -> None:
        """Join. A client without a router yet goes on trying, and can be used meanwhile.

        Raises MeshError if a router cannot listen: another one exists, or the address is not this
        machine's. Raises TopologyError if the socket cannot be created.
        """
        atexit.register(self._end)
        if self.where.router:
            self._listen()
            try:
                self._keep_door()
            except MeshError:
                self.close()
                raise
            return
        self._keep_door()
        self._opened = True
        if self.where.socket:
            self._socket()  # raises its errors here, not in the thread
        self._start_seeking()
        self._tried.wait(TRY_S)  # limited, as a hanging router accepts a connection and no more

    def wait_joined(self, timeout: float) -> bool:
        return self._joined.wait(timeout)

    def _socket(self) -> Path:
        return sockets.socket_of(self.namespace)

    def _listen(self) -> None:
        """Open the session of a router: one per namespace and computer."""
        path = self._socket()
        if path.is_dir():
            raise MeshError(f"{path} is a folder, and the socket would be there: remove it")
        listen = self._endpoints(self.where)
        try:
            session = zenoh.open(self._config(self.where, listen))
        except zenoh.ZError as error:
            if (there := sockets.holder(path)) is not None:
                raise MeshError(
                    f"process {there} is the router of the namespace {self.namespace!r}"
                    f" already ({path}): `armadico down` ends it, --namespace names another"
                ) from None
            raise MeshError(f"cannot listen on {', '.join(listen)}: {reason(error)}") from None
        door = self.where.door
        sockets.note_keys(self.namespace, "" if door is None else door.folder)
        self._begin(session)
        self._peers = PeerLinks(self, self.where.peers, self.where.door)

    def _endpoints(self, where: Topology) -> tuple[str, ...]:
        """The endpoints of a router's session. Its door listens on those over TLS."""
        own = [end for end in where.listen if where.door is None or not end.startswith("tls/")]
        return (sockets.endpoint(self._socket()), *own)

    def _keep_door(self) -> None:
        door = self.where.door
        if door is not None and not door.is_foreign:
            self._stop_keeping = door.keep(self)

    def reopen(self, where: Topology) -> None:
        """Replace a router's session by one with other settings, within this process.

        Zenoh reads rights, users and certificates only when a session opens. All clients lose their
        links and join the new session; what is published in between is lost. Raises MeshError if
        the new settings cannot be used: the session continues, or was opened again with the old
        ones.
        """
        assert self.where.router, "a client joins anew by itself"
        listen = self._endpoints(where)
        with self._reopening:
            try:
                config = self._config(where, listen)
            except zenoh.ZError as error:
                raise MeshError(f"these settings cannot be used: {reason(error)}") from None
            with self._lock:
                session, self._session = self._open, None
                # The clients keep what they know of each other until they are linked again.
                self._declared.tokens[ROUTER.format(id=self.router)].undeclare()  # type: ignore[no-untyped-call]
                ending = self._ending(session)
                self._presence.begin_again(self.now())
                self._wait_for_due()
            ending()
            try:
                new = zenoh.open(config)
            except zenoh.ZError as error:
                self._begin(self._opened_again())
                raise MeshError(f"these settings cannot be used: {reason(error)}") from None
            self.where = where
            self._begin(new)

    def _opened_again(self) -> zenoh.Session:
        """Return a session of the router with its present settings, which worked before."""
        listen = self._endpoints(self.where)
        while True:
            try:
                return zenoh.open(self._config(self.where, listen))
            except zenoh.ZError as error:  # a client's port may be the router's for a moment
                logger.error("the router cannot listen: %s; trying again", reason(error))
                if self._left.wait(AGAIN_S):
                    raise MeshError("the mesh has been left") from None

    def _start_seeking(self) -> None:
        seeking = threading.Thread(target=self._seek, name="joining", daemon=True)
        seeking.start()
        self._seeking = seeking

    def _seek(self) -> None:
        """Wait for the router, which may start after its clients."""
        warning = threading.Timer(WARN_S, self._log_missing)
        warning.daemon = True
        warning.start()
        tries = 0
        while not (self._left.is_set() or self._seek_once()):
            self._tried.set()
            tries += 1
            is_quick = self.where.socket and tries <= QUICK
            self._left.wait(QUICK_S if is_quick else self._refusals.pause)
        self._tried.set()
        warning.cancel()

    def _log_missing(self) -> None:
        if not (self._joined.is_set() or self._left.is_set()):
            level = logging.WARNING if self._refusals.why(self.hung) else self._level
            logger.log(level, "%s; waiting for it", self.missing)

    def _seek_once(self) -> bool:
        """Join a router that is there now; return whether there was one."""
        path = self._socket() if self.where.socket else None
        if path is not None and sockets.holder(path) is not None:
            return self._join(sockets.endpoint(path), str(path))
        connect = self.where.connect
        answering = [there for there in connect if self._refusals.answers(there, PROBE_S)]
        if not answering:
            self.hung = ""
        return any(self._join(there, there) for there in answering)

    def _join(self, there: str, shown: str) -> bool:
        """Join by the router at an endpoint, `shown` for people; return whether it succeeded."""
        self.hung = shown
        try:
            session = zenoh.open(self._config(self.where, connect=(there,)))
        except (zenoh.ZError, OSError) as error:  # OSError: a file of the door cannot be read
            logger.debug("%s: %s", there, error)
            self._refusals.failed(there)
            return False
        self.hung, self.joined_at = "", there
        self._refusals.joined()
        if len(self.where.connect) > 1 and not self._leads_to_robot(session):
            _close(session)
            return False
        self._begin(session)
        return True

    def _leads_to_robot(self, session: zenoh.Session) -> bool:
        """Return whether the session's router is the robot's.

        Of several endpoints some are other robots', whose routers forward nothing of this robot.
        """
        tokens: list[zenoh.Reply] = []
        over = threading.Event()
        on_reply = zenoh.handlers.Callback(tokens.append, over.set, indirect=False)
        key = self._rooted(ROUTER.format(id="*"))
        session.liveliness().get(key, on_reply, timeout=ANSWER_S)
        over.wait(2 * ANSWER_S)
        return any(token.ok is not None for token in tokens)

    def _begin(self, session: zenoh.Session) -> None:
        """Use a new session and make all declarations in it; close it if the mesh was left."""
        with self._lock:
            left = self._left.is_set()
            if not left:
                self._declare_all(session)
        if left:  # without the lock: closing waits for threads that may wait for it
            _close(session)

    def _declare_all(self, session: zenoh.Session) -> None:
        """Make all declarations in a session, the mesh's from now on; the lock is held."""
        self._opened, self._session = True, session
        linked = _direct(lambda event: self._linked(session, event))
        self._keep(session.info.declare_link_events_listener(linked, history=True))
        if self.where.router:
            self.router = str(session.info.zid())
            key = ROUTER.format(id=self.router)
            self._declared.tokens[key] = session.liveliness().declare_token(self._rooted(key))
        else:
            where, root = self._placed(ROUTER.format(id="*"))
            self._watch_tokens(session, where, root, self._router_token)
        for declare in self._declarations:
            declare(session)
        self._joined.set()

    def _lose(self, session: zenoh.Session) -> None:
        """Replace a session whose link to the router is lost by a new one."""
        if self._session is not session or self._left.is_set():
            return
        self._session = None
        self.router = ""
        self._joined.clear()
        ending = self._ending(session)
        self._presence.link(False, self.now())
        # The end of the program waits for it, as in `close`. Without `daemon=False` the thread
        # would inherit `daemon` from Zenoh's thread.
        self._closing = threading.Thread(target=ending, name="closing", daemon=False)
        self._closing.start()
        self._start_seeking()

    def close(self, deadline: float = CLOSE_S) -> bool:
        """Leave; False if that takes longer than `deadline` (s) and continues in the background."""
        session = self._detach()
        if session is None:
            self._leave_door()
            return True
        # Closing may block for long and has no timeout. The end of the program waits for it,
        # because a thread that returns to an ended interpreter aborts the process.
        closing = threading.Thread(target=self._ending(session), name="closing")
        closing.start()
        closing.join(deadline)
        self._leave_door()
        return not closing.is_alive()

    def _leave_door(self) -> None:
        """Let the door go, after what was published last."""
        if self._stop_keeping is not None:
            self._stop_keeping()
            self._stop_keeping = None

    def _detach(self) -> zenoh.Session | None:
        """Return the session to close, without its tokens; None if there is none."""
        self._left.set()
        if self._peers is not None:
            self._peers.close()
        with self._lock:
            session, self._session = self._session, None
            if self._timer is not None:
                self._timer.cancel()
        if self._seeking is not None:
            self._seeking.join(ANSWER_S)
            if self._seeking.is_alive():  # within Zenoh: the end of the program waits for it, too
                threading.Thread(target=self._seeking.join, name="joining ends").start()
        # A router's own token goes last, and before its links.
        for token in reversed(self._declared.tokens.values()):
            token.undeclare()  # type: ignore[no-untyped-call]
        self._declared.tokens.clear()
        atexit.unregister(self._end)
        return session

    def _end(self) -> None:
        """Close a mesh that the program left open: Zenoh's threads would keep the process alive."""
        session = self._detach()
        for thread in (self._seeking, self._closing):
            if thread is not None:
                thread.join()
        if session is not None:
            self._ending(session)()
        self._leave_door()

    def _ending(self, session: zenoh.Session) -> Callable[[], None]:
        """Return a function that closes a session and then frees its declarations.

        The garbage collector must not free them: it would do so in any thread that allocates, and
        wait for Zenoh's own thread, which may wait for a lock of that thread.
        """
        declared, self._declared = self._declared, Declared()
        if self.where.router:
            _keep(session)

        def end() -> None:
            _close(session)
            declared.clear()

        return end

    # Messages ------------------------------------------------------------------------------------

    def publish(self, key: str, message: Message, data: bytes | None = None) -> None:
        data = encode(message) if data is None else data
        publisher = self._declared.publishers.get(key) or self._publisher(key)
        if publisher is None:
            return
        try:
            publisher.put(data)
        except zenoh.ZError:
            if self._declared.publishers.get(key) is publisher:  # else the link was just lost
                raise

    def _publisher(self, key: str) -> zenoh.Publisher | None:
        """Return a new publisher; None while there is no router."""
        with self._lock:
            if self._waits:
                return None
            self._note_forbidden("put", key)
            # All have the default priority: otherwise a stop and a speed could change order.
            publisher = self._declared.publishers[key] = self._open.declare_publisher(
                self._rooted(key),
                congestion_control=zenoh.CongestionControl.DROP,
                allowed_destination=zenoh.Locality.REMOTE,
            )
            return publisher

    def is_declared(self, key: str) -> bool:
        return key in self._declared.publishers or self._waits

    def subscribe(self, pattern: str, receiver: Receiver, *, passed_on: bool = True) -> None:
        """See `Mesh`; `passed_on`: include publications that other robots share."""
        where, root = self._placed(pattern)
        self._note_forbidden("declare_subscriber", pattern)

        def declare(session: zenoh.Session) -> None:
            def arrived(sample: zenoh.Sample) -> None:
                key = str(sample.key_expr)
                if self._session is not session:
                    return  # it is being closed
                if sample.attachment is not None and not passed_on:
                    return
                if "*" in key:
                    own = key.startswith(where[:root])
                    self.refuse(key[root:] if own else key, "published by wildcard")
                else:
                    receiver(key[root:], sample.payload.to_bytes())

            self._keep(session.declare_subscriber(where, _direct(arrived)))

        self._declare(declare)

    def pass_on(self, key: str, data: bytes) -> None:
        """Publish another robot's publication, marked as such."""
        session = self._session
        if session is not None:
            session.put(
                self._rooted(key),
                data,
                congestion_control=zenoh.CongestionControl.DROP,
                attachment=PASSED_ON,
            )

    def query(
        self,
        key: str,
        request: Message,
        timeout: float,
        each: Receiver,
        done: Callable[[], None],
    ) -> None:
        """See `Mesh`; both are called on Zenoh's thread."""
        where, root = self._placed(key)
        self._note_forbidden("query", key)

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                each(str(reply.ok.key_expr)[root:], reply.ok.payload.to_bytes())

        payload = encode(request)
        with self._lock:
            if not self._waits:
                self._open.get(
                    where,
                    zenoh.handlers.Callback(on_reply, done, indirect=False),
                    payload=payload,
                    timeout=timeout,
                    target=zenoh.QueryTarget.ALL,
                    congestion_control=zenoh.CongestionControl.DROP,  # never wait for a hanging one
                    consolidation=zenoh.ConsolidationMode.NONE,
                )
                return
        done()

    def answer(self, key: str, receiver: Callable[[Call], None]) -> None:
        where, root = self._placed(key)
        self._note_forbidden("declare_queryable", key)

        def on_query(query: zenoh.Query) -> None:
            receiver(Call(query, self.namespace, str(query.key_expr)[root:]))

        self._declare(lambda s: self._keep(s.declare_queryable(where, _direct(on_query))))

    def _note_forbidden(self, does: str, key: str) -> None:
        """Log once that the router drops a kind of message: nothing else tells its sender."""
        door = self.where.door
        if door is None or door.is_foreign or self.where.router or (does, key) in self._noted:
            return
        if len(self._noted) < NOTED:
            self._noted.add((does, key))
        if why := door.forbidden(does, key):
            logger.warning("%s", why)

    # Liveliness ----------------------------------------------------------------------------------

    def declare_alive(self, name: str, instance: str) -> None:
        key = TOKEN.format(name=name, instance=instance)
        self._note_forbidden("liveliness_token", key)

        def declare(session: zenoh.Session) -> None:
            self._declared.tokens[key] = session.liveliness().declare_token(self._rooted(key))
            self._presence.token(name, instance, True, self.now())

        self._declare(declare)

    def watch_alive(self, changed: Changed) -> None:
        with self._lock:
            first = not self._agent_watchers
            self._agent_watchers.append(changed)
            for agent in sorted(self._presence.reported):
                changed(*agent, True)
        if first:
            where, root = self._placed(TOKEN.format(name="*", instance="*"))
            self._declare(lambda s: self._watch_tokens(s, where, root, self._agent_token))

    @property
    def reachable(self) -> bool:
        return self._presence.reachable

    def watch_router(self, changed: Callable[[bool], None]) -> None:
        with self._lock:
            self._router_watchers.append(changed)
            changed(self._presence.reachable)

    # Changes of others, on Zenoh's threads and the timer's ----------------------------------------

    def _notify_agent(self, name: str, instance: str, there: bool) -> None:
        for changed in self._agent_watchers:
            changed(name, instance, there)

    def _notify_router(self, reachable: bool) -> None:
        for changed in self._router_watchers:
            changed(reachable)

    def _watch_tokens(
        self, session: zenoh.Session, where: str, root: int, then: Callable[[list[str], bool], None]
    ) -> None:
        def arrived(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr)
            chunks = key[root:].split("/")
            if "*" not in key:  # rights to a pattern are rights to declare the pattern
                with self._lock:
                    if self._session is session:
                        then(chunks[1:], sample.kind == zenoh.SampleKind.PUT)
                        self._wait_for_due()

        found = session.liveliness().declare_subscriber(where, _direct(arrived), history=True)
        self._keep(found)

    def _router_token(self, chunks: list[str], there: bool) -> None:
        # A router that ends closes one link after another: other agents' tokens go before ours.
        # Any client can declare and drop a token, so it is a reason to wait, and proves nothing.
        if not there and chunks == [self.router]:
            self._presence.inquire(self.now())

    def _agent_token(self, chunks: list[str], there: bool) -> None:
        if len(chunks) == 2:
            refused = self._presence.token(chunks[0], chunks[1], there, self.now())
            if refused:
                logger.warning("%s", refused)

    def _linked(self, session: zenoh.Session, event: zenoh.LinkEvent) -> None:
        there = event.kind == zenoh.SampleKind.PUT
        if not self.where.router:
            with self._lock:  # before the tokens of the link are processed
                if self._session is session:
                    if there:
                        self.router = str(event.link.zid)
                        self._presence.link(True, self.now())
                        self._wait_for_due()
                    else:
                        self._lose(session)
        if there:  # not for a lost link, which may be the end of the program: nothing may wait then
            release_links()

    def _wait_for_due(self) -> None:
        due = self._presence.due
        if due == float("inf") or self._timer is not None or self._left.is_set():
            return
        self._timer = threading.Timer(max(due - self.now(), 0.0), self._check_links)
        self._timer.daemon = True
        self._timer.start()

    def _check_links(self) -> None:
        with self._lock:
            self._timer = None
            self._presence.poll(self.now())
            self._wait_for_due()

    # Inside --------------------------------------------------------------------------------------

    @property
    def _waits(self) -> bool:
        """Whether it has no router yet."""
        return self._session is None and self._opened and not self._left.is_set()

    @property
    def _open(self) -> zenoh.Session:
        if self._session is None:
            raise MeshError("the mesh has not been joined, or has been left")
        return self._session

    def _declare(self, declare: Declare) -> None:
        """Make a declaration in this session and in later ones."""
        with self._lock:
            begun = self._opened or self._left.is_set()
            if begun and not self._waits:
                declare(self._open)
            self._declarations.append(declare)

    def _rooted(self, key: str) -> str:
        return rooted(self.namespace, key)

    def _placed(self, key: str) -> tuple[str, int]:
        """Return the full key or pattern, and the length of the prefix that it adds."""
        where = self._rooted(key)
        return where, len(where) - len(key)

    def _keep(self, declaration: object) -> None:
        self._declared.kept.append(declaration)

    @staticmethod
    def _config(
        where: Topology, listen: tuple[str, ...] = (), connect: tuple[str, ...] = ()
    ) -> zenoh.Config:
        config = zenoh.Config()
        own: dict[str, object] = {
            "mode": "router" if where.router else "client",
            "listen/endpoints": list(listen),
            "connect/endpoints": list(connect),
        }
        door = where.door
        own |= ROUTING if where.router else {}
        for key, value in (SETTINGS | own | (door.current() if door else {})).items():
            config.insert_json5(key, json.dumps(value))
        return config


class PeerLinks:
    """Passes on to a robot's society what the robots beside it publish on shared keys.

    It is a client of each other robot's router and passes on those keys, in one direction, so
    nothing else crosses between robots. Routers are not linked to each other: a link between
    Zenoh's routers (1.10.2) that returns after a hang stops forwarding for good.
    """

    def __init__(self, mesh: ZenohMesh, elsewhere: Sequence[str], door: Door | None) -> None:
        """Begin; `elsewhere` are endpoints of robots on other computers.

        The door is the robot's identity as their client.
        """
        self._mesh = mesh
        self._door = None if door is None else door.abroad()
        self._elsewhere = tuple(elsewhere)
        self._links: dict[str, ZenohMesh] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="peers", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join(CLOSE_S)
        for link in tuple(self._links.values()):
            link.close()

    def _keep(self) -> None:
        """Link to robots that appear, and close the links to those that have gone."""
        own = sockets.socket_of(self._mesh.namespace)
        for endpoint in self._elsewhere:
            self._link(endpoint)
        while not self._over.wait(PEERS_S):
            for path in sockets.peer_sockets(self._mesh.namespace):
                endpoint = sockets.endpoint(path)
                link = self._links.get(endpoint)
                if path == own or (link is not None and link.wait_joined(0.0)):
                    continue
                there = sockets.holder(path) is not None
                if link is None and there:
                    self._link(endpoint)
                elif link is not None and not there:
                    self._links.pop(endpoint).close()

    def _link(self, endpoint: str) -> None:
        where = topology(connect=endpoint, door=self._door)
        link = ZenohMesh(self._mesh.namespace, where, starts=True)

        own = self._mesh.namespace.rpartition("/")[2]

        def arrived(key: str, data: bytes) -> None:
            if key.split("/")[1] == own:
                self._mesh.refuse(key, "another robot published it as this one")
            elif self._is_needed(link):
                self._mesh.pass_on(key, data)

        for first in shared():
            link.subscribe(f"{first}/**", arrived, passed_on=False)
        self._links[endpoint] = link
        link.open()

    def _is_needed(self, link: ZenohMesh) -> bool:
        """Return whether this is the first link to its router; two endpoints may lead to one."""
        routers = [self._mesh.router]
        for other in tuple(self._links.values()):
            if other is link:
                break
            routers.append(other.router)
        return link.router not in routers


def _keep(session: zenoh.Session) -> None:
    """Never free a router's session: that costs 50 kB and a descriptor for each.

    Zenoh (1.10.2) frees it with Python's global lock held, and waits without a limit for a task of
    its only worker, which may wait for that lock to call a callback: the process hangs for good.
    """
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(session))


def _close(session: zenoh.Session) -> None:
    try:
        session.close()  # type: ignore[no-untyped-call]
    except zenoh.ZError as error:  # after 10 s, on a machine with too much to do
        logger.debug("a session is left behind: %s", error)


def _direct(callback: Callable[..., None]) -> Any:
    """Return a callback on the receiving thread, which saves a hop to another one."""
    return zenoh.handlers.Callback(callback, indirect=False)


# Explanations of the system's errors when a router cannot listen.
REASONS: Final = {
    "address already in use": "another process uses that port; name a free one, or none",
    "cannot assign requested address": "that is not an address of this machine",
    "permission denied": "ports below 1024 need privileges",
}


def reason(error: Exception) -> str:
    text = str(error)
    for system, words in REASONS.items():
        if system in text.lower():
            return words
    return text.partition(" at /")[0].partition("\n")[0]
