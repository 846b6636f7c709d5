"""`armadico why` of recordings: the same causes as live, and what it says to a wrong question."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap")

from armadico import cli
from armadico.cli import options
from armadico.core.messages import PROTOCOL, Stop
from armadico.watch.recorder import Recording
from tests.watch.made import copied, of_two_robots, recorded

Ask = Callable[..., Any]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """It drives; anna stops it at 3 s, bert lets it go on at 7 s; at 9 s its sonar agent dies."""
    path = tmp_path_factory.mktemp("why") / "run.mcap"
    with recorded(path) as run:
        mesh = run.mesh
        run.start()
        for at, stop in (3.0, Stop(1, True, "anna", 7)), (7.0, Stop(2, False, "bert", 7)):
            mesh.call_at(at, lambda said, _: mesh.publish(said), stop)
        mesh.call_at(9.0, lambda _a, _b: mesh.node("sonar").kill())
        run.begin()
        mesh.run(14.0)
    return path


@pytest.fixture
def query(recording: Path, capsys: pytest.CaptureFixture[str]) -> Ask:
    """What it answers a question, as an object; or its complaint."""

    def put(*words: str, path: Path = recording) -> Any:
        code = cli.main(["why", str(path), "--json", *words])
        out, err = capsys.readouterr()
        return json.loads(out) if code == 0 else (code, err)

    return put


def test_what_happened_is_told_in_order(query: Ask) -> None:
    found = query()
    assert found["seconds"] == pytest.approx(14.0, abs=0.3)
    assert [each["by"] for each in found["stops"]] == ["anna"]
    assert found["collisions"] == []
    assert found["standing"]["cause"]["sort"] == "absent"
    assert found["standing"]["cause"]["who"] == "sonar"


def test_a_moment_has_each_contenders_bid_with_the_inputs_that_made_it(query: Ask) -> None:
    found = query("--at", "2.5")
    (wheels,) = [each for each in found["contests"] if each["resource"] == "wheels"]
    assert wheels["holder"].startswith("goto-")
    assert wheels["obeyed"] == wheels["holder"]
    bids = {each["agent"]: each for each in wheels["bids"]}
    assert bids["goto"]["utility"] == wheels["utility"]
    assert bids["goto"]["wanted"] == wheels["wanted"]
    assert bids["avoid"]["utility"] is None
    assert bids["avoid"]["reason"] == "nothing in the way"
    keys = {each["key"] for each in bids["goto"]["inputs"]}
    assert keys == {"encoder/pose", "sonar/obstacles"}
    assert all(each["age"] <= 1 for each in bids["goto"]["inputs"])


def test_a_bid_that_nobody_asked_for_in_time_is_recomputed_from_the_journal(
    tmp_path: Path, query: Ask
) -> None:
    """Avoid dies between two askings: what it thought of the last moment nobody was told."""
    path = tmp_path / "dies.mcap"
    with recorded(path) as run:
        run.start()
        run.begin()
        run.mesh.run(4.95)
        run.mesh.node("avoid").kill()
        run.mesh.run(8.0)
    (wheels,) = [
        c for c in query("--at", "4.9", path=path)["contests"] if c["resource"] == "wheels"
    ]
    (avoid,) = [each for each in wheels["bids"] if each["agent"] == "avoid"]
    assert avoid["cycle"] is not None
    assert avoid["reason"] == "nothing in the way"


def test_why_it_stood_is_told_of_its_end_and_of_any_moment(query: Ask) -> None:
    assert query("--standing")["cause"]["who"] == "sonar"
    assert query("--standing", "--at", "6.5")["cause"]["who"] == "anna"
    assert query("--standing", "--at", "2.5") == {
        "stands": False,
        "sentences": query("--standing", "--at", "2.5")["sentences"],
        "cause": None,
    }


def test_a_stop_is_told_with_who_when_and_until_when(query: Ask) -> None:
    found = query("--stop")
    assert (found["by"], found["released_by"]) == ("anna", "bert")
    assert found["t"] == pytest.approx(3.0, abs=0.01)
    assert found["released"] == pytest.approx(7.0, abs=0.01)
    assert 0.3 < found["stood"] < 3.5, "a Pioneer brakes"


def test_for_people_it_is_sentences(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["why", str(recording), "--standing"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "The robot stands."
    assert "goto: no bid (no fresh sonar/obstacles)." in said
    assert said[-1].startswith("-> start it again")


def test_a_recording_that_was_cut_short_is_asked_as_far_as_it_goes(
    recording: Path, query: Ask, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[: 2 * recording.stat().st_size // 3])
    assert cli.main(["why", str(cut)]) == options.UNKNOWN
    out, err = capsys.readouterr()
    assert "was cut short" in err
    assert "how many are missing is not known" in err
    assert "At its end:" in out
    assert "Not all collisions are known" in out
    assert cli.main(["why", str(cut), "--at", "1"]) == 0
    assert cli.main(["why", str(cut), "--collision"]) == options.UNKNOWN, "it may have been cut off"


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["--at", "99"], 2, "--at 99"),
        (["--exchange", "9"], 1, "exchange of wheels 9"),
        (["--stop", "2"], 1, "stop 2"),
        (["--stop", "1", "--at", "3"], 2, "--at and --stop"),
        (["--namespace", "robot9"], 1, "'robot9'"),
    ],
)
def test_a_question_that_has_no_answer_is_told_why(
    words: list[str], code: int, says: str, query: Ask
) -> None:
    assert (got := query(*words))[0] == code
    assert says in got[1]


def test_a_recording_of_another_protocol_or_of_several_robots_is_refused(
    query: Ask, tmp_path: Path
) -> None:
    newer = tmp_path / "newer.mcap"
    Recording(newer, {"protocol": str(PROTOCOL + 1), "version": "9.9"}).close()
    code, said = query(path=newer)
    assert code == 2
    assert f"recorded with protocol {PROTOCOL + 1}" in said
    code, said = query(path=of_two_robots(tmp_path / "both.mcap"))
    assert code == 2
    assert "holds robot1, robot2; name one robot" in said


def test_a_gap_is_not_blamed_on_the_robot(recording: Path, query: Ask, tmp_path: Path) -> None:
    """Between two seconds nothing was kept."""
    gap = copied(recording, tmp_path / "gap.mcap", lambda _, t: not 5.0 < t < 11.0)
    found = query("--standing", "--at", "9.0", path=gap)
    assert (found["cause"]["sort"], found["cause"]["who"]) == ("unknown", "")
    assert "a recording has a gap" in found["cause"]["what"]


@pytest.mark.parametrize(
    ("key", "what", "why"),
    [
        ("sim/truth", "collision", "no sim/truth was received"),
        ("resource/wheels/ack", "exchange", "no resource/wheels/ack was received"),
        ("robot/st", "stop", "no robot/state was received"),
    ],
)
def test_events_that_nothing_counted_are_unknown_and_not_none(
    recording: Path, query: Ask, tmp_path: Path, key: str, what: str, why: str
) -> None:
    blind = copied(
        recording, tmp_path / "blind.mcap", lambda row_key, _: not row_key.startswith(key)
    )
    found = query(path=blind)
    assert found["unknown"][what] == why
    assert found[f"{what}s"] is None
    code, said = query(f"--{what}", "1", path=blind)
    assert code == options.UNKNOWN
    assert why in said


def test_events_after_the_last_message_that_counts_them_are_unknown(
    recording: Path, query: Ask, tmp_path: Path
) -> None:
    blind = copied(
        recording, tmp_path / "blind.mcap", lambda key, t: key != "sim/truth" or not 4.1 < t < 8.1
    )
    assert "was received from 4" in query(path=blind)["unknown"]["collision"]
    ended = copied(recording, tmp_path / "ended.mcap", lambda key, t: key != "sim/truth" or t < 4.2)
    assert "was received after 4" in query(path=ended)["unknown"]["collision"]
    assert query()["unknown"] == {}
