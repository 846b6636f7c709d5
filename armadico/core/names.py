"""The names of an agent's base classes, which a class of the user must not take.

An agent's methods and attributes share one name space with those of its base classes. A
`self.route = None` would replace the path of a behaviour, and a `def log` its log lines, without an
error until it is called. So such a class is refused when it is made.

Attributes are found in the compiled code (`self.x = ...`), so that nothing is checked while the
agent runs.
"""

from __future__ import annotations

import dis
import re
from collections.abc import Iterable, Iterator
from inspect import get_annotations, isfunction, signature, unwrap
from types import CodeType
from typing import Final

HOOKS: Final = frozenset(
    (
        *(
            "bid",
            "bid_for",
            "begins",
            "obey",
            "rest",
            "measure",
            "beyond",
            "unavailable",
            "why",
            "lacks",
        ),
        *("fill_card", "key_names"),
    )
)
"""The methods and attributes of `Agent` that a subclass may replace, besides declarations
(`ClassVar`) and handlers (`on_...`)."""

MOVED: Final = {
    "stop": "on_leave",
    "start": "on_start",
    "card": "fill_card",
    "receive": "on_message",
    "key_of": "key_names",
}
"""What was overridden before the kernel had it, and the hook that replaces it."""

STORE: Final = dis.opmap["STORE_ATTR"]
LOADS: Final = {
    code for name, code in dis.opmap.items() if "LOAD_FAST" in name or "LOAD_DEREF" in name
}
PAIRS: Final = {code for name, code in dis.opmap.items() if name.count("_FAST") == 2}

_TAKEN: Final = "_taken"
"""Attribute of a base class: the names that its subclasses must not take."""


def taken(cls: type) -> frozenset[str]:
    """Return the names that a subclass of a class must not take."""
    found: frozenset[str] = getattr(cls, _TAKEN, frozenset())
    return found


def take(cls: type, hooks: Iterable[str] = ()) -> None:
    """Make a class a base class: its names are taken as well, except `hooks`."""
    free = {*hooks, _TAKEN}
    for each in cls.__mro__:
        free |= {name for name, kind in get_annotations(each).items() if "ClassVar" in str(kind)}
    own = {*vars(cls), *(name for name, _ in stored(cls))} - free
    own = {name for name in own if not (_is_hook(name) or _is_dunder(name))}
    setattr(cls, _TAKEN, taken(cls) | own)


def check(cls: type, overrides: Iterable[str] = ()) -> None:
    """Raise TypeError if a class takes a name of its base classes, except `overrides`."""
    names = taken(cls)
    found: dict[str, str] = {}
    for each in reversed(cls.__mro__):
        if each is object or (each is not cls and taken(each)):
            continue  # it was checked when it was made; a mix-in was not
        for name, value in vars(each).items():
            if name in names:
                line = _line(value)
                found[name] = f"{name} (line {line})" if line else name
        found |= {name: f"self.{name} (line {at})" for name, at in stored(each) if name in names}
    for name in overrides:
        if name not in names:
            hint = f"; its work is done in {MOVED[name]!r} now" if name in MOVED else ""
            raise TypeError(
                f"the class {cls.__qualname__} overrides {name!r}, which no base class has{hint}"
            )
        found.pop(name, None)
    if found:
        raise TypeError(_refusal(cls, found.values()))


def handler_name(message: type) -> str:
    """Return the name of the method that receives a message, `on_plan_request`."""
    snake = re.sub(r"(?<!^)(?=[A-Z])", "_", message.__name__).lower()
    return f"on_{snake}"


def check_answers(cls: type, answers: Iterable[type]) -> None:
    """Raise TypeError if the handler of a query does not take the request and the question."""
    for request in answers:
        name = handler_name(request)
        handler = vars(cls).get(name)
        if handler is None or not isfunction(handler):
            continue
        try:
            signature(handler).bind(None, None, None)
        except TypeError:
            raise TypeError(
                f"{cls.__qualname__}.{name} (line {_line(handler)}) must take the request and the"
                f" question: def {name}(self, request: {request.__name__}, question: Question)"
            ) from None


def stored(cls: type) -> Iterator[tuple[str, int]]:
    """Yield the attributes that a class's methods set on their first argument, with the lines."""
    for value in vars(cls).values():
        if isinstance(value, (classmethod, staticmethod)):
            continue
        for function in (value, *(getattr(value, each, None) for each in ("fget", "fset"))):
            code = getattr(unwrap(function) if callable(function) else function, "__code__", None)
            if code is not None and code.co_argcount and not isinstance(function, type):
                yield from _stores(code, code.co_varnames[0])


def _stores(code: CodeType, me: str) -> Iterator[tuple[str, int]]:
    # `dis` would cost 3 ms for each class. Instructions are two bytes: opcode and argument.
    steps, at = code.co_code, -1
    cells = (each for each in code.co_cellvars if each not in code.co_varnames)
    variables = (*code.co_varnames, *cells, *code.co_freevars)
    while (at := steps.find(STORE, at + 1)) >= 0:
        if at % 2:
            continue
        attribute, before = _argument(steps, at)
        if steps[before] in LOADS:
            variable, _ = _argument(steps, before)
            if steps[before] in PAIRS:
                variable &= 15  # of two variables the last is on top
            if variables[variable] == me:
                yield code.co_names[attribute], _line_at(code, at)
    for each in code.co_consts:
        if isinstance(each, CodeType) and me in each.co_freevars:
            yield from _stores(each, me)


def _argument(steps: bytes, at: int) -> tuple[int, int]:
    """Return an instruction's argument, and where the one before begins."""
    value, shift, at = steps[at + 1], 8, at - 2
    while at >= 0 and steps[at] == dis.EXTENDED_ARG:
        value, shift, at = value | steps[at + 1] << shift, shift + 8, at - 2
    return value, at


def _line_at(code: CodeType, at: int) -> int:
    found = (line for first, last, line in code.co_lines() if first <= at < last and line)
    return next(found, code.co_firstlineno)


def _refusal(cls: type, found: Iterable[str]) -> str:
    public = sorted(name for name in taken(cls) if not name.startswith("_"))
    return (
        f"the class {cls.__qualname__} takes names of the framework: {', '.join(found)}."
        f" Choose other names. Taken are: {', '.join(public)}"
    )


def _is_dunder(name: str) -> bool:
    return name.startswith("__") and name.endswith("__")


def _is_hook(name: str) -> bool:
    return name in HOOKS or name.startswith("on_")


def _line(value: object) -> int:
    inner = getattr(value, "__func__", None) or getattr(value, "fget", None) or value
    code = getattr(inner, "__code__", None)
    return 0 if code is None else code.co_firstlineno
