"""Detection of a display."""

from __future__ import annotations

import os
from collections.abc import Mapping


def has_screen(environ: Mapping[str, str]) -> bool:
    """Whether a window or a browser can be opened on this machine."""
    if os.name == "nt" or os.uname().sysname == "Darwin":
        return True
    return bool(environ.get("DISPLAY") or environ.get("WAYLAND_DISPLAY"))
