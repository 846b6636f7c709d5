"""Two sessions in one building become one map, if that is proved; else nothing is merged."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from armadico import cli
from armadico.agents.slam.commands import joined as command
from armadico.agents.slam.commands import view
from armadico.agents.slam.joining import Found, _beside
from armadico.cli.additions import Start
from armadico.cli.map_option import MapFile
from armadico.config import graph_file, grid_map
from armadico.config.graph_file import SavedGraph
from armadico.config.grid_map import FREE, OCCUPIED, UNKNOWN, Cells
from armadico.launch.run import RobotRun
from armadico.mobile.geometry import Pose2, relative
from tests.slam import made_logs

HERE: Pose2 = (3.0, -2.0, 0.7)
"""Where the odometry of the first session begins, in the room."""

CHAIR = ((6.1, 1.8), (6.5, 1.8), (6.5, 2.2), (6.1, 2.2), (6.1, 1.8))
CRATE = ((2.2, 3.4), (2.7, 3.4), (2.7, 3.9), (2.2, 3.9), (2.2, 3.4))
WHERE_CHAIR, WHERE_CRATE = (6.12, 1.98), (2.45, 3.42)
"""A place on an outer side of each that the robot sees."""

MONDAY, TUESDAY = made_logs.driven(2)[:140], made_logs.driven(2)[70:200]


def walls(*boxes: tuple[tuple[float, float], ...]) -> NDArray[np.float64]:
    """The room with its pillar and some boxes."""
    rings = (made_logs.CORNERS, made_logs.PILLAR, *boxes)
    return np.array([(*a, *b) for one in rings for a, b in pairwise(one)], dtype=float)


def log(path: Path, poses: made_logs.Poses, lines: NDArray[np.float64], begins: Pose2) -> Path:
    """A log whose odometry has its origin somewhere in the room."""
    ranges, odometry = made_logs.measured(poses, lines), np.array(made_logs.moved(poses, begins))
    return made_logs.npz(path, poses, ranges=ranges, odometry=odometry, real_odometry=True)


def slam(*words: object, code: int = 0) -> None:
    assert cli.main(["slam", *map(str, words)]) == code


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs, with a chair, and with a crate in its place; the map of the first."""
    found = tmp_path_factory.mktemp("room")
    log(found / "monday.npz", MONDAY, walls(CHAIR), HERE)
    log(found / "tuesday.npz", TUESDAY, walls(CRATE), (7.0, 5.0, -2.0))
    slam(found / "monday.npz", "-o", found / "monday.yaml")
    return found


def at(cells: Cells, place: tuple[float, float]) -> set[int]:
    """The states within 0.1 m of a place of the room, on the map of the first session."""
    x, y, _ = relative(HERE, (*place, 0.0))
    steps = (-0.1, -0.05, 0.0, 0.05, 0.1)
    return {cells.at(x + dx, y + dy) for dx in steps for dy in steps}


def merged_rightly(folder: Path, output: Path) -> None:
    """The old map is as it was, and the new one has lost the chair and got the crate."""
    old, new = grid_map.read(folder / "monday.yaml"), grid_map.read(output)
    assert OCCUPIED in at(old, WHERE_CHAIR)
    assert at(new, WHERE_CHAIR) == {FREE}
    assert OCCUPIED not in at(old, WHERE_CRATE)
    assert OCCUPIED in at(new, WHERE_CRATE)
    graph = graph_file.of_map(output)
    assert {*graph.session.tolist()} == {0, 1}
    assert not graph.part.any()


def test_a_second_log_is_merged_what_is_gone_goes_and_what_is_new_comes(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {file: file.read_bytes() for file in folder.iterdir()}
    output, picture = tmp_path / "both.yaml", tmp_path / "changes.png"
    words = [folder / "tuesday.npz", "--onto", folder / "monday.yaml", "-o", output]
    slam(*words, "--picture", picture, "--json")
    found = json.loads(capsys.readouterr().out)
    assert found["onto"]["merged"]
    assert found["onto"]["contradicts_m"] < 0.1 * found["onto"]["fits_m"]
    merged_rightly(folder, output)
    there = np.array(made_logs.moved(TUESDAY, HERE))
    path = np.loadtxt(output.with_suffix(".tum"))[:, 1:3]
    assert np.abs(path - there[:, :2]).max() < 0.15, "in the frame of the map that it continues"
    assert {file: file.read_bytes() for file in folder.iterdir()} == before
    colours = {colour for _, colour in Image.open(picture).getcolors(100_000) or ()}
    assert {view.NEW, view.GONE} <= colours


def test_two_maps_are_joined_by_the_same_rule(folder: Path, tmp_path: Path) -> None:
    slam(folder / "tuesday.npz", "-o", tmp_path / "tuesday.yaml")
    words = [folder / "monday.yaml", tmp_path / "tuesday.yaml", "-o", tmp_path / "both.yaml"]
    assert cli.main(["map", "join", *map(str, words)]) == 0
    merged_rightly(folder, tmp_path / "both.yaml")


def other_building(folder: Path) -> SavedGraph:
    """A map of a room of another shape, twice as large."""
    lines = 2.0 * walls()[:, [1, 0, 3, 2]] * np.array([1.0, 0.6, 1.0, 0.6])
    poses = [(2.0 * y, 1.2 * x, 0.0) for x, y, _ in MONDAY]
    path = folder / "other.npz"
    log(path, poses, lines, (0.0, 0.0, 0.0))
    slam(path, "-o", folder / "other.yaml")
    return graph_file.of_map(folder / "other.yaml")


def mirrored(folder: Path) -> SavedGraph:
    """The map as a scanner makes it that hangs upside down and does not say so."""
    graph, side = graph_file.of_map(folder / "monday.yaml"), np.array([1.0, -1.0, -1.0])

    def seen(one: graph_file.DrawnScan) -> graph_file.DrawnScan:
        scan = one.scan
        turned = type(scan)(
            scan.cycle, scan.x, -scan.y, -scan.bearing, -scan.step, scan.reach, scan.packed
        )
        return one._replace(offset=one.offset * side, scan=turned)

    signs = np.outer(side, side)
    return replace(
        graph,
        poses=graph.poses * side,
        steps=graph.steps * side,
        information=graph.information * signs,
        scans=[seen(one) for one in graph.scans],
    )


def kept(graph: SavedGraph, path: Path) -> Path:
    """A map as files."""
    grid_map.save(graph.drawn(), path, {graph_file.beside(path): graph_file.encode(graph)})
    return path


@pytest.mark.parametrize("of", [other_building, mirrored])
def test_a_map_that_is_not_proved_to_be_of_the_building_is_not_merged(
    of: Callable[[Path], SavedGraph],
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    workshop = tmp_path / "made"
    workshop.mkdir()
    for file in folder.iterdir():
        (workshop / file.name).write_bytes(file.read_bytes())
    strange = kept(of(workshop), tmp_path / "strange.yaml")
    output = tmp_path / "both.yaml"
    capsys.readouterr()
    slam(folder / "tuesday.npz", "--onto", strange, "-o", output, code=3)
    assert "nothing is merged" in capsys.readouterr().err
    assert not output.exists()
    alone = graph_file.of_map(tmp_path / "both-apart.yaml")
    assert not alone.session.any(), "the log's own map, beside it"
    words = [strange, tmp_path / "both-apart.yaml", "-o", output]
    assert cli.main(["map", "join", *map(str, words)]) == 3
    assert not output.exists()


def test_a_part_without_a_proof_is_neither_drawn_nor_continued_even_if_it_is_larger(
    folder: Path, tmp_path: Path
) -> None:
    monday, strange = graph_file.of_map(folder / "monday.yaml"), mirrored(folder)
    twice = _beside(strange, strange, 1.0)
    one = replace(twice, part=twice.part * 0, session=twice.session * 0)
    week = kept(_beside(monday, one, 1.0), tmp_path / "week.yaml")
    assert OCCUPIED in at(grid_map.read(week), WHERE_CHAIR)
    output = tmp_path / "both.yaml"
    slam(folder / "tuesday.npz", "--onto", week, "-o", output)
    cells = grid_map.read(output)
    assert at(cells, WHERE_CHAIR) == {FREE}
    assert OCCUPIED in at(cells, WHERE_CRATE)


@pytest.mark.long
def test_a_map_that_is_turned_is_continued(folder: Path, tmp_path: Path) -> None:
    graph = graph_file.of_map(folder / "monday.yaml")
    frame = np.array([-4.0, 9.0, 2.1])
    c, s = np.cos(frame[2]), np.sin(frame[2])
    x, y, theta = graph.poses.T
    poses = np.column_stack([frame[0] + c * x - s * y, frame[1] + s * x + c * y, theta + frame[2]])
    turned = kept(replace(graph, poses=poses), tmp_path / "turned.yaml")
    slam(folder / "tuesday.npz", "--onto", turned, "-o", tmp_path / "both.yaml")


def test_bad_maps_are_refused_by_name_before_the_log_is_read(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(*words: object) -> str:
        capsys.readouterr()
        slam(*words, code=2)
        return capsys.readouterr().err

    good, none = folder / "monday.yaml", tmp_path / "no.npz"
    none.write_bytes(b"no log")
    cut = tmp_path / "cut.yaml"
    cut.write_bytes(good.read_bytes())
    whole = graph_file.beside(good).read_bytes()
    graph_file.beside(cut).write_bytes(whole[: len(whole) // 2])
    assert f"{graph_file.beside(cut)}: not the graph of a map" in refused(none, "--onto", cut)
    graph_file.beside(cut).unlink()
    assert f"{graph_file.beside(cut)}: there is no such file" in refused(none, "--onto", cut)
    assert "it is kept" in refused(none, "--onto", good, "-o", good)
    link = tmp_path / "link.yaml"
    link.symlink_to(good)
    assert "it is kept" in refused(none, "--onto", good, "-o", link)
    alone = kept(graph_file.of_map(good), tmp_path / "week-apart.yaml")
    assert "it is kept" in refused(none, "--onto", alone, "-o", tmp_path / "week.yaml")
    assert f"{alone} is there" in refused(none, "--onto", good, "-o", tmp_path / "week.yaml")
    assert "expected the .yaml" in refused(none, "--onto", graph_file.beside(good))
    assert cli.main(["map", "join", str(good), "-o", str(tmp_path / "a.yaml")]) == 2
    assert cli.main(["map", "save", str(good), "-o", str(tmp_path / "a.yaml")]) == 2


def test_a_map_that_another_process_uses_is_not_written_and_one_that_is_written_not_read(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    graph = graph_file.of_map(folder / "monday.yaml")
    theirs = kept(graph, tmp_path / "theirs.yaml")
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    with theirs.open() as file:
        fcntl.flock(file, fcntl.LOCK_SH)  # another process continues it
        slam(folder / "monday.npz", "-o", theirs, code=2)
        assert f"{theirs}: another process" in capsys.readouterr().err
        fcntl.flock(file, fcntl.LOCK_EX)  # another process writes it
        slam(folder / "tuesday.npz", "--onto", theirs, code=2)
        assert f"{theirs}: another process writes" in capsys.readouterr().err
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_a_robot_saves_a_map_while_another_process_searches_places_on_it(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = graph_file.of_map(folder / "monday.yaml")
    theirs = kept(graph, tmp_path / "theirs.yaml")
    saved: list[Path] = []

    def meanwhile(*_: object, **__: object) -> tuple[Found, ...]:
        saved.append(kept(graph, theirs))
        return (Found(0, 0, 0, 0, 0.0, refusal="not searched"),)

    monkeypatch.setattr(command, "joined", meanwhile)
    slam(folder / "tuesday.npz", "--onto", theirs, code=3)
    words = [theirs, folder / "monday.yaml", "-o", tmp_path / "both.yaml"]
    assert cli.main(["map", "join", *map(str, words)]) == 3
    assert saved == [theirs, theirs]


@pytest.mark.parametrize("interrupted", [False, True])
def test_the_map_of_an_exploration_goes_beside_one_that_another_process_reads(
    interrupted: bool, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    theirs = kept(graph_file.of_map(folder / "monday.yaml"), tmp_path / "theirs.yaml")
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    grid = grid_map.message_of(grid_map.read(theirs))
    client = SimpleNamespace(query=lambda *_, **__: grid, stop=lambda by: None)
    run = cast("RobotRun", SimpleNamespace(client=client))
    with theirs.open() as file:
        fcntl.flock(file, fcntl.LOCK_SH)
        MapFile(map=theirs).driven(cast("Start", None), run, interrupted=interrupted)
    said = capsys.readouterr().err
    assert f"{theirs}: another process" in said
    assert f"as {tmp_path / 'theirs-apart.yaml'}" in said
    assert np.array_equal(
        grid_map.read(tmp_path / "theirs-apart.yaml").states, grid_map.read(theirs).states
    )
    assert {file: file.read_bytes() for file in before} == before


def test_on_a_full_disk_the_map_that_was_there_stays(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    output = kept(graph_file.of_map(folder / "monday.yaml"), tmp_path / "both.yaml")
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    synced: list[int] = []
    real = os.fsync

    def full(descriptor: int) -> None:
        synced.append(descriptor)
        if len(synced) == 3:  # of the files that are written
            raise OSError(28, "No space left on device")
        real(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    words = [folder / "monday.yaml", folder / "monday.yaml", "-o", output]
    assert cli.main(["map", "join", *map(str, words)]) == 1
    said = capsys.readouterr().err
    assert f"cannot write {output}" in said
    assert "No space left" in said
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_a_picture_of_changes_leaves_out_what_is_only_drawn_beside_its_place() -> None:
    was, now = np.full((2, 30, 40), FREE, dtype=np.uint8)
    was[10, :], now[12, :] = OCCUPIED, OCCUPIED  # a wall, 0.1 m off
    now[20:22, 5:9] = OCCUPIED
    was[25:28, 30] = OCCUPIED
    was[:, 38:] = UNKNOWN
    grids = [Cells(1.0, 2.0, 0.05, one) for one in (was, now)]
    shown = view.changed(*grids, grids[1])
    assert (shown.new, shown.gone) == pytest.approx((8 * 0.0025, 3 * 0.0025))
    assert shown.first == pytest.approx(60 * 0.0025)
