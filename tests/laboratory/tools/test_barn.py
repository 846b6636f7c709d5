"""The BARN challenge's worlds, its rule and its score."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from armadico.cli.options import UsageError
from armadico.config.maps import parse_map
from armadico.config.mapwriter import format_map
from armadico.config.scenarios import load_scenario
from armadico.core.config_errors import ConfigError
from armadico_tools.commands import experiment
from armadico_tools.experiments import barn
from armadico_tools.experiments.barn_worlds import (
    FENCE,
    GOAL,
    SHIPPED,
    START,
    BarnWorld,
    read_worlds,
)
from armadico_tools.experiments.driving import Cell


def test_the_worlds_that_are_shipped() -> None:
    worlds = read_worlds()
    assert sorted(worlds) == [n for n in range(300) if n % 6]
    assert sum(n % 6 in barn.TUNED for n in worlds) == 150
    for world in worlds.values():
        assert set(FENCE) <= set(world.cylinders)
        assert 150 <= len(world.cylinders) <= 400
        assert 10.0 < world.path_m < 14.0
        assert world.world().clearance(*START[:2]) > 0.5
        assert world.world().clearance(*GOAL[:2]) > 0.5


def test_worlds_are_read_from_either_kind_of_file(tmp_path: Path) -> None:
    worlds = dict(list(read_worlds().items())[:5])
    path = tmp_path / "few.txt"
    path.write_text("".join(SHIPPED.read_text().partition("\n1 ")[1:])[1:])
    assert dict(list(read_worlds(path).items())[:5]) == worlds
    path = tmp_path / "few.json"
    listed = [
        {"world": w.number, "cylinders": w.cylinders, "path_length": w.path_m, "models": 474}
        for w in worlds.values()
    ]
    path.write_text(json.dumps(listed))
    assert read_worlds(path) == worlds


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "no world"),
        ("1 10 !!!", "base64"),
        ("1 nan AAAA", "METRES"),
        ("1 3 AAAA\n1 3 AAAA", "twice"),
        ('[{"world": 1, "cylinders": [[0]], "path_length": 1}]', "list of worlds"),
        ('[{"world": 1, "cylinders": [[0, 0]], "path_length": 0}]', "list of worlds"),
    ],
)
def test_a_file_that_is_none_of_worlds_is_refused(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "worlds"
    path.write_text(text)
    with pytest.raises(ConfigError, match=why):
        read_worlds(path)


def test_the_score_is_the_challenge_s() -> None:
    """Success x OT / clip(T, 2 OT, 8 OT), OT the path's length at 2 m/s."""
    world = BarnWorld(1, (), 11.0)
    assert world.score(None) == 0.0
    assert world.score(3.0) == world.score(11.0) == 0.5
    assert world.score(22.0) == 0.25
    assert world.score(44.0) == world.score(99.0) == 0.125
    assert world.score(3.0, clip=4.0) == 0.25
    assert world.score(33.0, clip=4.0) == pytest.approx(5.5 / 33.0)


def test_a_world_is_written_with_its_columns_and_is_no_map(tmp_path: Path) -> None:
    world = read_worlds()[1]
    scenario = load_scenario(barn.write(world, tmp_path, 0.5))
    assert (scenario.plan, scenario.v_max, scenario.sensors) == ("seen", 0.5, "ideal")
    read = parse_map(format_map(world.world()), "w")
    assert set(read.columns) == set(world.world().columns)


def drive(tmp_path: Path, cylinders: tuple[tuple[float, float], ...]) -> barn.BarnDrive:
    world = BarnWorld(1, cylinders, 10.0)
    path = barn.write(world, tmp_path, None)
    return barn.BarnDrive(Cell("c", str(path), parameters=barn.PARAMETERS), 1)


def test_the_clock_runs_from_a_tenth_of_a_metre_to_a_metre_before_the_goal(tmp_path: Path) -> None:
    run = drive(tmp_path, ())
    run.go()
    sample = run.sample()
    assert sample.reached
    assert sample.note == ""
    assert 8.9 <= sample.td_m <= 9.6
    assert run.began is not None
    assert run.ended is not None
    assert sample.tt_s == pytest.approx(run.ended - run.began, abs=0.001)
    assert sample.tt_s > 8.9 / 1.6


def test_a_contact_ends_the_run_and_counts_as_nothing(tmp_path: Path) -> None:
    run = drive(tmp_path, ())
    run.rehearsal.start()
    plant = run.rehearsal.robot.plant  # type: ignore[attr-defined]
    plant.add_columns([(-2.25, 3.55, 0.3)])
    run.rehearsal.begin()
    plant.set_pose(-2.25, 3.2, 1.5708)
    plant.touches.collisions = 1
    run.rehearsal.mesh.run(run.rehearsal.mesh.now + 1.0)
    sample = run.sample()
    assert run.touched
    assert not sample.reached
    assert sample.note == "touched"
    assert barn.score_of(BarnWorld(1, (), 10.0), sample) == 0.0


@pytest.mark.parametrize(
    "words",
    [
        ["--worlds", "6"],
        ["--v-max", "nan"],
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, words: list[str]) -> None:
    with pytest.raises(UsageError):
        experiment.main(["barn", "--out", str(tmp_path), *words])
