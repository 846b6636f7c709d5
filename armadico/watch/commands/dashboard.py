"""Show a society live in Rerun: the global and the local map, and utilities over time.

One process that subscribes to the mesh. Agents do not depend on it.
"""

from __future__ import annotations

import os
import signal
import sys
import webbrowser
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, flag, group, option
from armadico.runtime.signals import ending
from armadico.watch.beside import STARTING
from armadico.watch.screen import has_screen

if TYPE_CHECKING:
    from armadico.config.worlds import World
    from armadico.mesh.virtual import VirtualMesh
    from armadico.watch.dashboard.local_map import Zones
    from armadico.watch.dashboard.viewer import Viewer
    from armadico.watch.dashboard.virtual_run import Rehearsed

RERUN: Final = "0.41"
"""The supported version; Rerun's interfaces change between versions."""

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
    web: bool = flag("show it in a browser (the default)", either="where")
    native: bool = flag("show it in its own window", either="where")
    headless: bool = flag("serve and record without a viewer", either="where")
    record: Path | None = option("also write a file", metavar="FILE.rrd")
    world: str | None = option("draw the walls of this world (default: none)", metavar="MAP")
    port: int = option(
        f"port of the data; 0: a free port (default: {PORT})", default=PORT, metavar="P"
    )
    web_port: int = option(
        f"port of the page; 0: a free port (default: {WEB_PORT})", default=WEB_PORT, metavar="P"
    )
    no_open: bool = flag("do not open a browser")
    starting: bool = flag(None, STARTING)
    mesh: options.Meshes = group(options.Meshes, "the mesh")


def run(args: Options) -> int:
    """Serve until Ctrl-C."""
    _check_installed()
    _quiet()
    world = options.world_of(args.world)
    _check_record("--record", args.record)
    from armadico.watch.dashboard.viewer import ViewerError

    try:
        return _show(args, world)
    except ViewerError as error:
        raise FailedError(str(error)) from None


def kept(mesh: VirtualMesh, world: str, path: Path) -> Rehearsed:
    """A context in which a virtual run is written to a Rerun file.

    Raises UsageError or FailedError before the run.
    """
    _check_installed()
    _quiet()
    _check_record("--rrd", path)
    from armadico.watch.dashboard.virtual_run import Rehearsed

    return Rehearsed(mesh, world, path, zones())


def zones() -> Zones:
    """The zones around the robot of all installed agents, such as avoid's (thesis 3.5.2)."""
    from armadico.core.discovery import agents

    found: dict[str, Callable[[float], float]] = {}
    for _, kind in agents():
        found |= kind.borders
    return found


def _check_installed() -> None:
    """Raises FailedError with the command that installs it."""
    try:
        found = installed("rerun-sdk")
    except PackageNotFoundError:
        raise FailedError(f"the dashboard needs rerun, an extra: {INSTALL}") from None
    if not found.startswith(f"{RERUN}."):
        raise FailedError(f"rerun-sdk {found} is installed; {RERUN} is needed: {INSTALL}")


def _quiet() -> None:
    """Silence Rerun's warnings about itself; to be called before it is imported."""
    os.environ.setdefault("RUST_LOG", "error")


def _check_record(option: str, path: Path | None) -> None:
    """Raises UsageError or FailedError if the file cannot be written."""
    if path is None:
        return
    if path.suffix != ".rrd":
        raise UsageError(f"{option} {path}: the name must end with .rrd")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("wb").close()
    except OSError as error:
        raise FailedError(f"cannot write {path}: {error.strerror}") from None


def _show(args: Options, world: World | None) -> int:
    from armadico.watch.dashboard import viewer
    from armadico.watch.dashboard.live import Live
    from armadico.watch.dashboard.scene import Scene
    from armadico.watch.dashboard.server import close, finish, serve

    port = viewer.checked_port(args.port, "--port")
    meshes = args.mesh.join_each(starts=args.starting)
    spaces = [mesh.namespace for mesh in meshes]
    with ExitStack() as stack:
        recording, uri = serve(dict.fromkeys(spaces, world), port, args.record)
        if args.record is None:
            stack.callback(close, recording)
        else:
            stack.callback(finish, recording, args.record)
        for mesh in meshes:
            stack.enter_context(mesh)
        scenes = [Scene(recording, world, space, zones()) for space in spaces]
        live = Live(meshes, scenes, options.reporter("armadico dashboard"))
        for number in ending():
            signal.signal(number, lambda *_: live.stop())
        window = _open(args, uri)
        if window is not None:
            stack.enter_context(window)
        seen = False

        def ended() -> bool:
            nonlocal seen
            if not seen and viewer.watched(port):
                seen = True
                print("dashboard: a viewer is connected", flush=True)
            return window is not None and window.ended()

        live.run(ended)
        if window is not None and window.ended():
            options.report("armadico dashboard: the viewer has ended, so the dashboard ends")
    return 0


def _open(args: Options, uri: str) -> Viewer | None:
    """Open the chosen viewer and print its address; None without one."""
    from armadico.watch.dashboard import viewer

    if args.headless:
        print(f"dashboard: no window; a viewer may connect to {uri}", flush=True)
        return None
    if args.native:
        window = viewer.native(uri)
        print(f"dashboard: in its own window, from {uri}", flush=True)
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
    " time. It is served on this machine's loopback only.",
    EXAMPLES,
)
