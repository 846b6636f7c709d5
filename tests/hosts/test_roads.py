"""A site's own router: everybody is its client, and it may come last, and come back."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from armadico.cli.options import HOSTS_VARIABLE
from armadico.mesh.ports import private_endpoints
from tests.hosts.conftest import says
from tests.programs import Start, call

pytestmark = pytest.mark.live

Router = Callable[[], zenoh.Session]


@pytest.fixture
def router(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Router]:
    """A table that names a router, and what starts it."""
    endpoint = private_endpoints(1)
    table = tmp_path / "routed.toml"
    table.write_text(
        f'router = "{endpoint}"\n[lab1]\nagents = ["encoder"]\n[lab2]\nagents = ["goto"]\n'
    )
    monkeypatch.setenv(HOSTS_VARIABLE, str(table))
    config = zenoh.Config()
    for key, value in {
        "mode": "router",
        "listen/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    with ExitStack() as stack:
        yield lambda: stack.enter_context(zenoh.open(config))


def test_clients_wait_for_their_router_and_meet_through_it(router: Router, start: Start) -> None:
    ups = {host: start("up", "--host", host) for host in ("lab1", "lab2")}
    alone = call("ps")
    assert alone.returncode == 1
    assert "no router answers at tcp/127.0.0.1:" in alone.stderr
    router()
    for host, process in ups.items():
        says(process, f"{host} is up")
    seen = call("ps", "--host", "lab2", "--timeout", "10")
    assert (seen.returncode, seen.stdout) == (0, "lab2: up\n"), seen.stderr
    found = {
        host["name"]: host["state"] for host in json.loads(call("ps", "--json").stdout)["hosts"]
    }
    assert found == {"lab1": "up", "lab2": "up"}


def test_clients_of_a_router_listen_on_nothing(router: Router) -> None:
    words = ("goto", "--host", "lab2", "--listen", "tcp/127.0.0.1:7999")
    done = call(*words, program="armadico-agent")
    assert done.returncode == 2
    assert "--listen tcp/127.0.0.1:7999 contradicts the host table" in done.stderr
