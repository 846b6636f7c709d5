"""Access checks of the page, by Host, Origin and token (sans-IO).

Pages of other sites, open in the same browser, could send requests to this machine. The `Origin`
header, which browsers add, identifies them. The `Host` header detects a site whose name resolves to
this machine (DNS rebinding). A server on another address than loopback also requires a token.
"""

from __future__ import annotations

import base64
import hmac
from collections.abc import Iterable
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Final
from urllib.parse import urlsplit

LEAST_TOKEN: Final = 16  # characters; generated tokens have twice as many

# The WebSocket's subprotocol. The token is offered as a second one, because scripts cannot add
# headers to a WebSocket.
PROTOCOL: Final = "armadico.page"
TOKEN_PREFIX: Final = "token."


class GuardError(ValueError):
    """An invalid address or token; the message has the reason."""


@dataclass(frozen=True)
class Refusal:
    """Why a request is refused: an HTTP status, and a text."""

    status: int
    why: str


@dataclass(frozen=True)
class Guard:
    """The access rules."""

    # A browser that has it may drive, and release the stop; without it, it may look and stop.
    # Empty: every browser may, on loopback only.
    token: str = ""
    # Names of this machine that are valid as Host, besides localhost.
    names: frozenset[str] = frozenset()

    @classmethod
    def of(
        cls, address: str, token: str | None, names: Iterable[str] = (), *, closed: bool = False
    ) -> Guard:
        """The rules for a server on an address.

        All but loopback need a token, and so does a `closed` society: its keys let this server
        drive, and any program of this computer reaches it. Raises GuardError.
        """
        if not address:
            raise GuardError(
                "the address is empty: use 127.0.0.1 for this machine only, or 0.0.0.0 for all"
            )
        if token is not None and len(token) < LEAST_TOKEN:
            raise GuardError(f"a token must have at least {LEAST_TOKEN} characters")
        if token is not None and not (token.isascii() and token.isprintable()):
            raise GuardError("a token must consist of printable ASCII characters")
        if token is None and not is_loopback(address):
            raise GuardError(f"{address} is reachable from other machines, so it needs a token")
        if token is None and closed:
            raise GuardError("the society has keys, so its page needs a token")
        return cls(token or "", frozenset(name.lower() for name in names))

    def refusal(self, host: str | None, origin: str | None) -> Refusal | None:
        """None if the headers show that a request comes from this server's page; else why not.

        A program other than a browser sends no origin; no page can make it send requests.
        """
        if host is None or not self._is_ours(host):
            return Refusal(403, f"{_short(host)} is not a name of this server")
        if origin is not None and not _same(origin, host):
            return Refusal(403, f"requests from pages of {_short(origin)} are not allowed")
        return None

    def may(self, given: str | None) -> bool:
        """Whether a browser with this token may drive the robot, and release its stop."""
        return not self.token or (bool(given) and self.admit(given) is None)

    def admit(self, given: str | None) -> Refusal | None:
        """None if a browser is served: its token is right, or it has none; else why it is not."""
        if not (self.token and given):
            return None
        data = given.encode(errors="surrogatepass")  # a header may contain invalid text
        if not hmac.compare_digest(data, self.token.encode()):
            return Refusal(401, "the token is wrong")
        return None

    def _is_ours(self, host: str) -> bool:
        # No foreign name server can make addresses and localhost point here.
        name = _name(f"//{host}")
        return name == "localhost" or name in self.names or _is_address(name)


def is_loopback(address: str) -> bool:
    """Whether an address can be reached only from this machine."""
    if address == "localhost":
        return True
    try:
        return ip_address(address).is_loopback
    except ValueError:
        return False


def token_in(offered: Iterable[str]) -> str | None:
    """The token among the subprotocols that a page offers; None if there is none.

    It is in base64, because the name of a subprotocol has no spaces, slashes or the like.
    """
    found = next((each for each in offered if each.startswith(TOKEN_PREFIX)), None)
    if found is None:
        return None
    packed = found.removeprefix(TOKEN_PREFIX)
    try:
        return base64.urlsafe_b64decode(packed + "=" * (-len(packed) % 4)).decode()
    except ValueError:
        return ""


def bearer(header: str | None) -> str | None:
    """The token in an `Authorization` header; None if there is none."""
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
