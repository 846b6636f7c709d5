"""Agents as real processes: they are seen to come, to go, to be killed, to fail and to hang."""

from __future__ import annotations

import signal

import pytest

from armadico.core.messages import Card, Stop
from armadico.core.restart_policy import MISUSED
from armadico.launch.client import Client
from armadico.mesh.sockets import RUNTIME_VARIABLE, folder
from armadico.mobile.messages import Plan, PlanRequest, Waypoint
from tests.core.mesh.conftest import Spawn, SpawnRouter
from tests.programs import call
from tests.runtime_folder import fresh_folder

pytestmark = pytest.mark.live

SOON = 20.0  # s; a deadline, not an expectation
REQUEST = PlanRequest(Waypoint(0, 0, 0), Waypoint(1, 2, 0.5))


def there(client: Client, count: int) -> bool:
    return bool(client.wait_for(lambda: len(client.alive) == count, SOON))


def upset(client: Client) -> None:
    """Publish the stop that ends toys other than calm ones, until a query shows its arrival."""
    assert client.query(REQUEST, SOON) is not None
    client.publish(Stop(1, True, "the test", 1))


def test_an_agent_gives_its_card_and_answers_its_queries(client: Client, spawn: Spawn) -> None:
    process = spawn()
    assert there(client, 1)
    ((name, instance),) = client.alive
    card = client.cards(SOON)[name, instance]
    assert isinstance(card, Card)
    assert (card.name, card.instance, card.pid) == ("toy", instance, process.pid)
    assert card.provides == ("path/plan",)
    assert client.query(REQUEST, SOON) == Plan((), refusal=f"{instance} does not plan")


def test_an_agent_that_is_killed_is_seen_to_go(client: Client, spawn: Spawn) -> None:
    process = spawn()
    assert there(client, 1)
    process.kill()
    assert there(client, 0)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_an_agent_ends_in_order_on_a_signal(
    client: Client, spawn: Spawn, number: signal.Signals
) -> None:
    process = spawn()
    assert there(client, 1)
    process.send_signal(number)
    assert process.wait(SOON) == 0
    assert there(client, 0)


def test_an_agent_that_fails_logs_the_reason_and_ends(client: Client, spawn: Spawn) -> None:
    process = spawn("broken")
    assert there(client, 1)
    upset(client)
    _, errors = process.communicate(timeout=SOON)
    assert process.returncode == 1
    assert "toy failed" in errors
    assert "toy_process.py" in errors
    assert "cannot bear the test" in errors
    assert there(client, 0)


@pytest.mark.long
def test_an_agent_that_hangs_can_be_ended_all_the_same(client: Client, spawn: Spawn) -> None:
    process = spawn("hanging")
    assert there(client, 1)
    upset(client)
    assert client.cards(0.5) == dict.fromkeys(client.alive), "it hangs, so it does not answer"
    process.terminate()
    assert process.wait(SOON) == -signal.SIGALRM
    assert there(client, 0)


def test_an_agent_that_is_stopped_by_a_debugger_does_not_answer_and_comes_back(
    client: Client, spawn: Spawn
) -> None:
    process = spawn()
    assert there(client, 1)
    before = set(client.alive)
    process.send_signal(signal.SIGSTOP)
    assert there(client, 0), "its lease runs out"
    process.send_signal(signal.SIGCONT)
    assert there(client, 1)
    assert client.alive == before
    assert isinstance(client.cards(SOON)[next(iter(before))], Card)


def test_a_robot_agent_beside_another_router_reports_its_process_and_ends(
    spawn_router: SpawnRouter,
) -> None:
    router = spawn_router("one-robot")
    second = call("robot", "--namespace", "one-robot", program="armadico-agent")
    assert second.returncode == MISUSED
    assert f"process {router.pid} is the router" in second.stderr
    assert "Traceback" not in second.stderr


@pytest.mark.parametrize("agent", ["robot", "encoder"])
def test_an_agent_whose_sockets_folder_others_can_write_to_reports_that_and_ends(
    agent: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(RUNTIME_VARIABLE, fresh_folder())
    shared = folder()
    shared.chmod(0o777)
    process = call(agent, program="armadico-agent")
    assert process.returncode == MISUSED
    assert f"chmod 700 {shared}" in process.stderr
    assert "Traceback" not in process.stderr
