"""`armadico audit` of recordings: what is broken, kept, and not checked, and why not."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import cycle
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap")

from armadico import cli
from armadico.config.scenarios import load_scenario
from armadico.config.shipped import find
from armadico.core.messages import PROTOCOL, Point, Stop, encode
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import MissionState, MissionStatus, Trajectory, Waypoint
from armadico.observe.watching import Received
from armadico.watch.recorder import Recording
from tests.watch.made import copied, of_two_robots, recorded
from tests.watch.observed import LINE

Audit = Callable[..., tuple[int, dict[str, Any]]]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """It drives for 8 s."""
    path = tmp_path_factory.mktemp("audit") / "run.mcap"
    with recorded(path) as run:
        run.start()
        run.begin()
        run.mesh.run(8.0)
    return path


@pytest.fixture
def audit(capsys: pytest.CaptureFixture[str]) -> Audit:
    def judge(path: Path, *words: str) -> tuple[int, dict[str, Any]]:
        code = cli.main(["audit", str(path), "--json", *words])
        out, err = capsys.readouterr()
        return code, json.loads(out) if out else {"error": err}

    return judge


def answers(found: dict[str, Any]) -> dict[str, str]:
    return {each["promise"]: each["answer"] for each in found["promises"]}


def test_a_usual_drive_passes_and_what_had_no_occasion_is_named(
    recording: Path, audit: Audit
) -> None:
    code, found = audit(recording)
    assert (code, found["answer"], found["findings"]) == (0, "yes", [])
    judged = answers(found)
    assert (judged["one-driver"], judged["collision"], judged["odometry"]) == ("yes",) * 3
    assert judged["failed"] == "unknown", "no mission ended"
    assert "failed" in [each["promise"] for each in found["promises"] if not each["occasion"]]
    assert audit(recording, "--only", "failed")[0] == 3, "nothing at all was checked"


def test_a_robot_that_no_agent_drove_is_unknown_and_the_last_line_counts_all(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "idle.mcap"
    with recorded(path) as run:
        run.start()
        run.mesh.run(4.0)
    assert cli.main(["audit", str(path)]) == 3
    lines = capsys.readouterr().out.splitlines()
    assert "not checked  no agent drove the robot" in lines
    counted = {word.rpartition(" ")[0]: int(word.split()[-1]) for word in lines[-1].split(", ")}
    assert (counted["broken"], counted["not checked"]) == (0, 1)
    for word in ("kept", "no occasion"):
        assert counted[word] == sum(line.startswith(word) for line in lines)
        assert counted[word] > 0
    for promise in ("one-driver", "steady", "held"):
        assert any(line.startswith(f"no occasion  {promise} ") for line in lines)
    assert cli.main(["audit", str(path), "--only", "pose"]) == 0


def test_what_only_a_truth_shows_can_be_accepted_as_unknown_and_the_rest_is_named_as_kept(
    recording: Path, audit: Audit, tmp_path: Path
) -> None:
    real, nothing = tmp_path / "real.mcap", tmp_path / "nothing.mcap"
    copied(recording, real, lambda key, _: key != "sim/truth")
    code, found = audit(real, "--only", "pose")
    assert (code, answers(found)) == (3, {"pose": "unknown"})
    assert found["promises"][0]["what"] == "kept as far as was judged: no Truth received"
    code, found = audit(real, "--accept-unknown")
    assert (code, found["answer"]) == (0, "unknown")
    copied(recording, nothing, lambda key, _: key == "encoder/pose")
    assert audit(nothing, "--accept-unknown")[0] == 3, "nothing was kept"


def test_a_path_through_a_wall_of_the_map_that_the_agents_name_is_broken(
    audit: Audit, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    with recorded(path, Rehearsal(load_scenario("sc4"), Options(seed=4))) as run:
        run.start()
        run.mesh.run(1.0)
        end = Waypoint(run.scenario.start[0] + 50.0, run.scenario.start[1], 0.0)
        run.mesh.publish(Trajectory(1, 1, (end,), Point(*run.scenario.start[:2]), planned=True))
        run.mesh.run(1.5)
    assert audit(path, "--only", "path")[0] == 1
    code, found = audit(path, "--only", "path", "--world", "no-such-map")
    assert code == 2
    assert "no-such-map" in found["error"]


def test_by_another_map_than_the_agents_name_nothing_is_kept(
    recording: Path, audit: Audit, tmp_path: Path
) -> None:
    assert LINE.world != "house"
    code, found = audit(recording, "--world", "house", "--accept-unknown")
    assert (code, found["answer"]) == (3, "unknown")
    assert f"{LINE.world!r}, and --world is 'house'" in found["unread"][0]
    copy = tmp_path / "copy.map"
    copy.write_bytes(find("worlds", LINE.world).read_bytes())
    assert audit(recording, "--world", str(copy))[0] == 0, "the same walls under another name"


def test_by_a_map_of_the_same_name_that_the_agents_have_not_the_paths_are_not_judged(
    audit: Audit, tmp_path: Path
) -> None:
    """The shipped map is another one than the robot's own of its name."""
    path = tmp_path / "run.mcap"
    run = Rehearsal(LINE, Options(seed=4))
    for name in ("sonar", "path-planning"):
        object.__setattr__(run.mesh.node(name).agent.identity, "map", "89abcdef")
    with recorded(path, run):
        run.start()
        run.begin()
        run.mesh.run(5.0)
    found = {each["promise"]: each["what"] for each in audit(path)[1]["promises"]}
    assert "map" in found["path"]
    assert audit(path, "--world", LINE.world)[1]["unread"] == [
        f"--world is another map {LINE.world!r} than the agents have"
    ]


def test_a_mission_that_is_reported_as_reached_under_way_is_broken(
    audit: Audit, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    with recorded(path) as run:
        run.start()
        run.begin()
        run.mesh.run(5.0)
        number = run.watch.view.mission.mission if run.watch.view.mission else 1
        run.mesh.publish(MissionStatus(number, MissionState.REACHED, 0.0))
        run.mesh.run(5.5)
    code, found = audit(path)
    assert (code, answers(found)["reached"]) == (1, "no")
    assert audit(path, "--accept-unknown")[0] == 1


def test_a_recording_that_was_cut_is_never_all_kept(
    recording: Path, audit: Audit, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.mcap"
    data = recording.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    code, found = audit(cut, "--only", "one-driver")
    assert answers(found) == {"one-driver": "unknown"}
    assert "cut short" in found["promises"][0]["what"]
    assert (code, found["answer"]) == (3, "unknown")
    assert "cut short" in found["unread"][0]


def test_without_the_messages_that_it_needs_a_promise_is_not_checked(
    audit: Audit, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    kept = Recording(path)
    kept.add(Received("robot1", "robot/stop", encode(Stop(1, True, "anna", 7)), 10**9))
    kept.close()
    code, found = audit(path)
    assert (code, set(answers(found).values())) == (3, {"unknown"})
    assert all("received" in each["what"] for each in found["promises"])


def test_a_gap_is_not_blamed_on_the_robot_and_not_passed_over(
    recording: Path, audit: Audit, tmp_path: Path
) -> None:
    gap = copied(recording, tmp_path / "gap.mcap", lambda _, t: not 3 < t < 6)
    code, found = audit(gap, "--only", "one-driver")
    assert (code, found["findings"], answers(found)) == (3, [], {"one-driver": "unknown"})
    assert "nothing was received from" in found["unread"][0]
    assert audit(gap, "--only", "one-driver", "--accept-unknown")[0] == 3


@pytest.mark.parametrize(
    ("key", "promise"),
    [("sim/truth", "collision"), ("sonar/obstacles", "honest"), ("robot/state", "stands")],
)
def test_a_gap_in_one_kind_of_messages_is_not_passed_over(
    key: str, promise: str, recording: Path, audit: Audit, tmp_path: Path
) -> None:
    gap = copied(recording, tmp_path / "gap.mcap", lambda own, t: own != key or not 3 < t < 6)
    code, found = audit(gap, "--only", promise)
    assert (code, answers(found)) == (3, {promise: "unknown"})
    assert "received from" in found["promises"][0]["what"]


def test_a_recording_that_ends_while_the_robot_is_silent_does_not_pass(
    recording: Path, audit: Audit, tmp_path: Path
) -> None:
    dead = copied(
        recording,
        tmp_path / "dead.mcap",
        lambda key, t: t <= 4 or not key.startswith(("robot/", "resource/")),
    )
    code, found = audit(dead, "--only", "one-driver", "--only", "odometry")
    assert (code, found["answer"], found["unread"]) == (3, "unknown", [])
    assert set(answers(found).values()) == {"unknown"}
    assert all("received after" in each["what"] for each in found["promises"])


@pytest.mark.parametrize(
    ("thinned", "only", "what"),
    [
        ("resource/wheels/ack", "one-driver", "67% of Ack missing"),
        ("encoder/pose", "pose", "67% of Pose missing"),
    ],
)
def test_two_of_three_messages_that_come_each_cycle_are_missed(
    recording: Path, audit: Audit, tmp_path: Path, thinned: str, only: str, what: str
) -> None:
    thin, thirds = tmp_path / "thin.mcap", cycle((False, False, True))
    copied(recording, thin, lambda key, _: key != thinned or next(thirds))
    code, found = audit(thin, "--only", only)
    assert (code, found["findings"], found["unread"]) == (3, [], [])
    assert what in found["promises"][0]["what"]
    assert audit(thin, "--only", "collision")[0] == 0, "it needs none of them"


def test_without_any_card_it_is_not_known_that_there_was_no_map(
    recording: Path, audit: Audit, tmp_path: Path
) -> None:
    unmet = copied(recording, tmp_path / "unmet.mcap", lambda key, _: not key.endswith("/card"))
    code, found = audit(unmet, "--only", "path")
    assert (code, found["promises"][0]["occasion"]) == (3, True)
    assert "card" in found["promises"][0]["what"]


def unchecked(code: int, found: dict[str, Any]) -> str:
    """Why nothing at all was checked."""
    assert (code, found["answer"], set(answers(found).values())) == (3, "unknown", {"unknown"})
    return str(found["unread"][0])


@pytest.mark.parametrize("size", [0, 3, 400])
def test_a_recording_that_was_cut_before_its_first_messages_is_unknown(
    recording: Path, audit: Audit, tmp_path: Path, size: int
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[:size])
    assert str(cut) in unchecked(*audit(cut))


def test_a_recording_of_another_protocol_is_unknown(audit: Audit, tmp_path: Path) -> None:
    newer = tmp_path / "newer.mcap"
    Recording(newer, {"protocol": str(PROTOCOL + 1), "version": "9.9"}).close()
    assert f"protocol {PROTOCOL + 1}" in unchecked(*audit(newer))


def test_without_a_society_nothing_is_known(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    code = cli.main(["audit", "--live", "--for", "1", "--json"])
    assert "robot agent" in unchecked(code, json.loads(capsys.readouterr().out))


def test_a_recording_of_several_robots_is_not_judged(audit: Audit, tmp_path: Path) -> None:
    code, found = audit(of_two_robots(tmp_path / "both.mcap"))
    assert (code, "name one robot" in found["error"]) == (2, True)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("--only", "speedy"), "expected one of"),
        (("--live",), "either a recording or --live"),
        (("--for", "3"), "for --live"),
        (("--namespace", "robot9"), "no messages of 'robot9'; --namespace: robot1"),
    ],
)
def test_a_wrong_command_line_says_what_is_wrong(
    recording: Path, audit: Audit, words: tuple[str, ...], what: str
) -> None:
    code, found = audit(recording, *words)
    assert code == 2
    assert what in found["error"]
