"""The command line: light until it is used, clear when it is used wrongly."""

from __future__ import annotations

import re
import sys

import pytest

from armadico import cli
from armadico.core import discovery
from armadico.core.discovery import Found, installed
from tests.programs import call

HEAVY = {
    *("numpy", "zenoh", "pymunk", "cbor2", "msgspec", "serial", "rich", "rerun", "mcap"),
    *("psutil", "websockets", "asyncio", "matplotlib"),
}
HELP = """
import contextlib, io, os, sys
from armadico import cli
from armadico.core.discovery import COMMANDS, installed
for name in sorted(n for n, found in installed(COMMANDS).items() if found.package == "armadico"):
    if os.fork():  # so that none has what another one imported
        os.wait()
        continue
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        cli.main([name, "--help"])
    program = "armadico-agent" if name == "agent" else f"armadico {name}"
    examples = said.getvalue().partition("examples:")[2].count(program)
    print(name, examples, *sorted(HEAVY & set(sys.modules)), flush=True)
    os._exit(0)
cli.main(["--help"])
"""


def test_help_of_every_command_has_examples_and_imports_nothing_heavy() -> None:
    done = call("-c", HELP.replace("HEAVY", repr(HEAVY)), program=sys.executable)
    rows, _, overview = done.stdout.partition("usage:")
    for name, examples, *heavy in map(str.split, rows.splitlines()):
        assert int(examples) >= 2, name
        assert {*heavy} <= ({"msgspec"} if name == "ros2" else set()), name
        assert re.search(rf"^  {name} +\w", overview, re.MULTILINE), name


@pytest.mark.parametrize("name", cli.TOOLS)
def test_a_command_of_the_tools_that_are_not_installed_says_how_to_get_them(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not that it might be another: `bench` is no `echo`."""

    def product(group: str) -> dict[str, Found]:
        return {n: f for n, f in installed(group).items() if f.package == "armadico"}

    monkeypatch.setattr(cli, "installed", product)
    monkeypatch.setattr(discovery, "installed", product)
    assert cli.main([name]) == 2
    errors = capsys.readouterr().err
    assert all(word in errors for word in (f"{name!r}", "armadico-tools", "make tools"))
    assert cli.main(["help"]) == 0
    assert name in capsys.readouterr().out


def test_versions_agree() -> None:
    said = {call("--version").stdout, call("--version", program="armadico-agent").stdout}
    assert len(said) == 1
    assert said.pop().startswith("armadico ")


def test_the_beginning_of_an_option_is_no_option() -> None:
    """Else --seed would be --seeds: not that seed, but so many."""
    done = call("sim", "sc1", "--por", "1")
    assert done.returncode == 2
    assert "--por" in done.stderr
