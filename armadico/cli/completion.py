"""Print a completion script for bash, zsh or fish."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Final

import shtab

from armadico.cli import options
from armadico.config.discovery import COMMANDS, Found, installed

EXAMPLES: Final = """\
  source <(armadico completion bash)
  armadico completion zsh > ~/.zfunc/_armadico
  armadico completion fish > ~/.config/fish/completions/armadico.fish
"""

SHELLS: Final = ("bash", "zsh", "fish")


def main(argv: Sequence[str]) -> int:
    args = parser().parse_args(argv)
    print(shtab.complete(everything(), args.shell))
    return 0


def parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico completion",
        "Print a script that has a shell complete commands, options and their values. It is made"
        " from the commands that are installed, other packages' too.",
        EXAMPLES,
    )
    made.add_argument("shell", choices=SHELLS, help="which shell")
    return made


def everything() -> argparse.ArgumentParser:
    """One parser with all commands that are installed, each with its own options."""
    made = argparse.ArgumentParser(prog="armadico")
    commands = made.add_subparsers()
    for name, found in installed(COMMANDS).items():
        parents = [each for each in (_parser_of(found),) if each is not None]
        for parent in parents:
            for action in parent._actions:
                if action.type is Path:
                    action.complete = shtab.FILE  # type: ignore[attr-defined]
        commands.add_parser(name, help=found.summary, parents=parents, add_help=not parents)
    return made


def _parser_of(found: Found) -> argparse.ArgumentParser | None:
    """What its module's `parser` makes; somebody else's command may have none."""
    try:
        make = getattr(import_module(found.module), "parser", None)
    except ImportError:
        return None
    made = make() if callable(make) else None
    return made if isinstance(made, argparse.ArgumentParser) else None
