"""Hosts: missing agents and clock offsets."""

from __future__ import annotations

import pytest

from armadico.core.judgement import Answer
from armadico.core.messages import PROTOCOL, Card
from armadico.observe.diagnosis import HostState, diagnose, hosts_of
from armadico.observe.findings import Demand, Hosts, Sort, short
from armadico.observe.view import View


def card(name: str, host: str) -> Card:
    return Card(name, f"{name}-1", host, 1, "1", PROTOCOL, (), (), ())


def seen(*cards: Card) -> View:
    return View.of({(card.name, card.instance): card for card in cards})


def census(view: View, wanted: Hosts, now: float = 0.0) -> list[HostState]:
    return hosts_of(view, Demand(wanted), now)


def test_each_host_has_its_agents_and_the_missing_ones() -> None:
    view = seen(card("goto", "lab2"), card("encoder", "lab1"), card("avoid", "desk"))
    wanted = {"robot": ("robot",), "lab1": ("encoder", "sonar"), "lab2": ("goto",), "lab4": ()}
    found = {host.name: host for host in census(view, wanted)}
    assert {name: (host.agents, host.lacks) for name, host in found.items()} == {
        "robot": ((), ("robot",)),
        "lab1": (("encoder",), ("sonar",)),
        "lab2": (("goto",), ()),
        "lab4": ((), ()),
        "desk": (("avoid",), ()),
    }
    assert found["lab2"].state == found["desk"].state == "up"
    assert "sonar" in found["lab1"].state


@pytest.mark.parametrize(
    ("offsets", "named"),
    [
        ((3600.0, 3600.4, 3599.9), "3600 s ahead"),
        ((-7.0,), "7 s behind"),
        ((0.3, 1.9), ""),
        ((None,), ""),  # no offset is known
        ((None, 60.0), "60 s ahead"),
    ],
)
def test_the_skew_is_the_median_offset(offsets: tuple[float | None, ...], named: str) -> None:
    names = [f"a{number}" for number in range(len(offsets))]
    ahead = {f"{n}-1": o for n, o in zip(names, offsets, strict=True) if o is not None}
    view = seen(*(card(name, "lab2") for name in names))
    view.ahead |= ahead
    (host,) = census(view, {})
    assert named in host.skew
    assert bool(host.skew) == bool(named)


def test_an_open_port_is_shown_with_all_other_findings_and_is_not_wrong() -> None:
    for view in (View(), seen(card("goto", "lab2"))):
        findings = diagnose(view, Demand(open="tcp/10.0.0.2:7447"))
        (found,) = (each for each in findings if each.sort is Sort.OPEN)
        assert (found.who, found.answer) == ("tcp/10.0.0.2:7447", Answer.YES)
        assert f"open: {found}" in short(findings)
        assert not any(each.sort is Sort.OPEN for each in diagnose(view, Demand()))


def test_a_file_of_keys_that_cannot_be_read_is_wrong_and_named() -> None:
    what = "keys/members.json: cannot be read: cut"
    for view in (View(), seen(card("goto", "lab2"))):
        findings = diagnose(view, Demand(unread=lambda: (what,)))
        (found,) = (each for each in findings if each.sort is Sort.KEYS)
        assert (found.answer, found.who) == (Answer.NO, "keys/members.json")
        assert f"wrong: {found}" in short(findings)
        assert not any(each.sort is Sort.KEYS for each in diagnose(view, Demand()))


def test_a_certificate_that_is_not_renewed_is_wrong_and_says_when_it_expires() -> None:
    for view in (View(), seen(card("goto", "lab2"))):
        demand = Demand(ending=lambda: {"robot1/goto": 2400.0, "robot1/avoid": -1.0})
        findings = [each for each in diagnose(view, demand) if each.sort is Sort.EXPIRY]
        assert {each.who: each.answer for each in findings} == {
            "robot1/goto": Answer.NO,
            "robot1/avoid": Answer.NO,
        }
        assert "expires in 40 min" in str(findings[0])
        assert "has expired" in str(findings[1])
        assert not any(each.sort is Sort.EXPIRY for each in diagnose(view, Demand()))
