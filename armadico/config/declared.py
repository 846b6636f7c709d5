"""Options declared as the fields of a frozen dataclass: for Python, and for a command line.

The type and the default of a field are those of the option; its metadata has what a command line
needs besides. `armadico.cli.parsing` reads it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import field, fields
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T")  # the type of a field

DECLARED: Final = "option"
"""The key of a field's declaration in its metadata."""


class BadValueError(ValueError):
    """An option cannot have this value; raised by the function that reads it."""


class Must(NamedTuple):
    """A condition on a value, and its words in an error."""

    holds: Callable[[Any], bool]
    words: str


def at_least(least: float) -> Must:
    return Must(lambda value: value >= least, f"expected at least {least:g}")


def more_than(bound: float, words: str = "") -> Must:
    """More than a number, and finite."""
    words = words or f"expected more than {bound:g}"
    return Must(lambda value: bound < value < inf, words)


def between(least: float, most: float, words: str = "") -> Must:
    """From `least` to `most`, both included."""
    words = words or f"expected {least:g} to {most:g}"
    return Must(lambda value: least <= value <= most, words)


def ends_with(suffix: str, what: str) -> Must:
    """The suffix of a file's name."""
    return Must(lambda path: path.suffix == suffix, f"{what} must end with {suffix}")


def _is_pose(pose: Sequence[float]) -> bool:
    return all(map(isfinite, pose)) and abs(pose[2]) <= 360.0


FILE: Final = Must(Path.is_file, "no such file")
RECORDING: Final = ends_with(".mcap", "the name of a recording")
POSE: Final = Must(_is_pose, "expected finite m, m and -360 to 360 degrees")
"""x, y and heading; whether the place is free is checked with the world."""

PORT: Final = between(0, 65535)
"""A TCP port to listen on; 0 is any free one."""


class Option(NamedTuple):
    """The declaration of an option or argument."""

    flags: tuple[str, ...]
    keywords: dict[str, Any]
    read: Callable[[str], object] | None
    must: Must | None
    either: str
    positional: bool = False
    turned: Callable[[Any], Any] | None = None


class Group(NamedTuple):
    """The declaration of another dataclass of options."""

    kind: type
    title: str


class Added(NamedTuple):
    """The declaration of those that packages add."""

    find: Callable[[Collection[str]], Sequence[type[Any]]]


def option(
    help: str | None,  # noqa: A002 - as argparse calls it
    *flags: str,
    default: T = None,  # type: ignore[assignment]  # the field's type if it is not given
    factory: Callable[[], T] | None = None,
    read: Callable[[str], object] | None = None,
    must: Must | None = None,
    either: str = "",
    turned: Callable[[Any], Any] | None = None,
    **keywords: object,
) -> T:
    """A field that is an option.

    Args:
        help: For `--help`; None hides the option.
        flags: Its names; by default --NAME.
        default: Its value if it is not given.
        factory: Makes the default value when the command line is parsed.
        read: Reads a value, by default by the annotation. Raises BadValueError.
        must: A condition on its value.
        either: Options with the same word here exclude each other.
        turned: Turns its value, once checked, into the field's unit.
        keywords: `metavar`, `choices`, `nargs`, `const`, `required` as in argparse.
    """
    declared = Option(flags, {"help": help, **keywords}, read, must, either, turned=turned)
    if factory is not None:
        return field(default_factory=factory, metadata={DECLARED: declared})
    return field(default=default, metadata={DECLARED: declared})


def flag(help: str | None, *flags: str, **how: Any) -> bool:  # noqa: A002
    """A field that is a switch."""
    return option(help, *flags, default=False, **how)


def several(help: str, *flags: str, **how: Any) -> tuple[T, ...]:  # noqa: A002
    """A field that is an option which may be repeated."""
    return option(help, *flags, default=(), **how)


def argument(
    help: str,  # noqa: A002
    *,
    read: Callable[[str], T] | None = None,
    must: Must | None = None,
    **keywords: Any,
) -> T:
    """A field that is a positional argument; optional with `nargs="?"`."""
    default = {"default": keywords.pop("default", None)} if "nargs" in keywords else {}
    declared = Option((), {"help": help, **keywords}, read, must, "", positional=True)
    made: T = field(**default, metadata={DECLARED: declared})
    return made


def group(kind: type[T], title: str = "") -> T:
    """A field whose value is another dataclass of options, with a title in `--help`."""
    return field(default_factory=kind, metadata={DECLARED: Group(kind, title)})


def added(find: Callable[[Collection[str]], Sequence[type[T]]]) -> tuple[T, ...]:
    """A field for a tuple of other dataclasses of options, one of each class that `find` returns.

    `find` gets the flags that exist. For `--help` each class has the attributes `title` (of its
    group) and `examples`.
    """
    return field(default=(), metadata={DECLARED: Added(find)})


def flags_of(kind: type) -> list[str]:
    """The flags of a dataclass of options, without those that packages add."""
    found: list[str] = []
    for each in fields(kind):
        declared = each.metadata.get(DECLARED)
        if isinstance(declared, Group):
            found += flags_of(declared.kind)
        elif isinstance(declared, Option) and not declared.positional:
            found += declared.flags or (flag_of(each.name),)
    return found


def given(options: DataclassInstance) -> list[str]:
    """The flags of the options that do not have their default values."""
    declared = ((each, each.metadata.get(DECLARED)) for each in fields(options))
    return [
        (*how.flags, flag_of(each.name))[0]
        for each, how in declared
        if isinstance(how, Option) and getattr(options, each.name) != each.default
    ]


def flag_of(name: str) -> str:
    """The flag of a field."""
    return "--" + name.replace("_", "-")
