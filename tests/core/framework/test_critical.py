"""Critical bids of an agent whose class declares none have no effect in a society with keys."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import pytest

from armadico.core.agent import Identity
from armadico.core.coordination import Owner, Verdict
from armadico.core.cycles import PERIOD
from armadico.core.messages import Ballot, Claim, Command, Cycle, Log
from armadico.core.resources import WHEELS
from armadico.mesh.door import Door
from armadico.mesh.virtual import VirtualMesh
from armadico.testing.society import Society, bidder

from .solo import running

AT = 9
HONEST, FALSE = "avoid-1", "goto-1"


def owner() -> Owner:
    return Owner(WHEELS, running(AT), lambda instance: instance == HONEST)


def ballot(instance: str, *, critical: bool) -> Ballot:
    return Ballot(3, 1.0, critical, instance)


def command(of: Ballot) -> Command:
    return Command("wheels", Cycle(1, AT), of, (0.3, 0.0))


def claim(of: Ballot, *, critical: bool) -> Claim:
    return Claim("wheels", of, Cycle(1, AT), 1.0, critical)


@pytest.mark.parametrize(
    ("instance", "critical", "verdict"),
    [
        (HONEST, True, Verdict.OBEYED),
        (FALSE, False, Verdict.OBEYED),
        (FALSE, True, Verdict.NOT_CRITICAL),
    ],
)
def test_a_critical_ballot_is_obeyed_if_its_class_declares_it(
    instance: str, critical: bool, verdict: Verdict
) -> None:
    judging = owner()
    assert judging.judge(command(ballot(instance, critical=critical)), AT * PERIOD) is verdict
    refused = {f"{FALSE}: {Verdict.NOT_CRITICAL}": 1} if verdict is Verdict.NOT_CRITICAL else {}
    assert judging.refusals == refused


def test_a_critical_claim_ends_the_tenure_of_one_that_may_not() -> None:
    judging, own = owner(), ballot(FALSE, critical=False)
    assert judging.judge(command(own), AT * PERIOD) is Verdict.OBEYED
    judging.on_claim(claim(own, critical=True))
    assert judging.judge(command(own), AT * PERIOD) is Verdict.NOT_CRITICAL
    ack = judging.ack(())
    assert ack is not None
    assert not ack.critical


def test_what_may_not_be_critical_leaves_no_ballot_behind() -> None:
    judging = owner()
    judging.on_claim(claim(ballot(FALSE, critical=True), critical=True))
    assert judging.largest is None


class AvoidAlone(Door):
    """Bids of avoid alone may be critical."""

    def __init__(self) -> None:
        super().__init__("robot1/robot", {})

    def may_be_critical(self, instance: str, resource: str) -> bool:
        return instance.startswith("avoid-")


def test_a_false_critical_holder_is_deposed_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    identity = VirtualMesh.identity

    def with_keys(mesh: VirtualMesh, name: str, *more: object) -> Identity:
        made = identity(mesh, name, *more)  # type: ignore[arg-type]
        return replace(made, rights=AvoidAlone())

    monkeypatch.setattr(VirtualMesh, "identity", with_keys)
    logs: list[str] = []
    false = bidder("goto", 1.0, critical=True)
    honest = bidder("avoid", 0.4, critical=True, critical_for=(WHEELS,))
    society = Society(false, honest)
    society.mesh.watch(lambda _key, log, _now: logs.append(cast("Log", log).text), Log)
    society.run(8.0)
    assert set(society.obeyed_names(since=3.0)) == {"avoid"}
    assert any(Verdict.NOT_CRITICAL in text and "goto-" in text for text in logs)


def test_an_agent_with_undeclared_critical_bids_is_told() -> None:
    logs: list[str] = []
    society = Society(bidder("goto", 1.0, critical=True))
    society.mesh.watch(lambda _key, log, _now: logs.append(cast("Log", log).text), Log)
    society.run(3.0)
    assert sum("critical_for lacks that resource" in text for text in logs) == 1
    assert set(society.obeyed_names(since=1.5)) == {"goto"}, "without keys it is obeyed"
