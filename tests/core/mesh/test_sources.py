"""What an address counts as."""

from __future__ import annotations

import pytest

from armadico.mesh.sources import Rations, source_of


@pytest.mark.parametrize(
    ("address", "source"),
    [
        ("10.0.0.5", "10.0.0.5"),
        ("::ffff:10.0.0.5", "10.0.0.5"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
    ],
)
def test_a_source_is_an_address_or_with_ipv6_a_network(address: str, source: str) -> None:
    assert source_of(address) == source


def test_a_source_has_a_burst_and_a_rate_of_its_own() -> None:
    rations = Rations(rate_hz=2.0, burst=3.0)
    assert [rations.take("a", 0.0) for _ in range(5)] == [True, True, True, False, False]
    assert rations.take("b", 0.0)
    assert [rations.take("a", 0.5) for _ in range(2)] == [True, False]
    assert sum(rations.take("a", 100.0) for _ in range(9)) == 3


def test_few_sources_are_remembered() -> None:
    rations = Rations(rate_hz=1.0, burst=1.0, most=2)
    assert all(rations.take(source, 0.0) for source in "abc")
    assert not rations.take("c", 0.0)
    assert rations.take("a", 0.0)
