"""The table of measures: who drove, means and deviations; and all of it in a narrow terminal."""

from __future__ import annotations

from io import StringIO

import pytest
from msgspec.structs import replace
from rich.console import Console
from rich.progress import Progress

from armadico.cli import ps
from armadico.cli.measures import WORDS, show, statistics
from armadico.cli.options import FAILED, UNKNOWN
from armadico.cli.progress import bar, remark
from armadico.cli.run import Options, exit_code
from armadico.core.judgement import no, unknown, yes
from armadico.core.messages import PROTOCOL, Card
from armadico.mobile.messages import MissionState, MissionStatus
from armadico.observe.diagnosis import hosts_of
from armadico.observe.findings import NOTHING
from armadico.observe.measures import Result, RunWatch
from armadico.observe.view import View
from tests.whole.house.tree import ROOT

SHARES = {"goto": 77.25, "wall-follower-of-a-guest": 22.75}
RUN = Result("sc4", 7, True, 5.125, 1.5, 42.25, 99.75, SHARES, 6, 0, 0.375, arrived=True)
RUNS = [RUN, replace(RUN, seed=8, tt_s=44.25, shares={"goto": 100.0}, min_clearance_m=None)]


@pytest.mark.parametrize("width", ["60", "80", "200"])
def test_one_run_keeps_its_numbers_in_any_terminal_and_says_what_they_are(
    width: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", width)
    show("sc4", [RUN])
    said = capsys.readouterr().out
    for number in ("5.12", "1.50", "42.25", "99.75", "77.25", "22.75", "6", "0.38"):
        assert f"{number}│" in said
    assert "TD m" in said
    assert max(map(len, said.splitlines())) <= int(width)


@pytest.mark.parametrize("width", ["60", "200"])
def test_several_runs_have_mean_and_deviation_in_any_terminal(
    width: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", width)
    show("sc4", RUNS)
    said = capsys.readouterr().out
    assert "…" not in said
    for number in ("43.25", "1.41", "11.38", "16.09"):
        assert f"{number}│" in said
    assert ("44.25│" in said) == (width == "200")


def test_who_did_not_drive_has_none_of_it_and_what_is_not_known_does_not_count() -> None:
    found = statistics(RUNS)
    assert found["mean"]["shares"]["wall-follower-of-a-guest"] == 11.375
    clearances = [found[name]["min_clearance_m"] for name in ("mean", "deviation")]
    assert clearances == [0.375, None]


def test_the_page_defines_every_measure_and_condition() -> None:
    page = (ROOT / "docs" / "measures.md").read_text(encoding="utf-8")
    fields = {field for field, _, _ in WORDS} | {*Result.__struct_fields__}
    assert not [field for field in fields if f"`{field}`" not in page]


def test_the_progress_line_keeps_its_scenario_and_a_bar_in_a_narrow_terminal() -> None:
    console = Console(width=60, file=StringIO())
    with Progress(*bar(), console=console, expand=True, disable=True) as progress:
        said = "3.21 m to go, 0.45 m/s, gothrough drives, 12.8 V"
        progress.add_task(said, total=1.0, completed=1.0, label="sc1 seed 0")
        console.print(progress.get_renderable())
    (line,) = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert line.startswith("sc1 seed 0 ━━━━━━")
    assert "3.21 m to go, 0.45 m/s" in line
    assert len(line) <= 60


def test_the_progress_line_gives_no_distance_to_no_goal() -> None:
    watch = RunWatch("sc1", None)
    watch.update(MissionStatus(0, MissionState.NONE, 0.0), 0.0)
    assert remark(watch).startswith("no goal, ")
    watch.update(MissionStatus(1, MissionState.DRIVING, 2.0), 0.1)
    assert remark(watch).startswith("2.00 m to go, ")


def test_ps_breaks_no_name_in_a_narrow_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    keys = ("mission/request", "mission/status")
    who = ("path-planning", "path-planning-0123456789abcdef")
    silent = ("wall-follower", "wall-follower-0123456789abcdef")
    card = Card(*who, "lab1", 1, "1", PROTOCOL, keys, (), ("wheels",))
    view = View.of({who: card, silent: None})
    ps.show("r", view, hosts_of(view, NOTHING, 0.0), everyone=False)
    said = capsys.readouterr().out.split()
    assert {who[0], silent[0], *keys, "not", "answering"} <= set(said)


def test_unknown_has_its_own_exit_code_and_says_how_to_make_it_known(
    capsys: pytest.CaptureFixture[str],
) -> None:
    judgement = unknown("no truth", "start a simulator")
    assert exit_code(Options(), judgement) == UNKNOWN
    assert "no truth\n  -> start a simulator" in capsys.readouterr().err
    assert exit_code(Options(accept_unknown=True), judgement) == 0
    assert exit_code(Options(accept_unknown=True), no("2 collisions")) == FAILED


def test_the_table_names_what_is_unknown(capsys: pytest.CaptureFixture[str]) -> None:
    lost = replace(RUN, reached=None, arrived=True, collisions=None, judgement=unknown("no truth"))
    show("sc4", [lost])
    assert "no truth" in capsys.readouterr().out
    show("sc4", [replace(RUN, judgement=yes()), lost])
    assert "1 of 2 runs reached the goal, no collision, 1 unknown" in capsys.readouterr().out


def test_ps_keeps_the_hosts_at_80_columns(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    keys = ("localization/correction", "localization/particles", "interface/request")
    names = ("path-planning", "path-planning-0123456789abcdef")
    card = Card(*names, "laboratory-2", 1234567, "1.0.0", PROTOCOL, keys, (), ("wheels", "planner"))
    view = View.of({names: card})
    ps.show("r", view, hosts_of(view, NOTHING, 0.0), everyone=False)
    shown = capsys.readouterr().out
    assert "HOST" in shown.splitlines()[0]
    assert "laboratory-2" in shown
