"""The completion scripts: made from the commands, and understood by the shell."""

from __future__ import annotations

import sys

import pytest
import shtab

from armadico.cli import completion
from armadico.core.discovery import COMMANDS, Found, installed
from tests.programs import call


def words(typed: str) -> set[str]:
    """What bash offers at the end of a line."""
    script = (
        f"{shtab.complete(completion.everything(), 'bash')}\n"
        f"COMP_WORDS=({typed})\nCOMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))\n"
        '_shtab_armadico armadico "${COMP_WORDS[COMP_CWORD]}"\nprintf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = call("-c", script, program="/bin/bash")
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("armadico res", {"resume"}),
        ("armadico completion ''", {"bash", "zsh", "fish"}),
        ("armadico ps --j", {"--json"}),
    ],
)
def test_bash_completes(typed: str, offered: set[str]) -> None:
    assert words(typed) >= offered


@pytest.mark.parametrize("shell", completion.SHELLS)
def test_the_script_has_every_command_with_its_options(
    shell: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert completion.main([shell]) == 0
    text = capsys.readouterr().out
    for word in (*installed(COMMANDS), "sensors", "json"):
        assert word in text


def test_a_command_that_cannot_be_imported_or_has_no_parser_is_completed_by_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    others = {"gone": Found("gone", "no.such.module:main", ""), "json": Found("json", "json", "")}
    monkeypatch.setattr(completion, "installed", lambda _: others)
    assert words("armadico g") == {"gone"}


def test_completing_imports_no_numbers_and_no_mesh() -> None:
    script = (
        "import sys\nfrom armadico.cli import completion\ncompletion.everything()\n"
        "print(sorted({'numpy', 'zenoh', 'pymunk'} & set(sys.modules)))"
    )
    done = call("-c", script, program=sys.executable)
    assert done.stdout == "[]\n"
