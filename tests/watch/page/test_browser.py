"""The page in a browser, with a running virtual society."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from itertools import product
from math import degrees, hypot
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from armadico.config.grid_map import Cells
from armadico.config.grid_map import message_of as grid_message
from armadico.config.map_graphs import message_of as graph_message
from armadico.core import messages as m
from armadico.mesh.ports import LOOPBACK
from armadico.mobile.messages import MapGraph
from armadico.watch.page.guard import PROTOCOL, Guard
from armadico.watch.page.server import MOST, Server
from armadico.watch.page.session import TURN_S
from armadico.watch.teleop.teleop import Teleop
from tests.watch.browser import Browser, executable
from tests.watch.page.stage import HOME, Served, served, subprotocol

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(executable() is None, reason="no Chromium here: apt-get install chromium"),
    pytest.mark.timeout(240),
]

SIZE = (1280, 720)
SIZES = ((1280, 720, False), (1600, 1000, False), (390, 844, True))
TOKEN = "0123456789abcdef0123"

PARTS = f"armadico.robots.get('{HOME}').parts"
HELD = f"document.getElementById('stop').classList.contains('held') && {PARTS}.stop.held"


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("chromium"), *SIZE) as browser:
        yield browser


@pytest.fixture
def stage() -> Iterator[Served]:
    with served(Served("sc4")) as made:
        yield made


@pytest.fixture
def page(chromium: Browser, stage: Served) -> Iterator[Browser]:
    chromium.size(*SIZE)
    open_page(chromium, stage.address)
    yield chromium
    assert chromium.received("Runtime.exceptionThrown") == []


def open_page(browser: Browser, address: str) -> None:
    browser.open(address)
    browser.until(f"{PARTS}.motion.x !== undefined && {PARTS}.wheels.contenders.length > 2")


def at(browser: Browser, x: float, y: float) -> tuple[float, float]:
    """The position of a place of the world on the page."""
    script = f"""(() => {{
        const box = document.getElementById('map').getBoundingClientRect();
        const [px, py] = armadico.plan.screen({x}, {y});
        return [box.left + px, box.top + py];
    }})()"""
    px, py = browser.evaluate(script)
    return px, py


def shown(browser: Browser, part: str) -> Any:
    return json.loads(browser.evaluate(f"JSON.stringify({PARTS}.{part})"))


def off(browser: Browser, x: float, y: float) -> float:
    motion = shown(browser, "motion")
    return hypot(motion["x"] - x, motion["y"] - y)


def arrived(browser: Browser, x: float, y: float) -> None:
    """Wait until the robot has reached a place."""
    off = f"Math.hypot({PARTS}.motion.x - {x}, {PARTS}.motion.y - {y})"
    browser.until(f"{PARTS}.mission.state === 'reached' && {off} < 0.15")


@pytest.mark.long
def test_a_click_a_drag_a_wall_and_the_stop(page: Browser, stage: Served) -> None:
    page.drag(at(page, 3.4, 1.3))
    arrived(page, 3.4, 1.3)
    since = page.evaluate("document.querySelector('#exchanges .time').innerText")
    assert since.endswith(" ago"), since
    here = at(page, 3.2, 1.8)
    page.drag(here, (here[0] + 4, here[1] + 8), (here[0] + 40, here[1]))
    page.until(f"{PARTS}.mission.way?.at(-1)?.[0] < 3.3")
    arrived(page, 3.2, 1.8)
    assert abs(degrees(shown(page, "motion")["theta"])) < 6.0
    page.drag(at(page, 4.6, 1.5))
    page.until("document.querySelector('#remarks .no')?.innerText.includes('wall')")
    stage.watched = 0.1
    page.drag(at(page, 7.4, 1.5))
    page.until(f"{PARTS}.motion.v > 0.25")
    commands: list[tuple[int, tuple[float, ...]]] = []
    stage.call(lambda: stage.mesh.watch(lambda _, c, t: commands.append((t, c)), m.Command))
    page.key(" ", "Space")
    page.until(HELD)
    page.until(f"{PARTS}.motion.v === 0 && {PARTS}.motion.w === 0")
    there = shown(page, "motion")
    cycle = there["cycle"]
    page.until(f"{PARTS}.motion.cycle > {cycle + 30}")
    assert off(page, there["x"], there["y"]) < 0.01
    page.evaluate("document.getElementById('resume').focus()")
    page.key("Enter", "Enter")
    page.until(f"!{PARTS}.stop.stopped && {PARTS}.motion.v > 0.1")


def test_a_place_is_chosen_by_its_name_and_seen_before_the_robot_goes(page: Browser) -> None:
    page.until("document.querySelector('#place option[value=B]')")
    choose = "(place.value = 'B', place.dispatchEvent(new Event('change')))"
    page.evaluate(f"{{ const place = document.getElementById('place'); {choose}; }}")
    fields = "['gox', 'goy', 'goa'].map((id) => document.getElementById(id).value).join(' ')"
    assert page.evaluate(fields) == "7.40 0.70 -90"
    page.until(f"{PARTS}.mission.state")  # the page may be older than its first mission
    assert shown(page, "mission")["state"] == "none"
    page.evaluate("document.querySelector('#go button').click()")
    page.until(f"{PARTS}.mission.way?.at(-1)?.[0] > 7.3")


def inks(browser: Browser, x: float, y: float) -> set[str]:
    """Which of the colours of loops and of those that are off are near a place of the world."""
    script = f"""(() => {{
        const [px, py] = armadico.plan.screen({x}, {y}), scale = devicePixelRatio;
        const box = [px - 8, py - 8, 16, 16].map((v) => Math.round(v * scale));
        const {{ data }} = armadico.plan.ctx.getImageData(...box);
        const {{ good, stop }} = armadico.plan.c;
        return Object.entries({{ on: good, off: stop }}).filter(([, css]) => {{
            const ink = css.match(/[0-9a-f]{{2}}/g).map((v) => parseInt(v, 16));
            const at = Array.from({{ length: data.length / 4 }}, (_, k) => data.slice(4 * k));
            return at.some((pixel) => ink.every((v, i) => Math.abs(v - pixel[i]) < 60));
        }}).map(([name]) => name);
    }})()"""
    browser.evaluate("new Promise((done) => requestAnimationFrame(() => setTimeout(done)))")
    return set(browser.evaluate(script))


@pytest.mark.long
def test_loops_of_the_present_map_are_drawn_and_those_switched_off_in_another_colour(
    chromium: Browser,
) -> None:
    stage = Served("sc4", pace=TURN_S)  # a graph is shown for 20 s of the society's time
    scans = [(5.0, 0.5, 0.0), (6.5, 2.5, 0.0), (5.0, 2.5, 0.0), (6.5, 0.5, 0.0)]
    on, off = (5.0, 1.5), (6.5, 1.5)  # the middles of two loops
    graph = graph_message(1, scans, [(0, 2), (1, 3)], [False, True])
    cells = Cells(0.0, 0.0, 0.5, np.ones((8, 20), dtype=np.uint8))

    def drawn(graph: MapGraph, revision: int) -> tuple[set[str], set[str]]:
        """The colours of both loops, on a map of a revision."""
        for message in (grid_message(cells, revision), graph):
            stage.call(partial(stage.client.publish, message))
        chromium.until(
            f"{PARTS}.graph?.revision === {graph.revision} && {PARTS}.slam"
            f" && {PARTS}.slam.uncertain === '{graph.uncertain}'"
            f" && armadico.plan.robots.get('{HOME}').grid?.revision === {revision}"
        )
        return inks(chromium, *on), inks(chromium, *off)

    chromium.size(*SIZE)
    with served(stage):
        open_page(chromium, stage.address)
        assert drawn(graph, 1) == ({"on"}, {"off"})
        legend = "document.getElementById('slam').innerText"
        assert "1 of them switched off" in chromium.evaluate(legend)
        chromium.evaluate("document.getElementById('graph').click()")
        assert (inks(chromium, *on), inks(chromium, *off)) == (set(), set())
        chromium.evaluate("document.getElementById('graph').click()")
        assert drawn(graph, 2) == (set(), set())  # the map has moved on, and the graph is late
        assert drawn(replace(graph, revision=2, uncertain="so it is"), 2) == ({"on"}, {"off"})
        assert "so it is" in chromium.evaluate(legend)


@pytest.mark.long
def test_with_the_keyboard_alone(page: Browser) -> None:
    page.evaluate("document.getElementById('map').focus()")
    for _ in range(4):
        page.key("ArrowUp", "ArrowUp")
    page.key(",", "Comma")
    page.key("Enter", "Enter")
    arrived(page, 3.4, float(page.evaluate("document.getElementById('goy').value")))
    page.evaluate("document.getElementById('tab-drive').focus()")
    for tab in ("hand", "tasks", "agents", "tune"):
        page.key("ArrowRight", "ArrowRight")
        assert page.evaluate("document.activeElement.id") == f"tab-{tab}"
        assert page.evaluate(f"!document.getElementById('{tab}').hidden")
    page.key(" ", "Space")  # it does not press the focused element
    page.until(HELD)


@pytest.mark.long
def test_two_browsers_one_stops_the_other_resumes(
    page: Browser, stage: Served, tmp_path: Path
) -> None:
    with Browser(tmp_path, *SIZE) as other:
        open_page(other, stage.address)
        stage.watched = 0.1
        page.drag(at(page, 3.4, 2.4))
        other.until(f"{PARTS}.mission.state === 'driving' && {PARTS}.motion.v > 0.1")
        button = other.evaluate(
            "(({x, y}) => [x + 20, y + 20])"
            "(document.getElementById('stop').getBoundingClientRect())"
        )
        other.mouse("mousePressed", *button)  # without a release
        page.until(HELD)
        assert "page-2-" in page.evaluate("document.getElementById('latched').innerText")
        page.evaluate("document.getElementById('resume').click()")
        other.until(f"!{PARTS}.stop.stopped && {PARTS}.motion.v > 0.1")
        assert other.received("Runtime.exceptionThrown") == []


def until(condition: Callable[[], object], browser: Browser) -> None:
    for _ in range(300):
        if condition():
            return
        browser.evaluate("new Promise((done) => setTimeout(done, 20))")
    raise AssertionError("the condition is not met")


def test_a_key_a_finger_and_a_gamepad_hold_and_release_the_stick(
    page: Browser, stage: Served
) -> None:
    found = stage.call(stage.sticks)
    page.evaluate("document.getElementById('tab-hand').click()")
    page.evaluate("document.getElementById('pad').focus()")
    page.key("w", "KeyW", "keyDown")
    until(lambda: any(s.held and s.v == 1.0 and s.w == 0.0 for s in found), page)
    page.key("w", "KeyW", "keyUp")
    until(lambda: not found[-1].held, page)
    assert len({s.hand for s in found}) == 1
    assert [s.number for s in found] == sorted({s.number for s in found})

    box = page.evaluate(
        "(({x, y, width}) => [x, y, width])(document.getElementById('pad').getBoundingClientRect())"
    )
    middle = (box[0] + box[2] / 2, box[1] + box[2] / 2)
    page.mouse("mousePressed", *middle)
    page.mouse("mouseMoved", middle[0] - box[2] / 2, middle[1])
    until(lambda: found[-1].held and found[-1].w == 1.0 and found[-1].v == 0.0, page)
    page.evaluate("dispatchEvent(new Event('blur'))")  # another window gets the focus
    until(lambda: not found[-1].held, page)
    page.mouse("mouseReleased", *middle)

    page.evaluate(
        "globalThis.pads = [{index: 0, id: 'pad', connected: true, axes: [0, -0.5]}];"
        "navigator.getGamepads = () => globalThis.pads;"
        "document.hasFocus = () => true"
    )
    until(lambda: found[-1].held and found[-1].v == 0.5, page)
    page.evaluate("globalThis.pads = [null]")  # unplugged while it is pressed
    until(lambda: not found[-1].held, page)
    page.key("w", "KeyW", "keyDown")
    until(lambda: found[-1].held, page)
    page.open("about:blank")  # leaving the page releases the stick
    for _ in range(300):
        if not found[-1].held:
            break
        stage.call(lambda: None)
    assert not found[-1].held
    page.key("w", "KeyW", "keyUp")


@pytest.mark.long
def test_a_key_drives_and_the_robot_rests_when_it_is_released(chromium: Browser) -> None:
    stage = Served("sc4", pace=TURN_S)  # a delayed stick is stale
    stage.run.add(Teleop)
    chromium.size(*SIZE)
    with served(stage):
        open_page(chromium, stage.address)
        chromium.evaluate("document.getElementById('tab-hand').click()")
        chromium.evaluate("document.getElementById('pad').focus()")
        chromium.until(f"{PARTS}.hand.there")
        chromium.key("w", "KeyW", "keyDown")
        chromium.until("document.getElementById('handtext').innerText.startsWith('You drive')")
        chromium.until(f"{PARTS}.wheels.obeyed === 'teleop' && {PARTS}.motion.v > 0.2")
        chromium.key("w", "KeyW", "keyUp")
        chromium.until(f"{PARTS}.hand.hand === '' && {PARTS}.motion.v === 0")
        assert chromium.evaluate("document.getElementById('handtext').innerText") == "Free."
    assert chromium.received("Runtime.exceptionThrown") == []
    chromium.open("about:blank")


@pytest.mark.long
def test_without_its_server_a_stop_is_sent_when_the_connection_is_back(
    chromium: Browser,
) -> None:
    stage = Served("sc4")
    chromium.size(*SIZE)
    with served(stage):
        open_page(chromium, stage.address)
        assert stage.server is not None
        port = stage.server.port
        chromium.until("document.getElementById('link').innerText === 'connected'")
    chromium.until("document.getElementById('link').innerText === 'no connection'")
    chromium.key(" ", "Space")
    chromium.until("document.getElementById('latched').className === 'alarm'")
    again = Served("sc4")
    with Server(again.session, Guard.of(LOOPBACK, None), LOOPBACK, port):
        again.until(lambda: bool(again.session._shown), 10_000.0)
        again.until(lambda: again.robot.view.stop.stopped)
    chromium.open("about:blank")


def test_the_page_requires_the_right_token(chromium: Browser) -> None:
    chromium.size(*SIZE)
    with served(Served("sc4"), Guard.of("0.0.0.0", TOKEN)) as stage:
        chromium.open("about:blank")
        chromium.open(f"{stage.address}#token=wrongwrongwrongwrong")
        chromium.until("document.getElementById('door').open")
        chromium.until("document.getElementById('doortext').innerText.includes('token')")
        chromium.evaluate(f"document.getElementById('token').value = '{TOKEN}'")
        chromium.evaluate("document.querySelector('#key button').click()")
        chromium.until(f"{PARTS}.motion.x !== undefined")
        assert chromium.evaluate("location.hash") == ""
    chromium.evaluate("sessionStorage.clear()")
    chromium.open("about:blank")


@pytest.mark.long
def test_a_browser_that_lost_its_place_says_so_and_stops_the_robot(chromium: Browser) -> None:
    chromium.size(*SIZE)
    with served(Served("sc4"), Guard.of("0.0.0.0", TOKEN)) as stage, ExitStack() as stack:
        open_page(chromium, stage.address)
        address = stage.address.replace("http", "ws") + "socket"
        for _ in range(MOST):
            offered = [Subprotocol(each) for each in (PROTOCOL, subprotocol(TOKEN))]
            stack.enter_context(connect(address, subprotocols=offered))
        chromium.until("document.getElementById('link').innerText === 'refused'")
        chromium.until("document.getElementById('remarks').innerText.includes('16 browsers')")
        chromium.key(" ", "Space")
        until(lambda: stage.robot.view.stop.stopped, chromium)
    chromium.open("about:blank")


def test_it_fits_on_desktops_and_phones_light_and_dark(page: Browser) -> None:
    for (width, height, mobile), dark in product(SIZES, (False, True)):
        page.size(width, height, mobile=mobile, dark=dark)
        page.until(f"innerWidth === {width}")
        theme = "dark" if dark else "light"
        page.until(f"document.documentElement.dataset.theme === '{theme}'")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        stop = page.evaluate(
            "(({left, top, right, bottom}) => [left, top, right, bottom])"
            "(document.getElementById('stop').getBoundingClientRect())"
        )
        assert stop[0] >= 0.0
        assert stop[2] <= width
        assert stop[3] <= height  # without scrolling
        assert stop[3] - stop[1] >= 60.0
        assert page.evaluate("document.getElementById('map').clientHeight") >= 280
    hosts = {r["response"]["url"].split("/")[2] for r in page.received("Network.responseReceived")}
    assert len(hosts) == 1
