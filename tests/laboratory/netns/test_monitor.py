"""A network that is cut in two under monitors: each half makes up for the other, then one is whole.

Real processes on two hosts that are network namespaces.
"""

from __future__ import annotations

import json
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from armadico.config.hosts import load_hosts
from armadico_tools.testbed import WATCHER, Namespaces

pytestmark = pytest.mark.live

SOON = 60.0

TABLE = """\
[robot]
router = "tcp/10.77.2.1:7447"
agents = ["robot", "encoder", "sonar", "monitor"]
[lab]
address = "10.77.2.2"
agents = ["goto", "avoid", "interface", "monitor"]
"""

SCENARIO = """\
world = "empty"
start = [0, 0, 0]
plan = "direct"
sensors = "ideal"
agents = ["encoder", "sonar", "goto", "avoid", "interface"]
"""

ALONE = ("robot", "encoder", "interface")


class Bed:
    """Two hosts that are up, and a watcher that queries the agents."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "hosts.toml"
        self.file.write_text(TABLE)
        self.scenario = folder / "plain.toml"
        self.scenario.write_text(SCENARIO)
        self.bed = Namespaces(load_hosts(self.file))
        self.ups: dict[str, subprocess.Popen[bytes]] = {}

    def up(self, host: str) -> None:
        words = ["up", str(self.scenario), *self.bed.joining(host)]
        self.ups[host] = self.bed.start(host, host, words)

    def query(self, where: str, *words: str) -> Any:
        """What a command prints, as JSON."""
        options = () if where == WATCHER else ("--host", where)
        command = ["armadico", *words, "--json", "--hosts", str(self.file), *options]
        process = self.bed.popen(where, command, stdout=subprocess.PIPE, text=True)
        out, _ = process.communicate(timeout=SOON)
        return json.loads(out) if out else None

    def there(self) -> Counter[tuple[str, str]]:
        """The agents that can be seen by the watcher, and the host of each."""
        found = self.query(WATCHER, "ps")
        return (
            Counter((a["name"], a.get("host", "")) for a in found["agents"]) if found else Counter()
        )

    def until(self, condition: Callable[[Counter[tuple[str, str]]], bool], what: str) -> None:
        end = time.monotonic() + SOON
        seen = self.there()
        while not condition(seen):
            logs = {host: self.bed.last_lines(host, 12) for host in self.ups}
            assert time.monotonic() < end, f"{what}: {sorted(seen)}\n{logs}"
            seen = self.there()

    def plug(self, host: str, there: bool) -> None:
        self.bed.network.change(lambda switch: switch.plug(host, there))


@pytest.fixture
def bed(tmp_path: Path) -> Iterator[Bed]:
    made = Bed(tmp_path)
    with made.bed:
        yield made


@pytest.mark.long
def test_after_a_cut_each_agent_that_must_be_alone_is_there_once_and_no_host_gives_up(
    bed: Bed,
) -> None:
    for host in ("robot", "lab"):
        bed.up(host)
    expected = {
        *((name, "robot") for name in ("robot", "encoder", "sonar", "monitor", "wakeup")),
        *((name, "lab") for name in ("goto", "avoid", "interface", "monitor", "wakeup")),
    }
    bed.until(lambda seen: set(seen) == expected, "all are there")
    bed.plug("lab", False)
    moved = {(name, "robot") for name in ("goto", "avoid", "interface")}
    bed.until(lambda seen: moved <= set(seen), "what lab had is on robot")
    bed.plug("lab", True)

    def whole(seen: Counter[tuple[str, str]]) -> bool:
        often = Counter(name for name, _ in seen.elements())
        return ("wakeup", "lab") in seen and all(
            often[name] == 1 for name in (*ALONE, "goto", "avoid", "sonar")
        )

    bed.until(whole, "one of each is there")
    assert all(process.poll() is None for process in bed.ups.values())
