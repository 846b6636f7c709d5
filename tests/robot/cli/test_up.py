"""What `armadico up` makes of the name of a mission, a scenario or a file."""

from __future__ import annotations

import socket
from math import pi
from pathlib import Path

import pytest

from armadico.cli.options import UsageError
from armadico.cli.up import _place, _plan, _scenario, _started, main
from armadico.core.config_errors import ConfigError
from armadico.launch.supervisor import Plan
from armadico.mesh.topology import HOSTS_VARIABLE
from tests.programs import starter


@pytest.fixture(autouse=True)
def no_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(HOSTS_VARIABLE, raising=False)


def plan(*words: str) -> Plan:
    args = main.parse(words)
    scenario = _started(args, _scenario(args))
    return _plan(args, _place(args.mesh, scenario), scenario)


def test_agents_are_told_the_namespace_that_they_are_in() -> None:
    found = {member.name: member.sets for member in plan("sc4", "--namespace", "robot7").members}
    assert "namespace=robot7" in found["sonar"]


def test_a_robot_that_starts_elsewhere_knows_where_and_so_does_its_simulator() -> None:
    found = plan("house", "--namespace", "lab/r2", "--start", "1.5", "3", "90")
    sets = next(member.sets for member in found.members if member.name == "encoder")
    assert {"x=1.5", "y=3.0", "theta=1.5707963267948966"} <= {*sets}
    assert found.simulated is not None
    assert found.simulated.start == (1.5, 3.0, pi / 2)


@pytest.mark.parametrize(
    ("words", "error", "says"),
    [
        (("--start", "1", "1", "0"), UsageError, "--start"),
        (("sc4", "--start", "nan", "1", "0"), UsageError, "--start nan 1 0"),
        (("sc4", "--start", "4.6", "1", "0"), ConfigError, "m from"),
    ],
)
def test_a_start_that_cannot_be_is_refused(
    words: tuple[str, ...], error: type[Exception], says: str
) -> None:
    with pytest.raises(error, match=says):
        plan(*words)


def test_an_agent_of_the_table_that_is_not_installed_is_said_with_its_line(tmp_path: Path) -> None:
    table = tmp_path / "lab.toml"
    table.write_text('[lab1]\nagents = [\n  "goto",\n  "avodi",\n]\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"lab\.toml:4: lab1\.agents: .* did you mean 'avoid'"):
        plan("--hosts", str(table), "--host", "lab1")


GOTO = ("--set", "goto.social.coordination=mean")
ALL = ("--coordination", "mean")


@pytest.mark.parametrize(
    ("there", "chosen", "refused", "said"),
    [
        ('"interface"', GOTO, "wheels by different mechanisms", False),
        ('"avoid"', GOTO, "wheels by different mechanisms", False),
        ('"interface"', ALL, "", False),
        ('"avoid"', ALL, "", True),
    ],
)
def test_mechanisms_are_checked_as_far_as_this_host_has_the_agents_that_compete(
    there: str,
    chosen: tuple[str, ...],
    refused: str,
    said: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("armadico.agents.rivals")
    table = tmp_path / "lab.toml"
    table.write_text(
        f'[lab1]\nrouter = "tcp/127.0.0.1:7447"\n'
        f'agents = ["robot", "goto", "gothrough"]\n[lab2]\nagents = [{there}]\n'
    )
    words = ("--hosts", str(table), "--host", "lab1", *chosen)
    if refused:
        with pytest.raises(ConfigError, match=refused):
            plan(*words)
    else:
        assert plan(*words)
    assert ("whether the agents of other hosts" in capsys.readouterr().err) == said


@pytest.mark.live
def test_a_host_without_the_robot_agent_says_that_it_waits_for_it(tmp_path: Path) -> None:
    table = tmp_path / "lab.toml"
    with socket.socket() as nobody, starter() as start:
        nobody.bind(("127.0.0.1", 0))  # and does not listen
        router = f"tcp/127.0.0.1:{nobody.getsockname()[1]}"
        table.write_text(
            f'[robot]\nrouter = "{router}"\nagents = ["robot"]\n[lab1]\nagents = ["goto"]\n'
        )
        words = ("--hosts", str(table), "--host", "lab1", "--namespace", "up-test")
        process = start("up", *words)
        assert process.stderr is not None
        said = iter(process.stderr.readline, "")
        assert any(f"no robot agent at {router}; " in line for line in said)
