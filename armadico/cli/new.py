"""Write the package of a new agent of your own, with a test; it works as it is."""

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
    "behaviour": "it competes for the wheels",
    "sensor": "it publishes what it computes from sensor data",
    "planner": "it plans paths to a goal",
}
"""The kinds of agent; the first is the default."""

FILES: Final = {
    "pyproject.toml": "pyproject",
    "{module}.py": "{which}",
    "test_{module}.py": "{which}-test",
}
"""The files of the package, and their templates (`configs/new`)."""

EXAMPLES: Final = """\
  armadico new agent weaver                       it drives: competes for the wheels
  armadico new agent room-finder --kind sensor    it publishes what it computes from the sonars
  armadico new agent way-round --kind planner     it plans the robot's paths
"""

NAME: Final = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")

DRIVES: Final = "rooms-a"
"""A scenario that suits each kind."""

GERMAN: Final = str.maketrans(
    {"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue"}
)
"""Transliteration of umlauts; other letters only lose their diacritics."""

LONGEST: Final = 40
"""Most characters of a name: it is part of keys, tables and file names."""


@dataclass(frozen=True, kw_only=True)
class Options:
    what: str = argument("what to create", choices=["agent"])
    name: str = argument("the agent's name, such as wall-follower", metavar="NAME")
    kind: str = option(
        "; ".join(starmap("{}: {}".format, KINDS.items())) + " (default: %(default)s)",
        default=next(iter(KINDS)),
        choices=KINDS,
    )
    into: Path = option(
        "write into this folder (default: this folder)", default=Path(), metavar="FOLDER"
    )


def run(args: Options) -> int:
    where: Path = args.into / args.name
    written = package(args.name, args.kind)
    if not args.into.is_dir():
        raise UsageError(f"--into {args.into}: no such folder")
    try:
        where.mkdir()
    except FileExistsError:
        raise FailedError(f"{where} exists already; nothing was written") from None
    for name, text in written.items():
        (where / name).write_text(text, encoding="utf-8")
    print(_next(args.name, args.kind, where, list(written)))
    return 0


def package(name: str, which: str) -> dict[str, str]:
    """The texts of a package's files by name. Raises UsageError for an invalid agent name."""
    if not NAME.fullmatch(name) or len(name) > LONGEST:
        better = _better(name)
        hint = ""
        if NAME.fullmatch(better):
            with suppress(UsageError):  # the suggestion may be taken
                package(better, which)
                hint = f"; did you mean {better!r}?"
        raise UsageError(
            f"{name!r} cannot be an agent's name; expected lower-case letters, digits and single"
            f" hyphens, a letter first, at most {LONGEST} characters{hint}"
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
        raise UsageError(f"{name!r} cannot be an agent's name: {taken}")
    return {
        to.format(module=module): Template(text).substitute(filled) for to, text in texts.items()
    }


def _better(name: str) -> str:
    """The name in allowed characters."""
    plain = normalize("NFKD", name.translate(GERMAN)).encode("ascii", "ignore").decode()
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", plain).lower()
    return re.sub(r"[^a-z0-9]+", "-", words).strip("-0123456789")[:LONGEST].strip("-")


def _taken(filled: dict[str, str], texts: Iterable[str]) -> str:
    """Why the name conflicts with another one, or ""."""
    name, module, kind = filled["name"], filled["module"], filled["kind"]
    if known := installed(AGENTS).get(name):
        return f"an agent of this name is installed, by {known.package or 'its own package'}"
    if keyword.iskeyword(module) or keyword.iskeyword(kind):
        return "it is a keyword of Python"
    if module in sys.stdlib_module_names or find_spec(module) is not None:
        return f"a module {module!r} exists already"
    if any(re.search(rf"(?<!\$)\b({kind}|{module})\b", text) for text in texts):
        return f"{kind} is used in the template"
    return ""


def _next(name: str, which: str, where: Path, written: list[str]) -> str:
    """The written files, and the next commands."""
    there = shlex.quote(f"{where}" if where.is_absolute() else f"./{where}")
    run = f"armadico run {DRIVES} --virtual --with {name}"
    if which == "planner":  # a society has one planner
        from armadico.config.scenarios import society
        from armadico.mobile.resources import PLANNER

        run += "".join(f" --without {other}" for other in owners(society().agents, PLANNER))
    rows = [
        (f"pip install -e {there}'[test]'", "install it; edits take effect at the next start"),
        (f"python -m pytest {there}", "run its test"),
        (run, "run it in a scenario"),
        (f"armadico-agent {name}", "join a running society"),
    ]
    width = max(len(command) for command, _ in rows)
    lines = [f"  {command:<{width}}   # {what}" for command, what in rows]
    return f"{where}: {', '.join(written)}\n\nnext:\n" + "\n".join(lines)


main: Final = Command(
    "armadico new",
    Options,
    run,
    "Write a package into a folder of the agent's name: the agent, its test, and its entry point."
    " It works as it is; change it from there.",
    EXAMPLES,
)
