"""Bugs that are planted, and must be found by runs that are short enough to be read."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from armadico.core import coordination
from armadico.core.coordination import Contender, Event, Owner, State, Verdict, by_newest
from armadico.core.cycles import CycleClock
from armadico.core.messages import Ack, Command, Message
from armadico_tools.explore.replay import Counterexample, Run, replay
from armadico_tools.explore.search import Limits, Search
from armadico_tools.explore.world import Parts, Setup


def first(setup: Setup, parts: Parts | None = None, faults: int = 1) -> Counterexample:
    """The shortest counterexample."""
    found = Search(setup, Limits(faults), parts).run()
    assert found.broken, "it was not found"
    return found.broken[0]


class ObeysSmaller(Owner):
    def _verdict(self, command: Command, now: float, *, stopped: bool, fault: str) -> Verdict:
        verdict = super()._verdict(command, now, stopped=stopped, fault=fault)
        return Verdict.OBEYED if verdict is Verdict.STALE_BALLOT else verdict


class ObeysStopped(Owner):
    def judge(
        self, command: Command, now: float, *, stopped: bool = False, fault: str = ""
    ) -> Verdict:
        return super().judge(command, now, fault=fault)


class NeverSilent(Owner):
    @property
    def silent_at(self) -> float | None:
        return None


class LooksAtNoAck(Contender):
    """Learns of no ballot by the ack, so it goes on casting the same small term."""

    def acked(self, ack: Ack, now: float) -> list[Message]:
        return super().acked(Ack(ack.resource, ack.cycle, measured=ack.measured), now)


class JumpsTerms(Contender):
    def _cast(self, event: Event, now: float) -> list[Message]:
        if self.largest is not None:
            ballot = self.largest
            self.largest = type(ballot)(
                ballot.term + 1, ballot.utility, ballot.critical, ballot.instance
            )
        return super()._cast(event, now)


class NoSilence(Contender):
    """Waits for a release for ever."""

    def _reason(self, now: float) -> Event | None:
        event = super()._reason(now)
        return None if event is Event.UNOBEYED and self.rival is not None else event


class NeverListens(CycleClock):
    """A contender that slept, or has just started, takes over at once."""

    @property
    def listening(self) -> bool:
        return self.newest is None


class LastHeard(Contender):
    """Compares its newest bid with the newest claim, whatever cycles they answer."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more, compare=by_newest)


SAFETY = [
    (
        Setup(("0.5", "0.6"), kinds=("fates",)),
        Parts(owner=ObeysSmaller),
        "ballots never go down",
        1,
    ),
    (Setup(("0.6",), kinds=("stop", "fates")), Parts(owner=ObeysStopped), "a stop stops", 2),
    (Setup(("0.6", "-"), kinds=("crash",)), Parts(owner=NeverSilent), "silence stops", 1),
    (Setup(("0.5", "0.6"), kinds=("bids",)), Parts(contender=JumpsTerms), "terms bounded", 1),
    (
        Setup(("0.6", "0.5"), kinds=("hang",)),
        Parts(clock=NeverListens),
        "only the better takes over",
        1,
    ),
    (
        Setup(("0.5", "0.53"), kinds=("rise",)),
        Parts(contender=LastHeard),
        "only the better takes over",
        1,
    ),
]


def _named(parts: Parts) -> str:
    own = {Contender, Owner, CycleClock}
    return next(k.__name__ for k in (parts.contender, parts.owner, parts.clock) if k not in own)


@pytest.mark.parametrize(
    ("setup", "parts", "promise", "faults"), SAFETY, ids=[_named(bug) for _, bug, *_ in SAFETY]
)
def test_a_bug_is_found_and_its_run_repeats(
    setup: Setup, parts: Parts, promise: str, faults: int
) -> None:
    found = first(setup, parts, faults)
    assert found.promise == promise
    assert found.run.cost <= faults
    assert found.run.cycles <= 16
    assert replay(found.run, parts) == [f"{promise}: {found.how}"]
    assert replay(found.run) == []


@pytest.mark.long(but=("NoSilence-setup1",))
@pytest.mark.parametrize(
    ("contender", "setup"),
    [
        (LooksAtNoAck, Setup(("0.6", "0.5"), kinds=("crash",))),
        (NoSilence, Setup(("0.6", "0.5"), kinds=("hang", "cut"), lasts=(8, None))),
    ],
)
def test_what_never_comes_right_is_found(contender: type[Contender], setup: Setup) -> None:
    parts = Parts(contender=contender)
    found = first(setup, parts)
    assert found.run.loop, "it goes on for ever"
    assert found.run.cost <= 1
    assert found.run.cycles <= 160, "it stands back for four seconds in between"
    assert any(text.startswith(found.promise) for text in replay(found.run, parts))


def transitions(monkeypatch: pytest.MonkeyPatch, state: State, event: Event, to: Any) -> None:
    table = {**coordination.TRANSITIONS, (state, event): to}
    if to is None:
        del table[state, event]
    monkeypatch.setattr(coordination, "TRANSITIONS", table)


def takes_over_from_the_unobeyed_never(monkeypatch: pytest.MonkeyPatch) -> None:
    transitions(monkeypatch, State.CONTENDING, Event.UNOBEYED, None)


def rests_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    transitions(monkeypatch, State.STANDING_BACK, Event.RESTED, None)


def goes_on_unobeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    transitions(monkeypatch, State.HOLDING, Event.NOT_OBEYED, None)


@pytest.mark.long(but=("takes_over_from_the_unobeyed_never-setup1",))
@pytest.mark.parametrize(
    ("plant", "setup"),
    [
        (goes_on_unobeyed, Setup(("0.6", "0.5"), kinds=("cut",), lasts=(None,))),
        (takes_over_from_the_unobeyed_never, Setup(("0.6", "0.5"), kinds=("crash",))),
        (rests_for_ever, Setup(("0.6", "-"), kinds=("cut",), lasts=(8,))),
    ],
)
def test_a_line_of_the_table_that_is_missing_is_found_and_breaks_its_promise_until_it_is_back(
    plant: Callable[[pytest.MonkeyPatch], None],
    setup: Setup,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plant(monkeypatch)
    found = first(setup)
    assert found.run.cost <= 1
    assert found.run.cycles <= 80
    run = eval(repr(found.run), {"Run": Run, "Setup": Setup})  # as it is printed
    assert run == found.run
    assert replay(run)
    monkeypatch.undo()
    assert replay(run) == []
