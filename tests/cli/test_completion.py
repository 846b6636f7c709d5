"""The completion scripts: made from the commands, and understood by the shell."""

from __future__ import annotations

import subprocess

import pytest

from armadico.cli import completion


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("armadico rec", {"record"}),
        ("armadico export run.mcap --to ''", {"csv", "rrd"}),
        ("armadico completion ''", {"bash", "zsh", "fish"}),
        ("armadico top --j", {"--json"}),
    ],
)
def test_bash_completes(typed: str, offered: set[str]) -> None:
    script = (
        f"{completion.bash(list(completion.commands()))}\n"
        f"COMP_WORDS=({typed})\nCOMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))\n"
        '_armadico\nprintf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        ["bash", "-eu", "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stderr == ""
    assert set(done.stdout.split()) >= offered


@pytest.mark.parametrize("shell", sorted(completion.SCRIPTS))
def test_every_command_and_option_is_in_the_script(shell: str) -> None:
    found = {command.name: command for command in completion.commands()}
    assert "--max-size" in found["record"].words
    text = completion.SCRIPTS[shell]([found["record"], found["top"]])
    for word in ("record", "top", "max-size", "once"):
        assert word in text
