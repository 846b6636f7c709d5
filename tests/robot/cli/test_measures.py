"""The table of measures: who drove, means and deviations; and all of it in a narrow terminal."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from armadico.cli.measures import show, statistics
from armadico.cli.options import FAILED, UNKNOWN
from armadico.cli.run import Options, exit_code
from armadico.core.judgement import no, unknown, yes
from armadico.observe.measures import Result

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


def test_who_did_not_drive_has_none_of_it_and_what_is_not_known_does_not_count() -> None:
    found = statistics(RUNS)
    assert found["mean"]["shares"]["wall-follower-of-a-guest"] == 11.375
    clearances = [found[name]["min_clearance_m"] for name in ("mean", "deviation")]
    assert clearances == [0.375, None]


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
