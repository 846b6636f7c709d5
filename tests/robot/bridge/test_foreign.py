"""An instance with another meaning of a resource: its messages have no effect."""

from __future__ import annotations

from msgspec.structs import replace

from armadico.core.messages import PROTOCOL, Ballot, Card, Claim, Command
from tests.robot.bridge.robot_bench import Bench

STRANGER = Ballot(9, 1.0, True, "avoid-2")


def card(instance: str, protocol: int) -> Card:
    return Card("avoid", instance, "lab2", 42, "1", protocol, (), (), ("wheels",))


def test_the_robot_agent_refuses_its_commands_and_claims_and_names_it_once() -> None:
    bench = Bench().connect()
    for _ in range(5):
        state = bench.status()
    for _ in range(2):
        bench.robot.kernel.met(card("avoid-2", PROTOCOL + 1), bench.now)
        bench.robot.kernel.met(card("avoid-1", PROTOCOL), bench.now)
    bench.take()
    (named,) = [text for text in bench.logs() if "protocol" in text]
    assert "avoid-2 (host lab2, pid 42)" in named
    bench.robot.kernel.receive(Claim("wheels", STRANGER, state.cycle, 1.0, True), bench.now)
    bench.robot.kernel.receive(Command("wheels", state.cycle, STRANGER, (0.2, 0.0)), bench.now)
    state = bench.status()
    assert (bench.ack().largest, bench.ack().obeyed) == (None, None)
    ours = Ballot(1, 0.5, False, "avoid-1")
    bench.robot.kernel.receive(Command("wheels", state.cycle, ours, (0.2, 0.0)), bench.now)
    bench.status()
    assert bench.ack().obeyed == ours


def test_another_meaning_of_the_wheels_is_refused_and_both_are_reported() -> None:
    bench = Bench().connect()
    for _ in range(5):
        state = bench.status()
    means = Card("avoid", "avoid-2", "lab2", 42, "1", PROTOCOL, (), (), ("wheels",))
    bench.robot.kernel.met(
        replace(means, declares=("wheels(left, right)", "gripper(f)")), bench.now
    )
    bench.take()
    (text,) = [text for text in bench.logs() if "avoid-2" in text]
    assert "declares wheels(left, right), this agent wheels(v, w)" in text
    bench.robot.kernel.receive(Command("wheels", state.cycle, STRANGER, (0.2, 0.0)), bench.now)
    bench.status()
    assert (bench.ack().largest, bench.ack().obeyed) == (None, None)


def test_agents_of_the_same_meaning_or_without_shared_resources_are_accepted() -> None:
    bench = Bench().connect()
    for _ in range(5):
        state = bench.status()
    same = Card("avoid", "avoid-2", "lab2", 42, "1", PROTOCOL, (), (), ("wheels",))
    for declares in (("wheels(v, w)",), ("gripper(f)",), ("wheels2(left, right)",), ()):
        bench.robot.kernel.met(replace(same, declares=declares), bench.now)
    bench.robot.kernel.receive(Command("wheels", state.cycle, STRANGER, (0.2, 0.0)), bench.now)
    bench.status()
    assert bench.ack().obeyed == STRANGER
