"""What the demo tells, from what was heard: who would drive, who took over, who lacks."""

from __future__ import annotations

import pytest

from armadico.core.messages import (
    Ack,
    Ballot,
    BidHistory,
    BidRecord,
    Card,
    Command,
    Cycle,
    Message,
    MissionState,
    MissionStatus,
    encode,
)
from armadico.observe.watching import Heard, Presence
from armadico_tools.hosts.remote_observer import read, written
from armadico_tools.hosts.timeline import Story, Takeover

GOTO, AVOID = "goto-0000000000000001", "avoid-0000000000000002"
HOMES = {GOTO: "lab2", AVOID: "lab1"}


def told(made: Story, at: float, key: str, message: Message, *, asked: bool = False) -> None:
    made.take(Heard("robot1", key, encode(message), round(at * 1e9), asked))


def token(made: Story, at: float, who: str, *, there: bool) -> None:
    made.take(Presence("robot1", who.partition("-")[0], who, there, round(at * 1e9)))


def bid(made: Story, at: float, who: str, utility: float | None, reason: str) -> None:
    record = BidRecord(Cycle(1, 5), "wheels", utility, False, (), reason)
    told(made, at, f"agent/x/{who}/bids", BidHistory(who, (record,)), asked=True)


def ack(made: Story, at: float, number: int, by: str, answered: int) -> None:
    ballot = Ballot(1, 0.6, False, by)
    said = Ack("wheels", Cycle(1, number), ballot, ballot, Cycle(1, answered), measured=(0.3, 0.0))
    told(made, at, "resource/wheels/ack", said)


def command(made: Story, at: float, who: str, number: int) -> None:
    said = Command("wheels", Cycle(1, number), Ballot(1, 0.6, False, who), (0.3, 0.0))
    told(made, at, f"robot/cmd/{who}", said)


def story() -> Story:
    made = Story()
    for who, host in HOMES.items():
        card = Card(who.partition("-")[0], who, host, 1, "", 1, (), (), ())
        told(made, 1.0, f"agent/x/{who}/card", card, asked=True)
        token(made, 1.0, who, there=True)
    return made


def test_what_is_heard_is_read_as_it_was_written() -> None:
    everything = [
        Heard("robot1", "robot/cmd/goto-1", b"\x00\xff", 10**18, True),
        Presence("robot1", "goto", GOTO, True, 10**18),
    ]
    assert [read(written(each)) for each in everything] == everything
    assert read("Traceback (most recent call last):") is None
    assert read('{"at": 1}') is None


def test_who_drives_and_how_fast() -> None:
    made = story()
    assert (made.driver, made.speed) == ("", 0.0)
    ack(made, 2.0, 9, GOTO, 8)
    assert (made.driver, made.speed) == (GOTO, 0.3)
    ack(made, 2.1, 19, GOTO, 8)
    assert made.driver == "", "obeyed long ago"


def test_who_lacks_on_which_host() -> None:
    made = story()
    wanted = {"lab1": ("avoid", "sonar"), "lab2": ("goto",)}
    assert made.lacks(wanted) == ["sonar on lab1"]
    token(made, 2.0, GOTO, there=False)
    assert made.lacks(wanted) == ["sonar on lab1", "goto on lab2"]
    assert made.name(AVOID) == "avoid on lab1"
    assert made.name(GOTO) == "goto on lab2", "where it was is still known"


def test_who_elsewhere_would_drive() -> None:
    made = story()
    bid(made, 1.0, GOTO, 0.6, "leg 0")
    bid(made, 1.0, AVOID, None, "nothing in the way")
    assert made.standing_by("lab2") == []
    bid(made, 1.5, AVOID, 0.4, "left")
    assert [(who, bid.utility) for who, bid in made.standing_by("lab2")] == [(AVOID, 0.4)]
    ack(made, 3.0, 20, GOTO, 19)
    assert made.standing_by("lab2") == [], "told too long ago"


def test_the_share_of_the_way() -> None:
    made = story()
    assert made.done() == 0.0
    for to_go in (8.0, 6.0, 2.0):
        status = MissionStatus(1, MissionState.DRIVING, to_go, 0)
        told(made, 1.0, "mission/status", status)
    assert made.done() == pytest.approx(0.75)


def test_who_took_over_is_who_was_obeyed_after_the_last_command() -> None:
    made = story()
    command(made, 1.00, GOTO, 10)
    ack(made, 1.10, 11, GOTO, 10)
    last = made.last_command("lab2")
    assert last is not None
    assert made.takeover(last) is None
    command(made, 1.25, AVOID, 12)
    assert made.takeover(last) is None, "said, and not known to be obeyed"
    ack(made, 1.30, 13, AVOID, 12)
    took = made.takeover(last)
    assert took == Takeover(AVOID, pytest.approx(0.25), 2)
