"""Write the package of a new agent, robot, resource or task of your own; it works as it is."""

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
from armadico.config.shipped import folder
from armadico.core.discovery import AGENTS, ROBOTS, TASKS, installed, owners

KINDS: Final = {
    "behaviour": "it competes for the wheels",
    "sensor": "it publishes what it computes from sensor data",
    "planner": "it plans paths to a goal",
}
"""The kinds of agent; the first is the default."""

AGENT: Final = {
    "pyproject.toml": "pyproject",
    "{module}.py": "{which}",
    "test_{module}.py": "{which}-test",
}
FILES: Final = {
    "agent": AGENT,
    "resource": {**AGENT, "pyproject.toml": "resource-pyproject"},
    "robot": {
        "pyproject.toml": "robot-pyproject",
        "{module}/__init__.py": "robot-init",
        "{module}/kind.py": "robot-kind",
        "{module}/driver.py": "robot-driver",
        "{module}/simulator.py": "robot-simulator",
        "{module}/{name}.toml": "robot-profile",
        "test_{module}.py": "robot-test",
    },
    "task": {**AGENT, "pyproject.toml": "task-pyproject", "mission.toml": "task-mission"},
}
"""The files of each package, and their templates (`configs/new`)."""

GROUPS: Final = {"agent": AGENTS, "resource": AGENTS, "robot": ROBOTS, "task": TASKS}
"""Where its name is looked up."""

EXAMPLES: Final = """\
  armadico new agent weaver                       it drives: competes for the wheels
  armadico new agent room-finder --kind sensor    it publishes what it computes from the sonars
  armadico new agent way-round --kind planner     it plans the robot's paths
  armadico new robot my-robot                     a driver, a simulator and a profile
  armadico new resource lamp                      an owner, and two agents that compete for it
  armadico new task greet                         a step of missions
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
    what: str = argument("what to create", choices=list(FILES))
    name: str = argument("its name, such as wall-follower", metavar="NAME")
    kind: str = option(
        "of an agent: " + "; ".join(starmap("{}: {}".format, KINDS.items())) + " (default:"
        " %(default)s)",
        default=next(iter(KINDS)),
        choices=KINDS,
    )
    into: Path = option(
        "write into this folder (default: this folder)", default=Path(), metavar="FOLDER"
    )


def run(args: Options) -> int:
    where: Path = args.into / args.name
    which = args.kind if args.what == "agent" else args.what
    written = package(args.name, which, args.what)
    if not args.into.is_dir():
        raise UsageError(f"--into {args.into}: no such folder")
    try:
        where.mkdir()
    except FileExistsError:
        raise FailedError(f"{where} exists already; nothing was written") from None
    for name, text in written.items():
        (where / name).parent.mkdir(exist_ok=True)
        (where / name).write_text(text, encoding="utf-8")
    print(_next(args.name, which, where, list(written)))
    return 0


def package(name: str, which: str, what: str = "agent") -> dict[str, str]:
    """The texts of a package's files by name. Raises UsageError for an invalid name."""
    article = "an" if what[0] in "aeiou" else "a"
    bad = f"{name!r} cannot be {article} {what}'s name"
    if not NAME.fullmatch(name) or len(name) > LONGEST:
        better = _better(name)
        hint = ""
        if NAME.fullmatch(better):
            with suppress(UsageError):  # the suggestion may be taken
                package(better, which, what)
                hint = f"; did you mean {better!r}?"
        raise UsageError(
            f"{bad}; expected lower-case letters, digits and single"
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
        for to, of in FILES[what].items()
    }
    if taken := _taken(filled, texts.values(), what):
        raise UsageError(f"{bad}: {taken}")
    return {
        to.format(module=module, name=name): Template(text).substitute(filled)
        for to, text in texts.items()
    }


def _better(name: str) -> str:
    """The name in allowed characters."""
    plain = normalize("NFKD", name.translate(GERMAN)).encode("ascii", "ignore").decode()
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", plain).lower()
    return re.sub(r"[^a-z0-9]+", "-", words).strip("-0123456789")[:LONGEST].strip("-")


def _taken(filled: dict[str, str], texts: Iterable[str], what: str) -> str:
    """Why the name conflicts with another one, or ""."""
    name, module, kind = filled["name"], filled["module"], filled["kind"]
    known = installed(GROUPS[what]).get(module if what == "robot" else name)
    if known is not None:
        return f"a plug-in of this name is installed, by {known.package or 'its own package'}"
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
    last = (f"armadico-agent {name}", "join a running society")
    if which == "robot":
        run = f"armadico run sc1 --virtual --profile {name}"
        last = (f"armadico sim {name} sc1 --port 8102", "serve its simulator")
    if which == "resource":
        run = "armadico run sc2 --virtual" + "".join(
            f" --with {each}" for each in (name, f"{name}-idle", f"{name}-near")
        )
    if which == "task":
        run = f"armadico mission run {there}/mission.toml --virtual"
        last = ("armadico mission list", "list the missions")
    if which == "planner":  # a society has one planner
        from armadico.config.scenarios import society
        from armadico.mobile.resources import PLANNER

        run += "".join(f" --without {other}" for other in owners(society().agents, PLANNER))
    rows = [
        (f"pip install -e {there}'[test]'", "install it; edits take effect at the next start"),
        (f"python -m pytest {there}", "run its test"),
        (run, "run it in a scenario"),
        last,
    ]
    width = max(len(command) for command, _ in rows)
    lines = [f"  {command:<{width}}   # {what}" for command, what in rows]
    return f"{where}: {', '.join(written)}\n\nnext:\n" + "\n".join(lines)


main: Final = Command(
    "armadico new",
    Options,
    run,
    "Write a package into a folder of that name: the code, its test, and its entry point. It works"
    " as it is; change it from there.",
    EXAMPLES,
)
