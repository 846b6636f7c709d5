"""The viewer process: rerun's binary, on loopback, with limited memory. It ends with this process.

The `rerun` command on the path is not used: it is a wrapper that leaves the real program running
when it ends. Its default of listening on all interfaces is not used either.
"""

from __future__ import annotations

import os
import re
import signal
import socket
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final
from urllib.parse import urlencode

import rerun_cli

from armadico.launch.processes import bound
from armadico.launch.programs import Program, end
from armadico.mesh.ports import LOOPBACK, free_port
from armadico.watch.screen import has_screen

VIEWER_MEMORY: Final = "1GB"  # of a native viewer; beyond it the oldest data are dropped

START_S: Final = 15.0

LOG_LINES: Final = 20  # last lines of the viewer's log that an error shows
ESTABLISHED: Final = "01"  # a connection's state in /proc/net/tcp

NO_GRAPHICS: Final = re.compile(
    r"graphics adapter|render context|wgpu|Vulkan|WINDOWING|DISPLAY|winit", re.I
)


class ViewerError(RuntimeError):
    """The viewer cannot be started; the message has the reason and what to do."""


class Viewer(Program):
    """One process of rerun; a context manager that leaves nothing running."""

    def __init__(self, arguments: Sequence[str], port: int, log: str = "info") -> None:
        """Start it; `port` is the port that it listens on, `log` its level. Raises ViewerError."""
        self.port = port
        self._file = tempfile.NamedTemporaryFile()  # noqa: SIM115 - closed with the viewer
        argv = [str(binary()), "--bind", LOOPBACK, *arguments]
        argv = bound(argv, signal.SIGTERM)  # otherwise it would keep the port if this is killed
        super().__init__("viewer", argv, Path(self._file.name), env={"RUST_LOG": log})
        try:
            self._await_port()
        except BaseException:
            self.stop()
            raise

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def check(self) -> None:
        """Raise ViewerError with its log if it has ended: it listens before it can draw."""
        if self.ended():
            raise _explained(self.last_lines(LOG_LINES))

    def stop(self) -> None:
        """End it within a few seconds, gracefully if possible."""
        end(self.popen)
        self._file.close()

    def _await_port(self) -> None:
        deadline = time.monotonic() + START_S
        while not listening(self.port):
            self.check()
            if time.monotonic() > deadline:
                raise ViewerError(f"the viewer did not start within {START_S:.0f} s")
            time.sleep(0.05)


def web(uri: str, port: int) -> Viewer:
    """Serve the web viewer for `uri`; a browser opens `link`."""
    return Viewer(["--serve-web", "--web-viewer-port", str(port), uri], port)


def link(uri: str, port: int) -> str:
    return f"http://{LOOPBACK}:{port}/?{urlencode({'url': uri, 'theme': 'dark'})}"


def native(uri: str) -> Viewer:
    """Open a window that shows `uri`. Raises ViewerError without a screen."""
    if not has_screen(os.environ):
        raise ViewerError(
            "--native needs a screen, but neither DISPLAY nor WAYLAND_DISPLAY is set;"
            " use --web for a browser, or --headless to record only"
        )
    port = free_port()
    options = ["--port", str(port), "--memory-limit", VIEWER_MEMORY, "--hide-welcome-screen"]
    return Viewer([*options, uri], port)


def binary() -> Path:
    """The program's path in the installed wheel. Raises ViewerError."""
    for name in ("rerun", "rerun.exe"):
        path = Path(rerun_cli.__file__).parent / name
        if path.is_file():
            return path
    raise ViewerError("rerun-sdk has no viewer; run: pip install 'armadico[dashboard]'")


def listening(port: int) -> bool:
    """Whether a program listens on a port of this machine."""
    try:
        socket.create_connection((LOOPBACK, port), timeout=0.5).close()
    except OSError:
        return False
    return True


def watched(port: int) -> bool:
    """Whether a viewer is connected to the data's port, by what the kernel lists (Linux)."""
    try:
        listed = Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]
    except OSError:
        return True  # not known, so do not wait
    here = f"0100007F:{port:04X}"
    return any(line.split()[1] == here and line.split()[3] == ESTABLISHED for line in listed)


def checked_port(port: int, option: str) -> int:
    """The port, or a free one for 0. Raises ViewerError if it is in use."""
    if port == 0:
        return free_port()
    try:
        socket.create_server((LOOPBACK, port)).close()
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ViewerError(
            f"port {port} cannot be used ({reason}); another dashboard may use it:"
            f" {option} 0 selects a free one"
        ) from None
    return port


def _explained(words: str) -> ViewerError:
    if NO_GRAPHICS.search(words):
        return ViewerError(
            f"the viewer found no graphics (Vulkan or a screen):\n{words}\n"
            "use --web for a browser, or --headless to record only; on Debian,"
            " mesa-vulkan-drivers renders without a graphics card"
        )
    return ViewerError(f"the viewer did not start:\n{words}")
