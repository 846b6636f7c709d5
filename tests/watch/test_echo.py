"""What is published is shown, whoever's message it is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cbor2
import pytest

from armadico.cli import options
from armadico.core.messages import LARGEST_PAYLOAD
from armadico.observe.watching import Received
from armadico.runtime.errors import AbsentError
from armadico.watch.commands import hz
from armadico.watch.commands.echo import line_of


@pytest.mark.parametrize(
    ("data", "shows"),
    [
        (cbor2.dumps([[7, 12], 1.25, "near\x1b[2J"]), "[[7, 12], 1.25, near\ufffd[2J]"),
        (b"\xff\x00", "ff00"),
        (bytes(LARGEST_PAYLOAD + 1), "0000"),
    ],
)
def test_another_packages_message_is_shown_as_the_values_that_it_has(
    data: bytes, shows: str
) -> None:
    line = options.shown(line_of(Received("robot1", "room-finder/room", data, 0), as_json=False))
    assert f"room-finder/room  not in the table of services: {shows}" in line


JOINED: Any = SimpleNamespace(namespace="robot1", wait_joined=lambda _: True)


class Regular:
    """A watcher that receives some messages, and then none; each wait takes its time at once."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, count: int, every_s: float, key: str = "robot/state"
    ) -> None:
        self.now, self.key, self.meshes = 0.0, key, (JOINED,)
        self.times = [every_s * (number + 1) for number in range(count)]
        monkeypatch.setattr(hz, "time", SimpleNamespace(monotonic=lambda: self.now))

    def clock(self) -> int:
        return int(self.now * 1e9)

    def get(self, timeout: float) -> Received | None:
        if not self.times or self.times[0] > self.now + timeout:
            self.now += max(timeout, 1e-3)
            if self.now > 22.0:
                raise KeyboardInterrupt
            return None
        self.now = max(self.now, self.times.pop(0))
        return Received("robot1", self.key, b"", self.clock())


def test_hz_goes_on_to_show_a_key_that_is_silent(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    watcher: Any = Regular(monkeypatch, 20, 0.1)
    with pytest.raises(KeyboardInterrupt):
        hz._follow(watcher, hz.Options(pattern="robot/state"), {})
    first, *_, silent = capsys.readouterr().out.splitlines()
    assert first.startswith("robot/state: 10.")
    assert silent.startswith("robot/state: 0 Hz, none for ")


def test_hz_does_not_call_a_key_silent_of_which_a_message_is_rare(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    watcher: Any = Regular(monkeypatch, 9, 4.9, "battery/level")
    with pytest.raises(KeyboardInterrupt):
        hz._follow(watcher, hz.Options(pattern="battery/level"), {})
    assert "none for" not in capsys.readouterr().out


def test_hz_ends_when_its_timeout_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    watcher: Any = Regular(monkeypatch, 20, 0.1)
    with pytest.raises(AbsentError):
        hz._follow(watcher, hz.Options(pattern="robot/state", timeout=0.3), {})
    assert watcher.now == pytest.approx(2.3, abs=0.1)
