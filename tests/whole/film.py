"""The film of docs/rehearse.md: on the page a goal is rehearsed, and then driven.

    python -m tests.whole.film docs/images/ask-first.gif

It starts a society of its own (world `house`), and leaves nothing running.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

from armadico.launch.processes import kill_trees
from tests.watch.browser import Browser
from tests.watch.page.test_browser import PARTS, at

SIZE = (1100, 640)
WIDTH = 880  # pixels of the film
FRAME_S = 0.25
COLOURS = 64
GOAL = (7.1, 4.8)  # m, in `house`


class Film:
    """Pictures of a page, each shown for as long as it was taken for."""

    def __init__(self, page: Browser) -> None:
        self._page = page
        self._frames: list[Image.Image] = []
        self._shown_ms: list[int] = []

    def take(self, shown_s: float = FRAME_S) -> None:
        """Take one picture."""
        png = Image.open(io.BytesIO(self._page.screenshot())).convert("RGB")
        size = (WIDTH, round(png.height * WIDTH / png.width))
        small = png.resize(size, Image.Resampling.LANCZOS)
        self._frames.append(small.quantize(COLOURS, dither=Image.Dither.NONE))
        self._shown_ms.append(round(1000 * shown_s))

    def until(self, condition: str, limit_s: float, faster: float = 1.0) -> None:
        """Take pictures until a condition of the page holds; the film is `faster` than it."""
        end = time.monotonic() + limit_s
        due = time.monotonic()
        while time.monotonic() < end:
            began = time.monotonic()
            self.take()
            if self._page.evaluate(f"Boolean({condition})"):
                return
            due = max(due + FRAME_S * faster, began)
            self._page.evaluate(f"new Promise((done) => setTimeout(done, {1000 * (due - began)}))")
        raise TimeoutError(f"not within {limit_s:.0f} s: {condition}")

    def save(self, file: Path) -> None:
        """Write it as GIF."""
        first, *rest = self._frames
        first.save(file, save_all=True, append_images=rest, duration=self._shown_ms, loop=0)


def film(address: str, file: Path) -> None:
    """Ask, look, go."""
    with tempfile.TemporaryDirectory() as folder, Browser(Path(folder), *SIZE) as page:
        page.open(address)
        page.until(f"{PARTS}.motion.x !== undefined && {PARTS}.wheels.contenders.length > 2")
        page.evaluate("document.getElementById('ask').click()")
        made = Film(page)
        made.take(1.5)
        page.drag(at(page, *GOAL))
        answered = "/^(yes|no|unknown)/.test(document.getElementById('says').innerText)"
        made.until(answered, 300.0, faster=8.0)
        made.take(4.0)
        page.evaluate("document.getElementById('godo').click()")
        made.until(f"{PARTS}.mission.state === 'reached'", 120.0, faster=4.0)
        made.take(2.0)
        made.save(file)


def main() -> int:
    """Run a society for the film."""
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    program = Path(sys.executable).parent / "armadico"
    society = subprocess.Popen(
        [program, "up", "house", "--page"], stderr=subprocess.PIPE, text=True
    )
    try:
        assert society.stderr is not None
        link = next(word for line in society.stderr for word in line.split() if "http://" in word)
        film(link, Path(sys.argv[1]))
    finally:
        kill_trees(society)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
