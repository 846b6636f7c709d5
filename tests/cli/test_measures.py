"""The table of measures: everybody who drove, means and deviations, and numbers at any width."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from armadico.cli.measures import WORDS, show, statistics
from armadico.observe.measures import Result
from tests.house.tree import ROOT

SHARES = {"goto": 77.25, "wall-follower-of-a-guest": 22.75}
RUN = Result("sc4", 7, True, 5.125, 1.5, 42.25, 99.75, SHARES, 6, 0, 0.375)
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
    assert "way driven" in said
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
