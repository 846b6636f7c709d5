"""Each mechanism has the feature that its authors rely on."""

from __future__ import annotations

import pytest

from armadico.agents.rivals.arbiter import Wish
from armadico.agents.rivals.mechanisms import Auction, Mean, Priority, Resolver
from armadico.core.agent import Identity
from armadico.core.messages import Cycle

FAST, SLOW, LEFT = (0.6, 0.0), (0.2, 0.0), (0.1, 0.5)


def wish(utility: float, action: tuple[float, float], *, critical: bool = False) -> Wish:
    return Wish("x-1", utility, action, critical)


def test_the_auction_changes_its_leader_only_for_a_bid_better_by_the_margin() -> None:
    auction = Auction(Identity("auction-1"))
    first = auction.decide({"goto": wish(0.50, FAST), "avoid": wish(0.40, SLOW)}, Cycle(1, 1))
    near = auction.decide({"goto": wish(0.50, FAST), "avoid": wish(0.54, SLOW)}, Cycle(1, 2))
    over = auction.decide({"goto": wish(0.50, FAST), "avoid": wish(0.56, SLOW)}, Cycle(1, 3))
    assert [*first.shares, *near.shares, *over.shares] == ["goto", "goto", "avoid"]


def test_a_critical_bid_wins_the_auction_at_equal_utility() -> None:
    auction = Auction(Identity("auction-1"))
    auction.decide({"goto": wish(1.0, FAST)}, Cycle(1, 1))
    both = {"goto": wish(1.0, FAST), "avoid": wish(1.0, SLOW, critical=True)}
    assert auction.decide(both, Cycle(1, 2)).shares == {"avoid": 1.0}


def test_the_auction_blends_the_new_leaders_action_in() -> None:
    auction = Auction(Identity("auction-1"))
    auction.decide({"goto": wish(0.6, FAST)}, Cycle(1, 1))
    wishes = {"goto": wish(0.6, FAST), "avoid": wish(0.9, SLOW)}
    speeds = [auction.decide(wishes, Cycle(1, n)).action[0] for n in range(2, 14)]
    assert SLOW[0] < speeds[0] < FAST[0]
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[-1] == SLOW[0]


def test_a_suppressing_layer_holds_the_line_for_its_time_after_its_last_output() -> None:
    priority = Priority(Identity("priority-1"))
    priority.kernel.now = 10.0
    both = {"goto": wish(1.0, FAST), "avoid": wish(0.9, LEFT)}
    assert priority.decide(both, Cycle(1, 1)).action == LEFT
    alone = {"goto": wish(1.0, FAST)}
    priority.kernel.now = 10.0 + 0.9 * priority.p.suppression_s
    assert priority.decide(alone, Cycle(1, 2)).action == LEFT
    priority.kernel.now = 10.0 + 1.1 * priority.p.suppression_s
    assert priority.decide(alone, Cycle(1, 5)).action == FAST


def test_a_higher_layer_that_is_not_active_suppresses_nothing() -> None:
    priority = Priority(Identity("priority-1"))
    weak = {"goto": wish(0.5, FAST), "avoid": wish(priority.p.active - 0.1, LEFT)}
    assert priority.decide(weak, Cycle(1, 1)).shares == {"goto": 1.0}


def test_an_agent_below_the_order_suppresses_no_layer_however_much_it_bids() -> None:
    priority = Priority(Identity("priority-1"))
    liar = {"goto": wish(0.6, FAST), "liar": wish(0.99, LEFT)}
    assert priority.decide(liar, Cycle(1, 1)).shares == {"goto": 1.0}
    priority.kernel.now = 1.0
    assert priority.decide({"liar": wish(0.99, LEFT)}, Cycle(1, 2)).shares == {"liar": 1.0}


def test_in_arias_resolver_a_full_strength_leaves_nothing_to_lower_priorities() -> None:
    resolver = Resolver(Identity("resolver-1"))
    found = resolver.decide({"goto": wish(1.0, FAST), "avoid": wish(1.0, LEFT)}, Cycle(1, 1))
    assert found.action == LEFT


def test_in_arias_resolver_lower_priorities_share_the_strength_that_is_left() -> None:
    wishes = {
        "avoid": wish(0.6, (0.0, 1.0)),
        "goto": wish(0.9, (0.5, 0.0)),
        "gothrough": wish(0.3, (0.1, 0.0)),
    }
    found = Resolver(Identity("resolver-1")).decide(wishes, Cycle(1, 1))
    assert found.shares == pytest.approx({"avoid": 0.6, "goto": 0.3, "gothrough": 0.1})
    assert found.action == pytest.approx((0.16, 0.6))


def test_the_mean_weights_each_action_by_its_utility() -> None:
    wishes = {"goto": wish(0.75, (0.4, 0.0)), "avoid": wish(0.25, (0.0, 1.0))}
    found = Mean(Identity("mean-1")).decide(wishes, Cycle(1, 1))
    assert found.action == pytest.approx((0.3, 0.25))
    assert found.shares == pytest.approx({"goto": 0.75, "avoid": 0.25})
