"""The command line: light until it is used, clear when it is used wrongly."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

BIN = Path(sys.executable).parent
HEAVY = ("numpy", "zenoh", "pymunk", "cbor2", "msgspec", "serial", "rich")
OURS = ("goto", "stop", "resume", "ps", "sim", "agent")


def run(*command: str) -> subprocess.CompletedProcess[str]:
    program, *rest = command
    return subprocess.run(
        [str(BIN / program), *rest], capture_output=True, text=True, timeout=60, check=False
    )


@pytest.mark.parametrize(
    "call",
    [
        "cli.main(['--help'])",
        "cli.main(['--version'])",
        "agent.main(['--list'])",
        "agent.main(['--list', '--json'])",
        "agent.main(['--help'])",
        *(f"cli.main([{name!r}, '--help'])" for name in OURS),
    ],
)
def test_help_and_lists_import_nothing_heavy(call: str) -> None:
    script = (
        "import sys\nfrom armadico import cli\nfrom armadico.cli import agent\n"
        f"try:\n    {call}\nexcept SystemExit as end:\n    assert not end.code\n"
        f"print('HEAVY', sorted(set({HEAVY!r}) & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout.splitlines()[-1] == "HEAVY []", done.stdout + done.stderr


@pytest.mark.parametrize("name", OURS)
def test_every_command_explains_itself_with_examples(name: str) -> None:
    done = run("armadico", name, "--help")
    assert done.returncode == 0
    assert "examples:" in done.stdout
    program = "armadico-agent" if name == "agent" else f"armadico {name}"
    assert done.stdout.count(f"  {program} ") >= 2


def test_help_lists_every_command_with_what_it_is_for() -> None:
    done = run("armadico", "--help")
    rows = {words[0]: words[1:] for line in done.stdout.splitlines() if (words := line.split())}
    assert all(rows[name] for name in OURS)


def test_no_command_at_all_is_a_wrong_use() -> None:
    done = run("armadico")
    assert done.returncode == 2
    assert "usage:" in done.stdout


def test_versions_agree() -> None:
    said = {run("armadico", "--version").stdout, run("armadico-agent", "--version").stdout}
    assert len(said) == 1
    assert said.pop().startswith("armadico ")


def test_the_list_of_agents_for_programs_says_where_they_come_from() -> None:
    done = run("armadico-agent", "--list", "--json")
    agents = {row["name"]: row for row in json.loads(done.stdout)}
    assert agents["encoder"]["value"] == "armadico.agents.encoder:Encoder"
    assert agents["encoder"]["package"] == "armadico"
    assert agents["encoder"]["summary"]


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (("armadico", "gto"), "did you mean 'goto'?"),
        (("armadico-agent", "encodr"), "did you mean 'encoder'?"),
        (("armadico-agent",), "which agent?"),
        (("armadico-agent", "encoder", "--set", "colour=1"), "colour"),
        (("armadico-agent", "encoder", "--set", "x=far"), "x"),
        (("armadico-agent", "encoder", "--config", "/no/such.toml"), "/no/such.toml"),
        (("armadico-agent", "encoder", "--host", "nowhere"), "nowhere"),
        (("armadico-agent", "encoder", "--hosts", "/no/hosts.toml"), "/no/hosts.toml"),
        (("armadico", "ps", "--connect", "7450"), "tcp/192.168.1.5:7450"),
        (("armadico", "ps", "--namespace", "a*"), "namespace"),
        (("armadico", "goto", "1", "2"), "DEG"),
        (("armadico", "goto", "1", "2", "nan"), "'nan' is no finite number"),
        (("armadico", "sim", "sc99"), "sc99"),
        (("armadico", "sim", "sc1", "--start", "500", "nan", "0"), "start"),
    ],
)
def test_a_wrong_use_is_told_clearly_with_exit_code_2(command: tuple[str, ...], says: str) -> None:
    done = run(*command)
    assert done.returncode == 2, done.stderr
    assert says in done.stderr
    assert "Traceback" not in done.stderr


def test_the_beginning_of_an_option_is_no_option() -> None:
    """Else --seed would be --seeds: not that seed, but so many."""
    done = run("armadico", "sim", "sc1", "--por", "1")
    assert done.returncode == 2
    assert "--por" in done.stderr
