"""What the demo tells, from what was heard: who would drive, who took over, who lacks."""

from __future__ import annotations

import pytest

from armadico.cli.remote_observer import read, written
from armadico.core.messages import (
    Ack,
    Ballot,
    BidHistory,
    BidRecord,
    Card,
    Command,
    Cycle,
    Message,
    encode,
)
from armadico.core.resources import WHEELS
from armadico.core.services import BIDS, CARD
from armadico.mobile.messages import MissionState, MissionStatus
from armadico.observe.watching import Heard, Presence
from armadico_tools.hosts.timeline import Story

GOTO, AVOID = "goto-0000000000000001", "avoid-0000000000000002"
HOMES = {GOTO: "lab2", AVOID: "lab1"}


def heard(at: float, message: Message) -> Heard:
    """It, on its way from the observer's host."""
    who = getattr(message, "instance", "")
    keys = {
        Ack: WHEELS.ack_key,
        Command: WHEELS.command_key_of(GOTO),
        MissionStatus: "mission/status",
        Card: CARD.key_for(name="any", instance=who),
        BidHistory: BIDS.key_for(name="any", instance=who),
    }
    return Heard("robot1", keys[type(message)], encode(message), round(at * 1e9))


def told(made: Story, at: float, message: Message) -> None:
    made.hear(heard(at, message))


def story() -> Story:
    made = Story()
    for who, host in HOMES.items():
        told(made, 1.0, Card(who.partition("-")[0], who, host, 1, "", 1, (), (), ()))
        made.hear(Presence("robot1", who.partition("-")[0], who, True, 10**9))
    return made


def command(number: int, who: str) -> Command:
    return Command("wheels", Cycle(1, number), Ballot(number, 0.6, False, who), (0.3, 0.0))


def ack(number: int, of: Command) -> Ack:
    by = of.ballot
    return Ack("wheels", Cycle(1, number), by, by, of.cycle, 0.6, measured=(0.3, 0.0))


def bids(who: str, utility: float | None) -> BidHistory:
    action = () if utility is None else (0.3, 0.0)
    return BidHistory(who, (BidRecord(Cycle(1, 5), "wheels", utility, False, action, "why"),))


def test_what_came_is_read_as_it_was_written() -> None:
    for item in (Presence("robot1", "goto", GOTO, True, 7), heard(1.0, command(7, GOTO))):
        assert read(written(item)) == item
    assert read("Traceback (most recent call last):") is None
    assert read('{"at": 1}') is None


def test_who_drives_and_how_fast() -> None:
    made = story()
    assert (made.driver, made.speed) == (None, 0.0)
    told(made, 2.0, ack(9, command(8, GOTO)))
    assert (made.driver, made.speed) == (GOTO, 0.3)
    told(made, 2.1, ack(19, command(8, GOTO)))
    assert made.driver is None, "obeyed long ago"


def test_who_lacks_on_which_host() -> None:
    made = story()
    wanted = {"lab1": ("avoid", "sonar"), "lab2": ("goto",)}
    assert made.lacks(wanted) == ["sonar on lab1"]
    made.hear(Presence("robot1", "goto", GOTO, False, 2 * 10**9))
    assert made.lacks(wanted) == ["sonar on lab1", "goto on lab2"]
    assert made.name(AVOID) == "avoid on lab1"
    assert made.name(GOTO) == "goto on lab2", "where it was is still known"


def test_who_elsewhere_would_drive() -> None:
    made = story()
    told(made, 1.0, bids(GOTO, 0.6))
    told(made, 1.0, bids(AVOID, None))
    assert made.standing_by("lab2") == {}
    told(made, 1.5, bids(AVOID, 0.4))
    assert made.standing_by("lab2") == {AVOID: 0.4}
    told(made, 3.0, ack(20, command(19, GOTO)))
    assert made.standing_by("lab2") == {}, "told too long ago"


def test_the_share_of_the_way() -> None:
    made = story()
    assert made.done() == 0.0
    for to_go in (8.0, 6.0, 2.0):
        told(made, 1.0, MissionStatus(1, MissionState.DRIVING, to_go=to_go))
    assert made.done() == pytest.approx(0.75)


def test_who_took_over_is_who_was_obeyed_after_the_last_command() -> None:
    made = story()
    told(made, 1.00, command(10, GOTO))
    told(made, 1.10, ack(11, command(10, GOTO)))
    assert made.last_command("lab2") == (1.0, command(10, GOTO))
    assert made.next_obeyed(1.0, (GOTO,)) is None
    told(made, 1.25, command(12, AVOID))
    assert made.next_obeyed(1.0, (GOTO,)) is None, "said, and not known to be obeyed"
    told(made, 1.30, ack(13, command(12, AVOID)))
    assert made.next_obeyed(1.0, (GOTO,)) == (1.25, command(12, AVOID))
