"""Which connections a porter serves first: a flood from one address keeps no other one out."""

from __future__ import annotations

import pytest

from armadico.keys.lobby import (
    BURST,
    INTRODUCTION_S,
    MOST,
    MOST_OF_A_SOURCE,
    RATE_HZ,
    RATE_OF_STRANGERS_HZ,
    Lobby,
)


def served(lobby: Lobby[str], now: float, most: int = 10_000) -> list[str]:
    """What begins its handshake now, in order."""
    found: list[str] = []
    while len(found) < most and (each := lobby.next(now)) is not None:
        lobby.leave(each)
        found.append(each)
    return found


def test_of_a_source_with_too_many_silent_connections_the_oldest_goes() -> None:
    lobby = Lobby[str]()
    gone = [lobby.enter(f"x{n}", "x", 0.01 * n) for n in range(MOST_OF_A_SOURCE + 3)]
    assert [each for each in gone if each] == ["x0", "x1", "x2"]


def test_a_crowd_of_strangers_makes_room_for_the_next_one() -> None:
    lobby = Lobby[str](frozenset(["robot"]))
    for n in range(20):
        lobby.enter(f"member{n}", "robot", 0.0)
    for n in range(600):
        lobby.enter(f"{n}", f"s{n % 50}", 1.0)
    assert len(lobby.waiting) == MOST
    assert all(f"member{n}" in lobby.waiting for n in range(20))


def test_sources_take_turns() -> None:
    lobby = Lobby[str]()
    for n in range(30):
        lobby.enter(f"flood{n}", "flood", 0.0)
        lobby.ready(f"flood{n}")
    lobby.enter("honest", "other", 0.0)
    lobby.ready("honest")
    assert "honest" in served(lobby, 0.0, most=2)


def test_an_address_of_the_host_table_comes_first() -> None:
    lobby = Lobby[str](frozenset(["host"]))
    for source in range(100):
        lobby.enter(f"{source}", f"s{source}", 0.0)
        lobby.ready(f"{source}")
    lobby.enter("host's", "host", 0.0)
    lobby.ready("host's")
    assert served(lobby, 0.0, most=1) == ["host's"]


def test_handshakes_of_a_source_are_rationed_and_those_that_succeed_cost_half() -> None:
    lobby = Lobby[str](frozenset(["honest"]))
    count = 0
    for n in range(1000):  # in a second
        lobby.enter(f"bad{n}", "flood", n * 1e-3)
        lobby.ready(f"bad{n}")
        count += len(served(lobby, n * 1e-3))
    assert count <= BURST + RATE_HZ + 1
    assert not served(lobby, 1.0)

    for n in range(2 * int(BURST) - 1):
        lobby.enter(f"good{n}", "honest", 1.0)
        lobby.ready(f"good{n}")
        assert lobby.next(1.0) == f"good{n}"
        lobby.introduced(f"good{n}", 1.0)
    lobby.enter("one more", "honest", 1.0)
    lobby.ready("one more")
    assert lobby.next(1.0) is None


def test_of_a_source_the_newest_is_served_first_as_it_is_the_last_to_give_up() -> None:
    lobby = Lobby[str]()
    for name in ("old", "new"):
        lobby.enter(name, "x", 0.0)
        lobby.ready(name)
    assert served(lobby, 0.0) == ["new", "old"]


def test_strangers_from_many_addresses_share_one_ration_and_named_ones_do_not_wait() -> None:
    lobby = Lobby[str](frozenset(["robot"]))
    for n in range(MOST):
        lobby.enter(f"{n}", f"s{n}", 0.0)
        lobby.ready(f"{n}")
    assert len(served(lobby, 0.0)) == RATE_OF_STRANGERS_HZ
    lobby.enter("member", "robot", 0.0)
    lobby.ready("member")
    assert served(lobby, 0.0) == ["member"]


def test_the_next_turn_comes_as_soon_as_it_can_do_something() -> None:
    lobby = Lobby[str]()
    assert lobby.due(0.0) is None
    lobby.enter("silent", "s", 10.0)
    assert lobby.due(10.5) == pytest.approx(INTRODUCTION_S - 0.5)
    for n in range(int(BURST) + 1):
        lobby.enter(f"{n}", "t", 10.5)
        lobby.ready(f"{n}")
        if n < BURST:
            assert served(lobby, 10.5) == [f"{n}"]
    assert served(lobby, 10.5) == []
    assert lobby.due(10.5) == pytest.approx(1 / RATE_HZ)
    assert served(lobby, 10.5 + 1.01 / RATE_HZ) == [f"{int(BURST)}"]


def test_who_does_not_introduce_itself_in_time_has_to_go() -> None:
    lobby = Lobby[str]()
    lobby.enter("old", "s", 0.0)
    lobby.enter("young", "s", 1.0)
    assert lobby.late(INTRODUCTION_S) == ["old"]
    assert list(lobby.waiting) == ["young"]
