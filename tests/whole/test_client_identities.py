"""Clients on a real router with keys: each is known by its identity, not by what it announces."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path

import pytest

from armadico.config.endpoints import Endpoints
from armadico.core.messages import Ask, ParametersReply, ParametersRequest, Setting, decode
from armadico.core.services import SETTINGS, service_of
from armadico.keys.members import of_agents, of_client
from armadico.launch.client import Client
from armadico.mesh.door import CLIENT, MCP, ROBOT
from armadico.mesh.ports import free_port
from armadico.runtime.process import AgentHost, identity
from armadico.watch.assistant.assistant import Assistant
from armadico.watch.assistant.keeper import Parameters
from armadico.watch.assistant.messages import AssistantReply, AssistantRequest
from armadico.watch.assistant.policy.ledger import lines_of
from armadico.watch.assistant.policy.messages import Answered, ApprovalAnswer, Choice
from tests.keys.labs import NAMESPACE, lab_in

pytestmark = pytest.mark.live

SOON_S = 20.0
GUEST, TRUSTED = f"{CLIENT}guest", f"{CLIENT}trusted"
POLICY = f"""
[default]
forbidden = ["where", "goto", "places"]

[clients."{TRUSTED}"]
forbidden = ["goto"]
"""


class Lab:
    """The robot's router, and an assistant agent with a policy for two clients."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        now = datetime.now(UTC)
        self.table, issuer = lab_in(folder, now, free_port())
        members = [of_client(NAMESPACE, name) for name in ("guest", "trusted")]
        members.append(of_agents(NAMESPACE, ("assistant",)))
        issuer.give(members, "lab1", issuer.store, now)
        self._stack, self.log = stack, folder / "requests.jsonl"
        self.where = Endpoints(namespace=NAMESPACE, table=self.table, name="lab1")
        stack.enter_context(self.where.mesh(ROBOT, router=True))
        (policy := folder / "policy.toml").write_text(POLICY)
        mesh = stack.enter_context(self.where.mesh("assistant"))
        own = identity("assistant", "lab1", rights=mesh.where.door)
        agent = Assistant(own, Parameters(policy=str(policy), log=str(self.log)))
        host = AgentHost([agent], mesh, door=mesh.where.door)
        thread = threading.Thread(target=host.live, daemon=True)
        thread.start()
        stack.callback(thread.join, SOON_S)
        stack.callback(host.request_stop)

    def client(self, name: str) -> Client:
        return Client(self._stack.enter_context(self.where.mesh(name)))


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with ExitStack() as stack:
        yield Lab(tmp_path, stack)


def ask(client: Client, announced: str, tool: str = "where") -> AssistantReply:
    reply = client.query(AssistantRequest(tool, "{}", announced), SOON_S)
    assert isinstance(reply, AssistantReply)
    return reply


@contextmanager
def as_another(client: Client, name: str) -> Iterator[None]:
    """Let a client ask on the key of another one."""
    own = client.mesh.guest
    client.mesh.guest = f"{name}-1f"
    yield
    client.mesh.guest = own


def test_a_section_is_for_the_identity_and_not_for_the_announced_name(lab: Lab) -> None:
    guest, trusted, server = (lab.client(name) for name in (GUEST, TRUSTED, MCP))
    assert not ask(trusted, "anything").refusal
    assert "forbids" in ask(guest, TRUSTED).refusal
    assert "forbids" in ask(server, TRUSTED).refusal
    assert not ask(guest, TRUSTED, "who").refusal
    assert "forbids" in ask(trusted, "guest", "goto").refusal
    by = [line for line in lines_of(lab.log) if b'"tool":"where"' in line]
    assert b'"by":"mcp-trusted (calls itself anything)"' in by[0]
    assert b'"by":"mcp-guest (calls itself mcp-trusted)"' in by[1]


def test_no_identity_asks_as_another_one(lab: Lab) -> None:
    guest, trusted, server = (lab.client(name) for name in (GUEST, TRUSTED, MCP))
    assert not ask(trusted, "").refusal
    request = AssistantRequest("where", "{}", TRUSTED)
    for client in (guest, server):
        for other in (TRUSTED, "*", "**"):
            with as_another(client, other):
                assert client.query(request, 2.0, patience=0.5) is None, other
        client.mesh.closed = False  # it asks on the key that societies without keys have
        assert client.query(request, 2.0, patience=0.5) is None
        client.mesh.closed = True
    assert len([line for line in lines_of(lab.log) if b'"tool":"where"' in line]) == 1


def test_an_answer_is_of_the_person_whose_key_it_comes_with(lab: Lab) -> None:
    anna, guest = lab.client("person-anna"), lab.client(GUEST)
    assert not ask(guest, "", "who").refusal
    answer = ApprovalAnswer("902ff418", Choice.YES, "ben")
    assert guest.query(answer, 2.0, patience=0.5) is None, "a program has no right to it"
    assert isinstance(anna.query(answer, SOON_S), Answered)
    (line,) = [line for line in lines_of(lab.log) if b"a person's answer" in line]
    assert b'"by":"person-anna (calls itself ben)"' in line


def test_a_client_reads_the_parameters_that_a_rehearsal_needs_and_changes_none(lab: Lab) -> None:
    guest = lab.client(GUEST)
    assert not ask(guest, "", "who").refusal  # the agent is there
    change = ParametersRequest((Setting("a_second", "99"),), "a guest")
    queries = {SETTINGS.pattern: Ask(), service_of(ParametersRequest).pattern: change}
    found: dict[str, list[ParametersReply]] = {}
    for key, request in queries.items():
        over = threading.Event()
        replies = found.setdefault(key, [])

        def each(_: str, data: bytes, replies: list[ParametersReply] = replies) -> None:
            replies.append(decode(data, ParametersReply))

        guest.mesh.query(key, request, 5.0, each, over.set)
        assert over.wait(SOON_S)
    told, changed = found.values()
    (reply,) = told
    assert reply.fixed is not None
    assert "policy" in {each.name for each in reply.fixed}
    assert not changed
