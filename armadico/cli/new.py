"""Write the beginning of an agent of your own: a package with a test, which works as it is."""

from __future__ import annotations

import keyword
import re
import shlex
import sys
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import starmap
from pathlib import Path
from string import Template
from typing import Final
from unicodedata import normalize

from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, argument, option
from armadico.config.discovery import AGENTS, installed, owners
from armadico.config.shipped import folder

KINDS: Final = {
    "behaviour": "it contends for the wheels",
    "sensor": "it publishes what it makes of what it hears",
    "planner": "it says which way leads to a goal",
}
"""The first is what is written unless another is asked for."""

FILES: Final = {
    "pyproject.toml": "pyproject",
    "{module}.py": "{which}",
    "test_{module}.py": "{which}-test",
}
"""What is written, and from which of the shipped beginnings (`configs/new`)."""

EXAMPLES: Final = """\
  armadico new agent weaver                       it drives: contends for the wheels
  armadico new agent room-finder --kind sensor    it tells the others what it makes of the sonars
  armadico new agent way-round --kind planner     it plans the robot's ways
"""

NAME: Final = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")

DRIVES: Final = "rooms-a"
"""A scenario that each of them can take part in."""

GERMAN: Final = str.maketrans(
    {"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue"}
)
"""Umlauts as they are written without; of other letters their marks are left out."""

LONGEST: Final = 40
"""Characters of a name: it stands on keys, in tables and in names of files."""


@dataclass(frozen=True, kw_only=True)
class Options:
    what: str = argument("what is begun", choices=["agent"])
    name: str = argument("the agent's, such as wall-follower", metavar="NAME")
    kind: str = option(
        "; ".join(starmap("{}: {}".format, KINDS.items())) + " (default: %(default)s)",
        default=next(iter(KINDS)),
        choices=KINDS,
    )
    into: Path = option("where (default: here)", default=Path(), metavar="FOLDER")


def run(args: Options) -> int:
    where: Path = args.into / args.name
    written = package(args.name, args.kind)
    if not args.into.is_dir():
        raise UsageError(f"--into {args.into}: there is no such folder")
    try:
        where.mkdir()
    except FileExistsError:
        raise FailedError(f"{where} is there already: nothing was written") from None
    for name, text in written.items():
        (where / name).write_text(text, encoding="utf-8")
    print(_next(args.name, args.kind, where, list(written)))
    return 0


def package(name: str, which: str) -> dict[str, str]:
    """The files of a package, by their names. Raises UsageError for a name that will not do."""
    if not NAME.fullmatch(name) or len(name) > LONGEST:
        better = _better(name)
        hint = ""
        if NAME.fullmatch(better):
            with suppress(UsageError):  # or that would not do either
                package(better, which)
                hint = f"; {better!r} would"
        raise UsageError(
            f"{name!r} will not do: small letters, digits and single hyphens, a letter first,"
            f" at most {LONGEST} in all{hint}"
        )
    module = name.replace("-", "_")
    filled = {
        "name": name,
        "module": module,
        "kind": "".join(part.capitalize() for part in name.split("-")),
    }
    texts = {
        to: (folder("new") / f"{of.format(which=which)}.txt").read_text("utf-8")
        for to, of in FILES.items()
    }
    if taken := _taken(filled, texts.values()):
        raise UsageError(f"{name!r} will not do: {taken}")
    return {
        to.format(module=module): Template(text).substitute(filled) for to, text in texts.items()
    }


def _better(name: str) -> str:
    """What was meant, in the letters that may be."""
    plain = normalize("NFKD", name.translate(GERMAN)).encode("ascii", "ignore").decode()
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", plain).lower()
    return re.sub(r"[^a-z0-9]+", "-", words).strip("-0123456789")[:LONGEST].strip("-")


def _taken(filled: dict[str, str], texts: Iterable[str]) -> str:
    """Whose name it is already, where it could not be told from another's."""
    name, module, kind = filled["name"], filled["module"], filled["kind"]
    if known := installed(AGENTS).get(name):
        return f"an agent of that name is installed, by {known.package or 'a package of its own'}"
    if keyword.iskeyword(module) or keyword.iskeyword(kind):
        return "Python means something by it"
    if module in sys.stdlib_module_names or find_spec(module) is not None:
        return f"Python would find the module {module!r} that is there already"
    if any(re.search(rf"(?<!\$)\b({kind}|{module})\b", text) for text in texts):
        return f"{kind} is the name of something that it needs"
    return ""


def _next(name: str, which: str, where: Path, written: list[str]) -> str:
    """What was written, and what to type now."""
    there = shlex.quote(f"{where}" if where.is_absolute() else f"./{where}")
    run = f"armadico run {DRIVES} --virtual --with {name}"
    if which == "planner":  # of which there is one at a time
        from armadico.config.scenarios import society
        from armadico.mobile.resources import PLANNER

        run += "".join(f" --without {other}" for other in owners(society().agents, PLANNER))
    rows = [
        (f"pip install -e {there}'[test]'", "it is known by its name; what you edit is what runs"),
        (f"python -m pytest {there}", "its test"),
        (run, "it takes part"),
        (f"armadico-agent {name}", "it joins a society that is up"),
    ]
    width = max(len(command) for command, _ in rows)
    lines = [f"  {command:<{width}}   # {what}" for command, what in rows]
    return f"{where}: {', '.join(written)}\n\nnext:\n" + "\n".join(lines)


main: Final = Command(
    "armadico new",
    Options,
    run,
    "Write a package of your own into a folder of its name: an agent, its test, and what makes"
    " it known. It works as it is, to be changed from there.",
    EXAMPLES,
)
