"""Why a router's TLS port does not let a process in: Zenoh only reports a timeout.

A bare TCP connection to such a port is a failed handshake, for which Zenoh's listener sleeps 100 ms
(1.10.2). So a port is probed by a handshake with the process's own certificate.
"""

from __future__ import annotations

import socket
import ssl
from typing import Final

from armadico.mesh.door import TLS, Door
from armadico.mesh.topology import place_of

READ_S: Final = 0.3
"""How long a router's objection to a certificate is waited for: TLS 1.3 sends it afterwards."""

CLOCK: Final = "compare the clocks of both computers (`date`)"
RENEW: Final = "`armadico keys renew` makes a new one"

# By OpenSSL's code of a failed verification of the router's certificate.
UNVERIFIED: Final = {
    9: f"the robot's certificate is not valid yet, by this computer's clock: {CLOCK}",
    10: f"the robot's certificate has expired, by this computer's clock: {CLOCK}, or renew it on"
    " the robot's computer (`armadico keys renew`) and start its society again",
    62: "the robot's certificate is not for this address: make it again on the robot's computer"
    " with this host table (`armadico keys renew`)",
    64: "the robot's certificate is not for this address: make it again on the robot's computer"
    " with this host table (`armadico keys renew`)",
}
FOREIGN: Final = (
    "the robot's certificate is of another authority: unpack what `armadico keys host` writes on"
    " the computer of the robot's authority"
)

CLOSED: Final = (
    "it closes the link: the key was revoked or made anew, or is not of this robot's society"
    " (`armadico keys list` on the robot's computer)"
)

# By OpenSSL's name of the router's alert.
ALERTS: Final = {
    "CERTIFICATE_EXPIRED": f"takes this certificate for expired or not valid yet: {CLOCK}; {RENEW}",
    "UNKNOWN_CA": "does not know the authority of this certificate",
    "DECRYPT_ERROR": "does not know the authority of this certificate",
    "CERTIFICATE_REQUIRED": "requires a certificate",
    "BAD_CERTIFICATE": "rejects this certificate",
}


def tls_place(endpoint: str) -> tuple[str, int] | None:
    """Return the address and port of an endpoint over TLS; None for another one."""
    return place_of(endpoint) if endpoint.startswith("tls/") else None


def refusal(endpoint: str, door: Door, within: float, *, waits: bool = False) -> str | None:
    """Return why a router's TLS port refuses a door; "" if it does not, None if none listens.

    Connecting and the handshake may each take `within` s. `waits`: wait for the router's objection,
    too.
    """
    place = tls_place(endpoint)
    assert place is not None, "only TLS has handshakes"
    try:
        context = _context(door)
    except (OSError, ssl.SSLError) as error:
        return f"its keys cannot be used: {error.strerror or error}"
    try:
        with socket.create_connection(place, within) as line:
            return _shaken(context, line, place[0], waits=waits)
    except OSError:
        return None


def speaks_tls(endpoint: str, within: float) -> bool:
    """Return whether a port answers by TLS; any certificate counts. False if none listens."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        with (
            socket.create_connection(place_of(endpoint), within) as line,
            context.wrap_socket(line),
        ):
            return True
    except OSError:
        return False


def _context(door: Door) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(str(door.settings[f"{TLS}root_ca_certificate"]))
    certificate = str(door.settings[f"{TLS}connect_certificate"])
    context.load_cert_chain(certificate, str(door.settings[f"{TLS}connect_private_key"]))
    return context


def _shaken(
    context: ssl.SSLContext, line: socket.socket, address: str, *, waits: bool
) -> str | None:
    """Make a handshake; return as `refusal`."""
    secure = None
    try:
        secure = context.wrap_socket(line, server_hostname=address)
        if waits:
            secure.settimeout(READ_S)
            if not secure.recv(1):
                return CLOSED
    except TimeoutError:
        if secure is None:
            return "it accepts connections and answers no TLS: it is open, it starts, or it hangs"
    except ssl.SSLCertVerificationError as error:
        return UNVERIFIED.get(error.verify_code, FOREIGN)
    except ssl.SSLError as error:
        reason = error.reason or ""
        if "ALERT" not in reason:
            return "it answers no TLS: its society is open, or is no society"
        alerts = (text for name, text in ALERTS.items() if name in reason)
        return f"the robot's router {next(alerts, f'ends the handshake ({reason.lower()})')}"
    except OSError:
        return "it ends the connection within the handshake"
    finally:
        if secure is not None:
            secure.close()
    return ""
