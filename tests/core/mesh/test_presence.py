"""Which agents are reported as gone, and when, while the link to the router comes and goes."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from armadico.mesh.presence import GRACE_S, MOST, MOST_NEW, MOST_OF_A_NAME, NEW_S, ROOM_S, Presence

GOTO, AVOID = ("goto", "goto-1"), ("avoid", "avoid-1")


class Process:
    """A process's view of the mesh, and all that it has reported."""

    def __init__(self, *, reachable: bool = False) -> None:
        self.now = 0.0
        self.news: list[Any] = []
        self.alive: set[tuple[str, str]] = set()
        self.presence = Presence(self._changed, self.news.append, reachable=reachable)

    def _changed(self, name: str, instance: str, there: bool) -> None:
        self.news.append(("+" if there else "-") + name)
        (self.alive.add if there else self.alive.discard)((name, instance))

    def link(self, up: bool = True) -> None:
        self.presence.link(up, self.now)

    def come(self, *agents: tuple[str, str]) -> None:
        for name, instance in agents:
            self.presence.token(name, instance, True, self.now)

    def go(self, *agents: tuple[str, str]) -> None:
        for name, instance in agents:
            self.presence.token(name, instance, False, self.now)

    def wait(self, seconds: float) -> None:
        """Let time pass; `look` is called whenever it is due."""
        end = self.now + seconds
        while self.presence.due <= end:
            self.now = max(self.presence.due, self.now)
            self.presence.poll(self.now)
        self.now = end

    def read(self) -> list[Any]:
        """The news since the last reading."""
        news = self.news[:]
        self.news.clear()
        return news


@pytest.fixture
def process() -> Process:
    """A client that is linked to the router and has seen two agents."""
    made = Process()
    made.link()
    made.come(GOTO, AVOID)
    assert made.read() == [True, "+goto", "+avoid"]
    return made


def test_a_forged_end_of_the_router_costs_a_delay_once_and_no_agent_its_life(
    process: Process,
) -> None:
    process.presence.inquire(process.now)
    process.go(GOTO)
    assert process.read() == [], "wait: the link will show it"
    process.wait(GRACE_S)
    assert process.read() == ["-goto"], "the link stayed, so it was no end of the router"
    process.presence.inquire(process.now)
    process.go(AVOID)
    assert process.read() == ["-avoid"], "once per link"


def flood(process: Process, names: int, each: int) -> list[str]:
    """Tokens of a stranger, and the lines for the log that they cost."""
    agents = [(f"n{n}", f"n{n}-{i}") for n in range(names) for i in range(each)]
    lines = [process.presence.token(*agent, True, process.now) for agent in agents]
    return [line for line in lines if line]


def test_a_flood_of_tokens_is_bounded_and_reported_in_few_lines(process: Process) -> None:
    lines = flood(process, 1, 2000) + flood(process, 2000, 1)
    lines += [process.presence.token("a" * 999, "c", True, 0.0)]
    assert "more than 128 characters" in lines[-1]
    assert len(process.alive) == MOST_NEW
    process.wait(MOST / MOST_NEW * 2 * NEW_S)
    assert len(process.alive) == MOST
    assert GOTO in process.alive
    assert 0 < len(lines) < 20
    assert any("'n0'" in line for line in lines), "whose tokens they are"
    process.go(GOTO)
    assert GOTO not in process.alive


def test_an_agent_that_waits_for_room_is_reported_once_the_flood_is_over(process: Process) -> None:
    flood(process, MOST, 1)
    process.come(("sonar", "sonar-1"))
    process.wait(NEW_S)
    assert ("sonar", "sonar-1") not in process.alive
    process.go(*[(f"n{n}", f"n{n}-0") for n in range(MOST)])
    process.wait(NEW_S + 2 * ROOM_S)
    assert process.alive == {GOTO, AVOID, ("sonar", "sonar-1")}
    assert process.presence.due == float("inf"), "and nothing is left to do"


def test_one_that_is_dropped_while_it_waits_is_never_reported(process: Process) -> None:
    flood(process, MOST, 1)
    process.come(("sonar", "sonar-1"))
    process.go(("sonar", "sonar-1"))
    process.wait(3 * NEW_S)
    assert "+sonar" not in process.read()


def test_a_token_declared_and_dropped_again_and_again_costs_no_more_than_many_tokens(
    process: Process,
) -> None:
    for n in range(1000):
        process.come(("x", f"x-{n}"))
        process.go(("x", f"x-{n}"))
    assert process.read().count("+x") == MOST_OF_A_NAME
    process.come(("sonar", "sonar-1"))
    assert process.read() == ["+sonar"], "others are not delayed"


def test_a_flood_that_comes_before_the_known_agents_displaces_none(process: Process) -> None:
    process.link(False)
    process.link()
    flood(process, 1, 2 * MOST)
    flood(process, 2 * MOST, 1)
    process.come(GOTO, AVOID)
    process.wait(2 * GRACE_S)
    assert not [news for news in process.read() if news in ("-goto", "-avoid")]


# Examples -----------------------------------------------------------------------------------------


def test_a_second_loss_of_the_router_begins_the_grace_period_anew(process: Process) -> None:
    process.link(False)
    process.link()
    process.wait(0.9 * GRACE_S)
    process.link(False)
    process.wait(10.0)
    process.link()
    process.wait(GRACE_S - 0.01)
    assert process.read() == [False, True, False, True]
    process.wait(0.02)
    assert process.read() == ["-avoid", "-goto"]


def test_the_robots_router_is_reachable_from_the_beginning_and_reports_at_once() -> None:
    router = Process(reachable=True)
    assert router.presence.reachable
    router.come(GOTO)
    router.go(GOTO)
    assert router.read() == ["+goto", "-goto"]


# Any order of events ------------------------------------------------------------------------------

AGENTS = st.sampled_from([("a", "a-1"), ("a", "a-2"), ("b", "b-1")])


class AnyOrder(RuleBasedStateMachine):
    """The link and agents that come and go in any order, and time that passes."""

    def __init__(self) -> None:
        super().__init__()
        self.process = Process()
        self.up = False
        self.there: set[tuple[str, str]] = set()  # since the link came up

    @rule(up=st.booleans())
    def link(self, up: bool) -> None:
        if self.up and not up:
            self.there.clear()
        self.up = up
        self.process.link(up)
        self._check_reports()

    @rule(agent=AGENTS)
    def come(self, agent: tuple[str, str]) -> None:
        self.there.add(agent)
        self.process.come(agent)
        self._check_reports()

    @rule(agent=AGENTS)
    def go(self, agent: tuple[str, str]) -> None:
        self.there.discard(agent)
        self.process.go(agent)
        self._check_reports()

    @rule(seconds=st.sampled_from([0.01, 0.5, GRACE_S * 1.1]))
    def wait(self, seconds: float) -> None:
        self.process.wait(seconds)
        self._check_reports()

    def _check_reports(self) -> None:
        for news in self.process.read():
            if isinstance(news, bool):
                assert news == self.up
            else:
                assert news.startswith("+") or self.up, "gone, though the router is out of reach"
        assert self.process.presence.reachable == self.up

    @invariant()
    def every_agent_that_is_there_counts_as_alive(self) -> None:
        assert self.there <= self.process.alive

    @precondition(lambda self: self.up)
    @rule()
    def in_the_end_every_agent_that_has_gone_is_reported(self) -> None:
        self.process.wait(GRACE_S + 0.001)
        self._check_reports()
        assert self.process.alive == self.there


TestAnyOrder = AnyOrder.TestCase
