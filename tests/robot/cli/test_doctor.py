"""What `armadico doctor` says of this machine; `test_diagnosis.py` has the society."""

from __future__ import annotations

import json
from importlib import metadata
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from rich.console import Console

from armadico.cli import doctor
from armadico.cli import main as armadico
from armadico.core.judgement import Answer
from armadico.core.messages import Cycle, Line, RobotState, Stop
from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.mobile.map_graphs import message_of as graph_message
from armadico.mobile.messages import BatteryLevel, Correction, MissionState, MissionStatus, Pose
from armadico.observe.findings import Finding, Sort, fine, open_question, those
from armadico.observe.view import View
from armadico.watch.commands import top

WELL = RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, motors=True, stalled=False)


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


def test_a_finding_is_shown_with_its_verdict_and_cure() -> None:
    words = {
        fine(Sort.LINE, "", "No errors."): "ok ",
        fine(Sort.LINE, "", "7 bytes dropped.", "check it"): "note ",
        open_question(Sort.AGENTS, "", "Not known.", "--hosts"): "unknown ",
        Finding(Sort.HOST, "lab2", "lab2 is off.", "switch it on"): "wrong ",
    }
    for finding, verdict in words.items():
        first, *cure = doctor.lines(finding)
        assert first.startswith(verdict)
        assert finding.what in first
        assert cure == ([f"         -> {finding.todo}"] if finding.todo else [])


def test_top_says_why_the_robot_stands() -> None:
    view = View()
    stop = Stop(1, stopped=True, by="anna")
    view.token("robot-1", there=True, t=0.0)
    view.update("robot/state", replace(WELL, stop=stop), 0.0)
    snapshot = top.Snapshots(view, "robot1").at(0.1)
    assert snapshot["standing"]["cause"]["who"] == "anna"
    console = Console(width=120)
    with console.capture() as shown:
        console.print(top.tables(snapshot))
    assert "It is stopped by anna." in shown.get()


def test_top_says_what_is_left_of_the_battery() -> None:
    view = View()
    view.learn(replace(WELL, charging=True), 0.0)
    assert "12.0 V, charging" in top._heading(top.Snapshots(view, "robot1").at(0.0))
    view.learn(BatteryLevel(Cycle(1, 1), 11.7, 0.59, 4e5), 0.0)
    assert "12.0 V, 59 %, charging" in top._heading(top.Snapshots(view, "robot1").at(0.0))


def test_top_says_it_in_its_first_line() -> None:
    view = View()
    stop = Stop(1, stopped=True, by="the STOP button at the robot")
    view.learn(replace(WELL, motors=False, stalled=True, stop=stop, line=Line(mangled=3)), 0.0)
    said = top._heading(top.Snapshots(view, "robot1").at(0.0))
    assert "STOPPED by the STOP button at the robot" in said
    assert said.endswith("STALLED, MOTORS OFF, 3 bad checksums")


def posed(variance: float) -> Pose:
    return Pose(Cycle(1, 1), 1.2, 3.4, 0.5, (variance, 0.0, 0.0, 0.0, 0.0, 0.0012))


def test_top_says_where_it_is_how_surely_and_for_how_long_it_has_been_lost() -> None:
    view = View()
    snapshots = top.Snapshots(view, "robot1")
    view.learn(WELL, 0.0)
    assert snapshots.at(0.0)["pose"] is None
    view.learn(Pose(Cycle(1, 1), 1.2, 3.4, 0.5), 0.0)
    assert "at (1.20, 3.40)" in top._heading(snapshots.at(0.0))
    assert "+-" not in top._heading(snapshots.at(0.0))
    assert "map" not in top._heading(snapshots.at(0.0))
    graph = graph_message(7, np.zeros((9, 3)), [(0, 8), (1, 8)], [False, True], "so it is")
    view.learn(graph, 0.0)
    assert "map: revision 7, 9 key scans, 2 loops (1 off), the map may be wrong: so it is" in (
        top._heading(snapshots.at(0.0))
    )
    assert snapshots.at(100.0)["slam"] is None, "the agent is gone"
    view.learn(Correction(Cycle(1, 1), 0, 0, 0, (0.0,) * 6, 0.97), 1.0)
    view.learn(posed(0.0025), 1.0)
    said = top._heading(snapshots.at(1.0))
    assert "at (1.20, 3.40), +-0.05 m, +-2 deg, confidence 0.97" in said
    row = snapshots.at(1.0)["pose"]
    assert (row["deviation_m"], row["confidence"], row["lost_s"]) == (0.05, 0.97, None)
    view.learn(posed(1.96), 2.0)
    assert "at (1.20, 3.40), LOST for 12 s, +-1.40 m" in top._heading(snapshots.at(14.0))
    assert snapshots.at(14.0)["pose"]["lost_s"] == 12.0


def test_top_says_why_a_mission_is_not_driven() -> None:
    view = View()
    view.learn(WELL, 0.0)
    view.learn(MissionStatus(1, MissionState.DRIVING, 4.0, 0, "waits: door D is shut"), 0.0)
    snapshot = top.Snapshots(view, "robot1").at(0.0)
    assert snapshot["mission"] == {
        "number": "1",
        "state": "driving",
        "to_go": 4.0,
        "note": "waits: door D is shut",
        "unseen_m": 0.0,
    }
    assert "driving, waits: door D is shut" in top._heading(snapshot)


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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["/x/.venv/bin/python", "/x/.venv/bin/armadico-agent", "goto"], "armadico-agent goto"),
        (["/usr/bin/python3", "-P", "-m", "armadico", "agent", "goto"], "armadico agent goto"),
        (["/x/python", "-m", "armadico.child", "1", "15"], "armadico.child 1 15"),
        (["/usr/sbin/sshd", "-D"], "sshd -D"),
        ([], ""),
    ],
)
def test_who_has_a_port_is_called_as_it_was_typed(words: list[str], said: str) -> None:
    assert doctor.called(words) == said


def test_a_long_command_line_is_cut_at_its_end() -> None:
    long = ["python", "/x/armadico-agent", "encoder", *("--set", "x=3.4") * 20]
    assert doctor.called(long).startswith("armadico-agent encoder --set x=3.4")
    assert doctor.called(long).endswith("...")


@pytest.mark.parametrize(
    ("package", "extra"), [("cyclonedds", "ros2"), ("foxglove-sdk", "foxglove")]
)
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
