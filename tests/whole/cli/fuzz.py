"""Commands called with options that make no sense: python fuzz.py SEED CASES COMMAND...

Each command's own parser says what it takes. Everything happens in this process, from where no
mesh is joined, no process started and no window opened; what would take longer gets a Ctrl-C, which
is one more thing that must end in order. Prints what a user would have seen a traceback of.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import random
import resource
import signal
import subprocess
import sys
import traceback
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from typing import Any, NoReturn

from cyclonedds.idl import IdlStruct

import armadico
import armadico_tools
from armadico import __main__, cli
from armadico.cli import completion, pool
from armadico.cli.options import FailedError
from armadico.core.discovery import AGENTS, COMMANDS, installed
from armadico.mesh.topology import MeshError
from armadico.mesh.zenoh import ZenohMesh
from armadico.runtime import process

PATIENCE_S = 0.1
"""Then it is interrupted."""

MEMORY = 6 << 30
"""What reads a device that has no end should end before the machine does."""

IN_PASSING = "Exception ignored in"
"""Python's word of a Ctrl-C that meets a destructor, which nobody can take."""

NUMBERS = ("-1", "0", "1", "0.5", "1e309", "nan", "-inf", "9" * 30, "1e6", "-3.5", "90")
TEXTS = (
    "",
    " ",
    "[/nope]",
    "[red]",
    "a\x1b[31m\nb",
    "\udcff",
    "é",
    "{",
    "%s",
    "a" * 5000,
    "*",
    "**/**",
)
PATHS = (
    *("..", ".", "/", "\\", "/dev/full", "/dev/null", "/no/such/file", "out.png", "out.rrd"),
    *(
        f"{name}.{kind}"
        for name in ("no", "junk", "empty", "ok")
        for kind in ("toml", "map", "mcap")
    ),
)
ADDRESSES = (
    *("tcp/127.0.0.1:1", "tcp/[::1", "tcp://", "tcp://127.0.0.1:1", "tcp://1:99999999", "::"),
    *("serial://", "serial:///dev/null", "serial:///no/such"),
)
NAMES = (
    "sc1",
    "goto",
    "goto+goto",
    "a+b",
    "demo",
    "localhost",
    "robot1",
    "pioneer-2dx",
    "thesis",
    "csv",
)
SETTINGS = ("=", "x=", "x=y=z", "goto.=", "v_max=nan", "goto.v_max=[", "x=1", "zones.stop=0.1")
VALUES = (NUMBERS, TEXTS, PATHS, ADDRESSES, NAMES, SETTINGS)


def main(seed: str, cases: str, *names: str) -> None:
    """So many calls of each command; without names of all."""
    for package in (armadico, armadico_tools):  # an import that Ctrl-C ends halfway cannot go on
        for module in walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith((".__main__", ".child")):
                import_module(module.name)
    for found in installed(AGENTS).values():
        found.load()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    _cut_off()
    kinds = IdlStruct.__subclasses__()
    while kinds:  # DDS describes its types once; nor can that go on halfway
        kind = kinds.pop()
        kinds += kind.__subclasses__()
        kind.__idl__.populate()
    _put_files()
    rng = random.Random(int(seed))
    for name, found in installed(COMMANDS).items():
        for _ in range(int(cases)) if not names or name in names else ():
            words = [name, *_words(rng, completion.parser_of(found))]
            fault = _call(words)
            if fault:
                sys.stdout.write(f"{words}: {fault}\n")


def _call(words: list[str]) -> str:
    """What is wrong with how it ended; nothing, if nothing is."""
    out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors=__main__.UNPRINTABLE)
    said = io.StringIO()
    code: Any = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(said):
            signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
            try:
                code = cli.main(words)
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
    except SystemExit as end:  # argparse
        code = end.code
    except KeyboardInterrupt:
        pass  # while an error was being told; `armadico.__main__` takes it
    except BaseException:
        return traceback.format_exc()
    if "Traceback" in said.getvalue() and IN_PASSING not in said.getvalue():
        return said.getvalue()
    return "" if code in (0, 1, 2, 130) else f"exit code {code}"


def _words(rng: random.Random, made: argparse.ArgumentParser) -> list[str]:
    """A command line of a parser: too few options or too many, and whatever values."""
    actions = [
        action
        for action in made._actions
        if not isinstance(action, argparse._HelpAction | argparse._VersionAction)
    ]
    words: list[str] = []
    for action in actions:
        if not action.option_strings:
            words += _values(rng, action)
    options = [action for action in actions if action.option_strings]
    chosen = rng.sample(options, min(len(options), rng.choice((0, 1, 1, 2, 3))))
    chosen += [action for action in options if action.required and action not in chosen]
    for action in chosen:
        option, values = action.option_strings[-1], _values(rng, action)
        words += [f"{option}={values[0]}"] if action.nargs is None else [option, *values]
    return words


def _values(rng: random.Random, action: argparse.Action) -> list[str]:
    counts = {None: (1,), "?": (0, 1), "*": (0, 1, 2), "+": (1, 2)}
    count = action.nargs if isinstance(action.nargs, int) else rng.choice(counts[action.nargs])
    return list(_each(rng, action, count))


def _each(rng: random.Random, action: argparse.Action, count: int) -> Iterator[str]:
    for _ in range(count):
        known = list(action.choices or ())
        yield rng.choice(known if known and rng.random() < 0.8 else rng.choice(VALUES))


def _cut_off() -> None:
    """No mesh, no other process, and nobody served."""

    def no_mesh(_self: ZenohMesh) -> NoReturn:
        raise MeshError("there is no mesh here")

    def nothing(*_: object, **__: object) -> NoReturn:
        raise FailedError("nothing is started here")

    ZenohMesh.open = no_mesh  # type: ignore[method-assign]
    subprocess.Popen.__init__ = nothing  # type: ignore[method-assign, assignment]
    process.serve = nothing  # type: ignore[assignment]
    pool.ProcessPoolExecutor = nothing  # type: ignore[misc, assignment]


def _put_files() -> None:
    """In the current folder."""
    scenario = 'world = "sc1"\nstart = [0, 0, 0]\ngoal = [2, 0, 0]\n'
    walls = "2D-Map\nLineMinPos: a b\nLINES\n1 2\nnan nan 1e999 2\n"
    for kind in ("toml", "map", "mcap"):
        Path(f"empty.{kind}").touch()
        Path(f"junk.{kind}").write_bytes(b"\xff\xfe\x00[[" * 400)
    Path("ok.toml").write_text(scenario, encoding="utf-8")
    Path("ok.map").write_text(walls, encoding="utf-8")
    os.environ["HOME"] = str(Path.cwd())


if __name__ == "__main__":
    main(*sys.argv[1:])
