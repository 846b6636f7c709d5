"""Every kind of message of every identity on every key, tried on one live router.

The clients are plain Zenoh sessions, which restrict nothing themselves. A message that a client's
session has sent before an answered query has been processed by the router, so nothing waits.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest
import zenoh

from armadico.keys.rights import Does, Table
from armadico.mesh import sockets
from armadico.mesh.door import ACCESS, USER, Door
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import SETTINGS, ZenohMesh
from tests.keys.members import everybody

NAMESPACE = "matrix"
BARRIER = f"{NAMESPACE}/router/*"
ANSWER_S = 5.0
BLOCK = zenoh.CongestionControl.BLOCK  # as so much at once is otherwise dropped


def concrete(expression: str) -> str:
    """A key that an expression matches."""
    return expression.replace("$*", "1f").replace("**", "x").replace("*", "x")


class Lab:
    """A router with all rights, and a session of each identity."""

    def __init__(self, rights: Table, folder: Path) -> None:
        self.rights = rights
        users = folder / "users"
        names = [f"{NAMESPACE}/{name}" for name in rights.speakers]
        users.write_text("\n".join(f"{name}:password" for name in names))
        door = Door(
            f"{NAMESPACE}/robot",
            {
                f"{USER}user": f"{NAMESPACE}/robot",
                f"{USER}password": "password",
                f"{USER}dictionary_file": str(users),
                ACCESS: rights.access_control(NAMESPACE),
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
        found = {right.key for right in self.rights.rights}
        found |= {concrete(key) for key in found}
        return (*sorted(found), "**", "robot/**", "*/**", "robot/cmd/$*1f", "nobody/knows")

    def session(self, identity: str) -> zenoh.Session:
        if identity not in self._sessions:
            config = zenoh.Config()
            endpoint = sockets.endpoint(sockets.socket_of(NAMESPACE))
            own: dict[str, object] = {
                "mode": "client",
                "connect/endpoints": [endpoint],
                f"{USER}user": f"{NAMESPACE}/{identity}",
                f"{USER}password": "password",
            }
            for key, value in (SETTINGS | own).items():
                config.insert_json5(key, json.dumps(value))
            self._sessions[identity] = zenoh.open(config)
        return self._sessions[identity]

    def settle(self, session: zenoh.Session) -> None:
        """Wait until the router has processed what a session has sent, and the other way round."""
        replies = [*session.liveliness().get(BARRIER, timeout=ANSWER_S)]
        assert len(replies) == 1, "every identity may look for its router"

    def allowed(self, identity: str, does: Does) -> set[str]:
        keys = self.expressions
        return {key for key in keys if self.rights.why(identity, does, key) is not None}


def rooted(key: str) -> str:
    return f"{key if key.startswith('fleet/') else f'{NAMESPACE}/{key}'}"


def bare(key: object) -> str:
    return str(key).removeprefix(f"{NAMESPACE}/")


def direct(callback: Callable[[Any], None]) -> Any:
    return zenoh.handlers.Callback(callback, indirect=False)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    with pytest.MonkeyPatch.context() as patch:
        runtime = tmp_path_factory.mktemp("runtime")
        runtime.chmod(0o700)
        patch.setenv("XDG_RUNTIME_DIR", str(runtime))
        lab = Lab(everybody(NAMESPACE), tmp_path_factory.mktemp("users"))
        yield lab
        lab.close()


IDENTITIES = sorted(set(everybody(NAMESPACE).speakers) - {"robot"})
every_identity = pytest.mark.parametrize("identity", IDENTITIES)


@every_identity
def test_puts_and_deletes_arrive_on_allowed_keys_only(lab: Lab, identity: str) -> None:
    session, got = lab.session(identity), []
    listener = lab.router.declare_subscriber(
        "**", direct(lambda s: got.append((s.kind, bare(s.key_expr))))
    )
    for key in lab.expressions:
        session.put(rooted(key), b"x", congestion_control=BLOCK)
        session.delete(rooted(key), congestion_control=BLOCK)
    lab.settle(session)
    listener.undeclare()  # type: ignore[no-untyped-call]
    assert {key for kind, key in got if kind == zenoh.SampleKind.PUT} == lab.allowed(
        identity, Does.PUT
    )
    assert not [key for kind, key in got if kind == zenoh.SampleKind.DELETE]


@every_identity
def test_tokens_are_seen_on_allowed_keys_only(lab: Lab, identity: str) -> None:
    session, got = lab.session(identity), set()
    listener = lab.router.liveliness().declare_subscriber(
        "**", direct(lambda s: got.add(bare(s.key_expr)))
    )
    tokens = [session.liveliness().declare_token(rooted(key)) for key in lab.expressions]
    lab.settle(session)
    for token in tokens:
        token.undeclare()  # type: ignore[no-untyped-call]
    listener.undeclare()  # type: ignore[no-untyped-call]
    assert got == lab.allowed(identity, Does.TOKEN)


@every_identity
def test_queries_arrive_on_allowed_keys_only(lab: Lab, identity: str) -> None:
    session, got = lab.session(identity), set()
    answers = lab.router.declare_queryable("**", direct(lambda q: got.add(bare(q.key_expr))))
    lab.settle(session)
    replies = [
        session.get(rooted(key), timeout=ANSWER_S, congestion_control=BLOCK)
        for key in lab.expressions
    ]
    lab.settle(session)
    answers.undeclare()  # type: ignore[no-untyped-call]
    assert got == lab.allowed(identity, Does.QUERY)
    del replies


@every_identity
def test_tokens_are_looked_for_on_allowed_keys_only(lab: Lab, identity: str) -> None:
    session = lab.session(identity)
    tokens = {
        key: lab.router.liveliness().declare_token(rooted(key))
        for key in lab.expressions
        if "*" not in key
    }
    found = {
        key for key in lab.expressions if [*session.liveliness().get(rooted(key), timeout=ANSWER_S)]
    }
    for token in tokens.values():
        token.undeclare()  # type: ignore[no-untyped-call]
    assert found <= lab.allowed(identity, Does.LOOK)


@every_identity
def test_publications_reach_allowed_subscriptions_only(lab: Lab, identity: str) -> None:
    session, got = lab.session(identity), set()
    allowed = lab.allowed(identity, Does.SUBSCRIBE)
    keys = [key for key in lab.expressions if "*" not in key]

    def subscribed(patterns: list[str]) -> set[str]:
        got.clear()
        subscribers = [
            session.declare_subscriber(rooted(p), direct(lambda s: got.add(bare(s.key_expr))))
            for p in patterns
        ]
        lab.settle(session)
        for key in keys:
            lab.router.put(rooted(key), b"x", congestion_control=BLOCK)
        lab.settle(session)
        for subscriber in subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]
        lab.settle(session)
        return set(got)

    assert not subscribed([key for key in lab.expressions if key not in allowed])
    patterns = [zenoh.KeyExpr(pattern) for pattern in allowed]
    assert subscribed([*allowed]) == {
        key for key in keys if any(p.includes(zenoh.KeyExpr(key)) for p in patterns)
    }


@every_identity
def test_tokens_reach_allowed_watchers_only(lab: Lab, identity: str) -> None:
    session, got = lab.session(identity), set()
    keys = [key for key in lab.expressions if key not in lab.allowed(identity, Does.WATCH)]
    watchers = [
        session.liveliness().declare_subscriber(
            rooted(key), direct(lambda s: got.add(str(s.key_expr)))
        )
        for key in keys
    ]
    lab.settle(session)
    tokens = [
        lab.router.liveliness().declare_token(rooted(key))
        for key in lab.expressions
        if "*" not in key
    ]
    lab.settle(session)
    for each in (*watchers, *tokens):
        each.undeclare()  # type: ignore[no-untyped-call]
    assert not got


@every_identity
def test_queries_are_answered_on_allowed_keys_only(lab: Lab, identity: str) -> None:
    session, asked = lab.session(identity), set()
    allowed = lab.allowed(identity, Does.ANSWER)

    def on_query(key: str, query: zenoh.Query) -> None:
        asked.add(key)
        with query:
            query.reply(rooted(key), b"x")

    answers = [
        session.declare_queryable(rooted(key), direct(lambda q, k=key: on_query(k, q)))
        for key in lab.expressions
        if "*" not in key
    ]
    lab.settle(session)
    got = {
        bare(reply.ok.key_expr)
        for reply in lab.router.get("**", timeout=ANSWER_S, target=zenoh.QueryTarget.ALL)
        if reply.ok is not None
    }
    for each in answers:
        each.undeclare()  # type: ignore[no-untyped-call]
    assert asked == got == {key for key in allowed if "*" not in key}


@every_identity
def test_replies_arrive_from_allowed_keys_only(lab: Lab, identity: str) -> None:
    session = lab.session(identity)
    own = sorted(key for key in lab.allowed(identity, Does.ANSWER) if "*" not in key)
    if not own:
        pytest.skip("it answers nothing")

    def on_query(query: zenoh.Query) -> None:
        with query:
            for key in lab.expressions:
                if "*" not in key:
                    query.reply(rooted(key), b"forged")

    answers = session.declare_queryable(rooted(own[0]), direct(on_query))
    lab.settle(session)
    replies = lab.router.get(
        f"{rooted(own[0])}?_anyke", timeout=ANSWER_S, consolidation=zenoh.ConsolidationMode.NONE
    )
    got = {bare(reply.ok.key_expr) for reply in replies if reply.ok is not None}
    answers.undeclare()  # type: ignore[no-untyped-call]
    allowed = {key for key in lab.allowed(identity, Does.REPLY) if "*" not in key}
    assert got == allowed


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
