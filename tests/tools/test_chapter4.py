"""Chapter 4 measured again: what the experiments write, and what the robot does in them."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Sequence
from math import inf, pi, radians
from pathlib import Path
from typing import Any

import pytest

from armadico.agents.methods.controllers import Mode
from armadico_tools.experiments import controllers, identify, speed


class Folder:
    """What an experiment is handed, with everything in one process."""

    def __init__(self, out: Path, runs: int) -> None:
        self.runs, self.jobs, self.out, self.first_seed = runs, 1, out, 1000
        self.drawn: list[str] = []

    def rows(self, name: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        with (self.out / f"{name}.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(header)
            for row in rows:
                assert len(row) == len(header)
                writer.writerow(row)

    def table(self, text: str, name: str = "table") -> None:
        (self.out / f"{name}.md").write_text(text)

    def figure(self, figure: Any, name: str) -> None:
        assert figure.axes
        self.drawn.append(name)

    def map(self, function: Callable[[Any], Any], items: Sequence[Any], label: str) -> list[Any]:
        return [function(item) for item in items]


def ran(module: Any, out: Path, runs: int = 2) -> tuple[Folder, str]:
    pytest.importorskip("matplotlib")
    pytest.importorskip("scipy")
    out.mkdir(exist_ok=True)
    folder = Folder(out, runs)
    module.run(folder)
    return folder, (out / "table.md").read_text()


def read(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


# Identification -----------------------------------------------------------------------------------


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = identify.record

    def record(trial: Any, seed: int, robot: Any, seconds: float = 24.0) -> Any:
        return whole(trial, seed, robot, seconds)

    monkeypatch.setattr(identify, "record", record)


@pytest.mark.usefixtures("short")
def test_identify_shows_the_thesis_s_tables_beside_the_truth(tmp_path: Path) -> None:
    folder, table = ran(identify, tmp_path)
    assert folder.drawn == ["figure-4.8", "figure-4.9", "figure-4.10"]
    for number in ("17.83", "16.49", "0.2921", "0.4301", "0.000469", "17.07"):
        assert f"| {number} |" in table
    trials = len(identify.STRAIGHT) + len(identify.TURNING)
    assert len(read(tmp_path / "estimates.csv")) == trials * 2 * 2 * 3


@pytest.mark.usefixtures("short")
def test_table_4_6_is_reckoned_with_the_friction_found_straight_ahead() -> None:
    robot = identify.profile()
    trials = (*identify.STRAIGHT, *identify.MENDED)
    found = [one for trial in trials for one in identify.measure((trial, 1000))]
    alone = identify.pooled(found, identify.MENDED, 1000)
    whole = identify.together(found, 1000, robot)
    assert whole["C_s1"].half > alone["C_s1"].half
    share = 2.0 * robot.body.half_track_m / robot.body.wheel_radius_m
    moved = share * (whole["C_s"].value - robot.inertia.wheel_coulomb_nm)
    assert whole["C_s1"].value == pytest.approx(alone["C_s1"].value - moved)
    assert whole["I_0"].holds(robot.inertia.body_kg_m2)


def test_the_prbs_is_of_maximum_length_whatever_its_state() -> None:
    for state in range(127):
        bits = identify.prbs(state)
        windows = {tuple((bits + bits)[n : n + 7]) for n in range(127)}
        assert len(windows) == 127


def test_every_seed_has_its_own_noise_and_repeats() -> None:
    robot = identify.profile()
    logs = [identify.record(identify.STRAIGHT[0], seed, robot, 1.0) for seed in (1, 1, 2)]
    assert (logs[0].v == logs[1].v).all()
    assert (logs[0].v != logs[2].v).any()


def test_the_robot_that_is_held_turns_on_the_spot() -> None:
    robot = identify.profile()
    free, held = (
        identify.record(trial, 5, robot, 10.0, noise_m_s=0.0)
        for trial in (identify.TURNING[2], identify.MENDED[2])
    )
    assert abs(held.v).max() < 0.5 * abs(free.v).max()


# The speed loops ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("v", "w"), [point for kind in ("linear", "angular") for point in speed.KINDS[kind]]
)
def test_one_speed_alone_settles_under_two_seconds_and_hardly_overshoots(
    v: float, w: float
) -> None:
    answer = speed.respond((v, w, "S"))
    assert answer.settling() < 2.0
    assert answer.overshoot() < 0.1


def test_a_set_point_out_of_reach_never_settles() -> None:
    assert speed.respond((1.6, 4.0, "S")).settling() == inf


def test_scaled_set_points_keep_the_curvature_and_truncated_ones_do_not() -> None:
    for v, w in speed.random_setpoints(1000, 3):
        pair = speed.compare((v, w, "set-points"))
        assert pair.s.growth(pair.bend) < 0.5 * pair.t.growth(pair.bend)


def test_below_the_supply_s_limit_s_and_t_are_the_same() -> None:
    s, t = (speed.respond((0.5, 1.0, kind)) for kind in ("S", "T"))
    assert (s.v, s.w) == (t.v, t.w)


def test_speed_writes_the_same_numbers_twice(tmp_path: Path) -> None:
    first, table = ran(speed, tmp_path / "a")
    ran(speed, tmp_path / "b")
    assert first.drawn == ["figure-4.15", "s-against-t"]
    assert "under 10 % in the worst case" in table
    for name in ("responses", "s-against-t"):
        a, b = (read(tmp_path / folder / f"{name}.csv") for folder in "ab")
        assert a == b
        assert len(a) == (13 if name == "responses" else 4)


# The controllers ----------------------------------------------------------------------------------


def test_collaborative_is_faster_than_precise_and_better_than_fast() -> None:
    quick, exact, both = controllers.shipped(controllers.CASE_A)
    assert (quick.controller, exact.controller, both.controller) == tuple(Mode)
    assert quick.seconds < both.seconds < exact.seconds
    assert exact.reached
    assert both.reached
    assert not quick.reached
    assert quick.seconds == pytest.approx(5.0, abs=0.5)
    assert exact.seconds > 10.0


def test_chapter_4_s_cases_are_turned_by_a_quarter() -> None:
    """(x, y) of the thesis is (y, -x) here; headings stay, being counted from +y there."""
    for case, (x, y) in ((controllers.CASE_A, (-1.0, 5.0)), (controllers.CASE_B, (-2.0, 3.0))):
        assert case.goal[:2] == (y, -x)
    assert (controllers.CASE_A.goal[2], controllers.CASE_B.goal[2]) == (0.0, -pi / 2)
    assert controllers.CASE_B.start[2] == pytest.approx(-3 * pi / 8)


def test_the_pair_of_gains_that_is_drawn_is_one_for_which_the_claim_holds() -> None:
    assert controllers.GAINS in controllers.grid()
    both = controllers.pair((controllers.CASE_B, *controllers.GAINS))
    assert controllers.kind(*both) == "only collaborative"


def ended(metres: float, degrees: float) -> controllers.Drive:
    return controllers.Drive("", "", [(0.0,) * 6], metres, radians(degrees), True)


def test_kinds_are_by_position_and_heading() -> None:
    good, turned, away = ended(0.1, 3), ended(0.1, 8), ended(0.2, 0)
    assert controllers.kind(good, good) == "both"
    assert controllers.kind(turned, good) == "only collaborative"
    assert controllers.kind(good, away) == "only precise"
    assert controllers.kind(turned, away) == "neither"
    assert controllers.kind(turned, away, radians(10)) == "only precise"


def test_controllers_count_every_pair_of_gains_and_every_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(controllers, "KAP", (1.0, 2.2))
    monkeypatch.setattr(controllers, "KBP", (0.5, 1.7))
    folder, table = ran(controllers, tmp_path)
    assert "figure-4.19" in folder.drawn
    counts = [
        [int(cell) for cell in line.split("|")[3:7]]
        for line in table.splitlines()
        if line.startswith(("| 4 pairs", "| 2 starts"))
    ]
    assert [sum(row) for row in counts] == [4, 4, 4, 2, 2, 2]
    assert len(read(tmp_path / "runs.csv")) == 6 + 2 * 4 + 2 * 2
