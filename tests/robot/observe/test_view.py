"""A view of a society: live agents, the driving agent, claims, and rates."""

from __future__ import annotations

import pytest

from armadico.core import messages as m
from armadico.core.services import QUIET_S
from armadico.mobile.messages import Correction, Pose, Truth
from armadico.observe.described import resource
from armadico.observe.view import FRESH_CYCLES, Rate, View, driver, speed

GOTO, AVOID = "goto-0123456789abcdef", "avoid-0123456789abcdef"
BALLOT = m.Ballot(1, 0.5, False, "path-planning-0123456789abcdef")


def card(instance: str, *resources: str, owns: tuple[str, ...] = ()) -> m.Card:
    name = instance.rpartition("-")[0]
    return m.Card(name, instance, "here", 1, "1", m.PROTOCOL, (), (), resources, owns=owns)


def ack(number: int, by: str | None, resource: str = "wheels") -> m.Ack:
    ballot = None if by is None else m.Ballot(1, 0.5, False, by)
    cycle = m.Cycle(1, number)
    return m.Ack(resource, cycle, ballot, ballot, None if by is None else cycle)


def described(controller: str) -> m.Description:
    return m.Description(
        "slim", 0.1, 0.3, 0.1, 0.08, 1.2, 5.2, 0.3, 0.3, 1.7, 1.7, 0.3, 2.0, controller
    )


def claim(by: str, term: int = 1, utility: float | None = 0.6) -> m.Claim:
    return m.Claim("wheels", m.Ballot(term, 0.6, False, by), m.Cycle(1, 1), utility)


def test_two_publishers_of_a_state_and_two_simulators_are_detected() -> None:
    view = View()
    for digit in "12":
        instance = f"encoder-{digit * 16}"
        view.token(instance, there=True, t=0.0)
        keys = ("encoder/pose", "path/plan", "trajectory")  # a state, a query, a latched one
        view.learn(m.Card("encoder", instance, "here", 1, "1", m.PROTOCOL, keys, (), ()), 0.0)
        assert not view.strangers(0.0)
        view.learn(Truth(0, 0, 0, 0, 0, 0, 0, None, f"sim-{digit}"), 0.0)
    assert view.doubled == {"encoder/pose": ["encoder-" + "1" * 16, "encoder-" + "2" * 16]}
    assert view.strangers(0.0) == ["sim-1", "sim-2"]
    assert view.truth is None


def test_two_simulators_with_the_robots_own_id_are_strangers_and_one_that_restarted_is_not() -> (
    None
):
    view = View()
    view.learn(described("sim"), 0.0)
    for t in (7.0, 0.1, 0.2):
        view.learn(Truth(t, 0, 0, 0, 0, 0, 0, None, "sim"), t)
    assert not view.strangers(0.3)
    for t in (0.3, 0.4, 0.5):
        view.learn(Truth(t, 0, 0, 0, 0, 0, 0, None, "sim"), t)
        view.learn(Truth(t + 5.0, 0, 0, 0, 0, 0, 0, None, "sim"), t)
    assert view.strangers(0.6) == ["sim"]


@pytest.mark.parametrize("is_described", [False, True], ids=["unknown", "nameless"])
def test_a_truth_without_a_name_is_ignored(is_described: bool) -> None:
    """Otherwise a simulator left in the namespace would count for any robot without a name."""
    view = View()
    for _ in range(2):
        if is_described:
            view.learn(described(""), 0.0)
        view.learn(Truth(0, 50.0, 0, 0, 0, 0, 0, None), 0.0)
        assert view.truth is None
    assert view.strangers(0.0) == ([""] if is_described else [])


# The pose -----------------------------------------------------------------------------------------


def test_the_robot_is_lost_as_long_as_its_pose_is_too_uncertain() -> None:
    view = View()
    assert view.pose_text(0.0) == ""
    view.learn(Pose(m.Cycle(1, 1), 1.0, 2.0, 0.0), 0.0)
    assert view.pose_text(0.0) == "", "odometry alone has no covariance"
    for number, wide in ((2, 0.01), (3, 1.0), (4, 2.0)):
        view.learn(Pose(m.Cycle(1, number), 1, 2, 0, (wide, 0, 0, 0, 0, 0.01)), float(number))
    assert view.lost_since == 3.0
    assert view.pose_text(15.2) == "LOST for 12 s, +-1.41 m"
    view.learn(Pose(m.Cycle(1, 5), 1, 2, 0, (0.01, 0, 0, 0, 0, 0.01)), 16.0)
    assert view.lost_since is None
    view.learn(Correction(m.Cycle(1, 5), 0, 0, 0, (0.0,) * 6, 1.0, off_map=True), 16.0)
    assert view.pose_text(16.0) == "off the map, +-0.10 m, +-6 deg"
    view.learn(Correction(m.Cycle(1, 6), 0, 0, 0, (0.0,) * 6, 1.0), 17.0)
    assert view.pose_text(17.0) == "+-0.10 m, +-6 deg, confidence 1.00"
    assert view.pose_text(29.0) == "+-0.10 m, +-6 deg, by the wheels alone for 12 s"


def test_confidence_is_that_of_a_fresh_correction() -> None:
    view = View()
    assert view.confidence(0.0) is None
    view.learn(Correction(m.Cycle(1, 1), 0, 0, 0, (0.0,) * 6, 0.9), 1.0)
    assert view.confidence(1.0 + QUIET_S) == 0.9
    assert view.confidence(1.1 + QUIET_S) is None


# Resources ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("obeyed", "at", "expected"),
    [
        (BALLOT, m.Cycle(1, 9), BALLOT.instance),
        (BALLOT, m.Cycle(1, 10 - FRESH_CYCLES), BALLOT.instance),
        (BALLOT, m.Cycle(1, 9 - FRESH_CYCLES), None),
        (BALLOT, m.Cycle(2, 9), None),  # in another epoch
        (None, m.Cycle(1, 9), None),  # released
        (None, None, None),
    ],
)
def test_the_driver_is_the_instance_obeyed_recently(
    obeyed: m.Ballot | None, at: m.Cycle | None, expected: str | None
) -> None:
    last = m.Ack("wheels", m.Cycle(1, 10), BALLOT, obeyed, at)
    assert driver(last) == expected
    view = View()
    view.learn(last, 5.0)
    assert view.driver("wheels", 5.1) == expected
    assert view.driver("arm", 5.1) is None
    assert view.last_driver("wheels") == ("" if obeyed is None else BALLOT.instance)


def test_an_exchange_has_the_claim_of_the_new_holder() -> None:
    view = View()
    for number, by in enumerate((GOTO, GOTO, AVOID, None), 1):
        if by is not None:
            view.learn(claim(by, term=number), float(number))
        view.learn(ack(number, by), float(number))
    found = [(each.at, each.before, each.now) for each in view.exchanges]
    assert found == [(1.0, None, GOTO), (3.0, GOTO, AVOID), (4.0, AVOID, None)]
    assert view.exchanges[1].claim == claim(AVOID, term=3)
    assert view.exchanges[2].claim is None


def test_a_stop_is_not_known_without_fresh_messages() -> None:
    view = View()
    assert view.stopped(0.0) is None
    stop = m.Stop(1, True, "me")
    view.learn(m.RobotState(m.Cycle(1, 1), 0, 0, 0, 0, 0, 12.5, True, False, stop), 1.0)
    assert view.stopped(1.0 + QUIET_S) is True
    assert view.stopped(1.1 + QUIET_S) is None
    assert view.stop == stop, "the last one received"


def test_an_owner_with_long_cycles_does_not_time_out_between_them() -> None:
    view = View()
    for number, t in ((1, 1.0), (2, 2.0), (4, 4.0)):  # the third was lost
        view.learn(ack(number, GOTO, "task"), t)
    assert view.driver("task", 6.9) == GOTO
    assert view.driver("task", 7.1) is None
    restarted = m.Ack("task", m.Cycle(2, 1), BALLOT, BALLOT, m.Cycle(2, 1))
    view.learn(restarted, 100.0)
    assert view.driver("task", 100.1 + QUIET_S) is None, "a new epoch has no period yet"


def test_the_valid_claim_has_the_largest_ballot_until_it_expires_or_is_released() -> None:
    view = View()
    view.learn(claim(GOTO, 2), 0.0)
    view.learn(claim(AVOID), 0.1)
    assert view.claim("wheels", 0.2) == claim(GOTO, 2)
    assert view.claim("wheels", 1.0) is None
    view.learn(claim(AVOID), 1.0)
    assert view.claim("wheels", 1.0) == claim(AVOID)
    view.learn(claim(GOTO, 2), 1.1)
    view.learn(claim(GOTO, 2, None), 1.2)
    view.learn(claim(AVOID), 1.3)
    assert view.claim("wheels", 1.3) is None, "it is delayed, and was beaten"


# Agents -------------------------------------------------------------------------------------------


def test_tokens_show_live_agents_and_cards_describe_them() -> None:
    view = View()
    assert not view.complete
    assert view.token(GOTO, there=True, t=1.0)
    assert not view.token(GOTO, there=True, t=2.0)  # liveliness may report it twice
    assert view.alive == {GOTO: 1.0}
    view.learn(card(AVOID, "arm"), 2.0)
    assert view.agents == [("goto", GOTO, None)], "a card is no token"
    view.learn(card(GOTO, "wheels", owns=("lamp",)), 2.0)
    assert view.complete
    assert view.token(AVOID, there=True, t=3.0)
    assert [agent.instance for agent in view.agents] == [AVOID, GOTO]
    assert view.names == {"avoid", "goto"}
    assert view.resources == ["arm", "lamp", "wheels"]
    (contender,) = resource(view, "wheels", 3.0)["contenders"]
    assert contender["name"] == "goto"
    assert view.token(GOTO, there=False, t=4.0)
    assert not view.token(GOTO, there=False, t=4.0)
    assert resource(view, "wheels", 4.0)["contenders"] == []
    assert view.cards[GOTO].host == "here", "the card is kept"


# Messages and rates -------------------------------------------------------------------------------


def test_publications_count_for_the_rate_of_their_key_and_replies_do_not() -> None:
    view = View()
    view.update("encoder/pose", Pose(m.Cycle(1, 1), 1.0, 0.0, 0.0), 1.0)
    view.update("encoder/pose", None, 1.1)  # it could not be decoded
    view.learn(card(GOTO), 1.1)
    assert {key: rate.count for key, rate in view.rates.items()} == {"encoder/pose": 2}
    assert view.rates["encoder/pose"].hz(1.1) == pytest.approx(10.0)
    assert view.pose is not None


def test_the_rate_falls_during_a_pause_and_counts_missed_deadlines() -> None:
    rate = Rate(deadline_s=0.3)
    for n in range(11):
        rate.add(n / 10)
    assert rate.hz(1.0) == pytest.approx(10.0)
    assert rate.missed == 0
    assert rate.hz(3.0) == pytest.approx(10 / 3)  # the pause counts
    assert rate.hz(60.0) == 0.0
    assert rate.missed == 1  # one pause, however often the rate is computed
    rate.add(61.0)
    rate.add(62.0)
    assert rate.missed == 2


@pytest.mark.parametrize(
    ("admitted", "capped", "shown"),
    [
        (0.25, "something is sensed ahead", "admits 0.25: something is sensed ahead"),
        (0.25, "", "admits 0.25: no reason given"),
        (0.5, "", "0.25 m/s (goto orders 0.50 m/s)"),
    ],
)
def test_half_the_ordered_speed_is_shown_with_its_reason_or_without_one(
    admitted: float, capped: str, shown: str
) -> None:
    state = m.RobotState(
        *(m.Cycle(1, 1), 0, 0, 0, 0.25, 0.0, 12.5, True, False),
        ordered=m.Twist(0.5, 0.0),
        admitted=m.Twist(admitted, 0.0),
        capped=capped,
        driver="goto-1",
    )
    assert shown in speed(state)
