"""The falsifier: a hostile holder is stopped or found, and what is found can be repeated."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.bridge.robot import Parameters
from armadico.bridge.simulator.plant import Plant
from armadico.cli.options import UsageError
from armadico.core.config_errors import ConfigError
from armadico.core.judgement import UNKNOWN_EXIT
from armadico_tools.commands import falsify
from armadico_tools.falsify import search, series, trial
from armadico_tools.falsify.cases import SIZE, Case, loads, setting
from armadico_tools.falsify.search import Search, smaller
from armadico_tools.falsify.series import Ledger
from armadico_tools.faults.contacts import Cause
from armadico_tools.series import over

AT_A_WALL = Case("pioneer-2dx", "rooms-a", 1, 8.0, (3.6, 2.2, 0.0), ((0.6, 0.0),))
"""Straight at a wall 1 m away that it faces squarely."""


AT_A_SLANTED_WALL = Case(
    "pioneer-2dx",
    "house",
    1,
    4.0,
    (12.981, 7.312, 0.8155),
    ((0.83, 0.0), (1.19, 0.016)),
)
BESIDE_A_WALL = Case(
    "pioneer-2dx",
    "rooms-a",
    0,
    6.0,
    (3.838934, 4.071632, 1.628796),
    ((0.407446, -1.30688), (0.383657, 0.033962), (-0.225186, -0.150295)),
)
"""Walls that go on where no sonar hears them: one at 50 degrees, one at 15 degrees."""

Lift = Callable[[], None]


@pytest.fixture
def lift_limits(monkeypatch: pytest.MonkeyPatch) -> Lift:
    """Makes robot agents let every command through."""
    unlimited = partial(Parameters, reflex=False)
    return lambda: monkeypatch.setattr(trial, "Parameters", unlimited)


@pytest.fixture
def without_limits(lift_limits: Lift) -> None:
    lift_limits()


def test_a_hostile_holder_is_let_at_a_wall_only_where_the_robot_agent_has_no_limits(
    lift_limits: Lift, capsys: pytest.CaptureFixture[str]
) -> None:
    limited = trial.run(AT_A_WALL)
    lift_limits()
    outcome = trial.run(AT_A_WALL)
    assert outcome.found
    assert outcome.worth < min(-0.5, 1.5 * limited.worth)
    assert falsify.main(["--repeat", AT_A_WALL.dumps(), "--json"]) == 1
    again = json.loads(capsys.readouterr().out)
    assert (again["at"], again["worth"]) == (outcome.at, outcome.worth)


@pytest.mark.parametrize("case", [AT_A_WALL, AT_A_SLANTED_WALL, BESIDE_A_WALL])
def test_no_wall_that_was_heard_is_touched(case: Case) -> None:
    assert not trial.run(case).cause


@pytest.mark.usefixtures("without_limits")
def test_a_wall_that_no_sonar_hears_is_not_the_robots_fault(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Plant, "ping", lambda self, index: None)
    outcome = trial.run(AT_A_WALL)
    assert outcome.cause
    assert not outcome.found
    assert outcome.worth == trial.SPARED_S


def test_a_contact_of_which_the_readings_do_not_tell_enough_does_not_pass(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    outcome = trial.Outcome(AT_A_WALL, 60, trial.SPARED_S, Cause.UNKNOWN.value)
    monkeypatch.setattr(series, "run", lambda _: outcome)
    assert falsify.main(["--repeat", AT_A_WALL.dumps(), "--json"]) == UNKNOWN_EXIT
    assert json.loads(capsys.readouterr().out)["judgement"]["answer"] == "unknown"


@pytest.mark.long
@pytest.mark.usefixtures("without_limits")
def test_a_small_search_finds_a_contact_goes_on_where_it_was_and_prints_a_repeatable_case(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[int] = []
    whole = Search.run

    def small(self: Search) -> search.Found:
        ran.append(self.seed)
        return whole(replace(self, generations=1, lasts=6.0))

    monkeypatch.setattr(Search, "run", small)
    some = ["--robot", "pioneer-2dx", "--world", "rooms-a", "--jobs", "1", "--out", str(tmp_path)]
    assert falsify.main([*some, "--cycles", "100", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["robots"]["pioneer-2dx"]["preventable"] > 0
    first = list(ran)
    (command,) = found["repeat"]
    assert falsify.main(shlex.split(command)[2:]) == 1
    cycles = Ledger(tmp_path, "pioneer-2dx", ("rooms-a",)).cycles
    assert falsify.main([*some, "--cycles", str(cycles + 1)]) == 1
    assert not set(first) & set(ran[len(first) :]), "no seed is searched twice"


def test_an_interrupted_search_does_not_pass_and_says_how_far_it_came(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = Search.run

    def interrupted(self: Search) -> search.Found:
        if self.seed:
            raise KeyboardInterrupt
        return whole(replace(self, generations=1, lasts=1.0))

    monkeypatch.setattr(Search, "run", interrupted)
    some = ["--robot", "pioneer-2dx", "--world", "rooms-a", "--jobs", "1", "--out", str(tmp_path)]
    assert falsify.main([*some, "--cycles", "20000"]) == UNKNOWN_EXIT
    driven = Ledger(tmp_path, "pioneer-2dx", ("rooms-a",)).cycles
    assert f"unknown: pioneer-2dx: {driven:,} of 20,000 cycles were driven" in (
        capsys.readouterr().out
    )
    assert falsify.main([*some, "--cycles", str(driven), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["judgement"]["answer"] == "yes"


def test_a_series_of_which_a_process_was_killed_is_not_whole(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert not over(os._exit, [1, 1], 2, "seeds", lambda _task, _found: None)
    assert "a process was killed after 0 of 2 seeds" in capsys.readouterr().err


@pytest.mark.usefixtures("without_limits")
def test_a_case_is_made_simpler_while_it_still_touches() -> None:
    people = ((1.0, 0.6, 0.4),)
    outcome = trial.run(replace(AT_A_WALL, people=people, delay=0.05, towards=0.01))
    assert outcome.found
    assert smaller(outcome).case == AT_A_WALL


def test_every_point_of_the_cube_is_a_case_that_can_be_written_and_read() -> None:
    for share in (0.0, 0.5, 1.0):
        case = setting("turtlebot3-burger", ("rooms-a", "house"), 3, 5.0).case([share] * SIZE)
        assert loads(case.dumps()) == case


def test_bad_input_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="not a case of armadico falsify"):
        loads('{"robot": "pioneer-2dx"}')
    with pytest.raises(UsageError, match="--cycles is not used with --repeat"):
        falsify.main(["--repeat", "{}", "--cycles", "5"])
