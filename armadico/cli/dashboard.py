"""Show a society live in Rerun: the global and the local map, and utilities over time.

One process that subscribes to the mesh; no agent notices whether it runs, is slow or hangs.
"""

from __future__ import annotations

import os
import signal
import sys
import webbrowser
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.beside import STARTING
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, flag, group, option
from armadico.observe.screen import has_screen

if TYPE_CHECKING:
    from armadico.config.worlds import World
    from armadico.launch.virtual import Rehearsal
    from armadico.observe.dashboard.local_map import Zones
    from armadico.observe.dashboard.viewer import Viewer
    from armadico.observe.dashboard.virtual_run import Rehearsed

RERUN: Final = "0.41"
"""The version that this is written for; the viewer's interfaces change from one to the next."""

INSTALL: Final = f"{sys.executable} -m pip install 'armadico[dashboard]'"

PORT: Final = 9876
WEB_PORT: Final = 9090

EXAMPLES: Final = """\
  armadico dashboard --world sc4             in a browser; the link is printed
  armadico dashboard --native                in a window of its own
  armadico dashboard --headless --record run.rrd
  armadico dashboard --namespace robot1 --namespace robot2
  armadico run sc4 --dashboard               with the run
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    web: bool = flag("a page for a browser (the default)", either="where")
    native: bool = flag("a window of its own", either="where")
    headless: bool = flag("nothing to see: serve and record", either="where")
    record: Path | None = option("keep it in a file, too", metavar="FILE.rrd")
    world: str | None = option("draw the walls of this world", metavar="MAP")
    port: int = option(
        f"of the data, 0: one that is free (default: {PORT})", default=PORT, metavar="P"
    )
    web_port: int = option(
        f"of the page, 0: one that is free (default: {WEB_PORT})", default=WEB_PORT, metavar="P"
    )
    no_open: bool = flag("do not open a browser")
    starting: bool = flag(None, STARTING)
    mesh: options.Meshes = group(options.Meshes, "the mesh")


def run(args: Options) -> int:
    """Show what happens until Ctrl-C."""
    _check_installed()
    _quiet()
    world = options.world_of(args.world)
    _check_record("--record", args.record)
    from armadico.observe.dashboard.viewer import ViewerError

    try:
        return _show(args, world)
    except ViewerError as error:
        raise FailedError(str(error)) from None


def kept(rehearsal: Rehearsal, path: Path) -> Rehearsed:
    """What the dashboard would show of a virtual run, kept in a file while this is entered.

    Raises UsageError or FailedError before the run.
    """
    _check_installed()
    _quiet()
    _check_record("--rrd", path)
    from armadico.observe.dashboard.virtual_run import Rehearsed

    return Rehearsed(rehearsal.mesh, rehearsal.scenario.world, path, zones())


def zones() -> Zones:
    """The borders that agents installed here have around the robot, as avoid (thesis 3.5.2)."""
    from armadico.config.discovery import AGENTS, agent_class, installed

    found: dict[str, Callable[[float], float]] = {}
    for name in installed(AGENTS):
        with suppress(ImportError):  # somebody else's, and broken: not ours to mend
            found |= agent_class(name).borders
    return found


def _check_installed() -> None:
    """Raises FailedError, saying what to install."""
    try:
        found = installed("rerun-sdk")
    except PackageNotFoundError:
        raise FailedError(f"the dashboard needs rerun, which is an extra: {INSTALL}") from None
    if not found.startswith(f"{RERUN}."):
        raise FailedError(
            f"rerun-sdk {found} is installed, and the dashboard needs {RERUN}: {INSTALL}"
        )


def _quiet() -> None:
    """Rerun's library warns of itself where nobody can do anything; before it is imported."""
    os.environ.setdefault("RUST_LOG", "error")


def _check_record(option: str, path: Path | None) -> None:
    """Whether it can be written is said before anything starts. Raises FailedError, UsageError."""
    if path is None:
        return
    if path.suffix != ".rrd":
        raise UsageError(f"{option} {path}: rerun reads files whose names end with .rrd")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("wb").close()
    except OSError as error:
        raise FailedError(f"cannot write {path}: {error.strerror}") from None


def _show(args: Options, world: World | None) -> int:
    """Join, serve, show; everything is down again when this returns."""
    from armadico.observe.dashboard import viewer
    from armadico.observe.dashboard.live import Live
    from armadico.observe.dashboard.scene import Scene
    from armadico.observe.dashboard.server import close, serve

    port = viewer.checked_port(args.port, "--port")
    meshes = args.mesh.join_each(starts=args.starting)
    spaces = [mesh.namespace for mesh in meshes]
    with ExitStack() as stack:
        recording, uri = serve(dict.fromkeys(spaces, world), port, args.record)
        stack.callback(close, recording)
        for mesh in meshes:
            stack.enter_context(mesh)
        scenes = [Scene(recording, world, space, zones()) for space in spaces]
        live = Live(meshes, scenes, options.teller("armadico dashboard"))
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: live.stop())
        window = _open(args, uri)
        if window is not None:
            stack.enter_context(window)
        seen = False

        def ended() -> bool:
            nonlocal seen
            if not seen and viewer.watched(port):
                seen = True
                print("dashboard: somebody looks", flush=True)
            return window is not None and window.ended()

        live.run(ended)
        if window is not None and window.ended():
            options.say("armadico dashboard: the viewer is gone, and so is the dashboard")
    return 0


def _open(args: Options, uri: str) -> Viewer | None:
    """Whatever shows it; says where."""
    from armadico.observe.dashboard import viewer

    if args.headless:
        print(f"dashboard: no window; a viewer may connect to {uri}", flush=True)
        return None
    if args.native:
        window = viewer.native(uri)
        print(f"dashboard: in a window of its own, from {uri}", flush=True)
        return window
    web_port = viewer.checked_port(args.web_port, "--web-port")
    served = viewer.web(uri, web_port)
    address = viewer.link(uri, web_port)
    print(f"dashboard: {address}", flush=True)
    if not args.no_open and has_screen(os.environ):
        webbrowser.open(address)
    return served


main: Final = Command(
    "armadico dashboard",
    Options,
    run,
    "Show a society live in Rerun: the global and the local map, utilities and holders over"
    " time. Everything is served on this machine's loopback only.",
    EXAMPLES,
)
