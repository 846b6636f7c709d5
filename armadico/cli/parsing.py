"""A command's options, declared as the fields of a frozen dataclass and parsed into it.

    @dataclass(frozen=True, kw_only=True)
    class Options:
        pattern: str = argument("the keys, such as robot/state", metavar="KEYEXPR")
        count: int | None = option("end after N messages", "-n", metavar="N", must=at_least(1))
        json: bool = flag("print a JSON array")
        mesh: Mesh = group(Mesh)

    def run(args: Options) -> int: ...

    main = Command("armadico hz", Options, run, "Measure rates of messages.", EXAMPLES)

The annotation of a field decides how it is parsed: `bool` is a switch, `X | None` is optional,
`tuple[X, ...]` may be repeated and `tuple[X, X]` takes two values. A field without `option` is not
an option; a derived class may declare it as one. Only this module uses argparse.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import MISSING, Field, fields, replace
from functools import partial
from pathlib import Path
from types import UnionType
from typing import (
    TYPE_CHECKING,
    Any,
    Final,
    Generic,
    NoReturn,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

from armadico.config.declared import (
    DECLARED,
    FILE,
    PORT,
    POSE,
    RECORDING,
    Added,
    BadValueError,
    Group,
    Must,
    Option,
    added,
    argument,
    at_least,
    between,
    ends_with,
    flag,
    flag_of,
    flags_of,
    given,
    group,
    more_than,
    option,
    several,
)
from armadico.core.errors import nearest
from armadico.core.installed import version_of

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

__all__ = [
    "FILE",
    "PORT",
    "POSE",
    "RECORDING",
    "ArgumentParser",
    "BadValueError",
    "Command",
    "Must",
    "UsageError",
    "added",
    "argument",
    "at_least",
    "between",
    "ends_with",
    "flag",
    "flags_of",
    "given",
    "group",
    "more_than",
    "option",
    "parser",
    "several",
    "together",
    "version",
]
"""What a command imports, with the declarations of `armadico.config.declared`."""

T = TypeVar("T", bound="DataclassInstance")

NEGATIVE: Final = re.compile(r"-((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|inf(inity)?|nan)$", re.IGNORECASE)
"""A negative number: a value, not an option."""


class ArgumentParser(argparse.ArgumentParser):
    """A parser whose errors are one line, instead of the usage of thirty options."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As in argparse; the first unknown option ends it, with the nearest one that exists."""
        words = sys.argv[1:] if args is None else list(args)
        for word in words[: words.index("--") if "--" in words else None]:
            if word[:1] != "-" or word == "-" or " " in word or NEGATIVE.match(word):
                continue  # argparse takes it for a value
            name = word.partition("=")[0] if word.startswith("--") else word[:2]
            if name not in self._option_string_actions:
                self._no_such_option(name)
        return super().parse_known_args(args, namespace)

    def _no_such_option(self, name: str) -> NoReturn:
        shown = (a.option_strings for a in self._actions if a.help != argparse.SUPPRESS)
        flags = {flag[2:] for each in shown for flag in each if flag.startswith("--")}
        near = nearest(name.lstrip("-"), flags)  # the dashes alone are no likeness
        todo = f"did you mean --{near}?" if near else f"see {self.prog} --help"
        self.error(f"{name}: no such option; {todo}")

    def error(self, message: str) -> NoReturn:
        """Print one line and exit with 2."""
        self.exit(2, f"{self.prog}: error: {message}\n")


class UsageError(Exception):
    """The command line is wrong."""


class Command(Generic[T]):
    """A command, which an entry point of `armadico.commands` names; call it with the words."""

    def __init__(
        self,
        program: str,
        options: type[T],
        run: Callable[[T], int],
        description: str,
        examples: str,
        refused: Callable[[T, UsageError], None] | None = None,
    ) -> None:
        """`refused` is called with options whose value breaks a `Must`."""
        self.program, self.options, self.run = program, options, run
        self.description, self.examples, self.refused = description, examples, refused

    def __call__(self, argv: Sequence[str]) -> int:
        return self.run(self.parse(argv))

    def parse(self, argv: Sequence[str]) -> T:
        """Parse the words. Raises UsageError, or SystemExit as argparse does."""
        found = _built(self.options, self.parser().parse_args(argv))
        try:
            _check(found)
        except UsageError as error:
            if self.refused is not None:
                self.refused(found, error)
            raise
        return _turned(found)

    def parser(self) -> ArgumentParser:
        examples = (self.examples, *_examples(self.options, self.program))
        made = parser(self.program, self.description, "".join(examples))
        _declare(made, self.options)
        return made


def version() -> str:
    """The installed version."""
    return version_of("armadico")


def parser(program: str, description: str, examples: str) -> ArgumentParser:
    """A parser whose help ends with examples."""
    made = ArgumentParser(
        prog=program,
        description=description,
        epilog="examples:\n" + examples,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,  # --seed is not --seeds
    )
    # argparse would take -1e5 and -inf for unknown options.
    made._negative_number_matcher = NEGATIVE
    made.add_argument("--version", action="version", version=f"armadico {version()}")
    return made


def together(
    program: str, commands: Iterable[tuple[str, str, ArgumentParser | None]], complete: object
) -> ArgumentParser:
    """One parser of several commands (name, summary, parser), for shell completion.

    `complete` is shtab's completion of options that take a file.
    """
    made = ArgumentParser(prog=program)
    below = made.add_subparsers()
    for name, summary, of in commands:
        parents = [] if of is None else [of]
        for action in [] if of is None else of._actions:
            if action.type is Path:
                action.complete = complete  # type: ignore[attr-defined]
        below.add_parser(name, help=summary, parents=parents, add_help=not parents)
    return made


def _examples(kind: type, program: str) -> Iterator[str]:
    """The examples of a program with options that packages add."""
    for each in fields(kind):
        if isinstance(declared := each.metadata.get(DECLARED), Added):
            lines = (line for other in declared.find(flags_of(kind)) for line in other.examples)
            yield from (f"  {line}\n" for line in lines if line.startswith(f"{program} "))


def _place(kind: type) -> str:
    """The prefix of an added dataclass: another one may have a field of the same name."""
    return f"{kind.__module__}.{kind.__qualname__}."


def _declare(made: argparse._ActionsContainer, kind: type, place: str = "") -> None:
    """Add the options of a dataclass to a parser or a group; `place` is before their names."""
    hints, alternatives = get_type_hints(kind), dict[str, argparse._MutuallyExclusiveGroup]()
    for each in fields(kind):
        declared = each.metadata.get(DECLARED)
        if isinstance(declared, Group):
            titled = bool(declared.title)
            group = made.add_argument_group(declared.title) if titled else made
            _declare(group, declared.kind, place)
        elif isinstance(declared, Added):
            groups: dict[str, argparse._ArgumentGroup] = {}
            for other in declared.find(flags_of(kind)):
                below = groups.get(other.title) or made.add_argument_group(other.title)
                groups[other.title] = below
                _declare(below, other, _place(other))
        elif isinstance(declared, Option):
            into = made
            if declared.either:
                into = alternatives.get(declared.either) or made.add_mutually_exclusive_group()
                alternatives[declared.either] = into
            how = _reading(hints[each.name]) | declared.keywords
            if "nargs" in declared.keywords:  # then the option is not repeated
                how.pop("action", None)
            if declared.keywords["help"] is None:
                how["help"] = argparse.SUPPRESS
            if declared.read is not None:
                how["type"] = partial(_read, declared.read)
            if declared.positional:
                into.add_argument(place + each.name, **how, **_default(each))
            else:
                flags = declared.flags or (flag_of(each.name),)
                if place and "choices" not in how and how.get("action") != "store_true":
                    how.setdefault("metavar", each.name.upper())
                into.add_argument(*flags, dest=place + each.name, **how, **_default(each))


def _read(read: Callable[[str], object], text: str) -> object:
    try:
        return read(text)
    except BadValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _reading(hint: object) -> dict[str, Any]:
    """How argparse reads what is annotated so."""
    inner = get_args(hint)
    if get_origin(hint) is UnionType:
        return _reading(next(each for each in inner if each is not type(None)))
    if get_origin(hint) is Sequence or inner[1:] == (Ellipsis,):
        return {"action": "append", **_reading(inner[0])}
    if get_origin(hint) is tuple:
        return {"nargs": len(inner), **_reading(inner[0])}
    if hint is bool:
        return {"action": "store_true"}
    return {} if hint is str else {"type": hint}


def _default(each: Field[object]) -> dict[str, Any]:
    """The default of a field for argparse, which copies a list and appends to it."""
    if each.default_factory is not MISSING:
        return {"default": each.default_factory()}
    if each.default is MISSING:
        return {}
    return {"default": list(each.default) if each.default == () else each.default}


def _built(kind: type[T], found: argparse.Namespace, place: str = "") -> T:
    """The dataclass with the parsed values."""
    values: dict[str, object] = {}
    for each in fields(kind):
        declared = each.metadata.get(DECLARED)
        if isinstance(declared, Group):
            values[each.name] = _built(declared.kind, found, place)
        elif isinstance(declared, Added):
            kinds = declared.find(flags_of(kind))
            values[each.name] = tuple(_built(other, found, _place(other)) for other in kinds)
        elif isinstance(declared, Option):
            values[each.name] = _frozen(getattr(found, place + each.name))
    return kind(**values)


def _check(options: DataclassInstance) -> None:
    """Raises UsageError for a value that breaks its `Must`."""
    for each in fields(options):
        declared, value = each.metadata.get(DECLARED), getattr(options, each.name)
        if isinstance(declared, Group):
            _check(value)
        if isinstance(declared, Added):
            for other in value:
                _check(other)
        if not isinstance(declared, Option) or declared.must is None or value is None:
            continue
        if not declared.must.holds(value):
            flag = "" if declared.positional else f"{(*declared.flags, flag_of(each.name))[0]} "
            raise UsageError(f"{flag}{_shown(value)}: {declared.must.words}")


def _turned(options: T) -> T:
    """The options in the units of their fields."""
    values: dict[str, object] = {}
    for each in fields(options):
        declared, value = each.metadata.get(DECLARED), getattr(options, each.name)
        if isinstance(declared, Group):
            values[each.name] = _turned(value)
        if isinstance(declared, Option) and declared.turned is not None and value is not None:
            values[each.name] = declared.turned(value)
    return replace(options, **values)


def _shown(value: object) -> str:
    if isinstance(value, tuple):
        return " ".join(map(_shown, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _frozen(value: object) -> object:
    return tuple(map(_frozen, value)) if isinstance(value, list) else value
