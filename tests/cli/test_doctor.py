"""What `armadico doctor` says of clocks; the rest of it meets a society in test_terminal.py."""

from __future__ import annotations

import json
from collections.abc import Generator
from importlib import metadata
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from rich.console import Console

from armadico.cli import doctor, top
from armadico.cli import main as armadico
from armadico.cli.options import Mesh
from armadico.core.messages import PROTOCOL, Card, Cycle, Line, MonitorReport, RobotState, Stop
from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.mobile.map_graphs import message_of as graph_message
from armadico.mobile.messages import BatteryLevel, Correction, MissionState, MissionStatus, Pose
from armadico.observe.standing import standing
from armadico.observe.view import View


def returned(findings: Generator[doctor.Finding, None, set[str]]) -> set[str]:
    while True:
        try:
            next(findings)
        except StopIteration as end:
            names: set[str] = end.value
            return names


@pytest.mark.parametrize("offsets", [{}, {"lab1": None}, {"lab1": 0.4, "lab2": -1.9}])
def test_clocks_that_agree_or_of_one_machine_are_well(offsets: dict[str, float | None]) -> None:
    assert doctor.clocks(offsets).verdict == "ok"


def test_a_clock_that_is_off_is_named_with_how_far_and_what_to_do() -> None:
    finding = doctor.clocks({"lab2": 3600.2, "lab1": 0.1, "lab3": -5.0})
    assert finding.verdict == "note"
    assert "lab2 +3600 s, lab3 -5 s" in finding.what
    assert "lab1" not in finding.what
    assert "chronyc" in finding.todo


def test_the_clock_of_a_host_that_does_not_answer_is_not_known() -> None:
    finding = doctor.clocks({"lab1": 0.0, "lab2": None})
    assert finding.verdict == "note"
    assert "lab2" in finding.what


def test_the_machines_are_those_of_the_host_table(tmp_path: Path) -> None:
    table = tmp_path / "hosts.toml"
    table.write_text('[lab1]\nrouter = "udp/127.0.0.1:7501"\n[lab2]\naddress = "127.0.0.2"\n')
    on_query = Mesh(hosts=str(table))
    assert returned(doctor.hosts(on_query)) == {"lab1", "lab2"}
    assert returned(doctor.hosts(Mesh())) == set()


def test_what_agents_report_of_themselves_is_shown() -> None:
    card = Card("robot", "robot-1", "here", 1, "1", PROTOCOL, (), (), ())
    assert list(doctor._faults([card])) == []
    (fault,) = doctor._faults([replace(card, fault="another controller")])
    assert (fault.subject, fault.verdict, fault.what) == ("robot", "wrong", "another controller")
    (doubt,) = doctor._faults([replace(card, doubts="another laser")])
    assert (doubt.verdict, doubt.what) == (doctor.NOTE, "another laser")


WELL = RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, motors=True, stalled=False)


def test_what_its_battery_and_its_line_are_like_is_said() -> None:
    battery, line = doctor.robot(WELL)
    assert (battery.verdict, battery.what) == (doctor.OK, "12.0 V")
    assert (line.subject, line.verdict) == ("line", "ok")
    counts = Line(dropped=7, resets=2)
    low = BatteryLevel(Cycle(1, 1), 10.2, 0.07, 5e4)
    found = list(doctor.robot(replace(WELL, line=counts), low))
    assert [f.subject for f in found] == ["battery", "line"]
    assert {f.verdict for f in found} == {"note"}
    assert "nearly empty: 12.0 V, 7 %" in found[0].what
    assert "7 bytes dropped, 2 odometry resets" in found[1].what
    charging = next(iter(doctor.robot(replace(WELL, charging=True), low)))
    assert (charging.verdict, charging.what) == (doctor.OK, "12.0 V, 7 %, charging")


@pytest.mark.parametrize(
    ("changed", "verdict", "says"),
    [
        ({"v": 0.4}, doctor.OK, "moves at 0.40 m/s"),
        ({}, doctor.OK, "It has no goal."),
        ({"stop": Stop(1, stopped=True, by="anna")}, doctor.NOTE, "It is stopped by anna."),
        ({"motors": False}, doctor.NOTE, "Its motors are off."),
    ],
)
def test_why_the_robot_stands_is_said(changed: dict[str, Any], verdict: str, says: str) -> None:
    view = View()
    view.update("robot/state", replace(WELL, **changed), 0.0)
    found = doctor.stands(standing(view, 0.1))
    assert (found.subject, found.verdict) == ("standing", verdict)
    assert says in found.what
    late = doctor.stands(standing(view, 2.0))
    assert late.verdict == doctor.WRONG
    assert "2.0 s" in late.what


def test_top_says_why_the_robot_stands() -> None:
    view = View()
    stop = Stop(1, stopped=True, by="anna")
    view.update("robot/state", replace(WELL, stop=stop), 0.0)
    snapshot = top.Snapshots(view, "robot1").at(0.1)
    assert snapshot["standing"]["cause"]["who"] == "anna"
    console = Console(width=120)
    with console.capture() as shown:
        console.print(top.tables(snapshot))
    assert "It is stopped by anna." in shown.get()


def test_what_the_monitor_that_acts_misses_is_wrong() -> None:
    def verdicts(*reports: MonitorReport) -> list[str]:
        return [found.verdict for found in doctor.monitors(reports)]

    acts, waits = MonitorReport("monitor-1", 90, True), MonitorReport("monitor-2", 20, False)
    assert verdicts() == []
    assert verdicts(waits, acts) == [doctor.OK]
    assert verdicts(waits) == [doctor.NOTE]
    lacks = replace(acts, missing=("encoder", "sonar"), note="b is asked to start encoder")
    (found,) = doctor.monitors([lacks, waits])
    assert found.verdict == doctor.WRONG
    assert "encoder, sonar (b is asked to start encoder)" in found.what
    assert "armadico logs encoder" in found.todo


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


@pytest.mark.parametrize(
    ("variance", "verdict", "deviation"),
    [(0.0025, "ok", "+-0.05 m"), (1.96, "note", "+-1.40 m")],
)
def test_the_deviation_of_the_pose_is_reported(
    variance: float, verdict: str, deviation: str
) -> None:
    found = doctor.pose(posed(variance))
    assert found.verdict == verdict
    assert deviation in found.what
    assert doctor.pose(replace(posed(1.0), covariance=())).verdict == doctor.NOTE


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


def test_a_host_without_a_router_in_the_table_is_not_looked_for(tmp_path: Path) -> None:
    table = tmp_path / "hosts.toml"
    table.write_text('[lab1]\nagents = ["goto"]\n')
    on_query = Mesh(hosts=str(table))
    (finding,) = doctor.hosts(on_query)
    assert (finding.subject, finding.verdict) == ("host lab1", "ok")


def test_a_folder_for_sockets_that_others_can_write_to_is_wrong(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(RUNTIME_VARIABLE, str(tmp_path))
    (tmp_path / "armadico").mkdir()
    (tmp_path / "armadico").chmod(0o777)
    (finding,) = doctor.router("doctor-test")
    assert (finding.subject, finding.verdict) == ("socket", "wrong")
    assert "chmod 700" in finding.what


@pytest.mark.live
def test_where_no_socket_can_be_made_that_is_found_and_the_rest_as_well(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / ("x" * 100)
    folder.mkdir()
    monkeypatch.setenv(RUNTIME_VARIABLE, str(folder))
    assert armadico(["doctor", "--json", "--namespace", "doctor-test"]) == 1
    findings = {f["subject"]: f for f in json.loads(capsys.readouterr().out)}
    assert findings["socket"]["verdict"] == "wrong"
    assert "too long" in findings["socket"]["what"]
    assert {"mesh", "clocks", "graphics"} <= set(findings)


@pytest.mark.live
def test_clocks_are_among_the_findings(capsys: pytest.CaptureFixture[str]) -> None:
    armadico(["doctor", "--json", "--namespace", "doctor-test"])
    findings = {f["subject"]: f for f in json.loads(capsys.readouterr().out)}
    assert findings["clocks"]["verdict"] == "ok"


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
    (found,) = [each for each in doctor.versions() if each.subject == package]
    assert f"pip install 'armadico[{extra}]'" in found.todo
