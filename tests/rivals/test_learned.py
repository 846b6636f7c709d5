"""Learned utilities replace those of ordinary bids alone, within bounds, and ballots decide."""

from __future__ import annotations

import pytest

from armadico.agents.driving.goto import Goto, Parameters
from armadico.agents.rivals.learned import (
    FEATURES,
    FORCED,
    LEARNED,
    LEAST,
    MOST,
    PARKS_M,
    PERIOD,
    explored,
    judged,
)
from armadico.config.loading import load_parameters
from armadico.config.parameters import load_set
from armadico.config.scenarios import ideal, load_scenario
from armadico.core.agent import Identity
from armadico.core.config_errors import ConfigError
from armadico.core.cycles import CycleClock
from armadico.core.discovery import agent_class
from armadico.core.exchange import Bid
from armadico.core.messages import Cycle, Description, RobotState
from armadico.core.parameters import Social
from armadico.core.resources import WHEELS
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Pose, Trajectory, Waypoint
from armadico.mobile.obstacles import Obstacles
from armadico.observe.measures import Result
from tests.rivals.test_features import ROBOT

NOW = Cycle(1, 1)
FAST = (0.5, 0.0)


def weights(**of: float) -> tuple[float, ...]:
    """Weights by the names of features; the others are 0."""
    assert {*of} <= {*FEATURES}
    return tuple(of.get(name, 0.0) for name in FEATURES)


def goto(utility: tuple[float, ...], left: float = 5.0) -> Goto:
    """An agent on its way along x, with so much of it left, m, and nothing near."""
    agent = Goto(Identity("goto-1"), Parameters(social=Social(utility=utility)))
    agent.on_description(ROBOT)
    goal = Waypoint(left, 0.0, 0.0)
    agent.on_trajectory(Trajectory(1, 1, (goal,)))
    agent.kernel.newest |= {
        Description: ROBOT,
        RobotState: RobotState(NOW, 0.0, 0.0, 0.0, 0.3, 0.0, 12.0, motors=True, stalled=False),
        Pose: Pose(NOW, 0.0, 0.0, 0.0),
        Obstacles: Obstacles(NOW, None, None, None, None),
    }
    return agent


def test_a_bid_that_saves_more_time_gets_a_larger_utility_within_bounds() -> None:
    agent = goto(weights(progress=4.0, facing=-1.0))
    utilities = [judged(agent, Bid(0.6, (v, 0.0))).utility for v in (-9.0, 0.1, 0.3, 0.5, 9.0)]
    assert utilities == sorted(utilities)
    assert (utilities[0], utilities[-1]) == (LEAST, MOST)
    assert LEAST < utilities[1] < utilities[2] < utilities[3] < MOST


@pytest.mark.parametrize(
    "bid",
    [Bid(0.7, FAST, critical=True), Bid(0.0, FAST), Bid(1.0, FAST)],
    ids=["critical", "offers", "largest"],
)
def test_critical_bids_offers_and_the_largest_bid_stay_as_they_are(bid: Bid) -> None:
    agent = goto(weights(one=9.0))
    assert judged(agent, bid) == explored(agent, bid, NOW) == bid


def test_where_the_robot_parks_and_without_weights_an_agents_own_utility_counts() -> None:
    bid = Bid(0.6, FAST)
    assert judged(goto(weights(one=9.0)), bid).utility == MOST
    assert judged(goto(weights(one=9.0), left=0.9 * PARKS_M), bid) == bid
    assert judged(goto(()), bid) == bid


def test_exploring_draws_an_utility_for_seconds_and_leaves_the_others_alone() -> None:
    agent, bid = goto(()), Bid(0.6, FAST)
    made = [explored(agent, bid, Cycle(7, n)).utility for n in range(5 * PERIOD)]
    for begin in range(0, len(made), PERIOD):
        assert len({*made[begin : begin + FORCED]}) == 1
        assert {*made[begin + FORCED : begin + PERIOD]} == {0.6}
    drawn = made[::PERIOD]
    assert len({*drawn}) == len(drawn)
    assert LEAST <= min(drawn) < max(drawn) <= MOST


def test_weights_of_another_number_are_refused_with_those_that_are_expected() -> None:
    with pytest.raises(ConfigError, match=r"goto: social.utility has 2 weights.*8: one, utility"):
        LEARNED.contender(WHEELS, goto((1.0, 2.0)), CycleClock())


def test_the_shipped_weights_are_of_these_features() -> None:
    found = load_set("learned")
    assert {*found} == {"goto", "avoid", "gothrough"}
    for agent, (setting,) in found.items():
        kind = agent_class(agent)
        made = kind(Identity(f"{agent}-1"), load_parameters(kind.parameters, None, [setting]))
        assert LEARNED.contender(WHEELS, made, CycleClock()) is not None


def drive(*sets: str, coordination: str | None = "learned") -> Result:
    options = Options(seed=1, coordination=coordination, sets=sets)
    return Rehearsal(prepared(ideal(load_scenario("sc4")), options), options).run()


def test_an_agent_leads_by_its_weights_that_does_not_by_its_own_utility() -> None:
    ballots = drive(coordination=None)
    low, high = (f"[{', '.join(map(str, weights(one=x)))}]" for x in (-9.0, 9.0))
    turned = drive(f"goto.social.utility={low}", f"gothrough.social.utility={high}")
    assert turned.reached
    assert turned.collisions == 0
    assert dict(turned.shares)["gothrough"] > dict(ballots.shares)["gothrough"]
