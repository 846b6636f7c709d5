"""The dashboard's page in a browser, on a machine without internet or a graphics card."""

from __future__ import annotations

import io
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

pytest.importorskip("rerun", reason="the dashboard's extra is not installed")

from PIL import Image

from armadico.config.scenarios import ideal, load_scenario
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.watch.dashboard import palette, viewer
from armadico.watch.dashboard.virtual_run import Rehearsed
from tests.watch.browser import Browser, Event, executable

SIZE = (1280, 720)
# Timeout for loading 43 MB of program and drawing without a graphics card; it takes 30 s.
DRAWN_S = 90.0

WANTED = {palette.agent(name)[:3] for name in ("goto", "avoid", "gothrough")}


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A short run in few chunks: without a graphics card the viewer reads a few per image."""
    drawn, packed = tmp_path / "drawn.rrd", tmp_path / "packed.rrd"
    rehearsal = Rehearsal(ideal(load_scenario("sc3")), Options())
    with Rehearsed(rehearsal.mesh, rehearsal.scenario.world, drawn, {}):
        assert rehearsal.run().reached
    command = [str(viewer.binary()), "rrd", "optimize", str(drawn), "-o", str(packed)]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    return packed


@pytest.fixture
def page(recording: Path) -> Iterator[str]:
    """The address of a page that shows it, as `armadico dashboard` prints it."""
    data, web = viewer.free_port(), viewer.free_port()
    options = ["--serve-web", "--web-viewer-port", str(web), "--port", str(data)]
    with viewer.Viewer([*options, str(recording)], web):
        address = viewer.link(f"rerun+http://{viewer.LOOPBACK}:{data}/proxy", web)
        yield f"{address}&renderer=webgl"


@pytest.mark.long
@pytest.mark.live
@pytest.mark.skipif(executable() is None, reason="no Chromium here: apt-get install chromium")
@pytest.mark.timeout(240)
def test_the_page_shows_the_run_without_internet(page: str, tmp_path: Path) -> None:
    with Browser(tmp_path, *SIZE) as browser:
        browser.open(page)
        png = settled(browser)
        (tmp_path / "page.png").write_bytes(png)
        assert colours(png) >= WANTED
        assert browser.received("Runtime.exceptionThrown") == []
        assert complaints(browser) == []
        hosts = {host(r["response"]["url"]) for r in browser.received("Network.responseReceived")}
        assert hosts == {viewer.LOOPBACK}


def settled(browser: Browser) -> bytes:
    """The screenshot with the wanted colours, twice the same; after a timeout the last one."""
    deadline = time.monotonic() + DRAWN_S
    before, png = b"", browser.screenshot()
    while time.monotonic() < deadline and (png != before or not colours(png) >= WANTED):
        before, png = png, browser.screenshot()
    return png


def colours(png: bytes) -> set[tuple[int, ...]]:
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    assert picture.size == SIZE
    return {colour for _, colour in picture.getcolors(2**20) or []}


def complaints(browser: Browser) -> list[Event]:
    """Errors on the page's console, except for failed requests to the internet."""
    logged = [entry["entry"] for entry in browser.received("Log.entryAdded")]
    here = [entry for entry in logged if host(entry.get("url", "")) in ("", viewer.LOOPBACK)]
    calls = browser.received("Runtime.consoleAPICalled")
    return [entry for entry in here if entry["level"] == "error"] + [
        event
        for event in calls
        if event["type"] == "error" and "Failed to fetch" not in str(event["args"])
    ]


def host(url: str) -> str:
    return urlsplit(url).hostname or ""
