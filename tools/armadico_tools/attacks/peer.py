"""A hand-written peer: a bare Zenoh session and CBOR, without Armadico and without its checks.

It is what an attacker writes from docs/protocol.md. It checks nothing that it sends.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any, Final, Self

import cbor2
import zenoh

SETTINGS: Final[dict[str, object]] = {
    "mode": "client",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "connect/timeout_ms": 2000,
    "transport/unicast/open_timeout": 2000,
    "transport/shared_memory/enabled": False,
    "open/return_conditions/connect_scouted": False,
    "open/return_conditions/declares": False,
}


class Peer:
    """One link to a robot's router, as a context manager. Keys are within the namespace.

    Attributes:
        arrived: The number of messages that it has received.
    """

    def __init__(
        self, namespace: str, endpoint: str, settings: Mapping[str, object] | None = None
    ) -> None:
        """Connect. Raises zenoh.ZError if it gets no link."""
        self.arrived = 0
        self._root = f"{namespace}/"
        self._kept: list[Any] = []
        self._tokens: list[zenoh.LivelinessToken] = []
        config = zenoh.Config()
        own = {"connect/endpoints": [endpoint]} | dict(settings or {})
        for key, value in (SETTINGS | own).items():
            config.insert_json5(key, json.dumps(value))
        self._session = zenoh.open(config)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._kept.clear()
        with suppress(zenoh.ZError):
            self._session.close()  # type: ignore[no-untyped-call]

    @property
    def is_linked(self) -> bool:
        return bool(list(self._session.info.routers_zid()))

    def put(self, keys: str | Iterable[str], *values: object) -> None:
        """Publish an array of values."""
        self.put_bytes(keys, cbor2.dumps(values))

    def put_bytes(self, keys: str | Iterable[str], data: bytes) -> None:
        with suppress(zenoh.ZError):  # the link is gone
            for key in [keys] if isinstance(keys, str) else keys:
                self._session.put(
                    self._root + key, data, congestion_control=zenoh.CongestionControl.DROP
                )

    def delete(self, *keys: str) -> None:
        with suppress(zenoh.ZError):
            for key in keys:
                self._session.delete(self._root + key)

    def token(self, key: str) -> None:
        """Declare a token, which lasts until `drop_tokens`."""
        self._tokens.append(self._session.liveliness().declare_token(self._root + key))

    def drop_tokens(self) -> None:
        for token in self._tokens:
            with suppress(zenoh.ZError):
                token.undeclare()  # type: ignore[no-untyped-call]
        self._tokens.clear()

    def answer(self, pattern: str, reply: Callable[[str], tuple[str, list[object]] | None]) -> None:
        """Answer queries on a pattern: `reply` gets the query's key, and returns key and values."""

        def asked(query: zenoh.Query) -> None:
            found = reply(str(query.key_expr).removeprefix(self._root))
            if found is not None:
                with suppress(zenoh.ZError):
                    query.reply(self._root + found[0], cbor2.dumps(found[1]))

        direct: Any = zenoh.handlers.Callback(asked, indirect=False)
        self._kept.append(self._session.declare_queryable(self._root + pattern, direct))

    def ask(self, key: str, *values: object, within: float = 0.5) -> list[bytes]:
        """Query a key; return the replies."""
        with suppress(zenoh.ZError):
            replies = self._session.get(
                self._root + key,
                payload=cbor2.dumps(values),
                timeout=within,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
            )
            return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]
        return []

    def listen(self, pattern: str) -> None:
        """Count what is published on a pattern."""

        def heard(_: zenoh.Sample) -> None:
            self.arrived += 1

        direct: Any = zenoh.handlers.Callback(heard, indirect=False)
        self._kept.append(self._session.declare_subscriber(self._root + pattern, direct))

    def tokens(self, pattern: str) -> list[str]:
        """The tokens that it can see now."""
        with suppress(zenoh.ZError):
            replies = self._session.liveliness().get(self._root + pattern, timeout=0.5)
            return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
        return []
