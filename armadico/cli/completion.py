"""Print a completion script for bash, zsh or fish."""

from __future__ import annotations

from dataclasses import dataclass
from sys import modules
from typing import Final

import shtab

from armadico.cli.parsing import ArgumentParser, Command, argument, together
from armadico.core.discovery import COMMANDS, Found, installed

EXAMPLES: Final = """\
  source <(armadico completion bash)
  armadico completion zsh > ~/.zfunc/_armadico
  armadico completion fish > ~/.config/fish/completions/armadico.fish
"""

SHELLS: Final = ("bash", "zsh", "fish")


@dataclass(frozen=True, kw_only=True)
class Options:
    shell: str = argument("the shell", choices=SHELLS)


def run(args: Options) -> int:
    print(shtab.complete(everything(), args.shell))
    return 0


def everything() -> ArgumentParser:
    """One parser with all installed commands and their options."""
    found = [(name, each.summary, parser_of(each)) for name, each in installed(COMMANDS).items()]
    return together("armadico", found, shtab.FILE)


def parser_of(found: Found) -> ArgumentParser | None:
    """The parser of a command; None if another package's command has none."""
    try:
        command = found.load()
    except ImportError:
        return None
    make = getattr(command, "parser", None) or getattr(modules[found.module], "parser", None)
    made = make() if callable(make) else None
    return made if isinstance(made, ArgumentParser) else None


main: Final = Command(
    "armadico completion",
    Options,
    run,
    "Print a script with which a shell completes commands, options and values. It covers all"
    " installed commands, including those of other packages.",
    EXAMPLES,
)
