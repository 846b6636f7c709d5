"""The identity by which a process joins a society whose host table has `keys`.

The core knows no more of keys than this. A package that makes them derives from `Door`, and
provides a function that opens one by an entry point of the group `armadico.doors`.
"""

# ruff: noqa: ARG002 - a package of keys uses the arguments

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from typing import Any, Final

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
CLIENT: Final = f"{MCP}-"  # of one client program

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


class Door:
    """The identity of one process, which only logs in: a package of keys derives a class of it.

    Attributes:
        name: `<namespace>/<name>`: the common name of its certificate, and its user name on the
            socket.
        settings: Zenoh's settings: TLS files, user and password; of a router also the users and
            the access control. A function is called for each session, and returns the setting:
            keys may be made anew while their process runs.
        folder: The folder of keys.
        is_foreign: Whether it joins another robot's society.
    """

    def __init__(self, name: str, settings: Mapping[str, Any], folder: str = "") -> None:
        self.name, self.settings, self.folder = name, settings, folder
        self.is_foreign = False

    def current(self) -> dict[str, object]:
        """Return Zenoh's settings for a session that is opened now. Raises OSError."""
        return {k: v() if callable(v) else v for k, v in self.settings.items()}

    def abroad(self) -> Door:
        """Return the same identity as a client of another robot's router."""
        found = copy(self)
        found.settings = {k: v for k, v in self.settings.items() if k not in ROUTERS}
        found.is_foreign = True
        return found

    def keep(self, mesh: Any) -> Callable[[], None]:
        """Keep its keys fresh while a mesh is open; return what is called before it closes."""
        return lambda: None

    def faults(self, here: bool) -> Sequence[str]:
        """Return what is wrong with its keys now, a sentence each; it reads the files.

        `here`: for a link on the robot's computer, else for one from another computer.
        """
        return ()

    def ending(self) -> Mapping[str, float]:
        """Return the certificates that soon end a link, and in how many seconds; reads files.

        On the robot's computer those of all links from other ones, elsewhere the computer's own.
        """
        return {}

    def sign(self, data: bytes) -> bytes:
        """Return a signature of data by this identity, of some hundred bytes."""
        return b""

    def verify(self, name: str, data: bytes, signed: bytes) -> bool:
        """Return whether an identity, without its namespace, has signed data."""
        return False

    def may_be_critical(self, instance: str, resource: str) -> bool:
        """Return whether an instance's bids may be critical (`armadico.core.individual`)."""
        return True

    def may_own(self, instance: str, resource: str) -> bool:
        """Return whether an instance may own a resource."""
        return True

    def forbidden(self, does: str, key: str) -> str:
        """Return why the robot's router drops a kind of Zenoh message on a key; "" if not."""
        return ""

    def doubts(self, labels: Sequence[Sequence[str]]) -> Sequence[str]:
        """Return how the rights of processes differ from what their classes declare.

        A sentence each; a process is given by the names of its agents.
        """
        return ()


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
