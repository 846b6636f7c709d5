"""The dashboard's drawings, from messages and from a run."""

from __future__ import annotations

import io
import math
from pathlib import Path

import pytest

pytest.importorskip("rerun", reason="the dashboard's extra is not installed")

import numpy as np
from msgspec.structs import replace
from PIL import Image

from armadico.config.grid_map import Cells, message_of
from armadico.config.map_graphs import message_of as graph_message
from armadico.config.scenarios import ideal, load_scenario
from armadico.config.worlds import load_world
from armadico.core import messages as m
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Echo, OccupancyGrid, Pose, Sonar
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.particles import message_of as particles_of
from armadico.mobile.scans import message_of as scan_of
from armadico.watch.commands.dashboard import zones
from armadico.watch.dashboard import palette, viewer
from armadico.watch.dashboard.blueprint import VIEWS
from armadico.watch.dashboard.global_map import PATH_POINTS
from armadico.watch.dashboard.scene import Scene
from armadico.watch.dashboard.server import close, finish, keep
from armadico.watch.dashboard.virtual_run import Rehearsed
from tests.robot.robots import described
from tests.watch.dashboard_picture import photograph
from tests.watch.kept import (
    AVOID,
    GOTO,
    Kept,
    ballot,
    cycle,
    drawn,
    record,
    state,
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.rrd"


# Entities -----------------------------------------------------------------------------------------


def test_the_map_made_by_driving_is_at_its_place_in_the_world(path: Path) -> None:
    states = np.array([[0, 1, 2], [1, 1, 0]], dtype=np.uint8)
    with drawn(path) as scene:
        scene.update(message_of(Cells(-1.0, 2.0, 0.5, states)), 1.0)
        scene.update(OccupancyGrid(0.0, 0.0, 0.5, 9, 9, b"no"), 9.0)
    ((_, kept),) = Kept(path).rows["/p/map/world/mapped"]
    assert kept["translation"] == [[-1.0, 2.0, 0.0]]
    with Image.open(io.BytesIO(bytes(kept["blob"][0]))) as image:
        assert image.size == (3, 2)
        assert image.getpixel((0, 0)) == palette.MAPPED[0]
        assert image.getpixel((1, 0)) == palette.MAPPED[1]  # the lowest row comes first
        assert image.getpixel((2, 0)) == palette.MAPPED[2]


def test_a_loop_is_drawn_when_it_closes_and_one_that_is_switched_off_in_another_colour(
    path: Path,
) -> None:
    grid = message_of(Cells(0.0, 0.0, 0.5, np.ones((4, 4), dtype=np.uint8)), 1)
    poses = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0)]
    with drawn(path) as scene:
        scene.update(graph_message(1, poses, [(0, 2)], [False]), 0.5)  # no map is drawn yet
        scene.update(grid, 1.0)
        scene.update(graph_message(1, poses[:2], [], []), 1.1)
        scene.update(graph_message(1, poses, [], []), 1.2)  # too soon, without a new loop
        scene.update(graph_message(1, poses, [(0, 2), (1, 2)], [False, True]), 1.3)
        scene.update(replace(graph_message(1, poses, [(0, 2)], [False]), packed=b"no"), 9.0)
        scene.update(graph_message(2, poses, [(0, 2)], [False]), 9.0)  # of a map to come
        scene.update(replace(grid, revision=2), 9.1)
    kept = Kept(path)
    slam = "/p/map/world/slam"
    assert [(t, rows["strips"]) for t, rows in kept.rows[f"{slam}/loops"]] == [
        (1.1, []),
        (1.3, [[[0.0, 0.0], [1.0, 1.0]]]),
    ]
    assert [(t, rows["strips"]) for t, rows in kept.rows[f"{slam}/off"]] == [
        (1.1, []),
        (1.3, [[[1.0, 0.0], [1.0, 1.0]]]),
    ]
    on, off = (kept.rows[f"{slam}/{name}"][-1][1]["colors"] for name in ("loops", "off"))
    assert on != off
    assert kept.rows[f"{slam}/status"][-1][1]["labels"] == [
        "map: revision 1, 3 key scans, 2 loops (1 off)"
    ]
    assert [t for t, _ in kept.rows[slam]] == [9.1], "cleared with the map that it belongs to"


def pose(number: int, xx: float, yy: float = 0.01, tt: float = 0.01) -> Pose:
    return Pose(cycle(number), 2.0, 1.0, 0.5, (xx, 0.0, 0.0, yy, 0.0, tt))


def test_the_poses_covariance_is_drawn_as_an_ellipse_and_an_angle(path: Path) -> None:
    with drawn(path) as scene:
        scene.update(Pose(cycle(1), 2.0, 1.0, 0.5), 0.0)  # no covariance
        scene.update(pose(2, 0.09), 1.0)
    ((t, kept),) = Kept(path).rows["/p/map/world/unsure"]
    assert t == 1.0
    ellipse, angle = kept["strips"]
    xs, ys = zip(*ellipse, strict=True)
    assert (min(xs), max(xs)) == pytest.approx((1.4, 2.6))  # 2 sigma of 0.3 m
    assert (min(ys), max(ys)) == pytest.approx((0.8, 1.2), abs=0.001)
    (left, here, right) = angle
    assert here == pytest.approx((2.0, 1.0))
    headings = [math.atan2(y - 1.0, x - 2.0) for x, y in (left, right)]
    assert headings == pytest.approx([0.7, 0.3], abs=1e-5)


def test_particles_are_drawn_until_they_time_out(path: Path) -> None:
    with drawn(path) as scene:
        particles = particles_of(cycle(1), [(1.0, 2.0, 0.0), (3.0, -1.0, math.pi / 2)])
        scene.update(particles, 1.0)
        scene.update(replace(particles, packed=b"no"), 1.5)
        for number, t in enumerate((2.0, 3.1, 9.0)):
            scene.update(state(number), t)
    (_, shown), (gone_at, gone) = Kept(path).rows["/p/map/world/particles"]
    assert np.array(shown["origins"]) == pytest.approx(np.array([[1.0, 2.0], [3.0, -1.0]]))
    assert shown["vectors"][0] == pytest.approx((0.12, 0.0), abs=1e-5)
    assert shown["vectors"][1] == pytest.approx((0.0, 0.12), abs=1e-4)
    assert gone_at == 3.1
    assert "origins" not in gone


def test_queried_bids_are_drawn_at_the_times_of_their_cycles(path: Path) -> None:
    with drawn(path) as scene:
        for number in range(1, 6):
            scene.update(state(number), number / 10)
            claim = m.Claim("wheels", ballot(GOTO), cycle(number), 0.6)
            scene.update(claim, number / 10 + 0.01)
        late = [record(n, u) for n, u in ((2, None), (3, 0.25), (4, 0.5), (5, None), (9, 0.9))]
        for _ in range(2):  # asked twice, drawn once
            scene.update(m.BidHistory(AVOID, tuple(late)), 1.0)
        scene.update(m.BidHistory(GOTO, (record(5, 0.6),)), 1.0)
    kept = Kept(path)
    assert kept.values("/p/utility/wheels/goto", "scalars") == [(n / 10, 0.6) for n in range(1, 6)]
    avoid = kept.values("/p/utility/wheels/avoid", "scalars")
    assert avoid[:2] == [(0.3, 0.25), (0.4, 0.5)]
    assert avoid[2][0] == 0.5
    assert math.isnan(avoid[2][1])  # no bid is a gap
    assert len(avoid) == 3


def test_a_scan_is_points_and_obstacles_are_those_of_all_sensors(path: Path) -> None:
    body = ("r", 0.1, 0.2, 0.2, 0.2, 1.0, 5.0, 0.3, 0.6, 1.7, 1.7, 0.3, 2.0)
    ranges = [1.0, 2.0, math.nan, math.inf, 9.0]
    scan = scan_of(cycle(1), ranges, (-0.2, 0.1), (0.1, 30.0), (0.1, 0.0, 0.0))
    laser = Obstacles(cycle(1), None, None, None, None, (m.Point(1, 0),), "laser")
    sonar = Obstacles(cycle(1), None, None, None, None, (m.Point(0, 1),))
    with drawn(path) as scene:
        scene.update(m.Description(*body, sensors=("laser", "sonar")), 0.0)
        scene.update(Pose(cycle(1), 5.0, 0.0, 0.0), 0.0)
        scene.update(scan, 0.1)
        scene.update(replace(scan, packed=b"abc"), 0.5)
        scene.update(laser, 0.2)
        scene.update(sonar, 0.2)
        scene.update(replace(sonar, sensor="camera"), 0.9)
    kept = Kept(path)
    (seen,) = (parts["positions"] for _, parts in kept.rows["/p/local/robot/scan"])
    assert len(seen) == 2, "those within sight of the local map"
    (echoes,) = (parts["positions"] for _, parts in kept.rows["/p/map/world/echoes"])
    assert len(echoes) == 3
    (points,) = (parts["positions"] for _, parts in kept.rows["/p/local/robot/points"])
    assert len(points) == 2


@pytest.mark.long
def test_drawing_rates_and_memory_are_bounded(path: Path) -> None:
    seconds, rate = 20, 200
    with drawn(path) as scene:
        for step in range(seconds * rate):
            scene.update(Pose(cycle(step), 0.05 * step, 0.0, 0.0), step / rate)
            echo = Echo(0.1, 0.0, step * 0.01, 1.0 + step % 20)
            scene.update(Sonar(cycle(step), 30.0, (echo,)), step / rate)
    kept = Kept(path)
    rows = {name: len(rows) / seconds for name, rows in kept.rows.items()}
    assert 5.0 < rows["/p/map/world/robot"] < 16.0
    assert 0.5 < rows["/p/map/world/path"] < 1.5
    assert len(kept.rows["/p/map/world/path"][-1][1]["strips"][0]) == PATH_POINTS
    assert max(len(parts["positions"]) for _, parts in kept.rows["/p/map/world/echoes"]) <= 1500


def test_a_file_without_its_footer_is_reported(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rerun only logs it if the disk is full when it writes the footer."""
    finish(keep({"one": None}, path), path)
    whole = path.read_bytes()

    def cut(recording: object) -> bool:
        assert close(recording)  # type: ignore[arg-type]
        path.write_bytes(whole[:-20])
        return True

    monkeypatch.setattr("armadico.watch.dashboard.server.close", cut)
    with pytest.raises(OSError, match="incomplete"):
        finish(keep({"one": None}, path), path)


def test_two_robots_have_separate_entities(tmp_path: Path) -> None:
    recording = keep({"one": None, "two": None}, tmp_path / "a.rrd")
    one, two = (Scene(recording, None, name) for name in ("one", "two"))
    one.update(state(1), 0.0)
    one.update(m.Claim("wheels", ballot(GOTO), cycle(1), 0.6), 0.0)
    two.update(Pose(cycle(1), 1.0, 2.0, 0.0), 0.0)
    close(recording)
    kept = Kept(tmp_path / "a.rrd")
    assert "/one/utility/wheels/goto" in kept.rows
    assert "/two/utility/wheels/goto" not in kept.rows
    assert kept.rows["/two/map/world/robot"][0][1]["translation"] == [[1.0, 2.0, 0.0]]
    assert "/one/map/world/robot" not in kept.rows


@pytest.mark.parametrize("profile", ["pioneer-2dx", "amigobot"])
def test_the_robot_is_drawn_with_its_described_size_and_not_before(
    path: Path, profile: str
) -> None:
    robot, pose = described(profile), Pose(cycle(1), 1.0, 2.0, 0.0)
    with drawn(path) as scene:
        scene.update(pose, 0.0)
        scene.update(robot, 0.1)
        scene.update(pose, 0.2)
    fixed = Kept(path).fixed
    for where in ("map/world/robot", "local/robot"):
        x, y = zip(*fixed[f"/p/{where}/outline"]["strips"][0], strict=True)
        assert (max(x), -min(x), max(y)) == pytest.approx(
            (robot.front, robot.rear, robot.half_width)
        )
    assert "/p/map/world/truth/outline" not in fixed


# A run --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Rehearsal]:
    path = tmp_path_factory.mktemp("run") / "sc3.rrd"
    rehearsal = Rehearsal(ideal(load_scenario("sc3")), Options())
    with Rehearsed(rehearsal.mesh, rehearsal.scenario.world, path, zones()):
        assert rehearsal.run().reached
    return path, rehearsal


def test_a_virtual_run_has_all_entities(run: tuple[Path, Rehearsal]) -> None:
    path, _ = run
    kept = Kept(path)
    entities = {name.removeprefix("/robot1/") for name in kept.rows}
    assert entities >= {
        *(
            f"map/world/{part}"
            for part in ("robot", "truth", "path", "plan", "waypoints", "echoes")
        ),
        *(f"local/robot/{part}" for part in ("points", "closest", "zones", "sonar")),
        *(f"utility/wheels/{name}" for name in ("goto", "avoid", "gothrough")),
        "local/robot/cells",
    }
    walls = kept.fixed["/robot1/map/world/walls"]["strips"]
    assert len(walls) == len(load_world("sc3").walls)


def test_the_native_viewer_shows_every_view_without_an_error(
    run: tuple[Path, Rehearsal], tmp_path: Path
) -> None:
    try:
        taken = photograph(run[0], 12.0, (1280, 720))
    except viewer.ViewerError as error:
        pytest.skip(f"no headless viewer here: {error}")
    assert taken.errors == ()
    assert taken.views >= set(VIEWS)
    (tmp_path / "dashboard.png").write_bytes(taken.png)
    picture = Image.open(io.BytesIO(taken.png)).convert("RGB")
    assert picture.size == (1280, 720)
    colours = {colour for _, colour in picture.getcolors(2**20) or []}
    assert {palette.agent(name)[:3] for name in ("goto", "avoid")} <= colours
