"""The command line: light until it is used, clear when it is used wrongly."""

from __future__ import annotations

import json

import pytest

from armadico import cli
from armadico.core import discovery
from armadico.core.discovery import Found, installed
from tests.programs import call, heavy, imports_nothing

HEAVY = ("numpy", "zenoh", "pymunk", "cbor2", "msgspec", "serial", "rich")
OURS = ("goto", "stop", "resume", "ps", "sim", "agent")


@pytest.mark.parametrize(
    ("module", "words"),
    [
        ("armadico.cli", ["--help"]),
        ("armadico.cli", ["--version"]),
        ("armadico.cli.agent", ["--list"]),
        ("armadico.cli.agent", ["--list", "--json"]),
        ("armadico.cli.agent", ["--help"]),
        *(("armadico.cli", [name, "--help"]) for name in OURS),
    ],
)
def test_help_and_lists_import_nothing_heavy(module: str, words: list[str]) -> None:
    assert imports_nothing(heavy(module, words, HEAVY))


@pytest.mark.parametrize("name", OURS)
def test_every_command_explains_itself_with_examples(name: str) -> None:
    done = call(name, "--help")
    assert done.returncode == 0
    assert "examples:" in done.stdout
    program = "armadico-agent" if name == "agent" else f"armadico {name}"
    assert done.stdout.count(f"  {program} ") >= 2


def test_help_lists_every_command_with_what_it_is_for() -> None:
    done = call("--help")
    rows = {words[0]: words[1:] for line in done.stdout.splitlines() if (words := line.split())}
    assert all(rows[name] for name in OURS)


def test_no_command_at_all_is_a_wrong_use() -> None:
    done = call()
    assert done.returncode == 2
    assert "usage:" in done.stdout


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


def test_the_list_of_agents_for_programs_says_where_they_come_from() -> None:
    done = call("--list", "--json", program="armadico-agent")
    agents = {row["name"]: row for row in json.loads(done.stdout)}
    assert agents["encoder"]["value"] == "armadico.agents.localization.encoder:Encoder"
    assert agents["encoder"]["package"] == "armadico"
    assert agents["encoder"]["summary"]


def test_the_beginning_of_an_option_is_no_option() -> None:
    """Else --seed would be --seeds: not that seed, but so many."""
    done = call("sim", "sc1", "--por", "1")
    assert done.returncode == 2
    assert "--por" in done.stderr
