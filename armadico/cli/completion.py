"""Print a completion script for bash, zsh or fish."""

from __future__ import annotations

import argparse
import contextlib
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, NoReturn
from unittest.mock import patch

from armadico.cli import options
from armadico.config.discovery import COMMANDS, installed

EXAMPLES: Final = """\
  source <(armadico completion bash)
  armadico completion zsh > ~/.zfunc/_armadico
  armadico completion fish > ~/.config/fish/completions/armadico.fish
"""


def main(argv: Sequence[str]) -> int:
    """Print the script."""
    made = options.parser(
        "armadico completion",
        "Print a script that has a shell complete commands, options and their values. It is made"
        " from the commands that are installed, other packages' too.",
        EXAMPLES,
    )
    made.add_argument("shell", choices=tuple(SCRIPTS), help="which shell")
    args = made.parse_args(argv)
    print(SCRIPTS[args.shell](list(commands())), end="")
    return 0


@dataclass(frozen=True)
class Option:
    """What may follow a command: flags, or a choice of words where there are none."""

    flags: tuple[str, ...]
    help: str
    choices: tuple[str, ...]
    takes_value: bool


@dataclass(frozen=True)
class Command:
    """One command, and what may follow it."""

    name: str
    help: str
    options: tuple[Option, ...]

    @property
    def words(self) -> list[str]:
        """Flags, and the words that stand for themselves."""
        return [word for each in self.options for word in each.flags or each.choices]


class _FoundError(Exception):
    """Not an error: the parser that a command was about to use."""

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        super().__init__()
        self.parser = parser


def commands() -> Iterator[Command]:
    """Every command that is installed; one that cannot be loaded has no options."""
    for name, found in installed(COMMANDS).items():
        parser = None
        with contextlib.suppress(ImportError):
            parser = parser_of(found.load())
        actions = () if parser is None else tuple(map(_option, parser._actions))
        yield Command(name, found.summary, actions)


def parser_of(command: Any) -> argparse.ArgumentParser | None:
    """The parser of a command, without running it: it is only ever asked for its help."""

    def caught(parser: argparse.ArgumentParser, *_: object, **__: object) -> NoReturn:
        raise _FoundError(parser)

    with (
        patch.object(argparse.ArgumentParser, "parse_args", caught),
        patch.object(argparse.ArgumentParser, "parse_known_args", caught),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        try:
            command(["--help"])
        except _FoundError as found:
            return found.parser
        except SystemExit:
            pass
    return None


def _option(action: argparse.Action) -> Option:
    text = " ".join(str(action.help or "").split()) if action.help != argparse.SUPPRESS else ""
    choices = tuple(map(str, action.choices)) if action.choices is not None else ()
    return Option(tuple(action.option_strings), text, choices, action.nargs != 0)


# The scripts --------------------------------------------------------------------------------------


def bash(found: Sequence[Command]) -> str:
    """For bash: words after the command, values after an option that has a choice, else files."""
    cases, values = [], []
    for command in found:
        cases.append(f"    {command.name}) words={_quoted(' '.join(command.words))} ;;")
        values += [
            f"    {'|'.join(f'{command.name}:{flag}' for flag in option.flags)})"
            f" values={_quoted(' '.join(option.choices))} ;;"
            for option in command.options
            if option.flags and option.choices
        ]
    names = _quoted(" ".join(command.name for command in found))
    return _BASH.format(names=names, cases="\n".join(cases), values="\n".join(values))


_BASH: Final = """\
# bash completion for armadico
_armadico() {{
  local current=${{COMP_WORDS[COMP_CWORD]}} previous=${{COMP_WORDS[COMP_CWORD-1]}}
  local command=${{COMP_WORDS[1]}} words="" values=""
  if [ "$COMP_CWORD" -eq 1 ]; then
    COMPREPLY=($(compgen -W {names} -- "$current"))
    return
  fi
  case "$command:$previous" in
{values}
  esac
  case "$command" in
{cases}
  esac
  COMPREPLY=($(compgen -W "${{values:-$words}}" -- "$current"))
}}
complete -o default -F _armadico armadico
"""


def zsh(found: Sequence[Command]) -> str:
    """For zsh, by `_arguments`."""
    names = "\n".join(f"    {_quoted(_zsh(c.name) + ':' + _zsh(c.help))}" for c in found)
    cases = []
    for command in found:
        specs = [spec for option in command.options for spec in _zsh_specs(option)]
        lines = " \\\n        ".join(["_arguments", *specs])
        cases.append(f"    {command.name})\n      {lines} ;;")
    return _ZSH.format(names=names, cases="\n".join(cases))


_ZSH: Final = """\
#compdef armadico
_armadico() {{
  local -a commands=(
{names}
  )
  if (( CURRENT == 2 )); then
    _describe command commands
    return
  fi
  local command=$words[2]
  shift words
  (( CURRENT-- ))
  case $command in
{cases}
  esac
}}
if [ "$funcstack[1]" = "_armadico" ]; then _armadico "$@"; else compdef _armadico armadico; fi
"""


def _zsh_specs(option: Option) -> Iterator[str]:
    values = f"({' '.join(option.choices)})" if option.choices else "_files"
    if not option.flags:
        yield _quoted(f"*:{_zsh(option.help)}:{values}")
    for flag in option.flags:
        value = f":value:{values}" if option.takes_value else ""
        yield _quoted(f"{flag}[{_zsh(option.help)}]{value}")


def _zsh(text: str) -> str:
    return "".join(f"\\{c}" if c in "[]:\\" else c for c in text)


def fish(found: Sequence[Command]) -> str:
    """For fish, a line an option."""
    lines = ["# fish completion for armadico"]
    for command in found:
        begin = "complete -c armadico -n __fish_use_subcommand -f"
        lines.append(f"{begin} -a {command.name} -d {_quoted(command.help)}")
        after = f"complete -c armadico -n '__fish_seen_subcommand_from {command.name}'"
        lines += [f"{after} {_fish(option)}" for option in command.options if _fish(option)]
    return "\n".join(lines) + "\n"


def _fish(option: Option) -> str:
    parts = [
        f"-l {flag[2:]}" if flag.startswith("--") else f"-s {flag[1:]}" for flag in option.flags
    ]
    if option.choices:
        parts.append(f"-{'x' if option.flags else 'f'} -a {_quoted(' '.join(option.choices))}")
    elif option.flags and option.takes_value:
        parts.append("-r")
    return " ".join([*parts, f"-d {_quoted(option.help)}"]) if parts else ""


def _quoted(text: str) -> str:
    """In single quotes, which all three shells read alike once there is none inside."""
    return "'" + text.replace("\\'", "'").replace("'", "’") + "'"


SCRIPTS: Final = {"bash": bash, "zsh": zsh, "fish": fish}
