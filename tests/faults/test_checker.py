"""The checker, one promise after another, on observations made by hand."""

from __future__ import annotations

import msgspec
import pytest

from armadico.messages import (
    Ballot,
    BidRecord,
    Claim,
    Command,
    Cycle,
    Message,
    MissionState,
    MissionStatus,
    Pose,
    RobotState,
    Stop,
    Truth,
)
from armadico.tools.faults.checker import Checker
from armadico.tools.faults.kinds import KINDS, Promise, voided
from armadico.tools.faults.observations import (
    Bids,
    Faulted,
    Left,
    Obeyed,
    Observation,
    Ordered,
    Passed,
    Said,
)

A, B = "goto-0123456789abcdef", "avoid-0123456789abcdef"


def ballot(term: int, who: str = A) -> Ballot:
    return Ballot(term, 0.6, False, who)


class Story:
    """Cycles of a tenth of a second, in which a robot drives unless the test says otherwise."""

    def __init__(self, epoch: int = 1) -> None:
        self.checker = Checker()
        self.epoch, self.number, self.now = epoch, 0, 0.0
        self.ballot: Ballot | None = ballot(3)
        self.v = 0.05
        self.obeyed_age = 1
        self.stop = Stop()
        self.contact = 0
        self.last = Cycle(epoch, 0)  # the cycle that was obeyed last
        self.order = self.talk = True
        self.x = 0.0
        self.said(MissionStatus(1, MissionState.DRIVING, 3.0))

    @property
    def cycle(self) -> Cycle:
        return Cycle(self.epoch, self.number)

    def see(self, seen: Observation) -> None:
        self.checker.take(seen)

    def said(self, message: Message) -> None:
        self.see(Said(self.now, message))

    def state(self, ballot: Ballot | None, obeyed: Ballot | None, at: Cycle | None) -> RobotState:
        return RobotState(
            *(self.cycle, self.x, 0, 0, self.v, 0, 12, True, False, ballot, obeyed, at, self.stop)
        )

    def cycles(self, count: int) -> None:
        """So many cycles in which the holder commands and is obeyed."""
        for _ in range(count):
            self.now = round(self.now + 0.1, 3)
            self.number += 1
            self.said(Truth(self.now, 0, 0, 0, self.v, 0, self.contact, 1.0))
            self.last = Cycle(self.epoch, max(self.number - self.obeyed_age, 0))
            self.said(self.state(self.ballot, self.ballot, self.last))
            if self.ballot is not None and self.talk:
                self.said(Command(self.cycle, self.ballot, self.v, 0.0))
                self.claim(self.ballot)
            if self.order:
                self.see(Ordered(self.now, self.v, 0.0))

    def claim(self, ballot: Ballot, utility: float | None = 0.6, commanded: float = 0.3) -> None:
        self.said(
            Claim("wheels", ballot, self.cycle, utility, False, (commanded, 0.0), (commanded, 0.0))
        )

    def stand(self, seconds: float, **bids: BidRecord) -> None:
        """At rest, with nobody obeyed, and these bids."""
        end = self.now + seconds
        self.see(Ordered(self.now, 0.0, 0.0))
        while self.now < end:
            self.now = round(self.now + 0.1, 3)
            self.number += 1
            self.said(Truth(self.now, 0, 0, 0, 0.0, 0, self.contact, 1.0))
            self.said(self.rest())
            for name, record in bids.items():
                self.see(Bids(self.now, f"{name}-0123456789abcdef", record))

    def rest(self) -> RobotState:
        old = self.last
        return RobotState(
            *(self.cycle, 0, 0, 0, 0.0, 0, 12, True, False, ballot(3), ballot(3), old, self.stop)
        )

    def broken(self) -> list[Promise]:
        return [violation.promise for violation in self.checker.violations]


@pytest.fixture
def story() -> Story:
    return Story()


def wants(utility: float | None, reason: str = "leg 1") -> BidRecord:
    return BidRecord(Cycle(1, 1), "wheels", utility, False, (), reason)


def test_an_ordinary_drive_breaks_nothing(story: Story) -> None:
    story.cycles(100)
    assert story.broken() == []


# One driver ---------------------------------------------------------------------------------------


def test_an_obeyed_ballot_that_goes_down_is_seen_in_the_echo(story: Story) -> None:
    story.cycles(10)
    story.ballot = ballot(2)
    story.cycles(1)
    assert Promise.ONE_DRIVER in story.broken()


def test_one_that_goes_down_and_up_between_two_cycles_is_seen_where_obeying_is(
    story: Story,
) -> None:
    story.cycles(10)
    for term in (3, 4, 3, 4):
        story.see(Obeyed(story.now, ballot(term), story.cycle))
    assert story.broken() == [Promise.ONE_DRIVER]


def test_the_largest_known_may_not_go_down_nor_be_below_the_obeyed(story: Story) -> None:
    story.cycles(5)
    story.said(story.state(ballot(2), ballot(3), story.cycle))
    assert story.broken() == [Promise.ONE_DRIVER] * 2


def test_a_new_epoch_begins_anew(story: Story) -> None:
    story.cycles(10)
    story.epoch, story.number, story.ballot = 2, 0, ballot(1)
    story.cycles(10)
    assert story.broken() == []


# Fresh --------------------------------------------------------------------------------------------


def test_a_command_for_a_cycle_long_past_is_refused_or_it_is_seen(story: Story) -> None:
    story.cycles(10)
    story.see(Obeyed(story.now, ballot(3), Cycle(1, story.number - 3)))
    assert story.broken() == []
    story.see(Obeyed(story.now, ballot(3), Cycle(1, story.number - 4)))
    story.see(Obeyed(story.now, ballot(3), Cycle(9, story.number)))
    assert story.broken() == [Promise.FRESH] * 2


def test_a_robot_agent_that_obeys_what_waited_while_it_hung_is_seen(story: Story) -> None:
    story.cycles(10)
    story.see(Faulted(story.now, "hang", ("robot",), began=True))
    story.now += 1.0
    story.see(Faulted(story.now, "hang", ("robot",), began=False))
    story.see(Obeyed(story.now, ballot(3), story.cycle))
    assert Promise.FRESH in story.broken()


def test_the_echo_alone_shows_late_obedience_too(story: Story) -> None:
    story.cycles(10)
    story.obeyed_age = 5
    story.number += 2
    story.cycles(1)
    assert Promise.FRESH in story.broken()


def test_the_echo_shows_an_older_cycle_of_one_reign_after_a_newer(story: Story) -> None:
    story.cycles(10)
    story.obeyed_age = 3
    story.cycles(1)
    assert story.broken() == [Promise.FRESH]


# One holder, and somebody obeyed ------------------------------------------------------------------


def test_two_reigns_side_by_side_are_seen_after_five_cycles(story: Story) -> None:
    story.cycles(10)
    for _ in range(5):
        story.cycles(1)
        story.claim(ballot(4, B))
    assert story.broken() == []
    for _ in range(2):
        story.cycles(1)
        story.claim(ballot(4, B))
    assert story.broken() == [Promise.ONE_HOLDER]


def test_two_reigns_in_a_cut_network_are_none_of_its_business_until_it_is_whole(
    story: Story,
) -> None:
    story.cycles(10)
    story.see(Faulted(story.now, "partition", (A,), began=True))
    for _ in range(10):
        story.cycles(1)
        story.claim(ballot(4, B))
    story.see(Faulted(story.now, "partition", (A,), began=False))
    for _ in range(4):
        story.cycles(1)
        story.claim(ballot(4, B))
    assert story.broken() == []


def test_a_reign_that_goes_on_after_a_pause_begins_anew(story: Story) -> None:
    story.cycles(10)
    story.claim(ballot(4, B))
    story.cycles(10)
    story.claim(ballot(4, B))
    story.cycles(1)
    assert story.broken() == []


def test_it_has_moved_that_crawls(story: Story) -> None:
    healed(story)
    story.v = 0.01
    story.x = 0.006
    story.cycles(25)
    assert Promise.MOVES not in story.broken()


def test_exchanges_one_after_another_are_one_holder_each(story: Story) -> None:
    for term in range(3, 20):
        story.ballot = ballot(term, A if term % 2 else B)
        story.cycles(3)
    assert Promise.ONE_HOLDER not in story.broken()


def test_nobody_obeyed_for_five_seconds_though_somebody_bids(story: Story) -> None:
    story.cycles(5)
    story.stand(5.0, goto=wants(0.6))
    assert Promise.OBEYED not in story.broken()
    story.stand(1.0, goto=wants(0.6))
    assert Promise.OBEYED in story.broken()


def test_nobody_need_be_obeyed_who_does_not_bid_is_stopped_or_has_gone(story: Story) -> None:
    story.cycles(5)
    story.stand(7.0, goto=wants(None, "no goal"))
    story.stop = Stop(1, True, "somebody")
    story.stand(7.0, goto=wants(0.6))
    story.stop = Stop(2, False, "somebody")
    story.stand(0.5, goto=wants(0.6))
    story.see(Left(story.now, A))
    story.stand(7.0)
    assert Promise.OBEYED not in story.broken()


def test_a_moment_without_a_bid_is_no_excuse_for_nobody_being_obeyed(story: Story) -> None:
    story.cycles(5)
    for _ in range(10):
        story.stand(0.5, goto=wants(0.6))
        story.stand(0.1, goto=wants(None, "only 0.4 m of free way"))
    assert Promise.OBEYED in story.broken()


# Silence and the watchdog -------------------------------------------------------------------------


def test_no_stop_in_time_after_the_last_command(story: Story) -> None:
    story.cycles(10)
    story.see(Passed(story.now + 0.39))
    assert story.broken() == []
    story.see(Passed(story.now + 0.41))
    assert story.broken() == [Promise.SILENCE]


def test_a_stop_in_time_is_well(story: Story) -> None:
    story.cycles(10)
    story.see(Ordered(story.now + 0.3, 0.0, 0.0))
    story.see(Passed(story.now + 0.9))
    assert story.broken() == []


def test_speeds_that_nobody_commanded(story: Story) -> None:
    story.cycles(10)
    story.see(Ordered(story.now, 0.4, 0.0))
    assert story.broken() == [Promise.SILENCE]


def test_a_robot_agent_that_repeats_the_last_command_has_not_stopped(story: Story) -> None:
    story.cycles(10)
    story.order = story.talk = False
    for _ in range(6):
        story.cycles(1)
        story.see(Ordered(story.now, story.v, 0.0))
    assert Promise.SILENCE in story.broken()


def test_wheels_that_do_not_rest_after_rest_was_ordered(story: Story) -> None:
    story.cycles(10)
    story.see(Ordered(story.now, 0.0, 0.0))
    story.order = False
    story.cycles(29)
    assert story.broken() == []
    story.cycles(3)
    assert story.broken() == [Promise.SILENCE]


def test_without_the_robot_agent_no_stop_but_rest_in_time(story: Story) -> None:
    story.cycles(10)
    story.see(Faulted(story.now, "crash", ("robot",), began=True))
    at = story.now
    for tenth in range(1, 52):
        story.now = round(at + 0.1 * tenth, 3)
        story.said(Truth(story.now, 0, 0, 0, 0.05, 0, 0, 1.0))
    assert story.broken() == [Promise.WATCHDOG]


# Motion -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("v", "w"), [(0.16, 0.0), (0.05, 0.4)])
def test_a_speed_that_jumps(story: Story, v: float, w: float) -> None:
    story.cycles(10)
    story.now = round(story.now + 0.1, 3)
    story.said(Truth(story.now, 0, 0, 0, v, w, 0, 1.0))
    assert story.broken() == [Promise.SMOOTH]


def test_a_wall_may_stop_it_at_once(story: Story) -> None:
    story.cycles(10)
    story.now = round(story.now + 0.1, 3)
    story.said(Truth(story.now, 0, 0, 0, 0.0, 0.0, 0, 0.0))
    assert Promise.SMOOTH not in story.broken()


def test_a_winner_that_overshoots_both(story: Story) -> None:
    story.cycles(15)
    story.said(Claim("wheels", ballot(4, B), story.cycle, 0.9, False, (0.1, 0.5), (0.2, 0.1)))
    assert story.broken() == []
    story.said(Claim("wheels", ballot(5, A), story.cycle, 0.9, False, (0.1, 0.5), (0.02, 0.1)))
    assert story.broken() == [Promise.SMOOTH]


def test_a_contact_counts_once_and_not_where_the_robot_agent_was_away(story: Story) -> None:
    story.cycles(5)
    story.contact = 1
    story.cycles(5)
    assert story.broken() == [Promise.COLLISION]
    story.see(Faulted(story.now, "hang", ("robot",), began=True))
    story.contact = 2
    story.said(Truth(story.now, 0, 0, 0, story.v, 0, 2, 1.0))
    assert story.broken() == [Promise.COLLISION]


def test_a_contact_does_not_count_while_the_pose_is_wrong(story: Story) -> None:
    story.cycles(5)
    story.said(Pose(story.cycle, 0.5, 0, 0))
    story.contact = 1
    story.cycles(2)
    assert story.broken() == []


def test_a_pose_that_comes_late_is_not_wrong(story: Story) -> None:
    story.cycles(5)
    then = story.cycle
    for x in (0.1, 0.2, 0.3):
        story.number += 1
        story.said(Truth(story.now, x, 0, 0, 0.0, 0, 0, 1.0))
        story.said(story.rest())
    story.said(Pose(then, 0.0, 0, 0))
    story.said(Truth(story.now, 0.3, 0, 0, 0.0, 0, 1, 1.0))
    assert story.broken() == [Promise.COLLISION]


def touched(story: Story, clearance: float, count: int) -> None:
    story.now = round(story.now + 0.1, 3)
    story.said(Truth(story.now, 0, 0, 0, 0.0, 0, count, clearance))


def test_what_a_fault_has_brought_it_against_it_may_touch_until_it_has_got_clear(
    story: Story,
) -> None:
    story.cycles(5)
    story.see(Faulted(story.now, "hang", ("robot",), began=True))
    touched(story, 0.05, 0)
    story.see(Faulted(story.now, "hang", ("robot",), began=False))
    for _ in range(100):
        touched(story, 0.05, 0)
    touched(story, 0.0, 1)
    assert story.broken() == []
    touched(story, 0.08, 1)
    touched(story, 0.0, 2)
    assert story.broken() == [Promise.COLLISION]


def test_what_it_came_near_by_itself_it_may_not_touch(story: Story) -> None:
    story.cycles(5)
    touched(story, 0.05, 0)
    touched(story, 0.0, 1)
    assert story.broken() == [Promise.COLLISION]


@pytest.mark.parametrize(
    ("x", "y", "broken"), [(0.05, 0.0, 0), (-0.05, 0.0, 0), (0.0, 0.05, 1), (0.04, 0.04, 1)]
)
def test_odometry_that_moves_sideways(story: Story, x: float, y: float, broken: int) -> None:
    story.cycles(5)
    story.number += 1
    told = story.state(story.ballot, story.ballot, story.last)
    story.said(msgspec.structs.replace(told, x=story.x + x, y=y))
    assert story.broken() == [Promise.ODOMETRY] * broken


# Moving again -------------------------------------------------------------------------------------


def healed(story: Story) -> None:
    story.cycles(5)
    story.see(Faulted(story.now, "partition", (A,), began=True))
    story.stand(3.0)
    story.see(Faulted(story.now, "partition", (A,), began=False))


def test_it_stands_after_healing_though_somebody_bids(story: Story) -> None:
    healed(story)
    story.stand(1.9, goto=wants(0.6))
    assert story.broken() == []
    story.stand(0.3, goto=wants(0.6))
    assert story.broken() == [Promise.MOVES]


def test_it_stands_after_healing_and_every_bid_says_why(story: Story) -> None:
    healed(story)
    story.stand(2.5, goto=wants(None, "no fresh encoder/pose"), avoid=wants(None, "nothing"))
    assert story.broken() == []


def test_a_bid_that_does_not_say_why_is_one_that_is_missing(story: Story) -> None:
    healed(story)
    story.stand(2.5, goto=wants(None, ""))
    assert story.broken() == [Promise.MOVES]


@pytest.mark.parametrize(("reason", "broken"), [("the goal is near", 0), ("", 1)])
def test_who_is_obeyed_and_commands_rest_says_why(story: Story, reason: str, broken: int) -> None:
    healed(story)
    story.v = 0.0
    for _ in range(25):
        story.cycles(1)
        story.see(Bids(story.now, A, wants(0.6, reason)))
    assert story.broken() == [Promise.MOVES] * broken


def test_who_stands_back_has_longer(story: Story) -> None:
    healed(story)
    story.claim(ballot(9, B), None)
    story.stand(4.5, goto=wants(0.6))
    assert story.broken() == []
    story.stand(1.0, goto=wants(0.6))
    assert Promise.MOVES in story.broken()


def test_the_longest_time_to_move_again_is_kept(story: Story) -> None:
    healed(story)
    story.stand(1.2, goto=wants(0.6))
    story.cycles(1)
    assert story.checker.longest == pytest.approx(1.3)


def test_every_kind_says_what_it_is_and_only_the_robot_agent_voids_the_stop() -> None:
    for name, kind in KINDS.items():
        assert kind.name == name
        assert kind.meaning
        assert Promise.SILENCE not in voided(name, ("goto",))
    assert Promise.SILENCE in voided("hang", ("robot",))
