"""`armadico mounting`: what wheels and scans tell of each other, against a known truth."""

from __future__ import annotations

import json
import sys
from math import cos, hypot, nan, pi, radians, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armadico import cli
from armadico.agents.methods.poses import Floats, compose, relative
from armadico.agents.slam import mounting
from armadico.agents.slam.logs.logs import Log, Recorded
from armadico.config.profile import load_profile
from armadico.core.messages import Cycle
from armadico.mobile.geometry import STOOD, Pose2
from armadico.mobile.messages import Echo, Scan, Sonar
from armadico.mobile.scans import message_of
from tests.robot.robots import with_laser
from tests.robot.scans import cast
from tests.slam import made_logs

WALLS = np.vstack([made_logs.walls(), [[0.0, 4.0, 1.0, 4.0], [6.0, 0.0, 6.0, 0.7]]])
STEP_S = 0.1
ANGLES = np.radians(np.arange(-135.0, 135.0, 1.5))
STRAIGHT = (0.3, 0.0)


def driven(seconds: float = 40.0, motion: tuple[float, float] | None = None) -> Floats:
    """(n, 3) a path of curves to both sides, or of constant speeds: m/s, rad/s."""
    at, found = np.array([2.5, 1.2, 0.0]), []
    for t in np.arange(0.0, seconds, 0.02):
        v, w = motion or (0.35 + 0.1 * sin(0.31 * t), 0.3 + 0.8 * sin(0.8 * t))
        found.append(at)
        at = compose(at, np.array([v * 0.02, 0.0, w * 0.02]))
    return np.array(found)


def log_of(
    path: Path,
    mount: Pose2 = STOOD,
    *,
    down: bool = False,
    wheels: tuple[float, float, float] = (1.0, 1.0, 0.0),
    late: float = 0.0,
    true: Floats | None = None,
    **others: Any,
) -> Path:
    """A log whose scanner is mounted so on a robot, and is assumed at its origin.

    `wheels` are the factors by which its odometry errs in ways and turns, and its drift, rad/m.
    """
    true = driven() if true is None else true
    rng, turns = np.random.default_rng(1), -1.0 if down else 1.0
    lasers = compose(true[::5], np.array([*mount[:2], radians(mount[2])]))
    scans = np.array([cast(WALLS, one, turns * ANGLES) for one in lasers])
    scans += 0.01 * rng.standard_normal(scans.shape)
    at, odometry = np.zeros(3), [np.zeros(3)]
    for step in relative(true[:-1], true[1:]):
        way, turn, drift = wheels
        at = compose(at, step * (way, way, turn) + (0.0, 0.0, drift * way * step[0]))
        odometry.append(at)
    behind = np.clip(np.arange(0, len(true), 5) + round(late / 0.02), 0, len(true) - 1)
    fields = {
        "t": STEP_S * np.arange(len(scans)),
        "odometry": np.array(odometry)[behind],
        "ranges": np.rint(1000.0 * np.minimum(scans, 60.0)).astype(np.uint16),
        "scale": 0.001,
        "angle_min": ANGLES[0],
        "angle_step": ANGLES[1] - ANGLES[0],
    }
    np.savez(path, **{**fields, **others})
    return path


def told(
    capsys: pytest.CaptureFixture[str], path: Path, *words: str
) -> tuple[int, dict[str, Any], dict[str, Any]]:
    """The exit code, the object, and its quantities by their names."""
    code = cli.main(["mounting", str(path), "--json", *words])
    found = json.loads(capsys.readouterr().out)
    return code, found, {one["name"]: one for one in found["quantities"]}


def test_a_log_whose_scanner_is_where_it_is_assumed_agrees(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found, quantities = told(capsys, log_of(tmp_path / "log.npz"))
    assert code == 0
    assert found["proposed"] == ""
    assert {one["judgement"]["answer"] for one in quantities.values()} == {"yes"}


@pytest.mark.parametrize(
    ("mount", "down"),
    [
        ((0.2, -0.1, 90.0), False),
        ((0.0, 0.0, -90.0), True),
        ((-0.15, 0.05, 180.0), True),
        ((0.1, 0.0, 17.0), False),
    ],
)
def test_a_scanner_that_is_mounted_in_another_way_is_measured_and_its_lines_are_proposed(
    mount: Pose2,
    down: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, found, quantities = told(capsys, log_of(tmp_path / "log.npz", mount, down=down))
    assert code == 1
    assert quantities["x_m"]["measured"] == pytest.approx(mount[0], abs=0.02)
    assert quantities["y_m"]["measured"] == pytest.approx(mount[1], abs=0.02)
    turned = quantities["bearing_deg"]["measured"] - mount[2]
    assert cos(radians(turned)) > cos(radians(1.0))
    assert quantities["upside_down"]["measured"] is down
    assert found["proposed"].startswith("[laser]\n")
    assert "bearing_deg = " in found["proposed"]
    assert ("upside_down = true" in found["proposed"]) is down


def test_wheels_that_err_and_scans_that_are_late_are_measured_beside_a_wrong_mounting(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wheels = (1.05, 0.85, 0.08)
    path = log_of(tmp_path / "log.npz", (0.2, 0.0, 90.0), wheels=wheels, late=0.2)
    code, found, quantities = told(capsys, path)
    assert code == 1
    assert quantities["ways"]["measured"] == pytest.approx(1 / 1.05, abs=0.02)
    assert quantities["turns"]["measured"] == pytest.approx(1 / 0.85, abs=0.03)
    assert radians(quantities["drift"]["measured"]) == pytest.approx(-0.08 / 0.85, abs=0.02)
    assert quantities["stamps late"]["measured"] == pytest.approx(0.2, abs=0.03)
    assert quantities["bearing_deg"]["measured"] == pytest.approx(90.0, abs=1.0)
    assert "alpha1 = " in found["proposed"]
    assert "late" in found["proposed"]


def test_a_robot_that_never_turned_tells_nothing_of_the_scanners_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there = driven(20.0, STRAIGHT) - (1.5, 0.0, 0.0)
    path = log_of(tmp_path / "log.npz", true=np.vstack([there, there[::-1]]))
    code, _, quantities = told(capsys, path)
    assert code == 3
    for name in ("x_m", "y_m", "upside_down", "turns"):
        assert quantities[name]["measured"] is None
        assert quantities[name]["judgement"]["answer"] == "unknown"
        assert "turned" in quantities[name]["judgement"]["reason"]
    assert quantities["bearing_deg"]["measured"] == pytest.approx(0.0, abs=1.0)


def test_a_bare_corridor_shows_the_bearing_and_not_the_ways_along_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = np.array([[-60.0, -1.0, 60.0, -1.0], [-60.0, 1.2, 60.0, 1.2]])
    monkeypatch.setattr(sys.modules[__name__], "WALLS", lines)
    at, path = np.zeros(3), []
    for t in np.arange(0.0, 40.0, 0.02):
        path.append(at)
        at = compose(at, np.array([0.008, 0.0, 0.012 * cos(0.9 * t)]))
    log = log_of(tmp_path / "log.npz", (0.2, 0.0, 90.0), true=np.array(path))
    code, _, quantities = told(capsys, log)
    assert code == 1
    assert quantities["bearing_deg"]["measured"] == pytest.approx(90.0, abs=1.0)
    assert quantities["ways"]["judgement"]["answer"] == "unknown"
    assert quantities["y_m"]["judgement"]["answer"] == "unknown"


def test_wheels_and_scans_of_different_drives_contradict_each_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    steps = np.random.default_rng(0).standard_normal((400, 3)) * (0.04, 0.04, 0.1)
    other = np.cumsum(steps, axis=0)
    code, found, quantities = told(capsys, log_of(tmp_path / "log.npz", odometry=other))
    assert code == 3
    assert {one["measured"] for one in quantities.values()} == {None}
    assert "contradict" in found["judgement"]["reason"]


def test_a_robot_that_stood_tells_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stood = driven(20.0, (0.0, 0.0))
    rattles = 1e-4 * np.random.default_rng(2).standard_normal((len(stood[::5]), 3))
    code, found, _ = told(capsys, log_of(tmp_path / "log.npz", true=stood, odometry=rattles))
    assert code == 3
    assert "moved by less" in found["judgement"]["reason"]


def test_a_cut_file_that_lost_its_angles_does_not_pass(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = log_of(tmp_path / "log.npz").read_bytes()
    cut = tmp_path / "cut.npz"
    cut.write_bytes(whole[: int(0.9 * len(whole))])
    assert told(capsys, cut)[0] in (1, 3)
    cut.write_bytes(whole[:300])
    assert cli.main(["mounting", str(cut)]) == 2


# Recordings ---------------------------------------------------------------------------------------


def recorded(path: Floats, mount: Pose2, believed: Pose2) -> Log:
    """A recording of scans that are up to a cycle old, each at its place in the cycle's frame.

    The robot agent believes the scanner to be elsewhere.
    """
    rng, messages, rows = np.random.default_rng(3), [], []
    for row in range(0, len(path) - 5, 5):
        old = int(rng.integers(0, 5)) if row else 0
        at = path[max(0, row - old)]
        x, y, theta = relative(path[row], at).tolist()
        laser = compose(at, np.array(mount))
        seen, step = cast(WALLS, laser, ANGLES), float(ANGLES[1] - ANGLES[0])
        angles = (float(ANGLES[0]), step)
        scan = message_of(
            Cycle(1, row), seen, angles, (0.05, 30.0), believed, since=(x, y, theta), number=row
        )
        messages.append(scan)
        rows.append(row // 5)
    odometry = path[::5][: len(rows)]
    return Log(
        "made",
        STEP_S * np.arange(len(rows)),
        odometry,
        np.full((len(rows), 3), nan),
        np.array(rows, dtype=np.intp),
        Recorded(tuple(messages)),
        cycles=True,
        used=len(rows),
    )


@pytest.mark.parametrize("believed", [(0.2, 0.1, 0.0), (0.0, 0.0, pi / 2)])
def test_the_motion_since_a_scan_that_a_recording_has_in_it_is_taken_out_again(
    believed: Pose2,
) -> None:
    rest = np.tile(driven()[:1], (100, 1))
    log = recorded(np.vstack([rest, driven()]), (0.2, 0.1, 0.0), believed)
    drive = mounting.drive_of(log, range(len(log)))
    assert drive is not None
    assert drive.mount[:2] == pytest.approx(believed[:2], abs=1e-6)
    pairs = [mounting.matched(drive, scans) for scans in mounting.chosen(drive)]
    solution = mounting.solve(drive, [pair for pair in pairs if pair is not None])
    assert solution is not None
    off = solution.values - (0.2, 0.1, ANGLES[0], 0.0, 0.0, 0.0, 0.0)
    assert hypot(off[0], off[1]) < 0.02
    assert np.abs(off[2:]).max() < 0.02


def test_a_recording_by_another_bearing_is_noted_and_its_measured_one_is_not_called_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """So it is after each use of the proposed lines: the bearing follows from angle_min_deg."""
    log = recorded(driven(1.0), STOOD, (0.0, 0.0, pi / 2))
    monkeypatch.setattr("armadico.agents.slam.commands.log_file.opened", lambda *_: (log, 1.0))
    (path := tmp_path / "made.mcap").touch()
    cli.main(["mounting", str(path), "--json", "--profile", with_laser()])
    said = capsys.readouterr().err
    assert "the recorded scans begin at another angle" in said
    assert "if angle_min_deg is not the driver's, the measured bearing is wrong" in said


def test_fewer_pairs_than_its_intervals_need_give_no_mounting() -> None:
    """The factor of the intervals is for eight blocks."""
    log = recorded(driven(), STOOD, STOOD)
    drive = mounting.drive_of(log, range(len(log)))
    assert drive is not None
    pairs = [mounting.matched(drive, scans) for scans in mounting.chosen(drive)[:40]]
    fit = [pair for pair in pairs if pair is not None]
    assert len(fit) >= 20
    assert mounting.solve(drive, fit[:39]) is None


def test_a_log_of_sonars_alone_has_no_scans() -> None:
    log = recorded(driven(5.0), STOOD, STOOD)
    assert log.readings.kind(0) is Scan
    echoes = Sonar(Cycle(1, 1), 5.0, (Echo(0.0, 0.0, 0.0, 1.0),))
    sonars = Log(*_arrays(log), Recorded((echoes,) * len(log)))
    assert mounting.drive_of(sonars, range(len(sonars))) is None


def _arrays(log: Log) -> tuple[Any, ...]:
    return log.name, log.times, log.odometry, log.reference, log.rows


def test_the_profile_that_is_named_is_what_is_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    laser = load_profile(with_laser()).laser
    assert laser is not None
    place = laser.x_m, laser.y_m, laser.bearing_deg
    assert place != (0.0, 0.0, 0.0)
    path = log_of(tmp_path / "log.npz", place, down=laser.upside_down)
    assert told(capsys, path, "--profile", with_laser())[0] == 0
    code, found, _ = told(capsys, path)
    assert (code, found["compared_with"]) == (1, "log")
