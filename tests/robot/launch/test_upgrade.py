"""A society is upgraded agent by agent while it drives: some use protocol 2, some protocol 3."""

from __future__ import annotations

from collections import Counter

import pytest

from armadico.config.scenarios import load_scenario
from armadico.core.coordination import Verdict
from armadico.core.judgement import Answer
from armadico.core.messages import OLDEST, PROTOCOL, Ack, Claim, Command, Log, Message, Stop
from armadico.core.resources import WHEELS
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mesh.virtual import Node, VirtualMesh
from armadico.mobile.messages import MissionState, MissionStatus, Trajectory
from armadico.observe.audit.auditor import Auditor, watched
from tests.driven import Driven

FIRST = (
    *("goto", "encoder", "avoid", "interface", "gothrough", "sonar", "path-planning"),
    *("localization", "relocate", "robot"),
)
"""Each agent before others that it exchanges messages with, and after some."""

GAP_S = 1.5  # from one upgrade to the next


class Mixed(Driven):
    """Scenario 4 by agents that all use one protocol, and what is published and received."""

    def __init__(self, protocol: int, seed: int = 3) -> None:
        self.mesh = VirtualMesh(seed)
        self.mesh.protocols = dict.fromkeys(FIRST, protocol)
        self.received: Counter[tuple[str, Message]] = Counter()  # claims, by who received them
        self.mesh.joined = self._note
        options = Options(seed=seed, limit=90.0)
        run = Rehearsal(load_scenario("sc4"), options, mesh=self.mesh)
        self.auditor = Auditor()
        super().__init__(run, Command, Log, Ack, Stop, Trajectory, MissionStatus)
        self.keys: Counter[tuple[str, str]] = Counter()
        self.mesh.watch(lambda k, m, t: self.auditor.update(t, k, m) and None, *watched())
        self.mesh.watch(self._claimed, Claim)
        self.begin()

    def _claimed(self, key: str, claim: Message, _t: float) -> None:
        assert isinstance(claim, Claim)
        self.keys[claim.ballot.instance, key] += 1

    def _note(self, node: Node) -> None:
        kernel = node.driver.kernel
        receive = kernel.receive

        def noted(message: Message, now: float) -> None:
            if type(message) is Claim:
                self.received[node.agent.instance, message] += 1
            receive(message, now)

        kernel.receive = noted  # type: ignore[method-assign]

    def replace(self, name: str, protocol: int) -> Node:
        """End an agent in order, and start it again with a protocol."""
        self.mesh.node(name).leave()
        self.mesh.protocols[name] = protocol
        return self.run.enter(name)

    @property
    def status(self) -> MissionStatus:
        return self.last(MissionStatus)

    @property
    def alive(self) -> list[Node]:
        return [node for node in self.mesh.nodes if node.alive]

    def protocols(self) -> dict[str, int]:
        return {node.name: node.agent.kernel.card().speaks for node in self.alive}

    def check(self) -> None:
        """Nothing was refused as strange, no promise was broken, and no claim counted twice."""
        texts = [log.text for log in self.of(Log)]
        assert not [text for text in texts if "protocol" in text or Verdict.NOT_ITS_KEY in text]
        self.auditor.tick(self.mesh.now)
        broken = [each for each in self.auditor.report() if each.answer is Answer.NO]
        assert broken == []
        assert max(self.received.values()) == 1


@pytest.mark.long(but=("robot-last",))
@pytest.mark.parametrize("order", [FIRST, FIRST[::-1]], ids=["robot-last", "robot-first"])
def test_a_society_is_upgraded_one_by_one_while_it_drives(order: tuple[str, ...]) -> None:
    drive = Mixed(OLDEST).let_pass(2.0)
    assert set(drive.protocols().values()) == {OLDEST}
    began, first = drive.mesh.now, drive.mesh.node(order[0]).agent.instance
    for name in order:
        drive.replace(name, PROTOCOL)
        drive.let_pass(GAP_S)
        assert drive.protocols()[name] == PROTOCOL, f"{name} stays"
    assert set(drive.protocols().values()) == {PROTOCOL}
    spoken = {node.agent.instance: node.agent.kernel.card().speaks for node in drive.mesh.nodes}
    obeyed = {ack.obeyed.instance for ack in drive.of(Ack, began) if ack.obeyed is not None}
    held = {spoken[instance] for instance in obeyed - {first}}
    assert held == {OLDEST, PROTOCOL}, "agents of both drove in the mixed society"
    drive.until(lambda: not any(node.driver.kernel.elders for node in drive.alive), 5.0)
    before = Counter(drive.keys)
    assert drive.until(lambda: drive.status.state is MissionState.REACHED, 60.0)
    shared = {key for (_, key) in drive.keys - before if key.endswith("/utility")}
    assert not shared, "nothing is repeated once the last of protocol 2 has ended"
    drive.check()


def test_agents_of_both_protocols_hear_each_other_in_both_directions() -> None:
    drive = Mixed(PROTOCOL).let_pass(2.0)
    old = drive.replace("goto", OLDEST)
    drive.let_pass(1.0)
    new = drive.mesh.node("avoid")
    for node in (old, new):  # each gives all that it has heard of the holder
        contender = node.driver.kernel.bidding(WHEELS).contender
        assert contender.holding or contender.rival is not None
    assert {key for who, key in drive.keys if who == old.agent.instance} <= {
        "resource/wheels/utility"
    }
    drive.mesh.publish(Stop(1, True, "anna", 7))
    drive.let_pass(0.5)
    assert all(node.agent.stopped for node in drive.alive)
    drive.mesh.publish(Stop(2, False, "anna", 7))
    drive.let_pass(3.0)
    assert not any(node.agent.stopped for node in drive.alive)
    assert drive.last(Ack).obeyed is not None
    drive.check()


def test_a_claim_on_the_shared_key_counts_only_from_an_agent_of_the_older_protocol() -> None:
    drive = Mixed(PROTOCOL).let_pass(3.0)
    ack = drive.last(Ack)
    assert ack.obeyed is not None
    holder = ack.obeyed.instance
    release = Claim(WHEELS.name, ack.obeyed, ack.cycle, None)
    drive.mesh.publish(release, sender="evil", key="resource/wheels/utility")
    drive.mesh.publish(release, sender="evil", key=WHEELS.utility_key_of("evil-1"))
    drive.mesh.publish(release, sender="evil", key=WHEELS.utility_key_of(f"evil-2/{holder}"))
    drive.let_pass(0.4)
    assert drive.last(Ack).obeyed == ack.obeyed, f"{holder} still drives"
    drive.let_pass(6.0)
    refused = [log.text for log in drive.of(Log) if Verdict.NOT_ITS_KEY in log.text]
    assert any("resource/wheels/utility:" in text for text in refused)
    for publisher in ("evil-1", f"evil-2/{holder}"):
        assert any(f"{WHEELS.utility_key_of(publisher)}:" in text for text in refused)
