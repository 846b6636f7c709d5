"""An instance of another protocol: what it says binds nobody."""

from __future__ import annotations

from armadico.messages import PROTOCOL, Ballot, Card, Claim, Command
from tests.bridge.robot_bench import Bench

STRANGER = Ballot(9, 1.0, True, "avoid-2")


def card(instance: str, protocol: int) -> Card:
    return Card("avoid", instance, "lab2", 42, "1", protocol, (), (), ("wheels",))


def test_the_robot_agent_refuses_its_commands_and_claims_and_names_it_once() -> None:
    bench = Bench().connect()
    for _ in range(5):
        state = bench.status()
    for _ in range(2):
        bench.robot.met(card("avoid-2", PROTOCOL + 1), bench.now)
        bench.robot.met(card("avoid-1", PROTOCOL), bench.now)
    bench.take()
    (named,) = [text for text in bench.logs() if "protocol" in text]
    assert "avoid-2 (host lab2, pid 42)" in named
    bench.robot.receive(Claim("wheels", STRANGER, state.cycle, 1.0, True), bench.now)
    bench.robot.receive(Command(state.cycle, STRANGER, 0.2, 0.0), bench.now)
    state = bench.status()
    assert (state.largest, state.obeyed) == (None, None)
    ours = Ballot(1, 0.5, False, "avoid-1")
    bench.robot.receive(Command(state.cycle, ours, 0.2, 0.0), bench.now)
    assert bench.status().obeyed == ours
