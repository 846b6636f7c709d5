"""Hosts, what each lacks, and how far its clock is off."""

from __future__ import annotations

import pytest

from armadico.core.messages import PROTOCOL, Card
from armadico.observe.hosts import census
from armadico.observe.view import View


def card(name: str, host: str) -> Card:
    return Card(name, f"{name}-1", host, 1, "1", PROTOCOL, (), (), ())


def seen(*cards: Card) -> View:
    return View.of({(card.name, card.instance): card for card in cards})


def test_each_host_says_what_it_has_and_what_it_lacks() -> None:
    view = seen(card("goto", "lab2"), card("encoder", "lab1"), card("avoid", "desk"))
    wanted = {"robot": ("robot",), "lab1": ("encoder", "sonar"), "lab2": ("goto",), "lab4": ()}
    found = {host.name: host.state for host in census(view, wanted, {})}
    assert found == {
        "robot": "no agent is alive",
        "lab1": "lacks: sonar",
        "lab2": "up",
        "lab4": "nothing is to run there",
        "desk": "up",
    }


def test_two_of_one_agent_are_two() -> None:
    (host,) = census(seen(card("avoid", "lab1")), {"lab1": ("avoid", "avoid")}, {})
    assert host.lacks == ("avoid",)


@pytest.mark.parametrize(
    ("offsets", "says"),
    [
        ((3600.0, 3600.4, 3599.9), "clock 3600 s ahead of this machine's"),
        ((-7.0,), "clock 7 s behind this machine's"),
        ((0.3, 1.9), ""),
        ((None,), ""),  # an agent that does not say
        ((None, 60.0), "clock 60 s ahead of this machine's"),
    ],
)
def test_a_clock_that_is_off_is_said_with_how_far(
    offsets: tuple[float | None, ...], says: str
) -> None:
    names = [f"a{number}" for number in range(len(offsets))]
    ahead = {f"{n}-1": o for n, o in zip(names, offsets, strict=True) if o is not None}
    (host,) = census(seen(*(card(name, "lab2") for name in names)), {}, ahead)
    assert host.skew == says
