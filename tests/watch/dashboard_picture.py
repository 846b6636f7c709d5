"""Pictures of a recording by the native viewer, without a window; for docs and tests.

`python -m tests.watch.dashboard_picture RUN.rrd OUT.png [SECONDS [WIDTH HEIGHT]]`
"""

from __future__ import annotations

import io
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from PIL import Image
from rerun.experimental import ViewerClient

from armadico.mesh.ports import LOOPBACK, free_port
from armadico.watch.dashboard.canvas import TIMELINE
from armadico.watch.dashboard.viewer import VIEWER_MEMORY, Viewer, ViewerError

LOADING_S: Final = 30.0
SETTLE_S: Final = 2.0
"""Time for a viewer to lay out its views."""

SIZE: Final = (1280, 720)


@dataclass(frozen=True)
class Picture:
    """A PNG, the names of the views in it, and the errors shown in it."""

    png: bytes
    views: frozenset[str]
    errors: tuple[str, ...]


def photograph(recording: Path, t: float, size: tuple[int, int] = SIZE) -> Picture:
    """The dashboard at t (s) of a recording. Raises ViewerError."""
    port = free_port()
    options = ["--headless", "--port", str(port), "--memory-limit", VIEWER_MEMORY]
    window = f"{size[0]}x{size[1]}"
    with Viewer([*options, "--window-size", window], port, log="error") as viewer:
        client = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{viewer.port}/proxy")
        deadline = time.monotonic() + LOADING_S
        while not _opened(client, recording):  # it listens before it can answer
            viewer.check()
            if time.monotonic() > deadline:
                raise ViewerError(f"the viewer did not answer within {LOADING_S:.0f} s")
            time.sleep(0.1)
        while (state := client.get_state()).loading or not state.views:
            if time.monotonic() > deadline:
                raise ViewerError(f"{recording} was not loaded within {LOADING_S:.0f} s")
            time.sleep(0.1)
        client.set_time(TIMELINE, duration=t, play_state="paused")
        time.sleep(SETTLE_S)
        png = client.take_screenshot()
        state = client.get_state()
        errors = (r for view in state.views for r in view.reports if r.severity == "error")
        return Picture(png, frozenset(v.name for v in state.views), tuple(map(str, errors)))


def _opened(client: ViewerClient, recording: Path) -> bool:
    try:
        client.open(str(recording.resolve()))
    except ConnectionError:
        return False
    return True


def main(arguments: list[str]) -> None:
    recording, out, *rest = arguments
    numbers = [float(number) for number in rest]
    size = (int(numbers[1]), int(numbers[2])) if len(numbers) > 2 else SIZE
    try:
        taken = photograph(Path(recording), numbers[0] if numbers else 0.0, size)
    except (ViewerError, TimeoutError) as error:
        sys.exit(f"no picture of {recording}: {error}")
    with Image.open(io.BytesIO(taken.png)) as image:  # optimized, a third of the bytes
        image.convert("RGB").save(out, format="PNG", optimize=True)
    sys.stdout.write(f"{out}: {', '.join(sorted(taken.views))}; {taken.errors or 'no errors'}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
