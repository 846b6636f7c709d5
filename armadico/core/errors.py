"""Unknown names: one error with the facts in fields, and one wording of "did you mean"."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class UnknownNameError(LookupError):
    """Nothing has this name.

    Attributes:
        kind: What was looked up, such as "agent".
        name: The name that was given.
        known: The names that exist, sorted.
        near: The known name most like `name`, or None.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str], message: str = "") -> None:
        self.kind, self.name, self.known = kind, name, tuple(sorted(known))
        self.near = nearest(name, self.known)
        self.message = message or no_such(kind, name, self.known)
        super().__init__(kind, name, self.known, self.message)  # in this order for pickle

    def __str__(self) -> str:
        return self.message


def no_such(kind: str, name: str, known: Iterable[str]) -> str:
    """The text for an unknown name: `no agent 'gto'; did you mean 'goto'? (known: ...)`."""
    return f"no {kind} {name!r}; {advice(name, known)}"


def advice(word: str, known: Iterable[str]) -> str:
    """The end of that text: the nearest known name, and all known names."""
    names = sorted(known)
    if not names:
        return "there are none"
    near, listed = hint(word, names), f"known: {', '.join(names)}"
    return f"{near} ({listed})" if near else listed


def hint(word: str, known: Iterable[str]) -> str:
    """`did you mean 'goto'?`, or "" if no known name is similar."""
    near = nearest(word, known)
    return f"did you mean {near!r}?" if near else ""


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known name most like `word` in any case, or None if none is similar."""
    folded = {name.casefold(): name for name in known}
    near = get_close_matches(word.casefold(), folded, n=1, cutoff=0.5)
    return folded[near[0]] if near else None
