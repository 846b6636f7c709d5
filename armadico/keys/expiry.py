"""When a certificate expires, and from when on that is announced: without the heavy library."""

from __future__ import annotations

import base64
import json
import re
from contextlib import suppress
from datetime import UTC, datetime
from itertools import islice
from typing import Final, NamedTuple

from armadico.keys.store import BACKDATED_S, Store
from armadico.mesh import sockets
from armadico.mesh.door import ROBOT

LINKS: Final = ".links"
"""Suffix of the file of the porter's links, beside the router's socket: for each the name, when its
certificate expires, and from when on that is announced, s since 1970."""

ANNOUNCED_S: Final = 3600.0
"""From so long before its end an expiry is announced, s; of a short life, from its last sixth."""

ROBOTS_S: Final = 14 * 86_400.0
"""The same of the robot's, which a person renews."""


class Validity(NamedTuple):
    """When a certificate is valid, s since 1970."""

    begins: float
    ends: float

    @property
    def life(self) -> float:
        """How long it is valid from its issue on, s."""
        return max(self.ends - self.begins - BACKDATED_S, 1.0)

    @property
    def renew_at(self) -> float:
        return self.ends - self.life / 3

    @property
    def announce_at(self) -> float:
        return self.ends - min(ANNOUNCED_S, self.life / 6)


def validity(certificate: bytes) -> Validity:
    """Return when a certificate of `armadico.keys.authority`, PEM, is valid. Raises ValueError.

    `cryptography` takes 60 ms and 10 MB to import, which is much for each process. In DER the two
    times are adjacent and of fixed length (RFC 5280, 4.1.2.5).
    """
    found = _VALIDITY.search(_der(certificate))
    if found is None:
        raise ValueError("no certificate")
    begins, ends = (
        datetime.strptime(t.decode(), "%y%m%d%H%M%SZ").replace(tzinfo=UTC).timestamp()
        for t in found.groups()
    )
    return Validity(begins, ends)


def user_in(certificate: bytes) -> str:
    """Return the user name of a certificate of `armadico.keys.authority`, PEM. Raises ValueError.

    In DER its common name is the second one, after the authority's (RFC 5280, 4.1.2.4).
    """
    found = _COMMON_NAME.finditer(_der(certificate))
    match = next(islice(found, 1, None), None)
    if match is None:
        raise ValueError("no certificate")
    size = match[1][0]
    return match.string[match.end() : match.end() + size].decode()


def _der(certificate: bytes) -> bytes:
    """Return the DER of a certificate, PEM. Raises ValueError."""
    lines = [line for line in certificate.splitlines() if not line.startswith(b"-----")]
    return base64.b64decode(b"".join(lines))


_COMMON_NAME: Final = re.compile(rb"\x06\x03\x55\x04\x03\x0c(.)", re.DOTALL)
_VALIDITY: Final = re.compile(rb"\x30\x1e\x17\x0d(\d{12}Z)\x17\x0d(\d{12}Z)")


def shown(t: float) -> str:
    """Return a time, s since 1970, for people."""
    return f"{datetime.fromtimestamp(t, UTC):%Y-%m-%d %H:%M} UTC"


def announcement(name: str, left: float, fault: str) -> str:
    """Return the announcement of an expiry in `left` seconds, for people."""
    if left <= 0:
        when = "has expired, so the robot closes its link"
    else:
        span = f"{left / 60:.0f} min" if left >= 120 else f"{left:.0f} s"
        when = f"expires in {span}, and then the robot closes its link"
    return f"the certificate of {name} {when}: {fault or 'it is being renewed'}"


def ending(store: Store, namespace: str, now: float) -> dict[str, float]:
    """Return the certificates that soon end a link, and in how many seconds (`Door.ending`).

    On the robot's computer those of the porter's links, and the robot's own one.
    """
    robot = store.identity(namespace, ROBOT)
    links = sockets.socket_of(namespace).with_suffix(LINKS)
    found: dict[str, float] = {}
    if robot.certificate.exists():
        with suppress(OSError, ValueError):
            if (left := validity(robot.certificate.read_bytes()).ends - now) < ROBOTS_S:
                found[robot.name] = left
        with suppress(OSError, ValueError):
            rows = json.loads(links.read_text(encoding="utf-8"))
            found |= {name: ends - now for name, ends, announced in rows if now >= announced}
        return found
    for identity in store.identities():
        with suppress(OSError, ValueError):
            valid = validity(identity.certificate.read_bytes())
            if identity.namespace == namespace and now >= valid.announce_at:
                found[identity.name] = valid.ends - now
    return found
