"""What `armadico doctor` says of clocks; the rest of it meets a society in test_terminal.py."""

from __future__ import annotations

import argparse
import json
from collections.abc import Generator
from pathlib import Path

import pytest

from armadico.cli import doctor
from armadico.cli import main as armadico
from armadico.mesh.topology import ENDPOINTS_VARIABLE
from tests.mesh.conftest import private_endpoints


def returned(findings: Generator[doctor.Finding, None, set[str]]) -> set[str]:
    while True:
        try:
            next(findings)
        except StopIteration as end:
            names: set[str] = end.value
            return names


@pytest.mark.parametrize("machines", [set(), {"lab1"}])
def test_one_machine_has_one_clock(machines: set[str]) -> None:
    assert doctor.clocks(machines).verdict == "ok"


def test_skew_between_machines_is_said_to_be_unknown_and_how_to_know_it() -> None:
    finding = doctor.clocks({"lab2", "lab1"})
    assert finding.verdict == "note"
    assert "between lab1, lab2 is not known" in finding.what
    assert "chronyc" in finding.todo


def test_the_machines_are_those_of_the_host_table(tmp_path: Path) -> None:
    table = tmp_path / "hosts.toml"
    table.write_text(
        "".join(f'[lab{n}]\nendpoints = ["udp/127.0.0.1:{7500 + n}"]\n' for n in (1, 2))
    )
    args = argparse.Namespace(host=None, hosts=str(table))
    assert returned(doctor.hosts(args)) == {"lab1", "lab2"}
    args.hosts = None
    assert returned(doctor.hosts(args)) == set()


@pytest.mark.live
def test_clocks_are_among_the_findings(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(ENDPOINTS_VARIABLE, private_endpoints())
    armadico(["doctor", "--json", "--namespace", "doctor-test"])
    findings = {f["subject"]: f for f in json.loads(capsys.readouterr().out)}
    assert findings["clocks"]["verdict"] == "ok"
