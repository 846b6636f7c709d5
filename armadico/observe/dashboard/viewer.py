"""The viewer as a process of its own: rerun's binary itself, on loopback, with its memory limited.

The `rerun` on the path is a wrapper whose end leaves the real program running, and by default it
listens on every interface; so neither is used.
"""

from __future__ import annotations

import os
import re
import socket
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final
from urllib.parse import urlencode

import rerun_cli

from armadico.mesh.ports import LOOPBACK, free_port
from armadico.observe.screen import has_screen
from armadico.runtime.programs import Program, end

VIEWER_MEMORY: Final = "1GB"
"""What a native viewer keeps before it drops the oldest data."""

START_S: Final = 15.0

WORDS: Final = 20
"""So many lines of its last words are shown."""

ESTABLISHED: Final = "01"
"""A connection's state, as the kernel lists it."""

NO_GRAPHICS: Final = re.compile(
    r"graphics adapter|render context|wgpu|Vulkan|WINDOWING|DISPLAY|winit", re.I
)


class ViewerError(RuntimeError):
    """The viewer cannot be had; the message says why, and what to do."""


class Viewer(Program):
    """One process of rerun's; a context manager that leaves nothing running."""

    def __init__(self, arguments: Sequence[str], port: int, log: str = "info") -> None:
        """Start it; `port` is where it will listen, `log` what it says. Raises ViewerError."""
        self.port = port
        self._file = tempfile.NamedTemporaryFile()  # noqa: SIM115 - closed with the viewer
        argv = [str(binary()), "--bind", LOOPBACK, *arguments]
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
        """Raise ViewerError, with its last words, if it is gone: it listens before it draws."""
        if self.ended():
            raise _explained(self.last_words(WORDS))

    def stop(self) -> None:
        """End it, in order if it can, and within a few seconds."""
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
    """Serve the web viewer, which shows `uri` in a browser that opens `link`."""
    return Viewer(["--serve-web", "--web-viewer-port", str(port), uri], port)


def link(uri: str, port: int) -> str:
    """What to open in a browser."""
    return f"http://{LOOPBACK}:{port}/?{urlencode({'url': uri, 'theme': 'dark'})}"


def native(uri: str) -> Viewer:
    """A window that shows `uri`. Raises ViewerError where there is no screen."""
    if not has_screen(os.environ):
        raise ViewerError(
            "--native needs a screen, and neither DISPLAY nor WAYLAND_DISPLAY is set;"
            " --web serves a page for a browser, --headless only records"
        )
    port = free_port()
    options = ["--port", str(port), "--memory-limit", VIEWER_MEMORY, "--hide-welcome-screen"]
    return Viewer([*options, uri], port)


def binary() -> Path:
    """The program itself, as the wheel brought it. Raises ViewerError."""
    for name in ("rerun", "rerun.exe"):
        path = Path(rerun_cli.__file__).parent / name
        if path.is_file():
            return path
    raise ViewerError("rerun-sdk came without its viewer; pip install 'armadico[dashboard]'")


def listening(port: int) -> bool:
    """Whether somebody answers on a port of this machine."""
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
        return True  # nobody can say, so nobody waits
    here = f"0100007F:{port:04X}"
    return any(line.split()[1] == here and line.split()[3] == ESTABLISHED for line in listed)


def checked_port(port: int, option: str) -> int:
    """The port, or one that is free for 0. Raises ViewerError if somebody has it."""
    if port == 0:
        return free_port()
    try:
        socket.create_server((LOOPBACK, port)).close()
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ViewerError(
            f"port {port} cannot be used ({reason}); perhaps another dashboard has it:"
            f" {option} 0 takes one that is free"
        ) from None
    return port


def _explained(words: str) -> ViewerError:
    if NO_GRAPHICS.search(words):
        return ViewerError(
            f"the viewer found no graphics (Vulkan or a screen):\n{words}\n"
            "--web serves a page for a browser, --headless only records; on Debian,"
            " mesa-vulkan-drivers draws without a graphics card"
        )
    return ViewerError(f"the viewer did not start:\n{words}")
