"""Who may use the page: by the address asked for, by the page that asks, and by a token (sans-IO).

A browser shows pages of strangers, and those may send requests to this machine, too. They are told
by the `Origin` that browsers add; one that has its own name resolve to this machine (DNS rebinding)
by the `Host`. Whoever listens on another address than loopback also wants a token of each request.
"""

from __future__ import annotations

import base64
import hmac
from collections.abc import Iterable
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Final
from urllib.parse import urlsplit

LEAST_TOKEN: Final = 16
"""Characters; what is drawn at random has twice as many."""

PROTOCOL: Final = "armadico.page"
"""The WebSocket's subprotocol; a token follows as a second one, since a page can add no header."""

TOKEN_PREFIX: Final = "token."


class GuardError(ValueError):
    """An address or a token that cannot be used; the message says why."""


@dataclass(frozen=True)
class Refusal:
    """Why somebody is not let in: a status of HTTP, and words for people."""

    status: int
    why: str


@dataclass(frozen=True)
class Guard:
    """What is let in.

    Attributes:
        token: What every request has to know; empty: none, on loopback only.
        names: Names of this machine by which it may be asked for, besides localhost.
    """

    token: str = ""
    names: frozenset[str] = frozenset()

    @classmethod
    def of(cls, address: str, token: str | None, names: Iterable[str] = ()) -> Guard:
        """For a server on an address. Raises GuardError: another than loopback needs a token."""
        if not address:
            raise GuardError("no address: 0.0.0.0 is for everybody, 127.0.0.1 for this machine")
        if token is not None and len(token) < LEAST_TOKEN:
            raise GuardError(f"a token has at least {LEAST_TOKEN} characters")
        if token is not None and not (token.isascii() and token.isprintable()):
            raise GuardError("a token is made of printable ASCII characters")
        if token is None and not is_loopback(address):
            raise GuardError(f"{address} is not this machine alone, so it needs a token")
        return cls(token or "", frozenset(name.lower() for name in names))

    def refusal(self, host: str | None, origin: str | None) -> Refusal | None:
        """Whether a request comes from our own page, by its headers; None: it may.

        A program that is no browser has no origin; it could not be made to send this by a page.
        """
        if host is None or not self._is_ours(host):
            return Refusal(403, f"this server is not called {_short(host)}")
        if origin is not None and not _same(origin, host):
            return Refusal(403, f"a page of {_short(origin)} may not ask this robot for anything")
        return None

    def admit(self, given: str | None) -> Refusal | None:
        """Whether a token is right; None: it is, or none is needed."""
        if not self.token:
            return None
        if not given:
            return Refusal(401, "a token is needed: it is in the link that `armadico page` prints")
        said = given.encode(errors="surrogatepass")  # a header's bytes may be no text
        if not hmac.compare_digest(said, self.token.encode()):
            return Refusal(401, "this token is not the right one")
        return None

    def _is_ours(self, host: str) -> bool:
        """Addresses and localhost cannot be made to point here by somebody else's name server."""
        name = _name(f"//{host}")
        return name == "localhost" or name in self.names or _is_address(name)


def is_loopback(address: str) -> bool:
    """Whether only programs of this machine reach an address."""
    if address == "localhost":
        return True
    try:
        return ip_address(address).is_loopback
    except ValueError:
        return False


def subprotocol(token: str) -> str:
    """A token as a subprotocol's name, which has no spaces, slashes or the like."""
    packed = base64.urlsafe_b64encode(token.encode()).decode().rstrip("=")
    return f"{TOKEN_PREFIX}{packed}"


def token_in(offered: Iterable[str]) -> str | None:
    """The token among the subprotocols that a page offers; None: there is none."""
    found = next((each for each in offered if each.startswith(TOKEN_PREFIX)), None)
    if found is None:
        return None
    packed = found.removeprefix(TOKEN_PREFIX)
    try:
        return base64.urlsafe_b64decode(packed + "=" * (-len(packed) % 4)).decode()
    except ValueError:
        return ""


def bearer(header: str | None) -> str | None:
    """The token in an `Authorization` header; None: there is none."""
    kind, _, token = (header or "").partition(" ")
    return token.strip() if kind.lower() == "bearer" and token else None


def _same(origin: str, host: str) -> bool:
    try:
        split = urlsplit(origin)
    except ValueError:
        return False
    return split.scheme in ("http", "https") and split.netloc.lower() == host.lower()


def _name(address: str) -> str:
    try:
        return (urlsplit(address).hostname or "").lower()
    except ValueError:
        return ""


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def _short(value: str | None) -> str:
    text = "".join(c if c.isprintable() else "?" for c in value or "nothing")
    return text if len(text) <= 80 else text[:79] + "…"
