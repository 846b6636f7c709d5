"""Every kind of message of every identity on every key, tried on one live router.

The clients are plain Zenoh sessions, which restrict nothing themselves. A message that a client's
session has sent before an answered query has been processed by the router, so nothing waits.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest
import zenoh

from armadico.core.messages import Log
from armadico.keys.expressions import covers
from armadico.keys.rights import Does, Table
from armadico.mesh import sockets
from armadico.mesh.door import ACCESS, MCP, PAGE, ROS2, SIMULATOR, USER, VIEWER, Door
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import SETTINGS, ZenohMesh
from tests.keys.members import ANNA, ANNA_B, CLAUDE, LAB, everybody

NAMESPACE = "matrix"
BESIDE = "other/robot"  # the router of a robot that shares keys with this one
BARRIER = f"{NAMESPACE}/router/*"
ANSWER_S = 5.0
BLOCK = zenoh.CongestionControl.BLOCK  # as so much at once is otherwise dropped


KINDS = (
    *("goto", "avoid", "encoder", "interface", "path-planning", "planner-onward", "monitor"),
    *("fleet", "teleop", LAB, ANNA, ANNA_B, PAGE, MCP, CLAUDE, ROS2, VIEWER, SIMULATOR),
)
"""One identity of each kind, and agents of each kind; the rights of others differ by names only."""


def concrete(expression: str) -> str:
    """A key that an expression matches."""
    return expression.replace("$*", "1f").replace("**", "x").replace("*", "x")


class Lab:
    """A router with all rights, and a session of each identity."""

    def __init__(self, rights: Table, folder: Path) -> None:
        self.rights = rights
        users = folder / "users"
        names = [BESIDE, *(f"{NAMESPACE}/{name}" for name in rights.speakers)]
        users.write_text("\n".join(f"{name}:password" for name in names))
        door = Door(
            f"{NAMESPACE}/robot",
            {
                f"{USER}user": f"{NAMESPACE}/robot",
                f"{USER}password": "password",
                f"{USER}dictionary_file": str(users),
                ACCESS: rights.access_control(NAMESPACE, [BESIDE.partition("/")[0]]),
            },
        )
        self.mesh = ZenohMesh(NAMESPACE, topology(router=True, door=door))
        self.mesh.open()
        assert self.mesh._session is not None
        self.router: zenoh.Session = self.mesh._session
        self._sessions: dict[str, zenoh.Session] = {}

    def close(self) -> None:
        for session in self._sessions.values():
            session.close()  # type: ignore[no-untyped-call]
        self.mesh.close()

    @cached_property
    def expressions(self) -> tuple[str, ...]:
        """Each expression of a right of anybody, each key of one, and all others' wildcards."""
        found = {concrete(right.key) for right in self.rights.rights}
        tried = [name for name in KINDS if name in self.rights.speakers]
        own = {key for name in tried for key in self.rights.allowed(name, Does.PUT) if "*" in key}
        return (*sorted(found | own), "**", "robot/**", "*/**", "robot/cmd/$*1f", "nobody/knows")

    @property
    def keys(self) -> list[str]:
        return [key for key in self.expressions if "*" not in key]

    def session(self, identity: str) -> zenoh.Session:
        if identity not in self._sessions:
            config = zenoh.Config()
            endpoint = sockets.endpoint(sockets.socket_of(NAMESPACE))
            own: dict[str, object] = {
                "mode": "client",
                "connect/endpoints": [endpoint],
                "transport/unicast/qos/enabled": False,  # one queue: nothing overtakes
                f"{USER}user": identity if "/" in identity else f"{NAMESPACE}/{identity}",
                f"{USER}password": "password",
            }
            for key, value in (SETTINGS | own).items():
                config.insert_json5(key, json.dumps(value))
            self._sessions[identity] = zenoh.open(config)
        return self._sessions[identity]

    @contextmanager
    def heard(self, declare: Callable[..., Any]) -> Iterator[tuple[set[str], set[str]]]:
        """Declare something of the router on all keys; yield the keys put and deleted."""
        put, deleted = set[str](), set[str]()

        def hear(sample: zenoh.Sample) -> None:
            (put if sample.kind == zenoh.SampleKind.PUT else deleted).add(bare(sample.key_expr))

        declared = declare("**", direct(hear))
        yield put, deleted
        undeclare([declared])

    def settle(self, session: zenoh.Session) -> None:
        """Wait until the router has processed what a session has sent, and the other way round."""
        found = session.liveliness().get(BARRIER, timeout=ANSWER_S)
        assert any(True for _ in found), "every identity may look for its router"

    def allowed(self, identity: str, does: Does) -> set[str]:
        rights, denied = self.rights.allowed(identity, does), self.rights.denied(identity, does)

        def covered(key: str, rules: set[str]) -> bool:
            return any(covers(rule, key) for rule in rules)

        return {k for k in self.expressions if covered(k, rights) and not covered(k, denied)}


def rooted(key: str) -> str:
    return f"{key if key.startswith('fleet/') else f'{NAMESPACE}/{key}'}"


def bare(key: object) -> str:
    return str(key).removeprefix(f"{NAMESPACE}/")


def direct(callback: Callable[[Any], None]) -> Any:
    return zenoh.handlers.Callback(callback, indirect=False)


def undeclare(declared: Iterable[Any]) -> None:
    for each in declared:
        each.undeclare()


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    with pytest.MonkeyPatch.context() as patch:
        runtime = tmp_path_factory.mktemp("runtime")
        runtime.chmod(0o700)
        patch.setenv("XDG_RUNTIME_DIR", str(runtime))
        lab = Lab(everybody(NAMESPACE), tmp_path_factory.mktemp("users"))
        yield lab
        lab.close()


@pytest.fixture(params=KINDS)
def identity(lab: Lab, request: pytest.FixtureRequest) -> str:
    name: str = request.param
    if name not in lab.rights.speakers:
        pytest.skip(f"{name} is not installed")
    return name


def test_puts_and_deletes_arrive_on_allowed_keys_only(lab: Lab, identity: str) -> None:
    session = lab.session(identity)
    with lab.heard(lab.router.declare_subscriber) as (put, deleted):
        for key in lab.expressions:
            session.put(rooted(key), b"x", congestion_control=BLOCK)
            session.delete(rooted(key), congestion_control=BLOCK)
        lab.settle(session)
        assert put == lab.allowed(identity, Does.PUT)
        assert not deleted


def test_tokens_are_seen_on_allowed_keys_only(lab: Lab, identity: str) -> None:
    session = lab.session(identity)
    with lab.heard(lab.router.liveliness().declare_subscriber) as (seen, _gone):
        tokens = [session.liveliness().declare_token(rooted(key)) for key in lab.expressions]
        lab.settle(session)
        undeclare(tokens)
        lab.settle(session)
        assert seen == lab.allowed(identity, Does.TOKEN)


def test_queries_arrive_on_allowed_keys_only(lab: Lab, identity: str) -> None:
    session, got = lab.session(identity), set[str]()
    answers = lab.router.declare_queryable("**", direct(lambda q: got.add(bare(q.key_expr))))
    lab.settle(session)
    for key in lab.expressions:
        session.get(rooted(key), timeout=ANSWER_S, congestion_control=BLOCK)
    lab.settle(session)
    undeclare([answers])
    assert got == lab.allowed(identity, Does.QUERY)


def test_tokens_are_looked_for_on_allowed_keys_only(lab: Lab, identity: str) -> None:
    session = lab.session(identity)
    tokens = [lab.router.liveliness().declare_token(rooted(key)) for key in lab.keys]
    found = {
        key for key in lab.expressions if [*session.liveliness().get(rooted(key), timeout=ANSWER_S)]
    }
    undeclare(tokens)
    assert found == lab.allowed(identity, Does.LOOK)


def test_publications_reach_allowed_subscriptions_only(lab: Lab, identity: str) -> None:
    session = lab.session(identity)
    allowed = lab.allowed(identity, Does.SUBSCRIBE)

    def heard(patterns: list[str]) -> set[str]:
        got = set[str]()
        hear = direct(lambda sample: got.add(bare(sample.key_expr)))
        subscribers = [session.declare_subscriber(rooted(each), hear) for each in patterns]
        lab.settle(session)
        for key in lab.keys:
            lab.router.put(rooted(key), b"x", congestion_control=BLOCK)
        lab.settle(session)
        undeclare(subscribers)
        lab.settle(session)
        return got

    assert not heard([key for key in lab.expressions if key not in allowed])
    assert heard([*allowed]) == {k for k in lab.keys if any(covers(each, k) for each in allowed)}


def test_tokens_reach_allowed_watchers_only(lab: Lab, identity: str) -> None:
    session, got = lab.session(identity), set[str]()
    allowed = lab.allowed(identity, Does.WATCH)
    hear = direct(lambda sample: got.add(bare(sample.key_expr)))
    watchers = [
        session.liveliness().declare_subscriber(rooted(key), hear)
        for key in lab.expressions
        if key not in allowed
    ]
    lab.settle(session)
    tokens = [lab.router.liveliness().declare_token(rooted(key)) for key in lab.keys]
    lab.settle(session)
    undeclare([*watchers, *tokens])
    assert not got


def test_queries_are_answered_on_allowed_keys_only(lab: Lab, identity: str) -> None:
    session, asked = lab.session(identity), set[str]()

    def on_query(query: zenoh.Query) -> None:
        asked.add(bare(query.key_expr))
        with query:
            query.reply(query.key_expr, b"x")

    answers = [session.declare_queryable(rooted(key), direct(on_query)) for key in lab.keys]
    lab.settle(session)
    got = {
        key
        for key in lab.keys
        if any(reply.ok for reply in lab.router.get(rooted(key), timeout=ANSWER_S))
    }
    undeclare(answers)
    assert asked == got == lab.allowed(identity, Does.ANSWER) & {*lab.keys}


def test_replies_arrive_from_allowed_keys_only(lab: Lab, identity: str) -> None:
    session = lab.session(identity)
    own = sorted(lab.allowed(identity, Does.ANSWER) & {*lab.keys})

    def on_query(query: zenoh.Query) -> None:
        with query:
            for key in lab.keys:
                query.reply(rooted(key), b"forged")

    for key in own[:1]:  # the others differ by name only, and guests answer nothing
        answers = session.declare_queryable(rooted(key), direct(on_query))
        lab.settle(session)
        replies = lab.router.get(
            f"{rooted(key)}?_anyke",
            timeout=ANSWER_S,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
        got = {bare(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        undeclare([answers])
        assert got == lab.allowed(identity, Does.REPLY) & {*lab.keys}
    assert bool(own) == bool(lab.rights.allowed(identity, Does.REPLY))


def test_the_router_of_another_robot_may_only_read_what_robots_share(lab: Lab) -> None:
    session, got = lab.session(BESIDE), set[str]()
    hear = direct(lambda sample: got.add(str(sample.key_expr)))
    patterns = [*map(rooted, lab.expressions), "fleet/**"]
    with lab.heard(lab.router.declare_subscriber) as (put, deleted):
        for key in lab.expressions:
            session.put(rooted(key), b"x", congestion_control=BLOCK)
        # Its own token, by which a client knows that it has reached a router, is allowed.
        assert [*session.liveliness().get("other/router/*", timeout=ANSWER_S)] == []
        assert not put | deleted
    own = [session.declare_subscriber(pattern, hear) for pattern in patterns]
    assert [*session.liveliness().get("other/router/*", timeout=ANSWER_S)] == []
    shared = {rooted(key) for key in lab.keys if rooted(key).startswith("fleet/")}
    for key in lab.keys:
        lab.router.put(rooted(key), b"x", congestion_control=BLOCK)
    assert [*session.liveliness().get("other/router/*", timeout=ANSWER_S)] == []
    undeclare(own)
    assert got == shared


def test_a_process_without_a_name_gets_no_link(lab: Lab) -> None:
    assert os.environ["XDG_RUNTIME_DIR"]
    for own in ({}, {f"{USER}user": f"{NAMESPACE}/goto", f"{USER}password": "guessed"}):
        config = zenoh.Config()
        settings: dict[str, object] = {
            "mode": "client",
            "connect/endpoints": [sockets.endpoint(sockets.socket_of(NAMESPACE))],
            "connect/timeout_ms": 300,
            **own,
        }
        for key, value in (SETTINGS | settings).items():
            config.insert_json5(key, json.dumps(value))
        with pytest.raises(zenoh.ZError):
            zenoh.open(config)
    assert lab.router


def test_a_process_logs_once_what_the_router_drops(
    lab: Lab, caplog: pytest.LogCaptureFixture
) -> None:
    class Named(Door):
        def forbidden(self, does: str, key: str) -> str:
            allowed = lab.rights.why("goto", Does(does), key)
            return "" if allowed else f"goto may not {does} {key}"

    settings = {f"{USER}user": f"{NAMESPACE}/goto", f"{USER}password": "password"}
    door = Named(f"{NAMESPACE}/goto", settings)
    with ZenohMesh(NAMESPACE, topology(door=door)) as mesh:
        assert mesh.wait_joined(ANSWER_S)
        mesh.subscribe("robot/state", lambda *_: None)
        mesh.subscribe("log/**", lambda *_: None)
        for key in ("log/goto-1f", "log/avoid-1f", "log/avoid-1f"):
            mesh.publish(key, Log(20, "text"))
    told = [record.getMessage() for record in caplog.records]
    assert told == ["goto may not declare_subscriber log/**", "goto may not put log/avoid-1f"]


def test_nobody_reads_or_changes_zenohs_own_settings(lab: Lab, identity: str) -> None:
    session = lab.session(identity)
    own = f"@/{lab.router.info.zid()}"
    read = [str(reply.ok.key_expr) for reply in session.get("@/**", timeout=ANSWER_S) if reply.ok]
    assert not [key for key in read if key.startswith(own)]
    key = f"{own}/router/config/access_control/enabled"
    session.put(key, b"false", congestion_control=BLOCK)
    session.put(rooted("robot/state"), b"x", congestion_control=BLOCK)
    with lab.heard(lab.router.declare_subscriber) as (put, _):
        lab.settle(session)
        assert "robot/state" not in put
