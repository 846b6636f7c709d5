"""What the demo tells, from made-up news: who would drive, who took over, who lacks."""

from __future__ import annotations

import pytest

from armadico.core.messages import Ack, Ballot, BidHistory, BidRecord, Card, Command, Cycle
from armadico_tools.hosts import events
from armadico_tools.hosts.remote_observer import told
from armadico_tools.hosts.timeline import Story, Takeover

GOTO, AVOID = "goto-0000000000000001", "avoid-0000000000000002"
HOMES = {GOTO: "lab2", AVOID: "lab1"}


def story() -> Story:
    made = Story()
    for who, host in HOMES.items():
        made.take(events.Home(who, host))
        made.take(events.Token(1.0, who, True))
    return made


def test_news_is_read_as_it_was_written() -> None:
    everything: list[events.News] = [
        events.Cycle(1.0, 7, GOTO, 6, 0.3),
        events.Commanded(1.0, GOTO, 7),
        events.Token(1.0, GOTO, True),
        events.Home(GOTO, "lab2"),
        events.Bidding(1.0, AVOID, None, "nothing in the way"),
        events.Mission(1.0, "driving", 3.5),
    ]
    assert [events.read(events.written(each)) for each in everything] == everything
    assert events.read("Traceback (most recent call last):") is None


def test_messages_are_told_in_short() -> None:
    by = Ballot(1, 0.6, False, GOTO)
    ack = Ack("wheels", Cycle(1, 9), by, by, Cycle(1, 8), 0.6, measured=(0.3, 0.0))
    assert [*told(ack, 2.0)] == [events.Cycle(2.0, 9, GOTO, 8, 0.3)]
    long_ago = Ack("wheels", Cycle(1, 19), by, by, Cycle(1, 8), 0.6, measured=(0.0, 0.0))
    assert [*told(long_ago, 2.0)] == [events.Cycle(2.0, 19, "", 0, 0.0)]
    released = Ack("wheels", Cycle(1, 9), by, None, Cycle(1, 8), measured=(0.1, 0.0))
    assert [*told(released, 2.0)] == [events.Cycle(2.0, 9, "", 0, 0.1)]
    command = Command("wheels", Cycle(1, 9), by, (0.3, 0.0))
    assert [*told(command, 2.0)] == [events.Commanded(2.0, GOTO, 9)]
    assert not [*told(Command("arm", Cycle(1, 9), by, (0.3,)), 2.0)]
    card = Card("goto", GOTO, "lab2", 1, "", 1, (), (), ())
    assert [*told(card, 2.0)] == [events.Home(GOTO, "lab2")]
    record = BidRecord(Cycle(1, 5), "wheels", 0.6, False, (0.3, 0.0), "leg 0")
    assert [*told(BidHistory(GOTO, (record,)), 2.0)] == [events.Bidding(2.0, GOTO, 0.6, "leg 0")]
    assert not [*told(BidHistory(GOTO, ()), 2.0)]


def test_who_lacks_on_which_host() -> None:
    made = story()
    wanted = {"lab1": ("avoid", "sonar"), "lab2": ("goto",)}
    assert made.lacks(wanted) == ["sonar on lab1"]
    made.take(events.Token(2.0, GOTO, False))
    assert made.lacks(wanted) == ["sonar on lab1", "goto on lab2"]
    assert made.name(AVOID) == "avoid on lab1"


def test_who_elsewhere_would_drive() -> None:
    made = story()
    made.take(events.Bidding(1.0, GOTO, 0.6, "leg 0"))
    made.take(events.Bidding(1.0, AVOID, None, "nothing in the way"))
    assert made.standing_by("lab2") == []
    made.take(events.Bidding(1.5, AVOID, 0.4, "left"))
    assert [bid.instance for bid in made.standing_by("lab2")] == [AVOID]
    made.take(events.Cycle(3.0, 20, GOTO, 19, 0.3))
    assert made.standing_by("lab2") == [], "told too long ago"


def test_the_share_of_the_way() -> None:
    made = story()
    assert made.done() == 0.0
    for to_go in (8.0, 6.0, 2.0):
        made.take(events.Mission(1.0, "driving", to_go))
    assert made.done() == pytest.approx(0.75)


def test_who_took_over_is_who_was_obeyed_after_the_last_command() -> None:
    made = story()
    made.take(events.Commanded(1.00, GOTO, 10))
    made.take(events.Cycle(1.10, 11, GOTO, 10, 0.3))
    last = made.last_command("lab2")
    assert last is not None
    assert made.takeover(last) is None
    made.take(events.Commanded(1.25, AVOID, 12))
    assert made.takeover(last) is None, "said, and not known to be obeyed"
    made.take(events.Cycle(1.30, 13, AVOID, 12, 0.3))
    took = made.takeover(last)
    assert took == Takeover(AVOID, pytest.approx(0.25), 2)
