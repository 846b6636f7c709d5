"""Each mechanism beyond the first four has the feature that its authors rely on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import pytest

from armadico.agents.driving.goto import Goto, Parameters
from armadico.agents.rivals.arbiter import Arbiter, Wish
from armadico.agents.rivals.fields import Schemas
from armadico.agents.rivals.grid import actions
from armadico.agents.rivals.layers import (
    Source,
    Subsumption,
    SubsumptionParameters,
    TwistMux,
    TwistMuxParameters,
    Wire,
)
from armadico.agents.rivals.libraries import ArbitrationGraph, BehaviourTree
from armadico.agents.rivals.operators import Operators, OperatorsParameters
from armadico.agents.rivals.sequences import Contract, Motivation, Sequencing
from armadico.agents.rivals.systems import SUBSUMPTION
from armadico.agents.rivals.trust import Trust
from armadico.agents.rivals.votes import Constrained, Damn, Fuzzy
from armadico.core.agent import Identity
from armadico.core.messages import Cycle, Description, Point, RobotState
from armadico.core.parameters import Social
from armadico.core.resources import WHEELS
from armadico.mobile.messages import BatteryLevel, Pose, Trajectory, Waypoint
from armadico.mobile.motion import Body
from armadico.mobile.offers import repelled

FAST, SLOW, LEFT = (0.6, 0.0), (0.2, 0.0), (0.1, 0.5)
LIMITS = {"v_max": 1.0, "w_max": 1.0, "v_accel": 0.5, "v_decel": 0.5, "w_accel": 2.0}
ROBOT = Description(
    "robot",
    0.1,
    front=0.2,
    rear=0.2,
    half_width=0.2,
    **LIMITS,
    w_decel=2.0,
    silence_s=0.3,
    watchdog_s=0.5,
)
GRID = actions(Body.of(ROBOT))
NOW = Cycle(1, 1)


def made(arbiter: Arbiter, at: float = 10.0) -> Arbiter:
    """The arbiter knows the robot, and the time."""
    arbiter.kernel.newest[Description] = ROBOT
    arbiter.kernel.now = at
    return arbiter


def wish(utility: float, action: tuple[float, float] = FAST, *, critical: bool = False) -> Wish:
    return Wish("x-1", utility, action, critical)


def rating(utility: float, rate: Callable[[float, float], float]) -> Wish:
    """A wish with votes on each action."""
    return Wish("x-1", utility, FAST, votes=tuple(rate(v, w) for v, w in GRID))


def around(v: float, w: float) -> Callable[[float, float], float]:
    return lambda a, b: 1.0 - min(abs(a - v) + abs(b - w), 2.0)


def leads(arbiter: Arbiter, name: str, utilities: tuple[float, ...]) -> list[str]:
    """Who leads, goto or another agent with these utilities in turn."""
    found = (arbiter.decide({"goto": wish(0.6), name: wish(u, LEFT)}, NOW) for u in utilities)
    return [name for decision in found for name in decision.shares]


def at(arbiter: Arbiter, x: float, seconds: float) -> None:
    """The time passes, and the robot is at a place."""
    arbiter.kernel.now = seconds
    arbiter.kernel.newest[Pose] = Pose(NOW, x, 0.0, 0.0)


def test_subsumption_an_inhibited_line_carries_nothing_and_a_suppressed_one_another_output() -> (
    None
):
    wires = Wire("avoid", "goto", "inhibit", 0.5), Wire("gothrough", "goto", "suppress", 0.2)
    for number, expected in ((0, (0.0, 0.0)), (1, LEFT)):
        parameters = SubsumptionParameters(wires=(wires[number],))
        layers = made(Subsumption(Identity("subsumption-1"), parameters))
        both = {"goto": wish(1.0), wires[number].source: wish(0.9, LEFT)}
        assert layers.decide(both, NOW).action == expected
        layers.kernel.now = 10.0 + 0.9 * wires[number].for_s
        assert layers.decide({"goto": wish(1.0)}, NOW).action == expected, "for its time"
        layers.kernel.now = 10.0 + 1.1 * wires[number].for_s
        assert layers.decide({"goto": wish(1.0)}, NOW).action == FAST
    assert SUBSUMPTION.told == "yes", "layers do not see each other"


@pytest.mark.parametrize("chosen", ["subsumption", "executive,subsumption"])
def test_what_an_agent_is_told_of_its_share_is_its_own_mechanisms(chosen: str) -> None:
    goto = Goto(Identity("goto-1"), Parameters(social=Social(coordination=chosen)))
    assert goto.share(WHEELS) == 1.0


def test_subsumption_a_layer_that_is_suppressed_itself_passes_the_suppressing_output_on() -> None:
    wires = (Wire("gothrough", "goto"), Wire("avoid", "gothrough"))
    layers = made(Subsumption(Identity("subsumption-1"), SubsumptionParameters(wires=wires)))
    all_three = {"goto": wish(1.0), "gothrough": wish(1.0, SLOW), "avoid": wish(1.0, LEFT)}
    assert layers.decide(all_three, NOW).action == LEFT


@pytest.mark.parametrize("does", ["suppress", "inhibit"])
def test_subsumption_a_layer_that_is_inhibited_does_nothing_to_others(
    does: Literal["suppress", "inhibit"],
) -> None:
    wires = (
        Wire("gothrough", "goto"),
        Wire("avoid", "goto", does),
        Wire("relocate", "avoid", "inhibit"),
    )
    layers = made(Subsumption(Identity("subsumption-1"), SubsumptionParameters(wires=wires)))
    actions = {"goto": FAST, "gothrough": SLOW, "avoid": LEFT, "relocate": LEFT}
    wishes = {name: wish(1.0, action) for name, action in actions.items()}
    assert layers.decide(wishes, NOW).shares == {"gothrough": 1.0}


def test_twist_mux_a_source_counts_until_its_timeout() -> None:
    mux = made(TwistMux(Identity("twist-mux-1")))
    mux.decide({"avoid": wish(1.0, LEFT), "goto": wish(1.0)}, NOW)
    mux.kernel.now = 10.4
    assert mux.decide({"goto": wish(1.0)}, NOW).action == LEFT
    mux.kernel.now = 10.6
    assert mux.decide({"goto": wish(1.0)}, NOW).action == FAST


def test_twist_mux_a_silent_lock_stops_what_is_below_it_and_nothing_above() -> None:
    sources = Source("teleop"), Source("avoid", lock_s=1.0), Source("goto")
    mux = made(TwistMux(Identity("twist-mux-1"), TwistMuxParameters(sources=sources)))
    mux.proposers = frozenset({"avoid", "goto"})
    assert mux.decide({"goto": wish(1.0)}, NOW).action == FAST
    mux.proposers = frozenset({"goto"})
    mux.kernel.now = 11.1
    assert mux.decide({"goto": wish(1.0)}, NOW).action == (0.0, 0.0)
    assert mux.decide({"goto": wish(1.0), "teleop": wish(1.0, SLOW)}, NOW).action == SLOW


def pulled(x: float, y: float) -> Wish:
    return Wish("x-1", 1.0, FAST, vector=(x, y))


def test_schemas_sum_vectors_so_that_a_push_turns_the_robot_away_and_slows_it_down() -> None:
    schemas = made(Schemas(Identity("schemas-1")))
    v, w = schemas.decide({"goto": pulled(1.0, 0.0)}, NOW).action
    slow_v, slow_w = schemas.decide(
        {"goto": pulled(1.0, 0.0), "avoid": pulled(-0.6, 0.4)}, NOW
    ).action
    assert slow_v < v
    assert slow_w > w + 0.1


def test_schemas_within_the_margin_an_obstacle_repels_more_than_any_goal_attracts() -> None:
    def push(free: float) -> float:
        return repelled([Point(0.2 + free, 0.0)], Body.of(ROBOT).outline, 0.5, 0.1)[0]

    assert push(0.6) == 0.0
    assert push(0.3) == pytest.approx(-0.5)
    assert push(0.05) < -10.0


def test_schemas_homeostatic_gains_favour_the_goal_when_the_battery_is_low() -> None:
    schemas = made(Schemas(Identity("schemas-1")))
    both = {"goto": pulled(1.0, 0.0), "avoid": pulled(-0.6, 0.4)}
    full = schemas.decide(both, NOW)
    schemas.kernel.newest[BatteryLevel] = BatteryLevel(NOW, 10.5, 0.0, 0.0)
    empty = schemas.decide(both, NOW)
    assert empty.shares["goto"] > full.shares["goto"]
    assert empty.action[0] > full.action[0]


def test_damn_a_compromise_that_nobody_likes_best_wins_by_the_sum_of_votes() -> None:
    damn = made(Damn(Identity("damn-1")))
    wishes = {"goto": rating(1.0, around(0.6, -0.4)), "gothrough": rating(1.0, around(0.6, 0.4))}
    assert damn.decide(wishes, NOW).action == pytest.approx((0.5, 0.0), abs=0.2)


def test_damn_weighs_votes_by_its_mode() -> None:
    damn = made(Damn(Identity("damn-1")))
    calm = {"goto": rating(1.0, around(0.6, -0.8)), "avoid": rating(1.0, around(0.2, 0.8))}
    calm["goto"] = Wish("x-1", 1.0, FAST, votes=tuple(1.5 * each for each in calm["goto"].votes))
    danger = {**calm, "avoid": Wish("x-2", 1.0, SLOW, critical=True, votes=calm["avoid"].votes)}
    assert damn.decide(calm, NOW).action[1] < -0.5
    assert damn.decide(danger, NOW).action[1] > 0.5


def test_constrained_never_takes_what_one_behaviour_forbids_or_the_ramps_cannot_reach() -> None:
    constrained = made(Constrained(Identity("constrained-1")))
    constrained.kernel.newest[RobotState] = RobotState(NOW, 0, 0, 0, 0.3, 0, 12, True, False)
    likes = rating(1.0, around(0.5, 0.0))
    free = constrained.decide({"goto": likes}, NOW).action
    assert free == pytest.approx((0.5, 0.0), abs=0.11)
    wall = rating(0.0, lambda v, _: -1.0 if v > 0.3 else 0.0)
    assert constrained.decide({"goto": likes, "avoid": wall}, NOW).action[0] <= 0.4
    faster = rating(1.0, around(1.0, 0.0))
    window = 0.3 + 0.5 * constrained.p.window_s
    assert constrained.decide({"goto": faster}, NOW).action[0] <= window + 0.01


def test_fuzzy_a_behaviour_counts_as_far_as_its_context_holds() -> None:
    fuzzy = made(Fuzzy(Identity("fuzzy-1")))
    goes, turns = around(0.6, -0.6), around(0.6, 0.6)
    ways = [
        fuzzy.decide({"goto": rating(1.0, goes), "avoid": rating(context, turns)}, NOW).action[1]
        for context in (0.0, 0.5, 1.0)
    ]
    assert ways[0] == pytest.approx(-0.6, abs=0.1)
    assert ways == sorted(ways)
    assert ways[2] == pytest.approx(0.0, abs=0.1), "both hold: what both find desirable"


def test_sequencing_keeps_a_method_until_it_succeeds() -> None:
    sequencing = made(Sequencing(Identity("sequencing-1")))
    found = leads(sequencing, "avoid", (0.7, 0.9, 0.5, 0.1))
    assert found == ["goto", "avoid", "avoid", "goto"]


def test_sequencing_notices_a_failure_by_itself_and_tries_the_next_method() -> None:
    sequencing = made(Sequencing(Identity("sequencing-1")))
    both = {"goto": wish(0.6), "avoid": wish(0.9, LEFT)}
    at(sequencing, 1.0, 10.0)
    assert sequencing.decide(both, NOW).shares == {"avoid": 1.0}
    at(sequencing, 1.0, 10.0 + 1.1 * sequencing.p.patience_s)
    assert sequencing.decide(both, NOW).shares == {"goto": 1.0}
    at(sequencing, 3.0, sequencing.now + 0.9 * sequencing.p.retry_s)
    assert sequencing.decide(both, NOW).shares == {"goto": 1.0}, "not tried again so soon"
    at(sequencing, 3.0, sequencing.now + 0.2 * sequencing.p.retry_s)
    assert sequencing.decide(both, NOW).shares == {"avoid": 1.0}


def takes_over(moves: float) -> float:
    """When an impatient behaviour takes over from a holder that moves so far per cycle, s."""
    motivation = made(Motivation(Identity("motivation-1")))
    for n in range(200):
        at(motivation, moves * n, 10.0 + 0.1 * n)
        both = {"avoid": wish(0.5, LEFT)} if n > 20 else {}
        if "avoid" in motivation.decide({"goto": wish(0.6), **both}, NOW).shares:
            return 0.1 * (n - 20)
    return float("inf")


def test_motivation_a_holder_that_does_not_get_on_loses_soon_and_one_that_does_keeps_long() -> None:
    assert takes_over(0.0) < 1.5
    assert takes_over(0.05) > 6.0


def test_motivation_a_holder_that_fails_yields_even_if_nobody_is_impatient() -> None:
    motivation = made(Motivation(Identity("motivation-1")))
    shares = []
    for n in range(int(10.0 * motivation.p.gives_up_s) + 20):
        at(motivation, 0.0, 10.0 + 0.1 * n)
        shares.append(motivation.decide({"goto": wish(0.6)}, NOW).shares)
    taken = shares.index({"goto": 1.0})
    assert {} in shares[taken:], "it gives up, and must become motivated again"


def test_a_contract_is_kept_for_its_tenure_except_for_a_critical_bid() -> None:
    contract = made(Contract(Identity("contract-1")))
    assert contract.decide({"goto": wish(0.6)}, NOW).shares == {"goto": 1.0}
    better = {"goto": wish(0.6), "avoid": wish(0.9, LEFT)}
    contract.kernel.now = 10.0 + 0.9 * contract.p.tenure_s
    assert contract.decide(better, NOW).shares == {"goto": 1.0}
    contract.kernel.now = 10.0 + 1.1 * contract.p.tenure_s
    assert contract.decide(better, NOW).shares == {"avoid": 1.0}
    urgent = {"avoid": wish(0.9, LEFT), "goto": wish(0.7, critical=True)}
    assert contract.decide(urgent, NOW).shares == {"goto": 1.0}


def test_an_agent_that_promises_and_leads_nowhere_loses_the_wheels_to_one_that_keeps_less() -> None:
    trust = made(Trust(Identity("trust-1")))
    trust.on_trajectory(Trajectory(1, 1, waypoints=(Waypoint(50.0, 0.0, 0.0),)))
    x, found = 0.0, []
    for n in range(1200):
        at(trust, x, 10.0 + 0.1 * n)
        both = {"liar": wish(0.99, (0.0, 0.0)), "goto": wish(0.6)}
        (lead,) = trust.decide(both, Cycle(1, n)).shares
        x += 0.03 * (lead == "goto")
        found.append(lead)
    assert found[0] == "liar"
    assert found[150:].count("liar") < 0.05 * len(found[150:])
    assert x > 20.0


def operators(rule: str) -> Operators:
    found = made(Operators(Identity("operators-1"), OperatorsParameters(rule=rule)))
    assert isinstance(found, Operators)
    return found


def test_aras_operators() -> None:
    both = {"avoid": wish(0.5, LEFT), "goto": wish(0.6)}
    assert operators("+(avoid, goto)").decide(both, NOW).shares == {"goto": 1.0}
    assert operators("-(avoid*2, goto)").decide(both, NOW).shares == {"avoid": 1.0}
    votes = {"a": rating(1.0, around(0.6, -0.4)), "b": rating(1.0, around(0.6, 0.4))}
    assert operators("&(a, b)").decide(votes, NOW).action[1] == pytest.approx(0.0, abs=0.05)
    switch = operators("#(avoid, goto)")
    found = leads(switch, "avoid", (0.5, 0.9, 0.5, 0.2))
    assert found == ["goto", "avoid", "avoid", "goto"], "the triggered one stays, until it ends"


@pytest.mark.parametrize("rule", ["", "+(goto", "+goto", "goto avoid", "%(goto)"])
def test_a_rule_that_cannot_be_read_is_refused(rule: str) -> None:
    with pytest.raises(ValueError, match="rule"):
        operators(rule)


def test_in_a_behaviour_tree_a_child_further_left_interrupts_the_running_one() -> None:
    pytest.importorskip("py_trees", reason="not there: pip install 'armadico[rivals]'")
    tree = made(BehaviourTree(Identity("behaviour-tree-1")))
    found = leads(tree, "avoid", (0.7, 0.9, 0.5, 0.3))
    assert found == ["goto", "avoid", "avoid", "goto"], "a running child goes on while it may"


def test_an_arbitration_graph_takes_the_next_option_for_a_command_that_is_not_verified() -> None:
    pytest.importorskip(
        "arbitration_graphs", reason="arbitration_graphs: pip install 'armadico[rivals]'"
    )
    graph = made(ArbitrationGraph(Identity("arbitration-graph-1")))
    fine = rating(0.0, lambda *_: 0.0)
    wall = rating(0.0, lambda _, w: -1.0 if w > 0.2 else 0.0)
    options = {"goto": wish(0.6), "gothrough": wish(0.9, SLOW), "avoid": wish(0.9, LEFT)}
    assert graph.decide({**options, "laser": fine}, NOW).shares == {"avoid": 1.0}
    assert graph.decide({**options, "laser": wall}, NOW).shares == {"gothrough": 1.0}
