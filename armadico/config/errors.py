"""One error for everything that can be wrong in a configuration: where it is and what is right."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path


class ConfigError(Exception):
    """A configuration that cannot be used.

    Its text is one line, `file:line: what is wrong; what would be right`, fit to be shown as it is.
    """

    def __init__(self, message: str, file: Path | str | None = None, line: int | None = None):
        self.message = message
        self.file = None if file is None else str(file)
        self.line = line
        super().__init__(":".join([*self._place(), " " + message]) if file else message)

    def _place(self) -> list[str]:
        return [part for part in (self.file, str(self.line or "")) if part]


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The name most like `word`, whatever its case; None if nothing is like it."""
    folded = {name.casefold(): name for name in known}
    near = get_close_matches(word.casefold(), folded, n=1, cutoff=0.5)
    return folded[near[0]] if near else None


def advice(word: str, known: Iterable[str]) -> str:
    """What is known, the nearest to `word` first: the end of a message about an unknown name."""
    names = sorted(known)
    if not names:
        return "there are none"
    near = nearest(word, names)
    listed = f"known: {', '.join(names)}"
    return f"did you mean {near!r}? ({listed})" if near else listed
