"""Causes of pauses in obeyed commands, from hand-made messages."""

from __future__ import annotations

import pytest

from armadico.core.cycles import PERIOD
from armadico.core.messages import Ack, Ballot, BidHistory, BidRecord, Command, Cycle
from armadico_tools.attacks.pauses import Cause, Drive, Kill, Pause

BALLOT = Ballot(1, 0.6, False, "goto-1")
OBEYED_FROM, PAUSES_FROM, GOES_ON = 1, 10, 20
"""Numbers of cycles: of the first obeyed command, and those without one."""


def drive(silent: range = range(0)) -> Drive:
    """Commands are obeyed but in cycles 10 to 19; no acknowledgements come in `silent` ones."""
    made, obeyed = Drive(), 0
    made.provides = {"encoder": ("encoder/pose",), "sonar": ("sonar/**",)}
    for number in range(OBEYED_FROM, GOES_ON + 5):
        if not PAUSES_FROM <= number < GOES_ON:
            obeyed = number
            made.update(Command("wheels", Cycle(1, number), BALLOT, (0.3, 0.0)), number * PERIOD)
        if number not in silent:
            made.update(
                Ack("wheels", Cycle(1, number), BALLOT, BALLOT, Cycle(1, obeyed)), number * PERIOD
            )
    return made


def bids(made: Drive, utility: float | None, reason: str = "", lacks: str = "") -> None:
    """A contender's records of the cycles without an obeyed command."""
    records = tuple(
        BidRecord(Cycle(1, number), "wheels", utility, False, (0.3, 0.0), reason, (), lacks)
        for number in range(PAUSES_FROM, GOES_ON)
    )
    made.update(BidHistory("goto-2", records), GOES_ON * PERIOD)


def only(made: Drive) -> Pause:
    (pause,) = made.pauses(0.0, (GOES_ON + 5) * PERIOD)
    assert pause.seconds == pytest.approx((GOES_ON - PAUSES_FROM + 1) * PERIOD)
    assert made.paused(pause.begin + PERIOD, pause.end) == pytest.approx(pause.seconds)
    return pause


def test_commands_in_each_cycle_have_no_pause() -> None:
    made = drive()
    assert made.pauses(GOES_ON * PERIOD, (GOES_ON + 5) * PERIOD) == []
    assert made.holder == "goto-1"


def test_a_pause_until_now_counts() -> None:
    (_, last) = drive().pauses(0.0, 100.0)
    assert last.end == 100.0


@pytest.mark.parametrize(
    ("utility", "reason", "lacks", "killed", "cause"),
    [
        (None, "", "encoder/pose", "encoder", f"{Cause.INPUT} (encoder/pose)"),
        (None, "", "encoder/pose", "goto", f"{Cause.LATE} (encoder/pose)"),
        (None, "", "sonar/obstacles", "", f"{Cause.LATE} (sonar/obstacles)"),
        (None, "no goal", "", "interface", f"{Cause.NO_BID} (no goal)"),
        (0.6, "", "", "goto", Cause.UNTAKEN),
        (0.0, "", "", "goto", f"{Cause.NO_BID} (a bid of 0)"),
    ],
)
def test_the_cause_is_what_the_contenders_recorded(
    utility: float | None, reason: str, lacks: str, killed: str, cause: str
) -> None:
    made = drive()
    bids(made, utility, reason, lacks)
    if killed:
        made.kills.append(Kill(PAUSES_FROM * PERIOD, killed, killed == "goto"))
    pause = only(made)
    assert pause.cause == cause
    assert (pause.killed, pause.held) == (killed, killed == "goto")


@pytest.mark.parametrize(("killed", "cause"), [("robot", Cause.OWNER), ("goto", Cause.SILENT)])
def test_without_acknowledgements_the_robot_agent_is_the_cause(killed: str, cause: Cause) -> None:
    made = drive(silent=range(PAUSES_FROM, GOES_ON))
    made.kills.append(Kill(PAUSES_FROM * PERIOD, killed, False))
    assert only(made).cause == cause


def test_without_records_no_contender_computed_a_bid() -> None:
    assert only(drive()).cause == Cause.NO_TURN


def test_commands_that_were_not_obeyed_were_refused() -> None:
    made = drive()
    for number in range(PAUSES_FROM, GOES_ON):
        made.update(Command("wheels", Cycle(1, number), BALLOT, (0.3, 0.0)), number * PERIOD)
    assert only(made).cause == Cause.REFUSED
