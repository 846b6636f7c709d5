"""The wakeup agent: starts, restarts, requests and its report."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.agents.supervision.messages import (
    HostShare,
    Kept,
    KeptState,
    WakeupOrder,
    WakeupReply,
    WakeupRequest,
)
from armadico.agents.supervision.wakeup import (
    CARD_S,
    IN_THE_WAY_S,
    MONITOR_S,
    NEWCOMER_S,
    PAUSES_S,
    SHARES_S,
    START_S,
    Do,
    Event,
    Load,
    Order,
    Parameters,
    Wakeup,
    lines,
    orders,
)
from armadico.core.agent import Identity, Question
from armadico.core.messages import PROTOCOL, Card, Message, MonitorReport
from armadico.core.outgoing import Answer, Publish, SendQuery, Write
from armadico.core.restart_policy import MISUSED

GOTO = 11
AVOID = 12


class Bench:
    """A wakeup agent of lab1; the test plays the machine and the mesh."""

    def __init__(self, *, up: bool = True, **more: Any) -> None:
        processes = more.pop("processes", {"goto": ("goto",), "avoid": ("avoid",)})
        parameters = Parameters(host="lab1", processes=processes, **more)
        self.agent = Wakeup(Identity("wakeup-1", "lab1", 1, rng=Random(1)), parameters)
        self.now = 100.0
        self.published: list[Message] = []
        self.orders: list[Order] = []
        self.started: list[float] = []  # when processes were, s
        self.queries: list[SendQuery] = []
        self.answers: list[WakeupReply] = []
        self.agent.kernel.start(self.now)
        if up:
            self.begins("goto", GOTO)
            self.begins("avoid", AVOID)
            self.meet("goto-1", GOTO)
            self.meet("avoid-1", AVOID)
        self.take()

    def take(self) -> list[Order]:
        """The orders since the last time."""
        found: list[Order] = []
        out, self.agent.kernel.outbox = self.agent.kernel.outbox, []
        for item in out:
            match item:
                case Write():
                    found += orders(item.data)
                case Publish():
                    self.published.append(item.message)
                case SendQuery():
                    self.queries.append(item)
                case Answer(_, WakeupReply() as reply):
                    self.answers.append(reply)
        self.orders += found
        self.started += [self.now for order in found if order.do is Do.START]
        return found

    def done(self) -> list[tuple[Do, str]]:
        """The orders since the last call, without log lines."""
        return [(order.do, order.label) for order in self.take() if order.do is not Do.SAY]

    def begins(self, label: str, pid: int) -> None:
        self.agent.kernel.on_bytes(lines(Event(label, pid)), self.now)

    def ends(self, label: str, code: int = -9, words: str = "") -> None:
        how = f"status {code}" if code >= 0 else "signal SIGKILL"
        self.agent.kernel.on_bytes(lines(Event(label, 0, how, code, words)), self.now)

    def appear(self, instance: str) -> None:
        self.agent.kernel.appeared(instance.rpartition("-")[0], instance, self.now)

    def card(self, instance: str, pid: int, host: str = "lab1") -> Card:
        name = instance.rpartition("-")[0]
        return Card(name, instance, host, pid, "1", PROTOCOL, (), (), ())

    def meet(self, instance: str, pid: int, host: str = "lab1") -> None:
        self.appear(instance)
        self.agent.kernel.met(self.card(instance, pid, host), self.now)

    def receive(self, message: Message) -> None:
        self.agent.kernel.receive(message, self.now)

    def other(self, *kept: Kept, host: str = "lab2") -> None:
        """Receive the share of another host."""
        self.receive(HostShare(f"wakeup-{host}", host, kept))

    def request(self, order: WakeupOrder, agent: str, pid: int = 0) -> str:
        """Send a request; return its refusal, or ""."""
        self.agent.kernel.on_query(
            WakeupRequest(order, agent, pid, "a test"), Question(1), self.now
        )
        out = self.agent.kernel.outbox
        (answer,) = (item.message for item in out if isinstance(item, Answer))
        assert isinstance(answer, WakeupReply)
        return answer.refusal

    def pass_time(self, seconds: float, late: float = 0.0) -> list[tuple[Do, str]]:
        """Wake the agent when due, or `late` s later, for some time. Return the orders."""
        end, found = self.now + seconds, []
        while (due := self.agent.kernel.wakeup) is not None and due <= end:
            self.now = max(self.now, due) + late
            self.agent.kernel.wake(self.now)
            found += self.done()
        self.now = max(self.now, end)
        return found

    def share(self) -> HostShare:
        self.take()
        return next(m for m in reversed(self.published) if isinstance(m, HostShare))

    def state(self, name: str) -> KeptState:
        return next(kept.state for kept in self.share().kept if name in kept.agents)

    def queried(self) -> list[str]:
        """The instances queried for their cards since the last call."""
        self.take()
        found, self.queries = self.queries, []
        return [item.key.split("/")[2] for item in found]


@pytest.fixture
def bench() -> Bench:
    return Bench()


# Coming up ----------------------------------------------------------------------------------------


def test_the_share_is_up_once_the_cards_of_its_own_processes_have_come() -> None:
    bench = Bench(up=False)
    bench.begins("goto", GOTO)
    bench.begins("avoid", AVOID)
    bench.meet("goto-1", GOTO)
    assert (bench.state("goto"), bench.state("avoid")) == (KeptState.UP, KeptState.STARTING)
    bench.meet("avoid-7", AVOID, host="lab2")
    bench.meet("avoid-8", 99)
    assert bench.done() == [], "the card of another host, or of another process, is not its own"
    bench.meet("avoid-1", AVOID)
    assert bench.done() == [(Do.READY, "")]
    bench.meet("goto-2", 13)
    assert bench.done() == [], "it is said once"


def test_a_simulator_is_not_waited_for() -> None:
    bench = Bench(up=False, processes={"simulator": (), "goto": ("goto",)})
    bench.begins("simulator", 10)
    bench.begins("goto", GOTO)
    bench.meet("goto-1", GOTO)
    assert bench.done() == [(Do.READY, "")]


def test_a_query_for_a_card_is_repeated_and_delays_no_other() -> None:
    bench = Bench(up=False)
    bench.begins("goto", GOTO)
    bench.begins("avoid", AVOID)
    for instance in ("avoid-dead", "avoid-1", "goto-1", "sonar-1"):
        bench.appear(instance)
    bench.take()
    (dead,) = (item for item in bench.queries if "avoid-dead" in item.key)
    assert dead.timeout == CARD_S
    assert sorted(bench.queried()) == ["avoid-1", "avoid-dead", "goto-1"], "and whom it waits for"
    bench.agent.kernel.on_reply(dead.id, None, bench.now)
    assert bench.queried() == ["avoid-dead"]
    bench.agent.kernel.met(bench.card("goto-1", GOTO), bench.now)
    bench.agent.kernel.met(bench.card("avoid-1", AVOID), bench.now)
    assert (Do.READY, "") in bench.done()


def test_a_process_that_does_not_join_the_mesh_is_killed() -> None:
    bench = Bench(up=False)
    bench.begins("goto", GOTO)
    bench.begins("avoid", AVOID)
    bench.meet("goto-1", GOTO)
    assert bench.pass_time(START_S - 1.0) == []
    assert bench.pass_time(2.0) == [(Do.KILL, "avoid")]
    bench.ends("avoid")
    assert bench.pass_time(1.0) == [(Do.START, "avoid")]


def test_on_a_loaded_machine_a_start_may_take_as_many_times_longer() -> None:
    bench = Bench(up=False)
    bench.begins("goto", GOTO)
    bench.agent.kernel.on_bytes(lines(Load(2.0)), bench.now)
    assert bench.pass_time(2 * START_S - 1.0) == []
    assert bench.share().load == 2.0
    assert bench.pass_time(2.0) == [(Do.KILL, "goto")]


# Ending -------------------------------------------------------------------------------------------


def test_a_process_that_ends_is_restarted_and_the_share_reports_it(bench: Bench) -> None:
    bench.ends("goto", 1, "no such thing")
    assert bench.state("goto") is KeptState.WAITING
    (why,) = (kept.why for kept in bench.share().kept if kept.why)
    assert "status 1" in why
    assert "no such thing" in why
    assert bench.pass_time(0.0) == [(Do.START, "goto")]
    bench.begins("goto", 21)
    assert bench.state("goto") is KeptState.STARTING
    bench.meet("goto-2", 21)
    assert bench.state("goto") is KeptState.UP
    assert bench.pass_time(60.0) == []


def test_a_process_that_keeps_dying_is_given_up_with_its_last_output() -> None:
    bench = Bench(restarts=2)
    for pid in (21, 22):
        bench.ends("goto", 1, "Traceback")
        assert bench.pass_time(1.0) == [(Do.START, "goto")]
        bench.begins("goto", pid)
    bench.ends("goto", 1, "ValueError: no goal")
    (order,) = (o for o in bench.take() if o.do is Do.GIVE_UP)
    assert "status 1" in order.text
    assert "the budget of 2 restarts in 30 s is spent" in order.text
    assert "ValueError: no goal" in order.text
    bench.agent.kernel.leave(bench.now)
    assert not bench.share().leaving, "another host must replace them"


def test_the_delay_of_a_restart_grows_per_process() -> None:
    bench = Bench(restarts=10)
    for pid, pause in enumerate((*PAUSES_S, PAUSES_S[-1]), start=21):
        bench.ends("goto")
        if pause:
            assert bench.pass_time(0.9 * pause) == []
        assert bench.pass_time(0.11 * pause) == [(Do.START, "goto")]
        bench.begins("goto", pid)
    bench.ends("avoid")
    assert bench.pass_time(0.0) == [(Do.START, "avoid")]


@pytest.mark.parametrize(("after", "do"), [(29.9, Do.GIVE_UP), (30.0, Do.START)])
def test_the_budget_is_that_of_all_and_what_is_long_ago_is_forgotten(after: float, do: Do) -> None:
    bench = Bench(restarts=1)
    bench.ends("goto")
    bench.pass_time(0.0)
    bench.begins("goto", 21)
    bench.meet("goto-2", 21)
    bench.pass_time(after)
    bench.ends("avoid")
    assert do in [*(order.do for order in bench.take()), *(d for d, _ in bench.pass_time(0.0))]


def test_several_that_end_at_once_count_before_they_are_started() -> None:
    bench = Bench(restarts=1)
    bench.ends("goto")
    assert Do.GIVE_UP not in [order.do for order in bench.take()]
    bench.ends("avoid")
    assert Do.GIVE_UP in [order.do for order in bench.take()]


def test_a_failure_does_not_pay_for_a_restart_on_request() -> None:
    bench = Bench(restarts=1)
    assert bench.request(WakeupOrder.RESTART, "goto") == ""
    bench.ends("goto")
    bench.pass_time(0.0)
    bench.begins("goto", 21)
    bench.ends("avoid")
    assert bench.pass_time(0.0) == [(Do.START, "avoid")]
    bench.begins("avoid", 22)
    bench.ends("goto")
    assert Do.GIVE_UP in [order.do for order in bench.take()], "this one failed"


@given(
    restarts=st.integers(0, 6),
    within=st.floats(0.5, 40.0),
    gaps=st.lists(st.floats(0.0, 10.0), max_size=30),
)
def test_no_window_holds_more_starts_than_the_budget(
    restarts: int, within: float, gaps: list[float]
) -> None:
    bench = Bench(restarts=restarts, within_s=within)
    for number, gap in enumerate(gaps):
        bench.pass_time(gap)
        label = ("goto", "avoid")[number % 2]
        bench.ends(label)
        if Do.GIVE_UP in [order.do for order in bench.take()]:
            break
        bench.pass_time(PAUSES_S[-1])
        bench.begins(label, 100 + number)
    for first in bench.started:
        assert sum(first <= at < first + within for at in bench.started) <= restarts


def test_a_process_refused_at_its_first_start_is_given_up() -> None:
    bench = Bench(up=False)
    bench.begins("goto", GOTO)
    bench.ends("goto", MISUSED, "another goto agent is alive already")
    bench.take()
    assert bench.pass_time(SHARES_S) == [(Do.GIVE_UP, "")], "no share reports a lent one"
    (order,) = (o for o in bench.orders if o.do is Do.GIVE_UP)
    assert "another goto agent is alive already" in order.text


def test_a_process_replaced_by_another_instance_is_retried(
    bench: Bench,
) -> None:
    bench.pass_time(NEWCOMER_S)
    bench.ends("goto", MISUSED)
    (order,) = (order for order in bench.take() if order.do is Do.SAY)
    assert order.text.startswith("goto ")
    assert bench.pass_time(IN_THE_WAY_S[0] - 0.01) == []
    assert bench.pass_time(0.02) == [(Do.START, "goto")]


def test_a_refused_process_is_retried_with_growing_delays_outside_the_budget() -> None:
    bench = Bench(restarts=1)
    bench.pass_time(NEWCOMER_S)
    for pid, pause in enumerate((*IN_THE_WAY_S, IN_THE_WAY_S[-1]), start=21):
        bench.ends("goto", MISUSED)
        bench.take()
        assert bench.pass_time(0.9 * pause) == []
        assert bench.pass_time(0.11 * pause) == [(Do.START, "goto")]
        bench.begins("goto", pid)
    bench.ends("avoid")
    assert bench.pass_time(0.0) == [(Do.START, "avoid")], "it is the first restart"
    bench.meet("goto-2", 24)
    bench.ends("goto", MISUSED)
    bench.take()
    assert bench.pass_time(IN_THE_WAY_S[0] + 0.01) == [(Do.START, "goto")]
    bench.begins("goto", 25)
    bench.ends("goto", 1)
    assert Do.GIVE_UP in [order.do for order in bench.take()], "now it failed itself"


def test_in_the_way_of_one_that_another_host_took_over_is_no_fault_however_early() -> None:
    """A host that comes back finds that its agents are elsewhere by now."""
    bench = Bench(up=False)
    bench.begins("goto", GOTO)
    bench.begins("avoid", AVOID)
    bench.meet("avoid-1", AVOID)
    bench.ends("goto", MISUSED)
    bench.other(Kept(("goto",), KeptState.UP, 5, lent=True))
    assert bench.pass_time(60.0) == [(Do.READY, "")], "it would be refused again"
    assert bench.state("goto") is KeptState.WAITING
    bench.agent.kernel.appeared("wakeup", "wakeup-lab2", bench.now)
    bench.agent.kernel.disappeared("wakeup", "wakeup-lab2", bench.now)
    assert bench.pass_time(IN_THE_WAY_S[-1]) == [(Do.START, "goto")]


# Requests -----------------------------------------------------------------------------------------


def test_several_requests_restart_a_process_once(bench: Bench) -> None:
    assert bench.request(WakeupOrder.RESTART, "goto", GOTO) == ""
    assert bench.done() == [(Do.KILL, "goto")]
    bench.ends("goto")
    assert bench.request(WakeupOrder.RESTART, "goto", GOTO) == ""
    assert bench.pass_time(1.0) == [(Do.START, "goto")]
    bench.begins("goto", 21)
    bench.take()
    assert bench.request(WakeupOrder.RESTART, "goto", GOTO) == ""
    assert bench.done() == [], "that one is gone"


def test_a_request_is_refused_if_the_budget_is_spent() -> None:
    bench = Bench(restarts=1, can=("encoder",))
    bench.ends("goto")
    bench.pass_time(1.0)
    for order, name in ((WakeupOrder.RESTART, "avoid"), (WakeupOrder.START, "encoder")):
        refusal = bench.request(order, name)
        assert "1 restarts in 30 s" in refusal
        assert bench.done() == []
    bench.pass_time(30.0)
    assert bench.request(WakeupOrder.RESTART, "avoid") == ""


def test_it_starts_the_agents_that_it_can_on_request() -> None:
    bench = Bench(can=("encoder",))
    assert bench.share().can == ("encoder",)
    refusal = bench.request(WakeupOrder.START, "sonar")
    assert "sonar" in refusal
    assert "encoder" in refusal
    bench.take()
    assert bench.request(WakeupOrder.START, "encoder") == ""
    assert bench.done() == [(Do.START, "encoder")]
    assert bench.request(WakeupOrder.START, "encoder") == ""
    assert bench.done() == [], "it is looked after already"
    assert bench.share().can == ()
    bench.begins("encoder", 31)
    bench.meet("encoder-1", 31)
    (lent,) = (kept for kept in bench.share().kept if kept.lent)
    assert (lent.agents, lent.state, lent.pid) == (("encoder",), KeptState.UP, 31)


def test_a_lent_process_ends_once_its_own_host_has_the_agent_again() -> None:
    bench = Bench(can=("encoder",))
    bench.request(WakeupOrder.START, "encoder")
    bench.begins("encoder", 31)
    bench.take()
    bench.other(Kept(("encoder",), KeptState.STARTING, 7))
    assert bench.done() == []
    own = Kept(("encoder",), KeptState.UP, 7)
    bench.other(own)
    assert bench.done() == [], "of two that may not both stay the newcomer goes by itself"
    bench.pass_time(NEWCOMER_S - 0.1)
    bench.other(Kept(("encoder",), KeptState.WAITING))
    bench.pass_time(NEWCOMER_S)
    bench.other(own)
    assert bench.done() == [], "it went, and is a newcomer again"
    bench.pass_time(NEWCOMER_S)
    bench.other(own)
    assert bench.done() == [(Do.END, "encoder")]
    assert bench.share().can == ("encoder",)
    bench.ends("encoder", 0)
    assert bench.pass_time(60.0) == []


def test_a_lent_process_that_fails_ends_no_other() -> None:
    bench = Bench(can=("encoder",), restarts=1)
    bench.request(WakeupOrder.START, "encoder")
    bench.begins("encoder", 31)
    bench.ends("encoder", 1)
    assert bench.done() == [(Do.START, "encoder")]
    assert not bench.agent.gave_up
    assert bench.state("goto") is KeptState.UP


def test_a_lent_process_refused_because_of_its_own_host_is_dropped() -> None:
    """Two halves of a network that was cut are one again, and each had started one."""
    bench = Bench(can=("encoder",))
    bench.request(WakeupOrder.START, "encoder")
    bench.begins("encoder", 31)
    bench.meet("encoder-1", 31)
    bench.pass_time(10.0)
    bench.ends("encoder", MISUSED)
    assert bench.pass_time(60.0) == []
    assert bench.share().can == ("encoder",)


def test_a_process_ended_on_request_stays_ended_until_a_start_request(bench: Bench) -> None:
    assert bench.request(WakeupOrder.END, "goto") == ""
    assert bench.done() == [(Do.END, "goto")]
    bench.ends("goto", 0)
    assert bench.pass_time(60.0) == []
    assert bench.state("goto") is KeptState.ENDED
    assert bench.request(WakeupOrder.START, "goto") == ""
    assert bench.done() == [(Do.START, "goto")]
    assert "sonar" in bench.request(WakeupOrder.END, "sonar")


# Report -------------------------------------------------------------------------------------------


def test_the_share_is_published_each_second_with_needs_and_leaving() -> None:
    bench = Bench(needs=("robot", "goto"))
    before = len(bench.published)
    bench.pass_time(5.0)
    assert len(bench.published) - before == 5
    assert bench.share().needs == ("robot", "goto")
    bench.agent.kernel.leave(bench.now)
    assert bench.share().leaving
    assert bench.share().needs == ()


def test_a_monitor_of_this_host_that_stops_reporting_is_killed() -> None:
    bench = Bench(processes={"monitor": ("monitor",)}, up=False)
    bench.begins("monitor", 41)
    bench.meet("monitor-1", 41)
    bench.receive(MonitorReport("monitor-2", 5, acts=True))
    bench.take()
    assert bench.pass_time(60.0) == [], "it has never said anything, nor has another"
    bench.receive(MonitorReport("monitor-1", 5, acts=True))
    assert bench.pass_time(MONITOR_S - 1.0) == []
    assert bench.pass_time(2.0) == [], "it is asked first"
    asked = bench.queries[-1]
    bench.agent.kernel.on_reply(asked.id, bench.card("monitor-1", 41), bench.now)
    assert bench.pass_time(MONITOR_S - 1.0) == [], "it answers"
    bench.pass_time(2.0)
    bench.agent.kernel.on_reply(bench.queries[-1].id, None, bench.now)
    assert bench.done() == [(Do.KILL, "monitor")]
    evidence = bench.orders[-2].text
    assert "has not reported for" in evidence
    assert "has been linked to the router for 82 s and sees 1 agents" in evidence
    assert bench.share().kept[0].killed == evidence
    bench.ends("monitor")
    assert bench.pass_time(1.0) == [(Do.START, "monitor")]


def test_the_outage_of_the_router_is_in_no_process_s_account() -> None:
    bench = Bench(processes={"monitor": ("monitor",)}, up=False)
    bench.begins("monitor", 41)
    bench.meet("monitor-1", 41)
    bench.receive(MonitorReport("monitor-1", 5, acts=True))
    bench.agent.kernel.router(False, bench.now)
    bench.pass_time(2.0 * MONITOR_S)
    bench.agent.kernel.router(True, bench.now)
    bench.take()
    asked = len(bench.queries)
    assert bench.pass_time(MONITOR_S - 1.0) == []
    assert len(bench.queries) == asked, "it had nothing to hear"


# A machine that cannot keep up --------------------------------------------------------------------


def slow() -> Bench:
    """A host that needs goto, and has a recorder that it does not; then it is late all the time."""
    processes = {"goto": ("goto",), "recorder": ("recorder",)}
    bench = Bench(processes=processes, up=False, needs=("goto",))
    bench.begins("goto", GOTO)
    bench.meet("goto-1", GOTO)
    bench.begins("recorder", 43)
    bench.meet("recorder-1", 43)
    bench.take()
    return bench


def test_a_slow_machine_holds_back_what_is_not_needed() -> None:
    bench = slow()
    before = len(bench.orders)
    assert bench.pass_time(12.0, late=0.3) == [(Do.END, "recorder")]
    bench.ends("recorder", 0)
    (text,) = [o.text for o in bench.orders[before:] if o.do is Do.SAY]
    assert "0.30 s" in text
    assert "recorder" in text
    assert bench.pass_time(40.0, late=0.3) == [], "it is not started again and again"
    assert bench.state("recorder") is KeptState.WAITING
    assert bench.state("goto") is KeptState.UP


def test_a_slow_machine_restarts_what_is_needed_first() -> None:
    bench = slow()
    bench.pass_time(12.0, late=0.3)
    bench.ends("recorder", 0)
    bench.ends("goto")
    assert bench.pass_time(2.0, late=0.3) == [(Do.START, "goto")]
    bench.begins("goto", GOTO + 10)
    bench.meet("goto-2", GOTO + 10)
    assert bench.pass_time(30.0) == [], "a pause of the load is not the end of it"
    assert bench.pass_time(40.0) == [(Do.START, "recorder")]


def test_a_pause_is_no_slow_machine() -> None:
    bench = slow()
    for _ in range(3):
        assert bench.pass_time(4.0) == []
        bench.now += 60.0
    assert bench.pass_time(5.0) == []


def test_the_card_of_an_agent_that_ended_before_the_start_is_not_kept() -> None:
    wakeup = Wakeup(Identity("wakeup-1", "lab1", 1, rng=Random(1)), Parameters(host="lab1"))
    kernel = wakeup.kernel
    for instance in ("goto-1", "avoid-1"):
        kernel.living.add(instance)
        kernel.met(replace(Bench().card(instance, GOTO), owns=("wheels",)), 0.0)
    kernel.living.discard("goto-1")
    kernel.start(0.0)
    assert wakeup._contending.keys() == {"avoid-1"}


def test_two_mechanisms_on_two_hosts_are_named_by_the_one_whose_owner_does_not() -> None:
    def said(owner: str) -> list[str]:
        bench = Bench()
        cards = (("robot-1", owner, ""), ("goto-1", "lab1", ""), ("avoid-2", "lab2", "wheels mean"))
        for instance, host, mechanism in (*cards, ("gothrough-2", "lab2", "wheels mean")):
            early = instance == "goto-1"  # its card comes before this agent has joined
            if not early:
                bench.appear(instance)
            card = bench.card(instance, GOTO, host)
            owns = ("wheels",) * (instance == "robot-1")
            bids = ("wheels",) * (instance != "robot-1")
            mechanisms = (mechanism,) * bool(mechanism)
            card = replace(card, owns=owns, resources=bids, mechanisms=mechanisms)
            bench.agent.kernel.met(card, bench.now)
            if early:
                bench.appear(instance)
        return [order.text for order in bench.take() if order.do is Do.SAY]

    assert not said("lab1")
    (text,) = said("lab2")
    assert "wheels by different mechanisms" in text
    assert "by mean: avoid-2 on lab2" in text
    assert "goto-1 on lab1" in text
