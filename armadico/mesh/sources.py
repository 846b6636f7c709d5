"""What an address counts as, where connections are rationed by where they come from (sans-IO)."""

from __future__ import annotations

import ipaddress


def source_of(address: str) -> str:
    """Return an address, or with IPv6 its network, which one machine has whole."""
    found = ipaddress.ip_address(address.partition("%")[0])
    if isinstance(found, ipaddress.IPv6Address):
        mapped = found.ipv4_mapped
        return str(mapped or ipaddress.ip_network((int(found), 64), strict=False))
    return str(found)
