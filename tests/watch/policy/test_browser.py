"""A request that waits for a person, in a browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from armadico.watch.assistant.assistant import Assistant
from armadico.watch.assistant.keeper import Parameters
from armadico.watch.assistant.messages import AssistantRequest
from tests.watch.browser import Browser, executable
from tests.watch.page.stage import HOME, Served, served

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(executable() is None, reason="no Chromium here: apt-get install chromium"),
    pytest.mark.timeout(240),
]
PARTS = f"armadico.robots.get('{HOME}').parts"
YES = "[...document.querySelectorAll('#asking button')].find((b) => b.textContent === 'Yes')"


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    (folder := tmp_path / "chromium").mkdir()
    with Browser(folder, 1280, 720) as browser:
        yield browser


def test_yes_is_one_click(browser: Browser, tmp_path: Path) -> None:
    (path := tmp_path / "policy.toml").write_text('[default]\napproval = ["goto"]\n')
    with served(Served("sc1")) as stage:
        stage.call(lambda: stage.run.add(Assistant, Parameters(policy=str(path))))
        browser.open(stage.address)
        browser.until(f"{PARTS}.motion.x !== undefined")
        assert browser.evaluate("document.getElementById('approvals').hidden")
        x, y = (browser.evaluate(f"{PARTS}.motion.{each}") for each in "xy")
        request = AssistantRequest("goto", f'{{"x": {x + 1.0}, "y": {y}}}', "a model")
        stage.call(lambda: stage.mesh.query(request, lambda _: None))
        browser.until(f"{YES} !== undefined && !document.getElementById('approvals').hidden")
        assert "a model asks for goto" in browser.evaluate(
            "document.getElementById('asking').textContent"
        )
        browser.evaluate(f"{YES}.click()")
        browser.until(f"{PARTS}.mission.state === 'driving'")
        browser.until("document.getElementById('approvals').hidden")
        assert browser.received("Runtime.exceptionThrown") == []


def test_what_waits_is_rehearsed_and_its_buttons_stay(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The text counts down each second; a button that is replaced meanwhile loses half a click."""
    pytest.importorskip("armadico.rehearsal")
    (path := tmp_path / "policy.toml").write_text('[default]\napproval = ["goto"]\n')
    shown = {
        "answer": "yes",
        "paths": [{"end": "arrived", "points": [[1, 1], [2, 1]], "put": None}],
    }
    monkeypatch.setattr(
        "armadico.rehearsal.page.told", lambda *_: ("yes: arrives in 4 of 4", shown)
    )
    with served(Served("sc1")) as stage:
        stage.call(lambda: stage.run.add(Assistant, Parameters(policy=str(path))))
        browser.open(stage.address)
        browser.until(f"{PARTS}.motion.x !== undefined")
        request = AssistantRequest("goto", '{"x": 2.0, "y": 1.0}', "a model")
        stage.call(lambda: stage.mesh.query(request, lambda _: None))
        asking = "document.getElementById('asking').textContent"
        browser.until(f"{asking}.includes('yes: arrives in 4 of 4')")
        assert browser.evaluate("armadico.plan.fan.length") == 1
        before = browser.evaluate(f"window.button = {YES}, {asking}")
        browser.until(f"{asking} !== {before!r}")
        assert browser.evaluate(f"window.button === {YES}")
        browser.evaluate("[...document.querySelectorAll('#asking button')][1].click()")
        browser.until("document.getElementById('approvals').hidden && !armadico.plan.fan.length")
        assert browser.received("Runtime.exceptionThrown") == []
