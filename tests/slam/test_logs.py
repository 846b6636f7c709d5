"""Logs are read in each form; unusable parts are left out and noted."""

from __future__ import annotations

import gzip
from dataclasses import replace
from math import hypot, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from armadico.agents.slam.logs import logs
from armadico.agents.slam.logs.logs import Log, LogError
from armadico.core.messages import Cycle
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import Scan
from armadico.mobile.scans import bearings_of, ranges_of
from tests.slam import made_logs

AT = (0.0, 0.0, 0.0)


def scan(log: Log, i: int) -> Scan:
    found = log.readings.message(i, Cycle(1, 1), AT, 1)
    assert isinstance(found, Scan)
    return found


def carmen(path: Path, lines: list[str], *, packed: bool = False) -> Path:
    data = ("\n".join(["# made here", *lines]) + "\n").encode()
    path.write_bytes(gzip.compress(data) if packed else data)
    return path


# npz ----------------------------------------------------------------------------------------------


def test_an_npz_log_is_read_as_it_was_written(tmp_path: Path) -> None:
    poses = made_logs.driven()
    log = logs.read(made_logs.npz(tmp_path / "a.npz"))
    assert len(log) == len(poses)
    assert not log.real
    assert not log.notes
    assert log.known.all()
    assert log.where(7) == pytest.approx(poses[7])
    assert ranges_of(scan(log, 7)) == pytest.approx(made_logs.ranges(poses[7]), abs=0.006)
    assert bearings_of(scan(log, 7))[[0, -1]] == pytest.approx([-pi / 2, pi / 2 - pi / 90])


def test_odometry_is_interpolated_between_rows(tmp_path: Path) -> None:
    poses: list[Pose2] = [(1.0, 1.0, 3.0), (2.0, 1.0, -3.0), (2.0, 2.0, -3.0)]
    log = logs.read(made_logs.npz(tmp_path / "a.npz", poses))
    half = log.odometry_at(0.5 * made_logs.STEP_S)
    assert half[:2] == pytest.approx((1.5, 1.0))
    assert abs(half[2]) == pytest.approx(pi, abs=1e-6)  # the short way round
    assert log.odometry_at(-1.0) == poses[0]
    assert log.odometry_at(99.0) == poses[2]


@pytest.mark.parametrize(
    ("others", "named"),
    [
        ({"odometry": None}, "odometry"),
        ({"ranges": None}, "ranges"),
        ({"odometry": np.zeros((3, 3))}, "(3, 3)"),
        ({"ranges": np.zeros(3)}, "ranges"),
        ({"t": np.array(["a"] * 127)}, "'t'"),
        ({"odometry": np.full((127, 3), np.nan)}, "odometry"),
        ({"angle_step": 0.0}, "scans"),
        ({"angle_min": -90.0}, "rad"),
        ({"angle_step": 1.0}, "rad"),
        ({"scale": None}, "0.05 to 50 m"),  # they are cm
        ({"scale": -0.01}, "scale"),
        ({"odometry": np.ones((127, 3))}, "odometry"),
    ],
)
def test_an_npz_that_is_no_log_is_refused(
    tmp_path: Path, others: dict[str, Any], named: str
) -> None:
    assert len(made_logs.driven()) == 127
    with pytest.raises(LogError) as caught:
        logs.read(made_logs.npz(tmp_path / "a.npz", **others))
    assert named in str(caught.value)
    assert "a.npz" in str(caught.value)


def cut(path: Path, share: float) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    return path


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_of_a_cut_npz_the_whole_rows_are_read(tmp_path: Path, save: Any) -> None:
    first = {"scale": 0.01, "angle_min": -pi / 2, "angle_step": pi / made_logs.RAYS}
    fields = {**first, **made_logs.fields()}
    path = tmp_path / "a.npz"
    for share, answer in ((0.85, "yes"), (0.4, "no")):
        save(path, **fields)
        log = logs.read(cut(path, share))
        assert 10 < len(log) < 127
        assert log.given == 127
        assert log.judgement.answer == answer
        assert log.notes == (f"the file is cut: {len(log)} of 127 rows are read",)
        last = len(log) - 1
        seen = made_logs.ranges(made_logs.driven()[last])
        assert ranges_of(scan(log, last)) == pytest.approx(seen, abs=0.006)


@pytest.mark.parametrize(
    ("t", "why"),
    [
        (np.full(127, 5.0), "all 127 have the time 5"),
        (np.zeros(127), "all 127 have the time 0"),
        (np.r_[0.0, np.ones(126)], "125 of 127 rows are not later"),
        (-0.4 * np.arange(127), "the clock runs backwards"),
        (400.0 * np.arange(127), "the clock jumps at 126 of 127"),  # it is ms
        (np.full(127, np.nan), "all 127 have the time 0"),
    ],
)
def test_rows_without_useful_times_are_taken_in_their_order(
    tmp_path: Path, t: NDArray[np.float64], why: str
) -> None:
    path = made_logs.npz(tmp_path / "a.npz", t=t)
    log = logs.read(path)
    assert len(log) == log.used == log.given == 127
    assert log.judgement.passed
    assert log.odometry[:, :2] == pytest.approx(np.array(made_logs.driven())[:, :2])
    assert why in log.notes[0]
    # The usual step of 0.15 m takes 0.3 s at 0.5 m/s.
    assert np.diff(log.times) == pytest.approx(0.3)
    assert np.diff(logs.read(path, period=0.7).times) == pytest.approx(0.7)


@pytest.mark.parametrize("shows", ["the same", "nothing"])
def test_a_scanner_that_shows_nothing_new_while_the_robot_drives_is_unknown(
    tmp_path: Path, shows: str
) -> None:
    whole = logs.read(made_logs.npz(tmp_path / "a.npz"))
    assert whole.judgement.passed
    assert isinstance(whole.readings, logs.Scans)
    ranges = whole.readings.ranges.copy()
    ranges[40:80] = ranges[40] if shows == "the same" else 0
    useless = replace(whole, readings=replace(whole.readings, ranges=ranges))
    assert useless.judgement.answer == "unknown"
    standing = replace(useless, odometry=np.zeros_like(whole.odometry))
    assert standing.judgement.passed, "a robot that stands may see the same"


def test_a_log_of_which_less_than_half_is_used_is_no_success(tmp_path: Path) -> None:
    path = np.array(made_logs.driven())
    path[40:] = np.nan
    log = logs.read(made_logs.npz(tmp_path / "a.npz", odometry=path))
    assert (log.used, log.given) == (40, 127)
    assert log.judgement.answer == "no"
    assert "40 of 127" in log.judgement.reason


def test_rows_without_numbers_are_left_out(tmp_path: Path) -> None:
    path = np.array(made_logs.driven())
    path[5], path[9, 2] = np.nan, 1e300
    reference = np.array(made_logs.driven())
    reference[3, 1] = np.nan
    log = logs.read(made_logs.npz(tmp_path / "a.npz", odometry=path, reference=reference))
    assert len(log) == len(path) - 2
    assert len(log.notes) == 1
    assert log.notes[0].startswith("2 of 127")
    assert log.where(3) is None
    assert np.flatnonzero(~log.known).tolist() == [3]
    assert log.where(8) == pytest.approx(reference[9 + 1])


def test_a_range_that_is_not_finite_is_invalid(tmp_path: Path) -> None:
    seen = np.array([made_logs.ranges(pose) for pose in made_logs.driven()])
    seen[4, :3] = np.nan, 0.0, np.inf
    log = logs.read(made_logs.npz(tmp_path / "a.npz", ranges=seen, scale=None))
    first = ranges_of(scan(log, 4))[:4]
    assert np.isnan(first[:2]).all()
    assert np.isinf(first[2])
    assert np.isfinite(first[3])


def test_rows_out_of_order_are_left_out(tmp_path: Path) -> None:
    t = made_logs.STEP_S * np.arange(127)
    t[[20, 40]] = t[[18, 39]]
    log = logs.read(made_logs.npz(tmp_path / "a.npz", t=t))
    assert len(log) == 125
    assert (np.diff(log.times) > 0).all()
    assert log.times[-1] == pytest.approx(t[-1])
    assert log.notes[0].startswith("2 of 127")


def test_an_odometry_that_jumps_is_reported(tmp_path: Path) -> None:
    path = np.array(made_logs.driven())
    path[60:] -= path[60]
    log = logs.read(made_logs.npz(tmp_path / "a.npz", odometry=path))
    (note,) = log.notes
    assert "8.1 m" in note


@pytest.mark.parametrize("jump", [3600.0, -3600.0])
def test_a_clock_that_jumps_is_followed(tmp_path: Path, jump: float) -> None:
    t = made_logs.STEP_S * np.arange(127)
    t[60:] += jump
    log = logs.read(made_logs.npz(tmp_path / "a.npz", t=t))
    assert len(log) == 127
    assert (np.diff(log.times) > 0).all()
    assert log.times[-1] < 60.0
    assert "1 times" in log.notes[0]


def test_a_frequent_largest_range_means_that_nothing_was_seen(tmp_path: Path) -> None:
    seen = np.array([made_logs.ranges(pose) for pose in made_logs.driven()])
    near = logs.read(made_logs.npz(tmp_path / "a.npz", ranges=np.minimum(seen, 4.0), scale=None))
    assert np.isinf(ranges_of(scan(near, 0))).sum() == (seen[0] >= 4.0).sum() > 0
    # Without such a frequent value the farthest wall is a wall.
    far = logs.read(made_logs.npz(tmp_path / "b.npz", ranges=seen, scale=None))
    assert np.isfinite(ranges_of(scan(far, 0))).all()
    limited = logs.read(tmp_path / "b.npz", reach=2.0)
    assert np.isinf(ranges_of(scan(limited, 0))).sum() == (seen[0] > 2.0).sum()


# Errors of odometry -------------------------------------------------------------------------------


def test_errors_depend_on_the_seed_and_grow_with_the_share(tmp_path: Path) -> None:
    log = logs.read(made_logs.npz(tmp_path / "a.npz"))
    assert logs.with_errors(log, 0.0, 1).odometry[:, :2] == pytest.approx(log.odometry[:, :2])
    one, same = (logs.with_errors(log, 0.05, 1).odometry for _ in range(2))
    assert (one == same).all()
    off = {
        share: np.mean(
            [
                hypot(*(logs.with_errors(log, share, seed).odometry[-1] - log.odometry[-1])[:2])
                for seed in range(20)
            ]
        )
        for share in (0.01, 0.1)
    }
    assert 0.02 < off[0.01] < 0.2 * off[0.1] < 2.0


def test_errors_have_the_standard_deviations_that_the_share_says() -> None:
    """Of 10 m ahead: half the share of the way, and so many rad/m; of 10 rad on the spot: all."""
    way = np.linspace(0.0, 10.0, 101)
    ahead, turning = way[:, None] * (1.0, 0.0, 0.0), way[:, None] * (0.0, 0.0, 1.0)
    ends = [
        (*logs.drifted(ahead, 0.01, seed)[-1], logs.drifted(turning, 0.01, seed)[-1, 2] - 10.0)
        for seed in range(400)
    ]
    assert np.std(ends, axis=0) == pytest.approx([0.05, 0.25, 0.05, 0.1], rel=0.15)


# CARMEN -------------------------------------------------------------------------------------------


def lines(poses: list[Pose2], odometry: list[Pose2]) -> list[str]:
    return [
        made_logs.flaser(made_logs.STEP_S * k, pose, odo, made_logs.ranges(true))
        for k, (pose, odo, true) in enumerate(zip(poses, odometry, made_logs.driven(), strict=True))
    ]


@pytest.mark.parametrize("packed", [False, True])
def test_two_different_poses_of_a_carmen_log_are_reference_and_odometry(
    tmp_path: Path, packed: bool
) -> None:
    poses = made_logs.driven()
    bent = [(0.9 * x, y, theta + 0.01 * k) for k, (x, y, theta) in enumerate(poses)]
    log = logs.read(carmen(tmp_path / "a.log", lines(poses, bent), packed=packed))
    assert log.real
    assert log.where(9) == pytest.approx(poses[9], abs=1e-5)
    assert log.odometry[9] == pytest.approx(bent[9], abs=1e-5)
    assert log.times[9] == pytest.approx(9 * made_logs.STEP_S)
    assert ranges_of(scan(log, 9)) == pytest.approx(made_logs.ranges(poses[9]), abs=0.006)


def test_one_pose_of_a_carmen_log_is_odometry_unless_it_is_declared_as_corrected(
    tmp_path: Path,
) -> None:
    poses = made_logs.driven()
    ahead = [made_logs.ahead(pose, 0.2) for pose in poses]
    raw = carmen(tmp_path / "a.log", lines(ahead, poses))
    log = logs.read(raw)
    assert log.real
    assert not log.known.any()
    assert scan(log, 0).x == pytest.approx(0.2, abs=1e-5)  # where the scanner is
    for corrected in (
        logs.read(raw, corrected=True),
        logs.read(carmen(tmp_path / "a.gfs.log", lines(ahead, poses))),
    ):
        assert not corrected.real
        assert corrected.where(9) == pytest.approx(poses[9], abs=1e-5)


def test_robotlaser_lines_have_their_own_angles(tmp_path: Path) -> None:
    made = []
    for k, pose in enumerate(made_logs.driven()):
        seen = " ".join(f"{value:.3f}" for value in made_logs.ranges(pose)[:60])
        at = " ".join(f"{value:.6f}" for value in (*pose, *pose))
        head = f"ROBOTLASER1 0 -1.0 1.2 0.02 8.0 0.01 0 60 {seen} 2 5.0 5.0"
        made.append(f"{head} {at} 0 0 0.4 0.4 0 {k} host {k}")
    log = logs.read(carmen(tmp_path / "a.log", made))
    assert len(log) == 127
    assert bearings_of(scan(log, 0))[[0, 1]] == pytest.approx([-1.0, -0.98])
    assert log.odometry[50] == pytest.approx(made_logs.driven()[50], abs=1e-5)


def test_broken_lines_are_left_out_and_other_angles_are_taken_at_those_of_most(
    tmp_path: Path,
) -> None:
    poses = made_logs.driven()
    good = lines(poses, poses)
    good[10] = good[10][:40]
    good[20] = good[20].replace("FLASER 90", "FLASER many")
    coarse = np.linspace(1.0, 1.29, 30, dtype=np.float64)
    good[30] = made_logs.flaser(30 * made_logs.STEP_S, poses[30], poses[30], coarse)
    log = logs.read(carmen(tmp_path / "a.log", [*good, "ODOM", "PARAM"]))
    assert len(log) == 125
    assert any(note.startswith("4 lines") for note in log.notes)
    assert any(note.startswith("1 of 125") for note in log.notes)
    seen = ranges_of(scan(log, 28))  # 6 degrees apart, at angles 2 degrees apart
    assert seen[[0, 3, 87]] == pytest.approx([1.0, 1.01, 1.29])


def test_an_incomplete_compressed_log_is_read_up_to_its_end(tmp_path: Path) -> None:
    poses = made_logs.driven()
    path = carmen(tmp_path / "a.log.gz", lines(poses, poses), packed=True)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    log = logs.read(path)
    assert 20 < len(log) < 100
    assert log.judgement.answer == "unknown"
    assert "incomplete" in log.judgement.reason


def test_odometry_lines_are_used_if_scans_have_no_pose(tmp_path: Path) -> None:
    poses = made_logs.driven()
    still = [AT] * len(poses)
    with pytest.raises(LogError, match="odometry"):
        logs.read(carmen(tmp_path / "a.log", lines(still, still)))
    beside = [
        f"ODOM {x} {y} {theta} 0 0 0 {made_logs.STEP_S * k} host {made_logs.STEP_S * k}"
        for k, (x, y, theta) in enumerate(poses)
    ]
    log = logs.read(carmen(tmp_path / "b.log", [*lines(still, still), "ODOM nan " * 8, *beside]))
    assert log.odometry[50, :2] == pytest.approx(poses[50][:2], abs=1e-5)
    assert log.notes == ("1 lines could not be read, the first of them line 129",)
    half = logs.read(carmen(tmp_path / "c.log", [*lines(still, still), *beside[:60]]))
    assert len(half) == 62  # two within a second of the last
    assert [note[:9] for note in half.notes] == ["65 of 127"]
    later = [f"ODOM {k} 0 0 0 0 0 {5000 + k} host 0" for k in range(9)]
    with pytest.raises(LogError, match="ODOM"):
        logs.read(carmen(tmp_path / "d.log", [*lines(still, still), *later]))


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("kind", ["FLASER", "RAWLASER1"])
def test_odometry_lines_belong_to_the_scans_around_them(
    tmp_path: Path, kind: str, timed: bool
) -> None:
    """By time, or by the order of the lines where all times of a kind are equal."""
    made = []
    for k, pose in enumerate(made_logs.driven()):
        t = made_logs.STEP_S * k if timed else 0.0
        made.append(f"ODOM {pose[0]} {pose[1]} {pose[2]} 0 0 0 {t if timed else 9.0} host {t}")
        seen = made_logs.ranges(pose)
        if kind == "FLASER":
            made.append(made_logs.flaser(t, AT, AT, seen))
            continue
        values = " ".join(f"{value:.3f}" for value in seen)
        head = f"RAWLASER1 0 {-pi / 2} {pi} {pi / made_logs.RAYS} 20.0 0.01 0 {len(seen)}"
        made.append(f"{head} {values} 0 {t} host {t}")
    log = logs.read(carmen(tmp_path / "a.log", [*made, made[-2]]))
    assert len(log) == 127
    off = np.hypot(*(log.odometry - np.array(made_logs.driven()))[:, :2].T)
    assert off.max() < (1e-4 if timed else 0.6 * made_logs.STEP_M)
    assert bool(log.notes) != timed
    assert ranges_of(scan(log, 9)) == pytest.approx(
        made_logs.ranges(made_logs.driven()[9]), abs=0.006
    )


def test_the_lasers_path_is_used_if_the_robot_has_no_pose(tmp_path: Path) -> None:
    poses = made_logs.driven()
    log = logs.read(carmen(tmp_path / "a.log", lines(poses, [AT] * len(poses)), packed=True))
    assert log.odometry[50] == pytest.approx(poses[50], abs=1e-5)


@pytest.mark.parametrize("data", [b"hello\n", b"\x00\xff" * 50, b"PK\x03\x04rubbish", b"\x89MCAP0"])
def test_another_file_is_refused(tmp_path: Path, data: bytes) -> None:
    pytest.importorskip("mcap")
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(LogError):
        logs.read(tmp_path / "a")


# Recordings ---------------------------------------------------------------------------------------
