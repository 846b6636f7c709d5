"""Errors of configurations: where the fault is, and what would be right."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from pathlib import Path
from typing import Self

from armadico.core.errors import UnknownNameError, advice

__all__ = ["ConfigError", "ConfigNameError", "ConfigValueError", "advice"]


class ConfigError(Exception):
    """A configuration that cannot be used.

    Its text is one line that a command prints as it is: `file:line: what is wrong; what is right`.
    """

    def __init__(
        self, message: str, file: Path | str | None = None, line: int | None = None
    ) -> None:
        Exception.__init__(self, message)  # not the next class: `ConfigNameError` has two bases
        self.message, self.line = message, line
        self.file = None if file is None else str(file)

    def __str__(self) -> str:
        place = ":".join(filter(None, (self.file, str(self.line or ""))))
        return f"{place}: {self.message}" if self.file else self.message

    def at(self, file: Path | str | None, line: int | None = None, before: str = "") -> Self:
        """The same error at another place, with `before` in front of its message."""
        found = copy(self)
        found.message = before + self.message
        found.file, found.line = None if file is None else str(file), line
        return found


class ConfigNameError(ConfigError, UnknownNameError):
    """A key, a word or the name of something that does not exist; see `UnknownNameError`."""

    def __init__(
        self,
        kind: str,
        name: str,
        known: Iterable[str],
        file: Path | str | None = None,
        line: int | None = None,
        message: str = "",
    ) -> None:
        UnknownNameError.__init__(self, kind, name, known, message)
        ConfigError.__init__(self, self.message, file, line)
        self.args = (kind, name, self.known, file, line, self.message)  # for pickle and copy


class ConfigValueError(ConfigError):
    """A value of the wrong type or out of its range.

    Attributes:
        key: Its path in the file, `sonar.sonars[3].x_m`.
        value: The value that was read.
        allowed: What it may be, for people.
    """

    def __init__(
        self,
        key: str,
        value: object,
        allowed: str,
        file: Path | str | None = None,
        line: int | None = None,
        message: str = "",
    ) -> None:
        self.key, self.value, self.allowed = key, value, allowed
        super().__init__(message or f"{key} = {value}: expected {allowed}", file, line)
        self.args = (key, value, allowed, file, line, self.message)  # for pickle and copy
