"""The checker, one promise after another, on observations made by hand."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from msgspec.structs import replace

from armadico.core.cycles import PERIOD
from armadico.core.exchange import Bid, SmoothExchange
from armadico.core.messages import (
    Ack,
    Action,
    Ballot,
    BidRecord,
    Claim,
    Command,
    Cycle,
    Message,
    RobotState,
    Stop,
)
from armadico.core.resources import WHEELS
from armadico.mobile.messages import (
    Echo,
    MissionState,
    MissionStatus,
    Pose,
    Sonar,
    Trajectory,
    Truth,
    Waypoint,
)
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.contacts import Cause
from armadico_tools.faults.fault_types import KINDS, Promise, voided
from armadico_tools.faults.monitored import Monitored
from armadico_tools.faults.observations import (
    Arrived,
    Asked,
    Bids,
    Denied,
    Faulted,
    Left,
    Obeyed,
    Observation,
    Ordered,
    Passed,
    Published,
)
from armadico_tools.faults.record import STOPS_S, Bounds

A, B = "goto-0123456789abcdef", "avoid-0123456789abcdef"


def ballot(term: int, instance: str = A) -> Ballot:
    return Ballot(term, 0.6, False, instance)


class Story:
    """Cycles of a tenth of a second, in which a robot drives by default."""

    def __init__(self, epoch: int = 1, command_delay_s: float = 0.0) -> None:
        self.checker = Checker(Bounds(command_delay_s=command_delay_s))
        self.epoch, self.number, self.now = epoch, 0, 0.0
        self.ballot: Ballot | None = ballot(3)
        self.v = 0.05
        self.obeyed_age = 1
        self.stop = Stop()
        self.contact = 0
        self.last = Cycle(epoch, 0)  # the cycle that was obeyed last
        self.order = self.talk = True
        self.x = self.driven = self.posed = 0.0
        self.publish(MissionStatus(1, MissionState.DRIVING, 3.0))

    @property
    def cycle(self) -> Cycle:
        return Cycle(self.epoch, self.number)

    def see(self, seen: Observation) -> None:
        self.checker.update(seen)

    def publish(self, message: Message) -> None:
        self.see(Published(self.now, message))

    @property
    def state(self) -> RobotState:
        return RobotState(self.cycle, self.x, 0, 0, self.v, 0, 12, True, False, self.stop)

    def publish_ack(self, largest: Ballot | None, obeyed: Ballot | None, at: Cycle | None) -> None:
        """The robot agent's two messages of a cycle."""
        self.publish(self.state)
        self.publish(Ack("wheels", self.cycle, largest, obeyed, at, 0.6, False, (self.v, 0.0)))

    def cycles(self, count: int) -> None:
        """So many cycles in which the holder commands and is obeyed."""
        for _ in range(count):
            self.now = round(self.now + 0.1, 3)
            self.number += 1
            self.publish(Truth(self.now, 0, 0, 0, self.v, 0, self.contact, 1.0))
            self.last = Cycle(self.epoch, max(self.number - self.obeyed_age, 0))
            self.publish_ack(self.ballot, self.ballot, self.last)
            if self.ballot is not None and self.talk:
                self.publish(Command("wheels", self.cycle, self.ballot, (self.v, 0.0)))
                self.claim(self.ballot)
            if self.order:
                self.see(Ordered(self.now, self.v, 0.0))

    def claim(self, ballot: Ballot, utility: float | None = 0.6, commanded: float = 0.3) -> None:
        self.publish(
            Claim("wheels", ballot, self.cycle, utility, False, (commanded, 0.0), (commanded, 0.0))
        )

    def stand(self, seconds: float, **bids: BidRecord) -> None:
        """At rest, with no command obeyed, and these bids."""
        end = self.now + seconds
        self.see(Ordered(self.now, 0.0, 0.0))
        while self.now < end:
            self.now = round(self.now + 0.1, 3)
            self.number += 1
            self.publish(Truth(self.now, 0, 0, 0, 0.0, 0, self.contact, 1.0))
            self.rest()
            for name, record in bids.items():
                self.see(Bids(self.now, f"{name}-0123456789abcdef", record))

    def rest(self) -> None:
        """A cycle at rest: what was obeyed last is long past."""
        self.publish(replace(self.state, x=0.0, v=0.0))
        self.publish(
            Ack("wheels", self.cycle, ballot(3), ballot(3), self.last, 0.6, False, (0.0, 0.0))
        )

    def broken(self) -> list[Promise]:
        return [violation.promise for violation in self.checker.violations]


@pytest.fixture
def story() -> Story:
    return Story()


def wants(utility: float | None, reason: str = "leg 1") -> BidRecord:
    return BidRecord(Cycle(1, 1), "wheels", utility, False, (), reason)


# One driver ---------------------------------------------------------------------------------------


def test_one_that_goes_down_and_up_between_two_cycles_is_seen_where_obeying_is(
    story: Story,
) -> None:
    story.cycles(10)
    for term in (3, 4, 3, 4):
        story.see(Obeyed(story.now, ballot(term), story.cycle))
    assert story.broken() == [Promise.ONE_DRIVER]


def test_the_largest_known_may_not_go_down_nor_be_below_the_obeyed(story: Story) -> None:
    story.cycles(5)
    story.publish_ack(ballot(2), ballot(3), story.cycle)
    assert story.broken() == [Promise.ONE_DRIVER] * 2


def test_a_new_epoch_begins_anew(story: Story) -> None:
    story.cycles(10)
    story.epoch, story.number, story.ballot = 2, 0, ballot(1)
    story.cycles(10)
    assert story.broken() == []


# Fresh --------------------------------------------------------------------------------------------


def test_a_robot_agent_that_obeys_what_waited_while_it_hung_is_seen(story: Story) -> None:
    story.cycles(10)
    story.see(Faulted(story.now, "hang", ("robot",), began=True))
    story.now += 1.0
    story.see(Faulted(story.now, "hang", ("robot",), began=False))
    story.see(Obeyed(story.now, ballot(3), story.cycle))
    assert Promise.FRESH in story.broken()


def test_the_acks_show_an_older_cycle_of_one_reign_after_a_newer(story: Story) -> None:
    story.cycles(10)
    story.obeyed_age = 3
    story.cycles(1)
    assert story.broken() == [Promise.FRESH]


# One holder, and a command obeyed -----------------------------------------------------------------


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


def test_it_has_moved_that_crawls_in_another_epoch(story: Story) -> None:
    healed(story)
    story.epoch, story.number, story.v = 2, 0, 0.01
    story.x = 7.0  # counted from elsewhere: no way that it has gone
    story.cycles(5)
    assert story.checker.longest is None
    story.x = 7.006
    story.cycles(25)
    assert Promise.MOVES not in story.broken()
    assert story.checker.longest is not None


def test_exchanges_one_after_another_are_one_holder_each(story: Story) -> None:
    for term in range(3, 20):
        story.ballot = ballot(term, A if term % 2 else B)
        story.cycles(3)
    assert Promise.ONE_HOLDER not in story.broken()


def test_no_command_obeyed_for_five_seconds_though_an_agent_bids(story: Story) -> None:
    story.cycles(5)
    story.stand(5.0, goto=wants(0.6))
    assert Promise.OBEYED not in story.broken()
    story.stand(1.0, goto=wants(0.6))
    assert Promise.OBEYED in story.broken()


def test_no_command_is_due_without_bids_when_stopped_or_gone(story: Story) -> None:
    story.cycles(5)
    story.stand(7.0, goto=wants(None, "no goal"))
    story.stop = Stop(1, True, "somebody")
    story.stand(7.0, goto=wants(0.6))
    story.stop = Stop(2, False, "somebody")
    story.stand(0.5, goto=wants(0.6))
    story.see(Left(story.now, A))
    story.stand(7.0)
    assert Promise.OBEYED not in story.broken()


def test_a_moment_without_a_bid_does_not_excuse(story: Story) -> None:
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


def test_speeds_that_were_not_commanded(story: Story) -> None:
    story.cycles(10)
    story.see(Ordered(story.now, 0.4, 0.0))
    assert story.broken() == [Promise.SILENCE]


@pytest.mark.parametrize(
    ("late", "cycles_on", "broken"),
    [(0.9, 0, []), (1.1, 0, [Promise.SILENCE]), (0.9, 4, [Promise.SILENCE])],
    ids=["that arrives late", "that arrives too late", "of a later cycle"],
)
def test_a_command(late: float, cycles_on: int, broken: list[Promise]) -> None:
    """A busy onlooker sees what the robot agent writes before the command that it obeys."""
    story = Story(command_delay_s=1.0)
    story.cycles(10)
    story.see(Ordered(story.now, 0.4, 0.0))
    requested = Cycle(1, story.number + cycles_on)
    arrival = story.now + late
    while story.now < arrival:
        story.cycles(1)
    story.publish(Command("wheels", requested, ballot(3), (0.4, 0.0)))
    story.cycles(3)
    assert story.broken() == broken


def test_a_robot_agent_that_repeats_the_last_command_has_not_stopped(story: Story) -> None:
    story.cycles(10)
    story.order = story.talk = False
    for _ in range(6):
        story.cycles(1)
        story.see(Ordered(story.now, story.v, 0.0))
    assert Promise.SILENCE in story.broken()


@pytest.mark.parametrize(
    ("slowed", "slower", "broken"),
    [(2, 0.02, []), (4, 0.02, []), (5, 0.02, [Promise.SILENCE]), (2, 0.0, [Promise.SILENCE])],
    ids=["once", "while it is obeyed", "for longer", "goes on as it was"],
)
def test_what_was_commanded_is_slowed_by_the_reflex(
    story: Story, slowed: int, slower: float, broken: list[Promise]
) -> None:
    """What came late, and was obeyed, is too old to have been commanded in the next cycle."""
    story.cycles(10)
    story.order = story.talk = False
    story.cycles(2)
    story.see(Ordered(story.now, story.v, 0.0))
    assert story.broken() == []
    for _ in range(slowed):
        story.cycles(1)
        story.see(Ordered(story.now, story.v - slower, 0.0))
    assert story.broken() == broken


def test_wheels_that_do_not_rest_after_rest_was_ordered(story: Story) -> None:
    story.cycles(10)
    story.see(Ordered(story.now, 0.0, 0.0))
    story.order = False
    story.cycles(29)
    assert story.broken() == []
    story.cycles(3)
    assert story.broken() == [Promise.SILENCE]


def test_without_the_robot_agent_the_guard_orders_rest_in_time(story: Story) -> None:
    story.cycles(10)
    story.see(Faulted(story.now, "crash", ("robot",), began=True))
    story.see(Ordered(story.now, 0.0, 0.0))
    at = story.now
    for tenth in range(1, 30):
        story.now = round(at + 0.1 * tenth, 3)
        story.publish(Truth(story.now, 0, 0, 0, 0.05, 0, 0, 1.0))
    assert story.broken() == []
    for tenth in range(30, 37):
        story.now = round(at + 0.1 * tenth, 3)
        story.publish(Truth(story.now, 0, 0, 0, 0.05, 0, 0, 1.0))
    assert sorted(story.broken()) == [Promise.SILENCE, Promise.WATCHDOG]


# Motion -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("v", "w"), [(0.16, 0.0), (0.05, 0.4)])
def test_a_speed_that_jumps(story: Story, v: float, w: float) -> None:
    story.cycles(10)
    story.now = round(story.now + 0.1, 3)
    story.publish(Truth(story.now, 0, 0, 0, v, w, 0, 1.0))
    assert story.broken() == [Promise.SMOOTH]


def test_a_wall_may_stop_it_at_once(story: Story) -> None:
    story.cycles(10)
    story.now = round(story.now + 0.1, 3)
    story.publish(Truth(story.now, 0, 0, 0, 0.0, 0.0, 0, 0.0))
    assert Promise.SMOOTH not in story.broken()


WANTED = (0.1, 0.5)
LOSER = (0.3, 0.0)  # as the story's holder commands, with 0.6 and 0.05 m/s measured


def begins(start: Action = LOSER, weight: float = 0.6, within: float | None = None) -> Action:
    """The first action of an agent that wants `WANTED`, with 0.9."""
    bid = Bid(0.9, WANTED, within=within)
    return SmoothExchange().begin(WHEELS, start, weight, bid, PERIOD).action(1, bid)


def swapped() -> Action:
    """As far from the winner's own as it should be from the loser's."""
    mixed = begins()
    assert not isinstance(mixed, bytes)
    return tuple(w + lo - m for w, lo, m in zip(WANTED, LOSER, mixed, strict=True))


@pytest.mark.parametrize(
    ("commanded", "broken"),
    [
        (begins(), 0),
        (begins((0.05, 0.0)), 0),  # it did not receive from the loser
        (WANTED, 1),  # not blended
        (swapped(), 1),
        (begins((0.0, 0.0)), 1),  # from rest, which is no agent's action
        ((0.02, 0.1), 1),  # beyond both
    ],
)
@pytest.mark.parametrize("winner", ["gothrough-0123456789abcdef", B])
def test_what_a_winner_commands_first_is_blended_by_the_rules(
    story: Story, winner: str, commanded: Action, broken: int
) -> None:
    story.cycles(15)
    claim = Claim("wheels", ballot(4, winner), story.cycle, 0.9, False, WANTED, commanded)
    story.publish(claim)
    assert story.broken() == [Promise.SMOOTH] * broken


@pytest.mark.parametrize(("winner", "broken"), [("gothrough-0123456789abcdef", 1), (B, 0)])
def test_a_hurried_agent_may_take_a_shorter_window(story: Story, winner: str, broken: int) -> None:
    story.cycles(15)
    story.publish(Truth(story.now, 0, 0, 0, story.v, 0, 0, 0.2))  # near to something
    shorter = begins(within=0.12)
    assert shorter != begins()
    story.publish(Claim("wheels", ballot(4, winner), story.cycle, 0.9, False, WANTED, shorter))
    assert story.broken() == [Promise.SMOOTH] * broken


@pytest.mark.parametrize(("ago_s", "broken"), [(0.2, 0), (3.0, 1)])
def test_what_sonars_that_repeat_themselves_show_may_hurry_it(
    story: Story, ago_s: float, broken: int
) -> None:
    story.see(Faulted(story.now, "frozen-sonar", ("robot",), began=True))
    story.cycles(15)
    story.see(Faulted(story.now, "frozen-sonar", ("robot",), began=False))
    story.cycles(round(ago_s / 0.1))
    story.publish(
        Claim("wheels", ballot(4, B), story.cycle, 0.9, False, WANTED, begins(within=0.12))
    )
    assert story.broken() == [Promise.SMOOTH] * broken


def test_about_to_collide_it_may_be_at_once(story: Story) -> None:
    story.cycles(15)
    story.publish(Claim("wheels", ballot(4, B), story.cycle, 0.9, True, WANTED, WANTED))
    assert story.broken() == []


# Handing over in time -----------------------------------------------------------------------------


def falls_silent(story: Story, fault: Faulted, *bidders: str) -> None:
    story.cycles(40)
    story.see(Obeyed(story.now, ballot(3), story.cycle))
    for instance in bidders:
        story.see(Bids(story.now, instance, wants(0.5)))
    story.talk = story.order = False
    story.see(replace(fault, at=story.now))


KILLED = Faulted(0.0, "crash", ("goto",), began=True)
HUNG = Faulted(0.0, "hang", ("goto",), began=True)
DEAF = Faulted(0.0, "one-way", ("goto",), began=True, to=("robot",))


@pytest.mark.parametrize(("fault", "due"), [(KILLED, 0.1), (HUNG, 0.3), (DEAF, 0.9)])
def test_a_holder_that_falls_silent_is_replaced_before_its_time(
    story: Story, fault: Faulted, due: float
) -> None:
    falls_silent(story, fault, A, B)
    for late, broken in ((due - 0.01, 0), (due + 0.01, 1)):
        at = story.now + late
        story.see(Bids(at, B, wants(0.5)))
        story.see(Passed(at))
        assert story.broken().count(Promise.HANDOVER) == broken


def test_a_holders_last_messages_may_arrive_after_it_hangs(story: Story) -> None:
    falls_silent(story, HUNG, A, B)
    story.see(Obeyed(story.now + 0.09, ballot(3), story.cycle))
    for late, broken in ((0.38, 0), (0.4, 1)):
        story.see(Bids(story.now + late, B, wants(0.5)))
        story.see(Passed(story.now + late))
        assert story.broken().count(Promise.HANDOVER) == broken


@pytest.mark.parametrize("fault", [KILLED, HUNG, DEAF])
def test_no_replacement_is_due_without_other_bids_or_after_one(
    story: Story, fault: Faulted
) -> None:
    falls_silent(story, fault, A)
    story.see(Passed(story.now + 1.0))
    other = Story()
    falls_silent(other, fault, A, B)
    other.see(Obeyed(other.now + 0.05, ballot(4, B), other.cycle))
    other.see(Bids(other.now + 1.0, B, wants(0.5)))
    other.see(Passed(other.now + 1.0))
    assert Promise.HANDOVER not in story.broken() + other.broken()


def test_an_agent_that_is_cut_off_from_the_robot_need_not_take_over(story: Story) -> None:
    cut = Faulted(0.0, "partition", ("goto", "sonar"), began=True, to=("robot",))
    falls_silent(story, cut, A, B)
    story.see(Bids(story.now + 1.0, B, wants(0.5)))
    story.see(Passed(story.now + 1.0))
    assert Promise.HANDOVER not in story.broken()


@pytest.mark.parametrize("margin", [None, 0.0, 0.1])
def test_agents_that_take_turns_are_steady_only_where_no_margin_keeps_them(
    margin: float | None,
) -> None:
    story = Story()
    story.checker = Checker(Bounds(margin=margin))
    for term in range(3, 33):
        story.ballot = ballot(term, (A, B)[term % 2])
        story.cycles(2)
    assert (Promise.STEADY in story.broken()) == (margin != 0.0)


# The stop -----------------------------------------------------------------------------------------


def stopped(story: Story, counter: int = 1) -> None:
    """A person stops it, and the robot agent publishes that."""
    story.cycles(5)
    story.stop = Stop(counter, True, "somebody")
    story.publish(story.stop)
    story.talk = story.order = False
    story.v = 0.0
    story.see(Ordered(story.now, 0.0, 0.0))
    story.cycles(5)


def test_a_stop_that_holds_until_it_is_released(story: Story) -> None:
    stopped(story)
    story.stop = Stop(2, False, "somebody")
    story.publish(story.stop)
    story.talk = story.order = True
    story.cycles(5)
    assert story.broken() == []


@pytest.mark.parametrize("restarted", [False, True])
def test_no_agent_drives_during_a_stop_under_any_fault(story: Story, restarted: bool) -> None:
    stopped(story)
    if restarted:
        story.see(Faulted(story.now, "crash", ("robot",), began=True))
        story.see(Faulted(story.now, "crash", ("robot",), began=False))
        story.epoch, story.stop = 2, Stop()
        story.cycles(1)
    story.see(Ordered(story.now, 0.05, 0.0))
    assert Promise.STOP in story.broken()


def test_a_release_of_another_stop_is_none(story: Story) -> None:
    stopped(story, counter=5)
    story.publish(Stop(6, False, "somebody", 99))
    story.see(Ordered(story.now, 0.05, 0.0))
    assert Promise.STOP in story.broken()


def test_an_old_stop_that_comes_late_is_none_and_must_not_hold(story: Story) -> None:
    old = Stop(1, True, "somebody", 7)
    story.cycles(5)
    story.publish(release := Stop(2, False, "somebody", 7))
    story.stop = release
    story.cycles(1)
    story.publish(old)
    story.cycles(5)
    assert story.broken() == []
    story.stop, story.talk, story.order, story.v = old, False, False, 0.0
    story.see(Ordered(story.now, 0.0, 0.0))
    story.cycles(13)
    assert story.broken() == [Promise.STOP]


def test_a_release_that_nobody_could_learn_of_is_lost_with_the_robot_agent() -> None:
    for cut, epoch, broken in (
        (True, 2, []),
        (True, 1, [Promise.STOP]),  # it released the stop itself
        (False, 2, [Promise.STOP]),
    ):
        story = Story()
        old = Stop(1, True, "somebody", 7)
        story.cycles(5)
        story.see(Faulted(story.now, "partition", ("robot",), began=True))
        story.publish(release := Stop(2, False, "somebody", 7))
        story.stop = release
        story.cycles(1)
        if not cut:
            story.see(Faulted(story.now, "partition", ("robot",), began=False))
            story.cycles(1)
        story.see(Faulted(story.now, "robot-restart", ("robot",), began=True))
        story.stop, story.order, story.talk, story.v = old, False, False, 0.0
        story.epoch = epoch
        story.see(Ordered(story.now, 0.0, 0.0))
        story.see(Faulted(story.now, "robot-restart", ("robot",), began=False))
        if cut:
            story.see(Faulted(story.now, "partition", ("robot",), began=False))
        story.cycles(13)
        assert story.broken() == broken


def test_a_stop_that_is_forgotten(story: Story) -> None:
    stopped(story)
    story.stop = Stop()
    story.cycles(9)
    assert story.broken() == []
    story.cycles(3)
    assert story.broken() == [Promise.STOP]


def test_a_stop_that_is_published_and_not_latched(story: Story) -> None:
    story.cycles(5)
    story.publish(Stop(1, True, "somebody"))
    story.cycles(2)
    assert story.broken() == []
    story.cycles(2)
    assert story.broken() == [Promise.STOP]


def test_wheels_that_do_not_rest_after_the_stop(story: Story) -> None:
    story.cycles(5)
    story.stop = Stop(1, True, "somebody")
    story.talk = story.order = False
    story.cycles(30)
    assert Promise.STOP not in story.broken()
    story.cycles(2)
    assert Promise.STOP in story.broken()


# The pose -----------------------------------------------------------------------------------------


def drives(story: Story, metres: float, posed: float | None = None) -> None:
    """So far ahead in a second; the pose went `posed` (default: as far)."""
    for step in range(1, 11):
        story.now = round(story.now + 0.1, 3)
        story.number += 1
        story.driven += metres / 10
        story.posed += (metres if posed is None else posed) / 10
        story.publish(Truth(story.now, story.driven, 0, 0, 0.0, 0, 0, 1.0))
        story.rest()
        story.publish(Pose(story.cycle, story.posed, 0, 0))
        del step


def test_a_pose_that_goes_wrong_by_itself(story: Story) -> None:
    drives(story, 0.5)
    assert story.broken() == []
    drives(story, 0.5, 0.6)
    assert story.broken() == [Promise.POSE]


@pytest.mark.parametrize(
    ("kind", "off", "broken"),
    [("serial-loss", 0.3, 0), ("serial-loss", 0.5, 1), ("crash", 0.0, 0), ("crash", 0.3, 1)],
)
def test_it_is_off_by_what_rolled_while_the_line_was_broken_not_the_robot_agent(
    story: Story, kind: str, off: float, broken: int
) -> None:
    drives(story, 0.5)
    story.see(Faulted(story.now, kind, ("robot",), began=True))
    for _ in range(10):
        story.now = round(story.now + 0.1, 3)
        story.driven += 0.03
        story.publish(Truth(story.now, story.driven, 0, 0, 0.0, 0, 0, 1.0))
    story.see(Faulted(story.now, kind, ("robot",), began=False))
    story.epoch, story.number, story.posed = 2, 0, story.driven - off
    story.last = Cycle(2, 0)
    drives(story, 0.1)
    assert story.broken() == [Promise.POSE] * broken


def test_tyres_slip_where_it_touches_something(story: Story) -> None:
    drives(story, 0.5)
    for clearance in (0.01, 0.0):
        story.now = round(story.now + 0.1, 3)
        story.publish(Truth(story.now, story.driven, 0, 0, 0.0, 0, 0, clearance))
    drives(story, 0.0, 0.1)
    assert story.broken() == []


def test_a_gap_that_no_fault_explains_is_no_excuse(story: Story) -> None:
    drives(story, 0.5)
    story.now, story.driven = story.now + 1.0, story.driven + 0.3
    story.publish(Truth(story.now, story.driven, 0, 0, 0.0, 0, 0, 1.0))
    drives(story, 0.1)
    assert story.broken() == [Promise.POSE]


def drives_with_pose(story: Story, seconds: int, *, off: float, std: float, v: float = 0.2) -> None:
    """Drive with a pose that is `off`, with a standard deviation of `std`."""
    for _ in range(10 * seconds):
        story.now = round(story.now + 0.1, 3)
        story.number += 1
        story.driven += 0.1 * v
        story.publish(Truth(story.now, story.driven, 0, 0, v, 0, 0, 1.0))
        story.v = v
        story.rest()
        covariance = (std**2, 0.0, 0.0, 0.0, 0.0, 0.01**2)
        anew = round(10 * off)  # the map moved: no jump
        story.publish(Pose(story.cycle, story.driven + off, 0, 0, covariance, revision=anew))


def posed(story: Story) -> list[Promise]:
    return [promise for promise in story.broken() if promise is Promise.POSE]


@pytest.mark.parametrize(
    ("off", "std", "v", "broken"),
    [
        (0.5, 0.05, 0.2, 1),  # 3 x 0.05 + 0.15 m, and 0.25 s of 0.2 m/s
        (0.34, 0.05, 0.2, 0),
        (0.5, 0.15, 0.2, 0),  # within its covariance
        (5.0, 0.6, 0.2, 0),  # it is reported as lost
        (5.0, 0.05, 0.0, 0),  # a standing robot does no harm by it
    ],
)
def test_a_pose_may_be_off_within_its_covariance(
    story: Story, off: float, std: float, v: float, broken: int
) -> None:
    drives_with_pose(story, 20, off=off, std=std, v=v)
    assert posed(story) == [Promise.POSE] * broken, "once, however long"


def test_a_pose_may_be_wrong_and_unsaid_for_five_seconds_of_driving(story: Story) -> None:
    for _ in range(3):  # each begins anew
        drives_with_pose(story, 4, off=1.0, std=0.05)
        drives_with_pose(story, 1, off=1.0, std=0.6)
        drives_with_pose(story, 4, off=1.0, std=0.05)
        drives_with_pose(story, 1, off=0.0, std=0.05)
    assert posed(story) == []
    assert story.checker.overconfident_s == pytest.approx(4.0, abs=0.2)
    drives_with_pose(story, 6, off=1.0, std=0.05)
    assert posed(story) == [Promise.POSE]


def test_wheels_that_are_made_to_count_wrong_may_have_a_pose_off_by_that(story: Story) -> None:
    story.checker = Checker(Bounds(way_error=0.2))
    drives(story, 1.0, 0.9)
    assert posed(story) == []
    drives(story, 1.0, 0.5)
    assert posed(story) == [Promise.POSE]


# Arriving -----------------------------------------------------------------------------------------


def test_a_fault_takes_no_time_of_a_mission(story: Story) -> None:
    story.publish(Trajectory(1, 1, (Waypoint(0.1, 0.0, 0.0),)))
    story.publish(Pose(story.cycle, 0.0, 0.0, 0.0))
    story.cycles(100)
    story.see(Faulted(story.now, "delay", (A,), began=True))
    story.cycles(300)
    story.see(Faulted(story.now, "delay", (A,), began=False))
    assert story.broken() == []
    story.cycles(210)
    assert story.broken() == [Promise.ARRIVES]


def test_one_that_is_reached_need_not_be_reached_again(story: Story) -> None:
    story.cycles(100)
    story.publish(MissionStatus(1, MissionState.REACHED, 0.0))
    story.claim(ballot(3), utility=None)  # whoever keeps the wheels breaks another promise
    story.stand(100.0)
    assert story.broken() == []


@pytest.mark.parametrize(("for_s", "broken"), [(1.9, []), (2.2, [Promise.ARRIVES])])
def test_a_mission_is_not_forgotten(story: Story, for_s: float, broken: list[Promise]) -> None:
    story.cycles(20)
    story.publish(MissionStatus(1, MissionState.DRIVING, 3.0))
    forgets(story, for_s)
    assert story.broken() == broken


def forgets(story: Story, for_s: float) -> None:
    """Report for some time that there is no mission."""
    for _ in range(round(10 * for_s)):
        story.publish(MissionStatus(0, MissionState.NONE, 0.0))
        story.cycles(1)


@pytest.mark.parametrize(("accepted", "broken"), [(False, []), (True, [Promise.ARRIVES])])
def test_a_mission_of_a_broken_network_counts_once_its_client_knows_that_it_is_accepted(
    story: Story, accepted: bool, broken: list[Promise]
) -> None:
    story.cycles(20)
    story.see(Faulted(story.now, "one-way", ("interface",), began=True, to=("robot",)))
    if accepted:
        story.see(Asked(story.now, 2, Waypoint(1.0, 0.0, 0.0)))
    story.publish(MissionStatus(2, MissionState.DRIVING, 1.0))
    story.see(Faulted(story.now, "one-way", ("interface",), began=False, to=("robot",)))
    forgets(story, 2.2)
    assert story.broken() == broken


def test_a_contact_counts_once_also_without_the_robot_agent(story: Story) -> None:
    story.cycles(5)
    story.contact = 1
    story.cycles(5)
    assert story.broken() == [Promise.COLLISION]
    story.see(Faulted(story.now, "hang", ("robot",), began=True))
    story.contact = 2
    story.publish(Truth(story.now, 0, 0, 0, story.v, 0, 2, 1.0))
    assert story.broken() == [Promise.COLLISION] * 2


def test_the_monitors_auditor_finds_by_messages_and_knows_no_truth(story: Story) -> None:
    story.checker = Monitored()
    story.cycles(10)
    story.contact = 1
    story.cycles(1)
    assert story.broken() == []
    story.ballot = ballot(2)
    story.cycles(1)
    assert Promise.ONE_DRIVER in story.broken()


WALL = ((1.0, -2.0, 1.0, 2.0),)


@pytest.mark.parametrize(
    ("far", "frozen", "why"),
    [
        (lambda x: 1.0 - x, False, ""),
        (lambda _: None, False, Cause.MUTE.value),
        (lambda _: None, True, Cause.FALSE.value),
    ],
)
def test_a_contact_counts_unless_no_sensor_could_have_known(
    far: Callable[[float], float | None], frozen: bool, why: str
) -> None:
    checker = Checker(Bounds(walls=WALL))
    checker.update(Published(0.0, Truth(0.0, 0, 0, 0, 0.3, 0, 0, 0.75)))
    if frozen:
        checker.update(Faulted(0.0, "frozen-sonar", ("robot",), began=True))
    for number in range(26):
        now, x = 0.1 * number, 0.03 * number
        near = max(0.75 - x, 0.0)
        checker.update(Published(now, Truth(now, x, 0, 0, 0.3, 0, int(near == 0.0), near)))
        echo = Echo(0.0, 0.0, 0.0, far(x))
        checker.update(Published(now, Sonar(Cycle(1, number), 5.0, (echo,))))
    assert checker.contacts == {why: 1}
    broken = [violation.promise for violation in checker.violations]
    assert broken.count(Promise.COLLISION) == (why == "")


def test_what_is_not_a_wall_counts_as_seen() -> None:
    checker = Checker(Bounds(walls=WALL))
    for count in (0, 1):
        checker.update(Published(0.1 * count, Truth(0.1 * count, 0, 0, 0, 0.3, 0, count, 0.0)))
    assert checker.contacts == {"": 1}


def test_a_wrong_pose_excuses_no_contact(story: Story) -> None:
    story.cycles(5)
    story.publish(Pose(story.cycle, 0.5, 0, 0))
    story.contact = 1
    story.cycles(2)
    assert story.broken() == [Promise.POSE, Promise.COLLISION]


def test_a_pose_that_comes_late_is_not_wrong(story: Story) -> None:
    story.cycles(5)
    then = story.cycle
    for x in (0.1, 0.2, 0.3):
        story.number += 1
        story.publish(Truth(story.now, x, 0, 0, 0.0, 0, 0, 1.0))
        story.rest()
    story.publish(Pose(then, 0.0, 0, 0))
    story.publish(Truth(story.now, 0.3, 0, 0, 0.0, 0, 1, 1.0))
    assert story.broken() == [Promise.COLLISION]


def test_where_there_is_nothing_to_touch_no_time_is_counted(story: Story) -> None:
    for number in range(10):
        story.publish(Truth(0.1 * number, 0, 0, 0, 0.3, 0, 0, None))
    assert story.checker.moving_s == {}


LOSES = Faulted(0.0, "serial-loss", ("robot",), began=True, amount=0.5)


def test_moving_time_is_counted_by_why_the_robot_cannot_act(story: Story) -> None:
    story.cycles(11)
    story.see(Arrived(story.now))
    story.see(LOSES)
    for _ in range(20):  # some orders arrive: it can act
        story.cycles(1)
        story.see(Arrived(story.now))
    assert story.checker.moving_s == pytest.approx({"": 3.0})
    story.cycles(20)  # none does, and none would have changed anything
    assert story.checker.moving_s == pytest.approx({"": 5.0})
    story.see(Arrived(story.now))
    story.order = False
    for _ in range(10):
        story.cycles(1)
        story.see(Ordered(story.now, 0.0, 0.0))
    waits = STOPS_S + 0.1
    assert story.checker.moving_s == pytest.approx({"": 5.0 + waits, "serial line": 1.0 - waits})


@pytest.mark.parametrize(("v", "counts"), [(0.0, 0), (0.05, 1)])
def test_a_lossy_line_excuses_a_contact_only_if_it_lost_the_braking(
    story: Story, v: float, counts: int
) -> None:
    story.cycles(11)
    story.see(Arrived(story.now))
    story.see(LOSES)
    story.order = False
    for _ in range(6):
        story.cycles(1)
        story.see(Ordered(story.now, v, 0.0))
    story.contact = 1
    story.cycles(1)
    assert story.broken().count(Promise.COLLISION) == counts


@pytest.mark.parametrize(
    ("kind", "amount", "void"),
    [
        *[("serial-loss", 0.1, False), ("serial-loss", 0.3, True)],
        *[("serial-garbage", 0.1, False), ("serial-garbage", 0.3, True)],
    ],
)
def test_a_little_of_a_fault_is_no_excuse(kind: str, amount: float, void: bool) -> None:
    assert (Promise.COLLISION in voided(kind, amount)) is void
    assert voided(kind)[Promise.COLLISION]


def touched(story: Story, clearance: float, count: int) -> None:
    story.now = round(story.now + 0.1, 3)
    story.publish(Truth(story.now, 0, 0, 0, 0.0, 0, count, clearance))


@pytest.mark.parametrize(
    ("clearance", "later", "broken"), [(0.3, 0.0, 0), (0.3, 1.4, 1), (0.5, 0.0, 1)]
)
def test_what_it_could_have_stopped_for_after_a_fault_is_its_own_doing(
    story: Story, clearance: float, later: float, broken: int
) -> None:
    story.cycles(5)
    story.see(Ordered(story.now, 0.0, 0.0))
    story.see(LOSES)
    # From 0.3 m/s: 0.24 m until it has listened and braked, 0.08 m of ramp, 0.1 m for its corners.
    story.publish(Truth(story.now, 0, 0, 0, 0.3, 0, 0, clearance))
    story.see(replace(LOSES, began=False))
    story.now += later
    touched(story, 0.0, 1)
    assert story.broken() == [Promise.COLLISION] * broken


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
    story.publish(replace(story.state, x=story.x + x, y=y))
    assert story.broken() == [Promise.ODOMETRY] * broken


# Moving again -------------------------------------------------------------------------------------


def healed(story: Story) -> None:
    story.cycles(5)
    story.see(Faulted(story.now, "partition", (A,), began=True))
    story.stand(3.0)
    story.see(Faulted(story.now, "partition", (A,), began=False))


def test_it_stands_after_healing_though_an_agent_bids(story: Story) -> None:
    healed(story)
    story.stand(1.9, goto=wants(0.6))
    assert story.broken() == []
    story.stand(0.3, goto=wants(0.6))
    assert story.broken() == [Promise.MOVES]


def test_it_stands_after_healing_and_every_bid_has_a_reason(story: Story) -> None:
    healed(story)
    story.stand(2.5, goto=wants(None, "no fresh encoder/pose"), avoid=wants(None, "nothing"))
    assert story.broken() == []


def test_a_bid_without_a_reason_counts_as_missing(story: Story) -> None:
    healed(story)
    story.stand(2.5, goto=wants(None, ""))
    assert story.broken() == [Promise.MOVES]


@pytest.mark.parametrize(("reason", "broken"), [("the goal is near", 0), ("", 1)])
def test_an_obeyed_agent_that_commands_rest_has_a_reason(
    story: Story, reason: str, broken: int
) -> None:
    healed(story)
    story.v = 0.0
    for _ in range(25):
        story.cycles(1)
        story.see(Bids(story.now, A, wants(0.6, reason)))
    assert story.broken() == [Promise.MOVES] * broken


def test_it_need_not_move_while_no_sonar_fires_and_has_its_time_afterwards(story: Story) -> None:
    healed(story)
    story.see(Faulted(story.now, "silent-sonar", ("robot",), began=True))
    story.stand(4.0, goto=wants(None, "no fresh sonar/obstacles"))
    story.see(Faulted(story.now, "silent-sonar", ("robot",), began=False))
    story.stand(1.9, goto=wants(0.6))
    assert story.broken() == []
    story.stand(0.3, goto=wants(0.6))
    assert story.broken() == [Promise.MOVES]


def test_it_moves_again_after_the_stop_is_released(story: Story) -> None:
    story.cycles(5)
    for counter, seconds in ((1, 3.0), (2, 1.9)):
        story.stop = Stop(counter, counter == 1, "somebody", 7)
        story.publish(story.stop)
        story.stand(seconds, goto=wants(0.6))
        assert story.broken() == []
    story.stand(0.3, goto=wants(0.6))
    assert story.broken() == [Promise.MOVES]


def test_a_holder_that_stands_back_has_longer(story: Story) -> None:
    healed(story)
    story.claim(ballot(9, B), None)
    story.stand(4.5, goto=wants(0.6))
    assert story.broken() == []
    story.stand(1.0, goto=wants(0.6))
    assert Promise.MOVES in story.broken()


@pytest.mark.parametrize(
    ("utility", "whole_s", "longer"), [(0.6, 0.0, True), (None, 0.0, False), (0.6, 1.5, False)]
)
def test_a_holder_that_releases_while_obeyed_stands_back_if_it_bids_on(
    story: Story, utility: float | None, whole_s: float, longer: bool
) -> None:
    story.cycles(5)
    story.see(Faulted(story.now, "delay", (A,), began=True))
    story.v = 0.0
    story.cycles(10)
    story.see(Faulted(story.now, "delay", (A,), began=False))
    story.cycles(1 + round(whole_s / 0.1))
    story.see(Bids(story.now, A, wants(utility)))
    story.claim(ballot(3), None)
    story.stand(2.5 - whole_s, goto=wants(0.6))
    assert (Promise.MOVES not in story.broken()) == longer


@pytest.mark.parametrize(("alone", "broken"), [(True, []), (False, [Promise.MOVES])])
def test_whose_bids_were_nonsense_stands_back_from_then_on_unless_another_bids(
    story: Story, alone: bool, broken: list[Promise]
) -> None:
    healed(story)
    story.see(Faulted(story.now, "nan", ("goto",), began=True))
    story.stand(1.8, goto=wants(1.0))
    if not alone:
        story.see(Bids(story.now, B, wants(0.5)))
    story.see(Bids(story.now, A, wants(1.0)))
    story.claim(ballot(9), None)
    story.see(Faulted(story.now, "nan", ("goto",), began=False))
    story.stand(4.5, goto=wants(0.6))
    assert [broken for broken in story.broken() if broken is Promise.MOVES] == broken
    story.stand(1.0, goto=wants(0.6))
    assert Promise.MOVES in story.broken()


@pytest.mark.parametrize(("holds_s", "broken"), [(0.5, []), (1.5, [Promise.MOVES])])
def test_others_wait_until_nonsense_that_holds_is_let_go_of(
    story: Story, holds_s: float, broken: list[Promise]
) -> None:
    healed(story)
    story.see(Faulted(story.now, "nan", ("goto",), began=True))
    story.stand(1.8, goto=wants(1.0), avoid=wants(0.5))
    for _ in range(round(holds_s / 0.1)):
        story.claim(ballot(9))
        story.stand(0.1, goto=wants(1.0), avoid=wants(0.5))
    story.claim(ballot(9), None)
    assert [promise for promise in story.broken() if promise is Promise.MOVES] == broken


@pytest.mark.parametrize(("instance", "broken"), [("robot", []), ("sonar", [Promise.MOVES])])
def test_a_robot_agent_that_another_was_in_the_way_of_is_there_a_second_later(
    story: Story, instance: str, broken: list[Promise]
) -> None:
    story.cycles(5)
    story.see(Faulted(story.now, "two-robot-agents", ("robot",), began=True))
    story.see(Ordered(story.now, 0.0, 0.0))
    story.now = round(story.now + 2.0, 3)
    story.see(Denied(story.now, f"{instance}-0123456789abcdef", "another is alive already"))
    story.see(Faulted(story.now, "two-robot-agents", ("robot",), began=False))
    story.stand(2.9, goto=wants(0.6))
    assert story.broken() == broken
    story.stand(0.3, goto=wants(0.6))
    assert story.broken() == [Promise.MOVES]


def test_the_longest_time_to_move_again_is_kept(story: Story) -> None:
    healed(story)
    story.stand(1.2, goto=wants(0.6))
    story.cycles(1)
    assert story.checker.longest == pytest.approx(1.3)


def test_every_kind_has_a_meaning_and_none_voids_the_stop() -> None:
    for name, kind in KINDS.items():
        assert kind.name == name
        assert kind.meaning
        assert Promise.SILENCE not in voided(name)
