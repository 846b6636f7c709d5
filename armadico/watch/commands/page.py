"""Serve the control page: click to drive, stop, missions, agents, and why the robot stands."""

from __future__ import annotations

import os
import secrets
import socket
import webbrowser
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from ipaddress import ip_address
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, flag, group, option
from armadico.mesh.door import PAGE
from armadico.mesh.ports import LOOPBACK
from armadico.watch.beside import STARTING, Helpers
from armadico.watch.screen import has_screen

if TYPE_CHECKING:
    from armadico.config.named import Gazetteer
    from armadico.mesh.base import Mesh
    from armadico.observe.findings import Demand
    from armadico.watch.page.guard import Guard
    from armadico.watch.page.session import Session, Spawns

PORT: Final = 8090
"""The default port of the page."""

TOKEN_VARIABLE: Final = "ARMADICO_PAGE_TOKEN"

EXAMPLES: Final = """\
  armadico page --world house                then open the link that is printed
  armadico page --port 0                     a port that is free
  armadico page --namespace robot1 --namespace robot2
  armadico page --bind 0.0.0.0               for a phone, too: the link has a token in it
  armadico run --world house --start 1 1.5 0 --for 600 --page
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    world: str | None = option(
        "draw the walls of this world (default: of the society that runs here)", metavar="MAP"
    )
    port: int = options.port_option(PORT)
    bind: str = option(
        f"listen on this address: {LOOPBACK} for this machine only, 0.0.0.0 for all machines that"
        f" have the token (default: {LOOPBACK})",
        default=LOOPBACK,
        metavar="ADDRESS",
    )
    token: str | None = option(
        "access token, at least 16 characters; visible in this machine's process list, unlike"
        f" ${TOKEN_VARIABLE} (default: with --bind or keys, a random one)",
        metavar="T",
    )
    no_open: bool = flag("do not open a browser")
    starting: bool = flag(None, STARTING)
    mesh: options.Meshes = group(options.Meshes, "the mesh")


def run(args: Options) -> int:
    from armadico.watch.page.guard import is_loopback

    meshes = args.mesh.join_each(PAGE, starts=args.starting)
    places = options.gazetteer(args.world, meshes[0].namespace)
    closed = any(mesh.closed for mesh in meshes)
    token = args.token or os.environ.get(TOKEN_VARIABLE) or None
    if token is None and (closed or not is_loopback(args.bind)):
        token = secrets.token_urlsafe(24)
    guard = guard_of(args.bind, token, closed=closed)
    options.end_as_by_ctrl_c()
    from armadico.watch.page.server import Server, ServerError

    with ExitStack() as stack:
        for mesh in meshes:
            stack.enter_context(mesh)
        helpers = stack.enter_context(Helpers(args.mesh))
        demands = [args.mesh.of(mesh.namespace).demand() for mesh in meshes]
        session = made(meshes, places, helpers.start, demands)
        try:
            server = stack.enter_context(Server(session, guard, args.bind, args.port))
        except ServerError as error:
            raise FailedError(str(error)) from None
        first, *others = _addresses(args.bind)
        link = _link(first, server.port, guard.token)
        also = f" (also at {', '.join(others)})" if others else ""
        with suppress(KeyboardInterrupt):  # which may come as soon as the link is printed
            print(f"page: {link}{also}", flush=True)
            if not args.no_open and has_screen(os.environ):
                webbrowser.open(link)
            while True:
                session.turn()
    return 0


def made(
    meshes: Sequence[Mesh], places: Gazetteer | None, start: Spawns, demands: Sequence[Demand]
) -> Session:
    """A session for robots with open meshes; `start` starts the teleop agent."""
    from armadico.watch.page.model import Robot
    from armadico.watch.page.session import Session
    from armadico.watch.slot import BY_HAND

    helpers, world = BY_HAND.besides, None if places is None else places.world
    robots = {
        m.namespace: Robot(
            m.namespace, world, partial(secrets.randbits, 63), helpers, demand, places
        )
        for m, demand in zip(meshes, demands, strict=True)
    }
    return Session(robots, meshes, start)


def guard_of(bind: str, token: str | None, *, closed: bool = False) -> Guard:
    """The access control of a server of this machine. Raises UsageError."""
    from armadico.watch.page.guard import Guard, GuardError

    name = socket.gethostname()
    try:
        return Guard.of(bind, token, (name, f"{name}.local", bind), closed=closed)
    except GuardError as error:
        raise UsageError(str(error)) from None


ANYWHERE: Final = {"0.0.0.0": socket.AF_INET, "::": socket.AF_INET6}
"""Addresses to listen on that are no address to connect to."""


def _addresses(bind: str) -> list[str]:
    """Where other machines find a server that listens on `bind`, the best one first.

    A phone resolves no host name of a small network, so the IP addresses come before it.
    """
    if bind not in ANYWHERE:
        return [bind]
    import psutil

    family = ANYWHERE[bind]
    up = {name for name, state in psutil.net_if_stats().items() if state.isup}
    cards = [card for name, of in psutil.net_if_addrs().items() if name in up for card in of]
    found = [card.address for card in cards if card.family == family]
    found = [a for a in found if not (ip_address(a).is_loopback or ip_address(a).is_link_local)]
    found.sort(key=_outward(family).__ne__)  # others, as of virtual machines, come behind it
    return [*found, socket.gethostname()]


def _outward(family: socket.AddressFamily) -> str:
    """The address by which this machine reaches others; empty if it has none. Sends nothing."""
    somewhere = "192.0.2.1" if family == socket.AF_INET else "2001:db8::1"  # for documentation
    with socket.socket(family, socket.SOCK_DGRAM) as line, suppress(OSError):
        line.connect((somewhere, 9))
        return str(line.getsockname()[0])
    return ""


def _link(host: str, port: int, token: str) -> str:
    """The link to the page; browsers do not send what is behind the #."""
    if ":" in host:
        host = f"[{host}]"
    return f"http://{host}:{port}/" + (f"#token={token}" if token else "")


main: Final = Command(
    "armadico page",
    Options,
    run,
    "Serve a page to watch and control the robot: a map to click on, stop and resume, missions,"
    " agents, which agent drives and why. It is served on this machine's loopback, or with --bind"
    " to other machines. There, and in a society with keys, only who has the token of the link may"
    " drive and release the stop; without it the page shows everything, and stops. Ctrl-C ends it;"
    " the society continues.",
    EXAMPLES,
)
