"""What `armadico doctor` says of this machine; `test_diagnosis.py` has the society."""

from __future__ import annotations

import json
from importlib import metadata
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

from armadico.cli import doctor
from armadico.cli import main as armadico
from armadico.core.judgement import Answer
from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.observe.findings import those


@pytest.mark.parametrize(
    ("shares", "wrong"),
    [
        ((0.5, 0.5, 4.0), []),  # busy, and well
        ((0.01, 0.5, 1.0), ["memory"]),
        ((0.5, 0.01, 1.0), ["disk"]),
        ((0.5, 0.5, 60.0), ["processor"]),
    ],
)
def test_a_machine_without_memory_disk_or_processor_is_named(
    shares: tuple[float, float, float], wrong: list[str]
) -> None:
    found = those(doctor.resources(*shares), Answer.NO)
    assert [each.who for each in found] == wrong
    assert all(each.todo for each in found)


def test_a_serial_line_without_permission_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ttyUSB0").touch()
    monkeypatch.setattr(doctor.os, "access", lambda *_: False)
    (finding,) = doctor.serial_ports(tmp_path)
    assert finding.answer is Answer.NO
    assert "permission denied" in finding.what
    assert "dialout" in finding.todo


def test_a_folder_for_sockets_that_others_can_write_to_is_wrong(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(RUNTIME_VARIABLE, str(tmp_path))
    (tmp_path / "armadico").mkdir()
    (tmp_path / "armadico").chmod(0o777)
    (finding,) = doctor.router("doctor-test")
    assert (finding.who, finding.answer) == ("socket", Answer.NO)
    assert "chmod 700" in finding.what


@pytest.mark.live
def test_where_no_socket_can_be_made_that_is_found_and_the_rest_as_well(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / ("x" * 100)
    folder.mkdir()
    monkeypatch.setenv(RUNTIME_VARIABLE, str(folder))
    assert armadico(["doctor", "--json", "--namespace", "doctor-test"]) == 1
    findings = {f["who"]: f for f in json.loads(capsys.readouterr().out)}
    assert findings["socket"]["answer"] == "no"
    assert "too long" in findings["socket"]["what"]
    assert {"mesh", "memory", "graphics"} <= set(findings)


@pytest.mark.parametrize(("package", "extra"), [("cyclonedds", "ros2"), ("mcap", "record")])
def test_an_extra_that_is_not_there_is_named_with_what_brings_it(
    package: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def version(name: str) -> str:
        if name == package:
            raise PackageNotFoundError(name)
        return metadata.version(name)

    monkeypatch.setattr(doctor, "version", version)
    (found,) = [each for each in doctor.versions() if each.who == package]
    assert f"pip install 'armadico[{extra}]'" in found.todo
