"""Localization on logs, and the errors of the estimates."""

from __future__ import annotations

import os
from collections.abc import Callable
from itertools import count
from math import hypot, nan, pi
from pathlib import Path

import numpy as np
import pytest

from armadico.agents.slam.logs import localizing, logs
from armadico.agents.slam.logs.localizing import Chosen, Event, Moment, Run, Track, summary
from armadico.agents.slam.logs.logs import Log, LogError
from armadico.config import grid_map
from armadico.config.grid_map import FREE, OCCUPIED
from armadico.config.profile import load_profile
from armadico.core.config_errors import ConfigError
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.geometry import Pose2, compose, relative
from tests.robot.robots import with_laser
from tests.robot.scans import map_of
from tests.slam import made_logs
from tests.slam.floors import CORRIDOR, ROOM

AGENT = "localization"
ROBOT = with_laser()


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    """Two rounds with 5 % errors of the odometry."""
    path = tmp_path_factory.mktemp("log") / "room.npz"
    return logs.with_errors(logs.read(made_logs.npz(path, made_logs.driven(2))), 0.05, 3)


@pytest.fixture(scope="module")
def world(log: Log, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A map made from the log."""
    path = tmp_path_factory.mktemp("map") / "room.yaml"
    grid_map.save(localizing.mapped(log, "first", load_profile(ROBOT)), path)
    return str(path)


def chosen(log: Log, world: str, **others: object) -> Chosen:
    values: dict[str, object] = {"readings": range(len(log)), "agent": AGENT, "seed": 1, **others}
    return Chosen(world, ROBOT, **values)  # type: ignore[arg-type]


def ticking() -> Callable[[], float]:
    """A clock that advances by a millisecond per call."""
    ticks = count()
    return lambda: 1e-3 * next(ticks)


def test_the_map_has_the_walls_and_the_floor(log: Log) -> None:
    cells = localizing.mapped(log, "all", load_profile(ROBOT))
    assert cells.at(4.0, 1.2) == FREE
    assert OCCUPIED in {cells.at(8.0 + off, 1.5) for off in (-0.05, 0.0, 0.05)}
    assert 30.0 < cells.area(FREE) < 52.0


def test_parts_of_a_log(log: Log) -> None:
    def of(name: str) -> list[int]:
        return log.part(name)

    every = list(range(len(log)))
    assert of("all") == every
    assert sorted(of("even") + of("odd")) == of("first") + of("second") == every
    assert of("odd")[:2] == [1, 3]
    assert abs(len(of("first")) - len(of("second"))) <= 1


@pytest.mark.long
def test_the_estimate_follows_the_reference_where_odometry_alone_does_not(
    log: Log, world: str
) -> None:
    found = summary(Run(log, chosen(log, world), ticking()).go())
    assert found.compared == found.scans == len(log)
    assert found.error_median_m is not None
    assert found.odometry_most_m is not None
    assert found.error_median_m < 0.06 < 0.4 < found.odometry_most_m
    assert found.lost_share == 0.0
    assert found.wrong_sure_share == 0.0
    assert found.metres == pytest.approx(35.6, abs=2.0)
    assert found.scan_median_ms > 0.0


def test_the_reference_is_moved_to_the_time_of_the_estimate(world: str, tmp_path: Path) -> None:
    """Readings arrive between two cycles, and the robot moves until the next one."""
    t = 0.45 * np.arange(127)
    exact = logs.read(made_logs.npz(tmp_path / "a.npz", t=t))
    for one in Run(exact, chosen(exact, world), float).go().moments[::9]:
        assert one.reference is not None
        assert one.reference[:2] == pytest.approx(one.alone[:2], abs=1e-6)


def test_the_newest_of_several_readings_in_a_cycle_is_used(world: str, tmp_path: Path) -> None:
    fast = logs.read(made_logs.npz(tmp_path / "a.npz", t=0.03 * np.arange(127)))
    moments = Run(fast, chosen(fast, world), float).go().moments
    assert moments[-1].reading == 126
    assert len(moments) < 127 / 3 + 2


def test_one_seed_is_one_result(log: Log, world: str) -> None:
    few = chosen(log, world, readings=range(60))
    first, same = (Run(log, few, float).go().moments for _ in range(2))
    other = Run(log, chosen(log, world, readings=range(60), seed=2), float).go().moments
    assert first == same
    assert [one.estimate for one in first] != [one.estimate for one in other]


@pytest.mark.long
def test_an_unknown_start_is_lost_until_it_is_found(log: Log, world: str) -> None:
    track = Run(log, chosen(log, world, anywhere=True), float).go()
    found = summary(track)
    assert track.moments[0].lost
    assert found.found_s is not None
    assert found.found_off_m is not None
    assert found.found_off_m < 0.3
    assert found.events[0].event == "found"


def test_a_given_start_is_used(log: Log, world: str) -> None:
    x, y, theta = log.where(0) or (nan,) * 3
    to = chosen(log, world, start=(x + 0.1, y, theta), readings=range(10))
    assert Run(log, to, float).go().moments[0].alone == pytest.approx((x + 0.1, y, theta), abs=0.2)


@pytest.mark.long
def test_a_map_of_another_place_is_reported(log: Log) -> None:
    track = Run(log, chosen(log, "rooms-a"), float).go()
    unsure = [one.lost or one.deviation > LOST_M for one in track.moments]
    assert sum(unsure) > 0.5 * len(unsure), "no mission is driven"
    found = summary(track)
    assert found.lost_share > 0.2
    assert (found.wrong_sure_share or 0.0) < 0.05


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The map of the room alone."""
    return map_of(tmp_path_factory.mktemp("map") / "room.map", ROOM)


def out_and_back(path: Path, drift: float, carried: int | None = None) -> Log:
    """A drive from the room to the end of the corridor and back, with wrong odometry.

    In the corridor the robot may be carried back to the room's far corner from a reading on.
    """
    turns = [(18.5, 2.3, pi * k / 8) for k in range(1, 8)]
    there = [(1.5 + 0.15 * k, 2.3, 0.0) for k in range(114)]
    back = [(x, y, pi) for x, y, _ in reversed(there)]
    poses = [*there, *turns, *back]
    if carried is not None:
        corner = [(1.0 + 0.1 * k, 1.0, 0.3) for k in range(40)]
        poses = [*poses[:carried], *corner]
    lines = np.array([*ROOM, *CORRIDOR], dtype=float)
    others: dict[str, object] = {"ranges": made_logs.measured(poses, lines)}
    if carried is not None:  # the wheels do not count it
        step = relative(poses[carried - 1], poses[carried])
        odometry = [
            *poses[:carried],
            *(compose(poses[carried - 1], relative(poses[carried], at)) for at in poses[carried:]),
        ]
        assert hypot(*step[:2]) > 5.0
        others["odometry"] = np.array(odometry)
    log = logs.read(made_logs.npz(path / "out.npz", poses, **others))
    return logs.with_errors(log, drift, 2) if drift else log


def test_a_robot_that_leaves_its_map_keeps_its_pose_and_comes_back(
    room: str, tmp_path: Path
) -> None:
    log = out_and_back(tmp_path, 0.05)
    track = Run(log, chosen(log, room), float).go()
    found = summary(track)
    off = [one.off_map for one in track.moments]
    assert not off[0]
    assert not off[-1]
    assert 0.3 < found.off_map_share < 0.9
    assert found.lost_share == found.wrong_sure_share == found.far_share == 0.0
    assert found.odometry_most_m is not None
    assert found.odometry_most_m > 0.8
    deepest = off.index(True) + off.count(True) // 2
    assert track.moments[deepest].deviation > 1.5 * track.moments[0].deviation
    home = track.moments[-1]
    assert home.reference is not None
    assert hypot(*np.subtract(home.estimate, home.reference)[:2]) < 0.1


def test_a_robot_that_is_carried_while_it_is_off_the_map_is_lost(room: str, tmp_path: Path) -> None:
    log = out_and_back(tmp_path, 0.0, carried=90)
    track = Run(log, chosen(log, room), float).go()
    assert any(one.off_map for one in track.moments[:90])
    assert not any(one.lost for one in track.moments[:90])
    assert any(one.lost for one in track.moments[90:])


def test_a_robot_that_is_carried_on_its_map_is_lost_and_found(tmp_path: Path) -> None:
    """The scans after it follow each other as well as those before."""
    floor = map_of(tmp_path / "floor.map", [*ROOM, *CORRIDOR])
    log = out_and_back(tmp_path, 0.0, carried=90)
    track = Run(log, chosen(log, floor), float).go()
    assert not any(one.lost or one.off_map for one in track.moments[:90])
    assert any(one.lost for one in track.moments[90:95])
    assert sum(one.deviation < 0.5 for one in track.moments[90:95] if not one.lost) < 2
    assert track.moments[-1].reference is not None
    assert not track.moments[-1].lost
    assert hypot(*np.subtract(track.moments[-1].estimate, track.moments[-1].reference)[:2]) < 0.1


def test_missing_readings_parameters_walls_and_references_are_errors(
    log: Log, world: str, tmp_path: Path
) -> None:
    with pytest.raises(LogError):
        Run(log, chosen(log, world, readings=[]), float).go()
    with pytest.raises(ConfigError, match="nonsense"):
        Run(log, chosen(log, world, sets=("nonsense=1",)), float).go()
    with pytest.raises(LogError):
        summary(Run(log, chosen(log, "empty", readings=range(5)), float).go())
    blind = logs.read(made_logs.npz(tmp_path / "a.npz", reference=None))
    with pytest.raises(LogError, match="start"):
        Run(blind, chosen(blind, world), float).go()
    with pytest.raises(LogError, match="map"):
        localizing.mapped(blind, "all", load_profile(ROBOT))


# Summary ------------------------------------------------------------------------------------------


def moment(
    k: int, off: float, deviation: float = 0.1, *, lost: bool = False, known: bool = True
) -> Moment:
    at: Pose2 = (float(k), 0.0, 0.0)
    estimate = (float(k), off, 0.1)
    return Moment(
        k, 2.0 * k, float(k), estimate, estimate, at if known else None, at, deviation, lost
    )


def test_shares_longest_times_and_events() -> None:
    track = Track(
        [
            moment(0, 0.0),
            moment(1, 0.4),
            moment(2, 0.6),  # wrong and sure
            moment(3, 0.6, 0.7),  # wrong, with a large deviation
            moment(4, 0.9, lost=True),  # wrong, and reported
            moment(5, 0.1),
            moment(6, 9.0, known=False),
            moment(7, 0.4),
        ],
        scan_s=[0.001] * 7 + [0.003],
        other_s=[0.2],
    )
    found = summary(track)
    assert (found.scans, found.compared) == (8, 7)
    assert found.off_share == pytest.approx(5 / 7, abs=1e-4)
    assert (found.off_longest_s, found.off_longest_m) == (8.0, 4.0)
    assert found.wrong_sure_share == pytest.approx(1 / 7, abs=1e-4)
    assert found.lost_share == pytest.approx(1 / 8)
    assert found.error_most_m == pytest.approx(0.9)
    assert found.heading_median_deg == pytest.approx(5.73, abs=0.01)
    assert found.scan_median_ms == pytest.approx(1.0)
    assert found.most_ms == pytest.approx(200.0)
    assert found.events == (Event(8.0, "lost", 4.0, 0.9, 0.9), Event(10.0, "found", 5.0, 0.1, 0.1))


@pytest.mark.parametrize(
    ("moments", "answer", "why"),
    [
        ([moment(k, 0.1) for k in range(4)], "yes", ""),
        ([moment(k, 0.1) for k in range(1)], "unknown", "nothing was tested"),
        ([moment(k, 0.1, known=False) for k in range(4)], "unknown", "no reference"),
        ([moment(k, 0.6 * (k == 2)) for k in range(4)], "no", "wrong and sure at 25.0 %"),
        ([moment(k, 0.4) for k in range(4)], "no", "more than 0.3 m off"),
        ([moment(k, 0.1, lost=True) for k in range(4)], "no", "reported lost"),
        ([moment(k, 0.1, lost=k in (5, 8)) for k in range(9)], "unknown", "was lost"),
        ([moment(k, 0.4 * (k > 6)) for k in range(9)], "unknown", "0.3 m off, at 22 %"),
        ([moment(k, 0.4 * (k < 3), lost=k > 6) for k in range(9)], "no", "off, at 56 %"),
        ([moment(k, 0.1, lost=k < 3) for k in range(9)], "yes", ""),  # found, and then never lost
        ([moment(k, 0.1, known=k < 2) for k in range(9)], "unknown", "no reference"),
    ],
)
def test_what_a_run_concludes(log: Log, moments: list[Moment], answer: str, why: str) -> None:
    found = localizing.judgement(log, summary(Track(moments, [0.001] * len(moments))))
    assert found.answer == answer
    assert why in found.reason


def test_a_run_that_is_always_lost_has_no_time_to_be_found() -> None:
    found = summary(Track([moment(k, 5.0, lost=True) for k in range(4)], [0.001] * 4))
    assert found.found_s is None
    assert found.lost_share == 1.0
    assert found.wrong_sure_share == 0.0
    assert found.deviation_median_m is None
    assert not found.events


# Real logs ----------------------------------------------------------------------------------------

FOLDER = Path(
    os.environ.get("ARMADICO_LOGS", Path(__file__).parents[3] / "shared" / "data" / "logs")
)


@pytest.mark.long
@pytest.mark.skipif(
    not (FOLDER / "seattle.npz").is_file(),
    reason="no logs of real robots: set ARMADICO_LOGS to their folder",
)
def test_a_log_of_a_real_robot(tmp_path: Path) -> None:
    log = logs.with_errors(logs.read(FOLDER / "seattle.npz"), 0.05, 1)
    assert len(log) == 241
    path = tmp_path / "map.yaml"
    grid_map.save(localizing.mapped(log, "all", load_profile(ROBOT)), path)
    found = summary(Run(log, chosen(log, str(path)), float).go())
    assert found.error_median_m is not None
    assert found.error_median_m < 0.1
    assert found.wrong_sure_share == 0.0
    last = log.where(240)
    assert last is not None
    assert hypot(*(np.array(last) - log.odometry[-1])[:2]) == pytest.approx(11.2, abs=0.1)
