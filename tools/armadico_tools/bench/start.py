"""What it costs to begin: modules imported, and the time until an agent is seen."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import closing
from typing import Final

from armadico.core.services import TOKEN
from armadico.launch.processes import command_line
from armadico.mesh import sockets
from armadico_tools.bench.figures import Figure, Tell, figure
from armadico_tools.bench.processes import floor, started
from armadico_tools.testbed import Place

HEAVY: Final = ("numpy", "zenoh", "pymunk", "cbor2", "msgspec", "serial", "rich", "matplotlib")
"""Packages that are slow to import, and not needed for --help."""

SEEN_S: Final = 20.0
"""Time limit for an agent's token."""

COUNT: Final = """
import contextlib, io, json, sys
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    {call}
print(json.dumps(sorted(sys.modules)))
"""


def imports(quick: bool, tell: Tell) -> list[Figure]:  # noqa: ARG001 - nothing to be quicker at
    """Modules after `armadico --help` and `armadico-agent --help`."""
    bare = _modules("pass")
    calls = {
        "imports-armadico": "from armadico.cli import main; main(['--help'])",
        "imports-armadico-agent": "from armadico.cli.agent import main; main(['--help'])",
    }
    figures, heavy = [], set()
    for done, (name, call) in enumerate(calls.items(), 1):
        found = _modules(call)
        heavy |= {module.partition(".")[0] for module in found} & set(HEAVY)
        figures.append(figure(name, "modules", [len(found)], [len(bare)]))
        tell(done / len(calls))
    return [*figures, figure("imports-heavy", "modules", [len(heavy)])]


def _modules(call: str) -> set[str]:
    script = COUNT.format(call=call)
    done = subprocess.run(
        [sys.executable, "-P", "-c", script], capture_output=True, text=True, check=True
    )
    return set(json.loads(done.stdout))


class Sightings:
    """When the token of a name was first seen, by the monotonic clock."""

    def __init__(self) -> None:
        self._seen: dict[str, float] = {}
        self._changed = threading.Condition()

    def changed(self, name: str, _instance: str, there: bool) -> None:
        """Called by the mesh, on its thread."""
        with self._changed:
            if there:
                self._seen.setdefault(name, time.monotonic())
            else:
                self._seen.pop(name, None)
            self._changed.notify_all()

    def await_one(self, name: str) -> float:
        """When it was seen. Raises TimeoutError if it is not."""
        with self._changed:
            if not self._changed.wait_for(lambda: name in self._seen, SEEN_S):
                raise TimeoutError(f"{name} was not seen within {SEEN_S:.0f} s")
            return self._seen[name]

    def await_none(self, name: str) -> None:
        """Until its token has gone."""
        with self._changed:
            self._changed.wait_for(lambda: name not in self._seen, SEEN_S)


def start(quick: bool, tell: Tell) -> list[Figure]:
    """From starting the process to the token, the agent and the floor in turns."""
    rounds = 4 if quick else 12
    whole, bare = [], []
    with Place("bench") as place, closing(place.mesh(router=True)) as mesh:
        sightings = Sightings()
        mesh.watch_alive(sightings.changed)
        key = f"{place.namespace}/{TOKEN.format(name='floor', instance='floor-1')}"
        agent = command_line(["agent", "goto", "--namespace", place.namespace], tied=True)
        bare_python = floor("token", "-", sockets.endpoint(sockets.socket_of(place.namespace)), key)

        def once(name: str, command: Sequence[str]) -> float:
            began = time.monotonic()
            with started(command):
                seen = sightings.await_one(name)
            sightings.await_none(name)
            return seen - began

        for done in range(rounds):
            whole.append(once("goto", agent))
            bare.append(once("floor", bare_python))
            tell((done + 1) / rounds)
    return [figure("start", "s", whole, bare)]
