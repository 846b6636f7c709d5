"""`armadico map save | load` in a society: map and graph together, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico.cli import map as command
from armadico.cli.options import FailedError
from armadico.config import graph_file, grid_map
from armadico.config.scenarios import exploring, load_scenario
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.runtime.errors import AbsentError
from tests.slam.test_graph_file import saved_graph


def explored(seconds: float) -> Rehearsal:
    """A Jackal that has explored for a time."""
    scenario = prepared(load_scenario("rooms-b"), Options(seed=1), profile="jackal")
    run = Rehearsal(exploring(scenario), Options(seed=1))
    run.start()
    run.begin()
    run.mesh.run(run.mesh.now + seconds)
    return run


def test_a_map_is_saved_with_its_graph_and_loaded_into_the_running_agent(tmp_path: Path) -> None:
    run, file = explored(8.0), tmp_path / "flat.yaml"
    assert "flat.graph.npz" in command.save(run.client, file)
    graph = graph_file.read(graph_file.beside(file))
    cells = grid_map.read(file)
    assert (cells.states == graph.drawn().states).all()
    assert "key scans loaded" in command.load(run.client, saved_graph(), file)
    run.mesh.run(run.mesh.now + 8.0)
    assert f"{file} is kept" in command.save(run.client, file)
    other = graph_file.read(graph_file.beside(tmp_path / "flat-apart.yaml"))
    assert (other.poses[:5] == saved_graph().poses[:5]).all()
    assert (grid_map.read(file).states == cells.states).all()


def test_a_graph_of_the_map_that_is_replaced_does_not_stay(tmp_path: Path) -> None:
    file = tmp_path / "flat.yaml"
    graph_file.beside(file).write_bytes(b"of an older map")
    scenario = prepared(load_scenario("sc3"), Options(sensors="ideal"))
    run = Rehearsal(exploring(scenario), Options(seed=1))
    run.start()
    run.mesh.run(run.mesh.now + 3.0)
    assert "flat.graph.npz is removed" in command.save(run.client, file)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["flat.pgm", "flat.yaml"]
    with pytest.raises(FailedError, match=r"mapping-.* cannot find the robot on a map"):
        command.load(run.client, saved_graph(), file)


def test_loading_into_a_society_that_localizes_names_the_agent() -> None:
    run = Rehearsal(load_scenario("sc4"), Options(seed=1))
    run.start()
    with pytest.raises(FailedError, match=r"localization-.* start it with --world flat\.yaml"):
        command.load(run.client, saved_graph(), Path("flat.yaml"))


def test_loading_without_an_agent_that_maps_is_refused() -> None:
    run = Rehearsal(
        load_scenario("sc4"), Options(seed=1, sensors="ideal", without=("localization",))
    )
    run.start()
    with pytest.raises(AbsentError, match="no agent slam is alive"):
        command.load(run.client, saved_graph(), Path("flat.yaml"))
