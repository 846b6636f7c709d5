"""The keys that several robots share, as the modules of messages declare them."""

from __future__ import annotations

_shared: set[str] = set()


def share(first: str) -> None:
    """Declare that robots share the keys with this first part: they are beside a namespace.

    Robots `lab/r1` and `lab/r2` share `lab/fleet/...` if "fleet" is shared.
    """
    _shared.add(first)


def shared() -> frozenset[str]:
    """Return the first parts of the keys that robots share."""
    return frozenset(_shared)


def is_shared(key: str) -> bool:
    return key.partition("/")[0] in _shared
