"""What an address counts as."""

from __future__ import annotations

import pytest

from armadico.mesh.sources import source_of


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
