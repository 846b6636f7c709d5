"""Replay of journals: equal with all faults, and different from the first effect of a change."""

from __future__ import annotations

import json
import shutil
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace as changed

pytest.importorskip("mcap")

from msgspec import msgpack

from armadico import cli
from armadico.cli import options
from armadico.config.scenarios import Scenario, load_scenario
from armadico.config.shipped import folder
from armadico.core import journal as j
from armadico.core.messages import PROTOCOL, JournalPiece, decode
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mesh.link_faults import LinkFaults
from armadico.observe.journals import Frames, Journal
from armadico.watch.recorder import McapFile, Recording
from armadico.watch.recordings import Past, rows
from armadico.watch.replay import Life, replayed
from armadico.watch.virtual_recording import Recorded

SEED = 5

At = tuple[float, Callable[[Rehearsal], object]]


def record(
    path: Path, *faults: At, limit: float = 4.0, scenario: Scenario | None = None, **more: Any
) -> Path:
    """A virtual run, with faults at their times, s."""
    chosen = Options(seed=SEED, limit=limit, **({"sensors": "ideal"} | more))
    made = Rehearsal(prepared(scenario or load_scenario("sc4"), chosen), chosen)
    for at, fault in faults:
        made.mesh.call_at(at, lambda _a, _b, fault=fault: fault(made))
    with Recorded(made.mesh, path, made.namespace):
        made.run()
    return path


def journals(path: Path) -> list[Journal]:
    return Past(path, pytest.fail).journals()


def journal_of(path: Path, name: str) -> Journal:
    (found,) = [each for each in journals(path) if each.name == name]
    return found


def without(path: Path, out: Path, number: int) -> Path:
    """The same recording without one piece of goto's journal."""
    file = McapFile(out, {"armadico": {"protocol": str(PROTOCOL)}})
    for row in rows(path, pytest.fail):
        if row.key.startswith("journal/goto") and decode(row.data, JournalPiece).number == number:
            continue
        file.add(row.namespace, row.key, None, row.data, row.t)
    file.close()
    return out


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("replay") / "run.mcap")


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """`armadico replay` with arguments: exit code, stdout and stderr."""

    def called(*words: object) -> tuple[int, str, str]:
        code = cli.main(["replay", *map(str, words)])
        return code, *capsys.readouterr()

    return called


# Equal --------------------------------------------------------------------------------------------


def test_every_agent_decides_the_same(recording: Path) -> None:
    found = [replayed(journal) for journal in journals(recording)]
    assert len(found) >= 7
    for outcome in found:
        assert outcome.equal, outcome
        assert not outcome.end
        assert not outcome.notes
        assert outcome.outputs > 0
        assert outcome.seconds == pytest.approx(5.0, abs=0.5)


def test_localization_decides_the_same(tmp_path: Path) -> None:
    path = record(tmp_path / "run.mcap", limit=1.5, sensors="real")
    for name in ("localization", "relocate"):
        outcome = replayed(journal_of(path, name))
        assert outcome.equal, outcome


def link(way: tuple[str, str], faults: LinkFaults) -> Callable[[Rehearsal], object]:
    def spoil(made: Rehearsal) -> None:
        made.mesh.link(*way).faults = faults

    return spoil


PROCESSES: Sequence[At] = (
    (1.5, lambda made: made.mesh.node("avoid").slow_down(0.03)),
    (2.0, lambda made: made.mesh.node("goto").kill()),
    (2.2, lambda made: made.mesh.node("avoid").slow_down(0.0)),
    (2.6, lambda made: made.enter("goto")),
    (3.0, lambda made: made.mesh.node("sonar").hang()),
    (3.3, lambda made: made.mesh.node("encoder").jump(3.0)),
    (4.3, lambda made: made.mesh.node("sonar").resume()),
)
LINKS: Sequence[At] = (
    (1.2, lambda made: made.mesh.publish_bytes(b"\xff", "encoder/pose")),
    (1.3, lambda made: made.mesh.publish_bytes(b"", "resource/wheels/utility")),
    (1.5, link(("encoder", "goto"), LinkFaults(loss=0.5, duplicate=0.3, reorder=0.3))),
    (1.5, link(("device", "robot"), LinkFaults(garble=0.4))),
    (2.0, lambda made: made.mesh.cut(["encoder", "sonar"], ["avoid", "robot"], lease=True)),
    (3.5, lambda made: made.mesh.heal(["encoder", "sonar"], ["avoid", "robot"])),
)


@pytest.mark.long(but=("faults1-1",))
@pytest.mark.parametrize(("faults", "lives"), [(PROCESSES, 2), (LINKS, 1)])
def test_runs_with_faults_are_replayed_equal(
    tmp_path: Path, faults: Sequence[At], lives: int
) -> None:
    path = record(tmp_path / "run.mcap", *faults)
    found = [replayed(journal) for journal in journals(path)]
    assert all(outcome.equal for outcome in found), [o for o in found if not o.equal]
    assert sum(outcome.name == "goto" for outcome in found) == lives


# Different ----------------------------------------------------------------------------------------


def speeds(path: Path, name: str) -> list[tuple[int, float]]:
    """An agent's recorded commands: number of outputs before each, and the speed."""
    found, before = list[tuple[int, float]](), 0
    for moment in Life(journal_of(path, name)).moments():
        for item in msgpack.decode(moment.then) if moment.then else ():
            if item[0] == j.PUBLISH and item[1].startswith("robot/cmd/") and item[2][3]:
                found.append((before, item[2][3][0]))
            before += 1
    return found


def test_a_changed_parameter_differs_at_its_first_effect(recording: Path) -> None:
    faster = [(before, v) for before, v in speeds(recording, "goto") if v > 0.2]
    assert faster, "it drives"
    outcome = replayed(journal_of(recording, "goto"), ["v_max=0.2"])
    assert outcome.difference is not None
    # The parameter also caps the speed in a turn, so its effect may begin at less than 0.2 m/s.
    assert outcome.difference.output <= faster[0][0]
    assert "robot/cmd/" in outcome.difference.then[0]
    assert "robot/cmd/" in outcome.difference.now[0]
    assert outcome.difference.inputs
    assert "v_max=0.2" in outcome.notes[-1]


def test_changed_code_differs_at_its_first_effect(recording: Path) -> None:
    journal = journal_of(recording, "sonar")
    kind = type(Life(journal).agent)
    on_sonar: Any = kind.on_sonar  # type: ignore[attr-defined]

    class Silent(kind):  # type: ignore[misc, valid-type]
        def on_sonar(self, sonar: Any) -> None:
            if sonar.cycle.number < 20:
                on_sonar(self, sonar)

    outcome = replayed(journal, kind=Silent)
    assert outcome.difference is not None
    assert '"number":20' in outcome.difference.inputs[-1]
    assert outcome.difference.now == ()
    assert any("armadico.agents.perception.sonar:" in note for note in outcome.notes)


def test_another_wakeup_time_is_a_difference_before_it_has_an_effect(recording: Path) -> None:
    outcome = replayed(journal_of(recording, "interface"), ["repeat_s=0.9"])
    assert outcome.difference is not None
    assert outcome.difference.inputs[-1] == "wake up"
    assert " 0.5" in outcome.difference.then[-1]
    assert " 0.4" in outcome.difference.now[-1]


def test_an_exception_of_changed_code_is_a_difference(recording: Path) -> None:
    journal = journal_of(recording, "sonar")
    kind = type(Life(journal).agent)

    class Broken(kind):  # type: ignore[misc, valid-type]
        def on_sonar(self, _: Any) -> None:
            raise ZeroDivisionError("by hand")

    outcome = replayed(journal, kind=Broken)
    assert outcome.difference is not None
    (failure,) = outcome.difference.now
    assert "ZeroDivisionError: by hand" in failure


# Empty or damaged ---------------------------------------------------------------------------------


def first_entries(journal: Journal, *entries: list[Any]) -> Journal:
    """The first entry of a journal, followed by these."""
    start = next(journal.entries())
    frame = zlib.compress(msgpack.encode([start, *entries]))
    return Journal(
        journal.namespace,
        journal.name,
        journal.instance,
        journal.head,
        "",
        Frames(((journal.received, len(frame).to_bytes(4, "big") + frame),)),
    )


def test_an_empty_journal_is_not_equal(recording: Path) -> None:
    goto = journal_of(recording, "goto")
    for entries in list[list[list[Any]]](([], [[j.BEGIN, 0.0]])):
        outcome = replayed(first_entries(goto, *entries))
        assert outcome.difference is None
        assert not outcome.equal


@pytest.mark.parametrize(
    "entry",
    [[j.DELIVER, 1.0], [j.ASKED, 1.0, 7, b"", "x", "y"], [j.TAKE, b"", None], [j.REPORT, 1.0, 3]],
)
def test_an_invalid_entry_ends_the_replay(recording: Path, entry: list[Any]) -> None:
    outcome = replayed(first_entries(journal_of(recording, "goto"), [j.BEGIN, 0.0], entry))
    assert outcome.end
    assert not outcome.equal


# Not replayed -------------------------------------------------------------------------------------


def test_a_journal_is_compared_up_to_a_gap(recording: Path, tmp_path: Path) -> None:
    path = without(recording, tmp_path / "gap.mcap", 3)
    outcome = replayed(journal_of(path, "goto"))
    assert outcome.equal
    assert "piece 3 of" in outcome.end
    assert 0 < outcome.seconds < replayed(journal_of(recording, "goto")).seconds
    assert not replayed(journal_of(path, "avoid")).end


def test_an_agent_that_started_before_the_recording_is_not_replayed_and_others_are(
    recording: Path, tmp_path: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    path = without(recording, tmp_path / "late.mcap", 0)
    code, out, _ = run(path, "--json")
    assert code == options.FAILED
    found = json.loads(out)["agents"]
    assert [each["name"] for each in found if each["refusal"]] == ["goto"]
    assert sum(each["equal"] for each in found) >= 6


def test_a_changed_parameter_of_an_agent_that_cannot_be_replayed_fails(
    recording: Path, tmp_path: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    path = without(recording, tmp_path / "late.mcap", 0)
    assert run(path, "--set", "goto.v_max=0.2")[0] == options.FAILED
    assert run(path, "--set", "avoid.v_danger=0.05")[0] == 0


def test_a_changed_parameter_is_not_replayed_whole_on_a_recording_that_was_cut(
    recording: Path, tmp_path: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    (cut := tmp_path / "cut.mcap").write_bytes(recording.read_bytes()[:-100_000])
    code, out, _ = run(cut, "--agent", "goto", "--set", "v_max=0.2")
    assert "The recording is damaged" in out
    assert code == options.UNKNOWN


def test_a_world_that_has_changed_is_named(tmp_path: Path) -> None:
    world = tmp_path / "hall.map"
    shutil.copy(folder("worlds") / f"{load_scenario('sc4').world}.map", world)
    path = record(
        tmp_path / "run.mcap", limit=1.0, scenario=changed(load_scenario("sc4"), world=str(world))
    )
    (planner,) = [each for each in journals(path) if each.name == "path-planning"]
    assert replayed(planner).equal
    shutil.copy(folder("worlds") / "house.map", world)
    assert str(world) in replayed(planner).refusal
    world.unlink()
    assert str(world) in replayed(planner).refusal


def altered(journal: Journal, **more: Any) -> Journal:
    assert journal.head is not None
    return Journal(
        journal.namespace,
        journal.name,
        journal.instance,
        changed(journal.head, **more),
        journal.fault,
        journal.frames,
    )


def test_an_agent_that_is_not_installed_is_named_with_its_class(recording: Path) -> None:
    stranger = altered(journal_of(recording, "goto"), name="gotto", kind="mine:Gotto")
    refusal = replayed(stranger).refusal
    assert "'goto'" in refusal, "the suggestion"
    assert "mine:Gotto" in refusal


# The command --------------------------------------------------------------------------------------


def test_the_command_reports_equal_agents(
    recording: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    code, out, _ = run(recording, "--agent", "goto", "--agent", "avoid")
    assert code == 0
    assert "2 of 2" in out


def test_the_command_reports_the_first_difference(
    recording: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    code, out, _ = run(recording, "--agent", "goto", "--set", "v_max=0.2")
    assert code == 0  # a changed parameter may differ
    assert out.count("publish robot/cmd/goto-") >= 2  # then and now
    found = json.loads(run(recording, "--set", "goto.v_max=0.2", "--json")[1])["agents"]
    assert [each["name"] for each in found if each["difference"]] == ["goto"]


def test_a_recording_without_journals_names_the_options_that_make_them(
    recording: Path, tmp_path: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    kept = Recording(tmp_path / "bare.mcap")
    for row in rows(recording, pytest.fail):
        if row.schema == "armadico.Here":
            from armadico.observe.watching import Presence

            here = row.fields
            kept.add(Presence("robot1", here["name"], here["instance"], True, row.t))
    kept.close()
    code, _, err = run(tmp_path / "bare.mcap")
    assert code == options.USAGE
    assert "--journal" in err
