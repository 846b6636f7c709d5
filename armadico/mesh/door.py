"""The identity by which a process joins a society whose host table has `keys`.

The core knows no more of keys than this. A package that makes them provides `door`, by an entry
point of the group `armadico.doors`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

DOORS: Final = "armadico.doors"
"""The group of the function that opens a door: `armadico.config.endpoints.Endpoints.door`."""

ROBOT: Final = "robot"  # the robot agent's process, which is the router
PAGE: Final = "page"
MCP: Final = "mcp"
ROS2: Final = "ros2"
VIEWER: Final = "viewer"  # reads only
SIMULATOR: Final = "simulator"
PERSON: Final = "person-"
LAUNCHER: Final = "launcher-"

LONGEST_NAME: Final = 40
"""Characters of a name. With its namespace it is a common name, of which X.509 allows 64."""

TLS: Final = "transport/link/tls/"
USER: Final = "transport/auth/usrpwd/"
ACCESS: Final = "access_control"
ROUTERS: Final = (
    f"{TLS}listen_certificate",
    f"{TLS}listen_private_key",
    f"{USER}dictionary_file",
    ACCESS,
)
"""The settings of a router alone."""


class Door(NamedTuple):
    """The identity of one process.

    Attributes:
        name: `<namespace>/<name>`: the common name of its certificate, and its user name on the
            socket.
        settings: Zenoh's settings: TLS files, user and password; of a router also the users and
            the access control. A function is called for each session, and returns the setting:
            keys may be made anew while their process runs.
        folder: The folder of keys.
        faults: What is wrong with its keys now, a sentence each, for a link on the robot's
            computer (True) or from another one. It reads the files.
        sign: Returns a signature of data by this identity, of some hundred bytes.
        verify: Whether an identity, without its namespace, has signed data.
        keep: Called with the open mesh; returns what is called before it closes.
        forbidden: Why the robot's router drops a kind of Zenoh message on a key of the namespace;
            "" if it does not.
        doubts: How the rights of processes, each the names of its agents, differ from what the
            agents' classes declare, a sentence each.
        may_be_critical: Whether an instance's bids for a resource may be critical
            (`armadico.core.individual.Identity`).
        may_own: Whether an instance may own a resource.
        ending: Returns the certificates that soon end a link, and in how many seconds: on the
            robot's computer those of all links from other ones, elsewhere those of the computer.
            It reads files.
    """

    name: str
    settings: Mapping[str, Any]
    folder: str = ""
    faults: Callable[[bool], Sequence[str]] = lambda _: ()
    sign: Callable[[bytes], bytes] = lambda _: b""
    verify: Callable[[str, bytes, bytes], bool] = lambda *_: False
    keep: Callable[[Any], Callable[[], None]] | None = None
    may_be_critical: Callable[[str, str], bool] | None = None
    may_own: Callable[[str, str], bool] | None = None
    ending: Callable[[], Mapping[str, float]] = dict
    doubts: Callable[[Sequence[Sequence[str]]], Sequence[str]] = lambda _: ()
    forbidden: Callable[[str, str], str] = lambda *_: ""

    def current(self) -> dict[str, object]:
        """Return Zenoh's settings for a session that is opened now. Raises OSError."""
        return {k: v() if callable(v) else v for k, v in self.settings.items()}

    def as_client(self) -> Door:
        """Return the same identity without what only a router has."""
        own = {k: v for k, v in self.settings.items() if k not in ROUTERS}
        return self._replace(settings=own, keep=None, forbidden=lambda *_: "")


def name_of(agents: Sequence[str]) -> str:
    """Return the name of the identity of agents that share a process; of one agent, its own."""
    return _fitting("+".join(sorted({*agents})))


def person(user: str | None = None) -> str:
    """Return the name of a person's identity, by default of the user of this process."""
    if user is None:
        import getpass

        try:
            user = getpass.getuser()
        except (OSError, KeyError):  # a user without an entry in the list of users
            user = str(os.getuid())
    return _fitting(PERSON + re.sub(r"[^A-Za-z0-9_.-]", "_", user))


def launcher(host: str) -> str:
    """Return the name of the identity of `armadico up` on a host of the table."""
    return _fitting(LAUNCHER + host)


def _fitting(name: str) -> str:
    """Return a name, cut if it is too long; different names stay different."""
    if len(name) <= LONGEST_NAME:
        return name
    import hashlib  # slow, and seldom needed

    digest = hashlib.sha256(name.encode()).hexdigest()[:8]
    return f"{name[: LONGEST_NAME - 9]}-{digest}"
