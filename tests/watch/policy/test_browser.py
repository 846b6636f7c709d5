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
