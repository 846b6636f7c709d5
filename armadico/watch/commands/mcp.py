"""Connect programs and language models to a society by the Model Context Protocol."""

from __future__ import annotations

import json
import os
import secrets
import sys
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import BadValueError, Command, group, option
from armadico.mesh.door import CLIENT, MCP
from armadico.watch.beside import Helpers

if TYPE_CHECKING:
    from armadico.config.worlds import World
    from armadico.launch.client import Client
    from armadico.mesh.zenoh import ZenohMesh
    from armadico.watch.mcp.server import Rehearse, Server
    from armadico.watch.page.guard import Guard

TOKEN_VARIABLE: Final = "ARMADICO_MCP_TOKEN"


class Address(NamedTuple):
    host: str
    port: int


def _address(text: str) -> Address:
    host, colon, port = text.rpartition(":")
    if not colon or not host or not port.isdecimal() or int(port) > 65535:
        raise BadValueError(f"{text!r}: expected HOST:PORT, such as 127.0.0.1:8091")
    return Address(host.strip("[]"), int(port))


EXAMPLES: Final = """\
  armadico mcp --world house
  claude mcp add robot -- armadico mcp --world house
  armadico mcp --http 127.0.0.1:8091         prints the address and the token
  armadico mcp --world house --client claude   by the key of `armadico keys client claude`
  armadico mcp --world house --policy limits.toml --log requests.jsonl
  {"mcpServers": {"robot": {"command": "armadico", "args": ["mcp", "--world", "house"]}}}
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    world: str | None = option(
        "the world that the robot is in (default: that of the society that runs here)",
        metavar="MAP",
    )
    http: Address | None = option(
        "serve HTTP there, instead of one program on standard input and output; port 0: a free one",
        read=_address,
        metavar="HOST:PORT",
    )
    token: str | None = option(
        "the token that clients of --http need, at least 16 characters; visible in this machine's"
        f" process list, unlike ${TOKEN_VARIABLE} (default: a random one, which is printed)",
        metavar="T",
    )
    client: str | None = option(
        "with keys: join by the key of this client (`armadico keys client NAME`), as which the"
        " policy and the log know it; no assistant agent is started (default: the key of `mcp`)",
        metavar="NAME",
    )
    policy: str | None = option(
        "limit by this policy what the program may do; only if no assistant agent is alive, which"
        " has its own",
        metavar="FILE",
    )
    log: Path | None = option("with --policy: append each request to this file", metavar="FILE")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    """Serve until standard input ends, or by HTTP until Ctrl-C."""
    from armadico.watch.commands.page import guard_of

    places = options.gazetteer(args.world, args.mesh.namespace)
    guard = None
    if args.http is None and args.token:
        raise UsageError("--token is for --http; a program on standard input needs none")
    if args.http is not None:  # a token is needed everywhere
        guard = guard_of(args.http.host, _given(args.token) or secrets.token_urlsafe(24))
    sets = _settings(args, None if places is None else places.world)
    mesh = args.mesh.join(MCP if args.client is None else f"{CLIENT}{args.client}")
    if args.client is not None and not mesh.closed:
        raise UsageError(f"--client {args.client}: this society has no keys, so nobody has one")
    from armadico.config.errands import load_mission
    from armadico.config.shipped import names
    from armadico.core.discovery import MISSIONS, installed
    from armadico.launch.client import Client
    from armadico.observe.watching import Watcher
    from armadico.watch.mcp.answers import Society
    from armadico.watch.mcp.guest import ASSISTANT
    from armadico.watch.mcp.lines import Lines
    from armadico.watch.mcp.server import Server

    missions = {n: load_mission(n).title for n in names("missions") if installed(MISSIONS)}
    options.end_as_by_ctrl_c()  # the helper leaves in order
    with ExitStack() as stack:
        stack.enter_context(mesh)
        watcher = Watcher([mesh])
        society = Society(places, missions, args.mesh.demand(), begun=watcher.clock() / 1e9)
        watcher.watch_alive()
        watcher.watch_router(society.view)
        watcher.subscribe()
        helpers = stack.enter_context(Helpers(args.mesh))
        if args.policy is not None and (alive := _assistant(Client(mesh))):
            raise FailedError(f"--policy: {alive} is alive, and has a policy of its own, or none")
        # A client that starts the agent would choose its own policy.
        starts = (
            None if args.client else partial(helpers.start, args.mesh.namespace, ASSISTANT, sets)
        )
        server = Server(
            (Client(mesh), Client(mesh)),
            watcher,
            society,
            starts,
            _rehearsal(mesh, args.world),
            limited=args.policy is not None,
        )
        if args.http is None or guard is None:
            server.serve(sys.stdin.buffer, sys.stdout.buffer, Lines(options.version()))
        else:
            _serve_http(server, args.http, guard, given=bool(_given(args.token)))
    return 0


def _given(token: str | None) -> str | None:
    return token or os.environ.get(TOKEN_VARIABLE) or None


def _rehearsal(mesh: ZenohMesh, world: str | None) -> Rehearse | None:
    """What drives virtually, if it is installed. Raises ImportError if it is damaged."""
    from armadico.core.discovery import REHEARSALS, installed

    found = installed(REHEARSALS).get("virtual")
    if found is None:
        return None
    rehearse: Rehearse = partial(found.load(), mesh, world=world)
    return rehearse


def _serve_http(server: Server, address: Address, guard: Guard, *, given: bool) -> None:
    """Serve until Ctrl-C; a token that was `given` is not printed. Raises FailedError."""
    from armadico.watch.mcp.http import PATH, Door

    host, port = address
    try:
        door = Door(server, guard, host, port, options.version())
    except (OSError, OverflowError, UnicodeError) as error:
        what = getattr(error, "strerror", None) or error
        raise FailedError(f"cannot listen on {host}, port {port}: {what}") from None
    with door, suppress(KeyboardInterrupt):
        shown = f"[{host}]" if ":" in host else host
        print(f"mcp: http://{shown}:{door.port}{PATH}", flush=True)
        if not given:
            print(f"header: Authorization: Bearer {guard.token}", flush=True)
        server.keep()


def _settings(args: Options, world: World | None) -> tuple[str, ...]:
    """The parameters of an assistant agent. Raises ConfigError if the policy is wrong."""
    if args.client is not None and args.policy is not None:
        raise UsageError("--policy: with --client no assistant agent is started; name one of them")
    if args.policy is None:
        if args.log is not None:
            raise UsageError("--log is for --policy")
        return ()
    from armadico.config.shipped import find
    from armadico.watch.assistant.policy.policy import load

    path = find("policies", args.policy)
    load(path, world)
    sets = [("policy", path.resolve()), ("log", args.log and args.log.absolute())]
    words = [*sets, ("world", args.world)]
    return tuple(f"{key}={json.dumps(str(value))}" for key, value in words if value is not None)


def _assistant(client: Client) -> str:
    """The instance of the assistant agent that is alive; "" if none is."""
    from armadico.watch.mcp.guest import ASSISTANT

    client.settle()
    return next((instance for name, instance in client.agents() if name == ASSISTANT), "")


main: Final = Command(
    "armadico mcp",
    Options,
    run,
    "Serve a society to one program on standard input and output, or to several by HTTP: where,"
    " places, map, who, why, history, missions, rehearse, goto, mission, wait, cancel, stop,"
    " resume. What is asked for goes through the assistant agent, which is started if there is"
    " none: it publishes every request for people to see, replaces no mission,"
    " and releases no stop.",
    EXAMPLES,
)
