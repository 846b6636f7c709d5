"""Experiments: the same seeds give the same bytes, and nothing that was finished is lost."""

from __future__ import annotations

import json
from itertools import pairwise
from math import hypot, pi
from pathlib import Path

import pytest
from msgspec import Struct, structs
from msgspec.structs import replace

from armadico.agents.methods.geometry import Placed
from armadico.cli import pool
from armadico.cli.options import FailedError, UsageError
from armadico.config.profile import load_profile
from armadico.config.scenarios import load_scenario
from armadico.config.worlds import World, load_world
from armadico.core.agent import Identity, Publish
from armadico.core.messages import Cycle, RobotState
from armadico.mobile.messages import Correction, Pose
from armadico.observe.conditions import software
from armadico.observe.measures import Result
from armadico_tools.commands.experiment import main
from armadico_tools.experiments import (
    EXPERIMENTS,
    base,
    floors,
    other_maps,
    published,
    statistics,
    store,
    utility,
)
from armadico_tools.experiments.base import Context
from armadico_tools.experiments.driving import (
    Cell,
    Drive,
    Sample,
    columns,
    drive,
    key_of,
    last_metre,
    of_thesis,
    options_of,
    scenario_of,
)
from armadico_tools.experiments.driving_time import (
    ARMS,
    BASELINES,
    EXACT,
    Surveyor,
    cells_of,
    make,
    ratios,
    shortest,
)
from armadico_tools.experiments.driving_time import drive as drive_time
from armadico_tools.experiments.floor_plans import (
    PASSAGE_M,
    floor_plan,
    passable,
    people,
    save,
)
from armadico_tools.experiments.histories import History
from armadico_tools.experiments.real_robot import LOCALIZED
from armadico_tools.experiments.table_5_3 import join
from armadico_tools.experiments.tables import Column, compare, differences
from armadico_tools.experiments.traces import Tick, exchanges_of, reigns_of, smoothness
from tests.programs import heavy, imports_nothing

SC1 = Cell("sc1 collaborative", "sc1", without=("gothrough",))
FAST = Cell("sc1 fast", "sc1", controller="fast", without=("gothrough",))


def context(folder: Path, runs: int = 1, jobs: int = 1) -> Context:
    folder.mkdir(parents=True, exist_ok=True)
    return Context(out=folder, runs=runs, jobs=jobs, source="here")


def about(runs: int = 2, first_seed: int = 1000, source: str = "s") -> store.About:
    return store.About(
        experiment="x", first_seed=first_seed, runs=runs, source=source, software=software()
    )


# Runs ---------------------------------------------------------------------------------------------


def test_the_same_seeds_give_the_same_bytes_however_many_processes(tmp_path: Path) -> None:
    context(tmp_path / "one", runs=2).drive([SC1, FAST])
    context(tmp_path / "two", runs=2, jobs=2).drive([SC1, FAST])
    one, two = ((tmp_path / name / "runs.csv").read_bytes() for name in ("one", "two"))
    assert one == two
    assert one.count(b"\n") == 5


def test_interrupted_runs_are_kept_and_not_driven_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driven: list[int] = []

    def interrupted(task: tuple[Cell, int]) -> Sample:
        driven.append(task[1])
        if len(driven) == 2:
            raise KeyboardInterrupt
        return drive(task)

    monkeypatch.setattr(base, "drive", interrupted)
    with pytest.raises(KeyboardInterrupt):
        context(tmp_path / "cut", runs=3).drive([SC1])
    kept = (tmp_path / "cut" / "runs.csv").read_text(encoding="utf-8")
    assert kept.count("\n") == 2
    with (tmp_path / "cut" / "runs.csv").open("a", encoding="utf-8") as file:
        file.write(kept.splitlines()[1][:40])  # as a kill in the middle of a line leaves it
    context(tmp_path / "cut", runs=3).drive([SC1])
    assert driven == [1000, 1001, 1001, 1002]
    context(tmp_path / "whole", runs=3).drive([SC1])
    cut, whole = ((tmp_path / name / "runs.csv").read_bytes() for name in ("cut", "whole"))
    assert cut == whole


class Square(Struct, frozen=True):
    of: int
    square: float


def square(of: int) -> Square:
    """What takes long, and ends in the middle of the third."""
    SQUARED.append(of)
    if len(SQUARED) == 3:
        raise KeyboardInterrupt
    return Square(of, float("nan") if of == 1 else of**2)


SQUARED: list[int] = []


def test_interrupted_what_was_found_is_kept_and_not_made_again(tmp_path: Path) -> None:
    SQUARED.clear()
    with pytest.raises(KeyboardInterrupt):
        context(tmp_path).map(square, [0, 2, 1, 3], "squares")
    with (tmp_path / "found.csv").open("ab") as file:
        file.write(b"cut sh")
    for _ in range(2):
        found = context(tmp_path).map(square, [3, 1, 2, 0], "squares")
        assert [each.of for each in found] == [3, 1, 2, 0]
        assert [each.square for each in found if each.of != 1] == [9.0, 4.0, 0.0]
    # NaN does not read back as it is, so it is found again each time.
    assert SQUARED == [0, 2, 1, 3, 1, 1]
    other = Context(out=tmp_path, source="of other code")
    other.map(square, [3], "squares")
    assert SQUARED[6:] == [3]


def test_a_run_depends_on_its_cell_and_on_the_code() -> None:
    keys = {key_of(SC1, "a"), key_of(SC1, "b"), key_of(FAST, "a")}
    keys.add(key_of(Cell(SC1.name, "sc2", without=SC1.without), "a"))
    keys.add(key_of(Cell(SC1.name, "sc1", parameters="thesis", without=SC1.without), "a"))
    assert len(keys) == 5
    assert key_of(SC1, "a") == key_of(SC1, "a")


def test_a_folder_of_other_runs_is_moved_aside_and_more_runs_go_on(tmp_path: Path) -> None:
    folder = tmp_path / "x"
    assert store.claim(folder, about()) is None
    (folder / "runs.csv").write_text("precious", encoding="utf-8")
    assert store.claim(folder, about(runs=5)) is None
    for number, other in enumerate((about(2), about(5, 0), about(5, 0, "t")), start=1):
        moved = store.claim(folder, other)
        assert moved == tmp_path / f"x.kept-{number}"
    assert (tmp_path / "x.kept-1" / "runs.csv").read_text(encoding="utf-8") == "precious"
    assert [path.name for path in folder.iterdir()] == ["about.json"]


def test_a_folder_that_no_experiment_made_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "utility").mkdir()
    (tmp_path / "utility" / "letter.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(FailedError, match="holds no results"):
        main(["utility", "--runs", "1", "--out", str(tmp_path)])
    assert [path.name for path in (tmp_path / "utility").iterdir()] == ["letter.txt"]


def test_results_come_in_the_order_of_the_items() -> None:
    finished: list[int] = []
    found = pool.over(abs, [-3, 2, -1], 2, "abs", lambda item, _: finished.append(item))
    assert found == [3, 2, 1]
    assert sorted(finished) == [-3, -1, 2]


# What a run says ----------------------------------------------------------------------------------


def test_the_fast_controller_stops_where_it_comes_to_rest() -> None:
    sample = drive((FAST, 1000))
    assert sample.arrived
    assert not sample.note
    assert 13.0 < sample.tt_s < 15.5  # s of simulation; it is calibrated to 14.3
    assert sample.fo_deg > 5.0  # it does not turn to the goal's heading
    assert not sample.reached


def test_an_agent_that_joins_restarts_nobody() -> None:
    found = join(("rooms-b", 1000))
    assert found.kept
    assert len(found.before) == 7
    assert not any(instance.startswith("gothrough") for instance in found.before)
    assert found.first_held_s is not None
    assert found.first_held_s > 5.0


def test_bids_are_known_for_every_cycle_and_one_agent_holds() -> None:
    turns = History(Cell("x", "sc3", without=("gothrough",)), 1000).turns()
    goto = [turn for turn in turns if turn.agent == "goto"]
    steps = [round(b.t - a.t, 3) for a, b in pairwise(goto)]
    assert set(steps) == {0.1}
    assert {turn.agent for turn in turns if turn.holds} == {"goto", "avoid"}


def test_a_robot_that_gets_nowhere_is_stuck_before_the_time_limit() -> None:
    run = Drive(Cell("x", "sc1", without=("goto", "avoid", "gothrough")), 1000)
    sample = run.go().sample()
    assert sample.note == "stuck"
    assert not sample.arrived
    assert 60.0 < sample.tt_s < run.rehearsal.limit


def tick(t: float, v: float, holder: str | None, command: float) -> Tick:
    return Tick(t, 0.0, 0.0, v, 0.0, holder, command, 0.0)


def test_smoothness_of_a_run_made_by_hand() -> None:
    speeds = (0.5, 0.5, 0.5, 0.4, 0.4)
    holders = ("goto", "goto", "avoid", "avoid", "goto")
    ticks = [tick(0.1 * i, v, holders[i], v) for i, v in enumerate(speeds)]
    assert exchanges_of(ticks) == [2, 4]
    assert reigns_of(ticks) == [
        ("goto", pytest.approx(0.2)),
        ("avoid", pytest.approx(0.2)),
        ("goto", pytest.approx(0.1)),
    ]
    found = smoothness(ticks)
    assert found.short_reigns == 3
    assert found.accel_step == pytest.approx(1.0)  # from 0 to -1 m/s2 and back
    assert found.command_step_v == pytest.approx(0.0)
    assert found.jerk_v == pytest.approx((200.0 / 3) ** 0.5, rel=1e-3)
    assert smoothness([tick(0.0, 0.1, "goto", 0.1)] * 4).accel_step is None


# Floor plans --------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_floor_plan_is_the_same_again_can_be_passed_and_loads(seed: int, tmp_path: Path) -> None:
    plan = floor_plan(seed)
    assert plan == floor_plan(seed)
    assert passable(plan.world.walls, plan.start, plan.goal, PASSAGE_M)
    scenario = load_scenario(save(plan, tmp_path))
    assert hypot(scenario.start[0] - plan.start[0], scenario.start[1] - plan.start[1]) < 1e-9
    assert scenario.plan == "rooms"


@pytest.mark.parametrize("seed", range(5))
def test_whoever_walks_in_a_floor_plan_is_the_same_again_and_the_scenario_takes_them(
    seed: int, tmp_path: Path
) -> None:
    plan = floor_plan(seed)
    walking = people(plan, seed, 3)
    assert walking == people(plan, seed, 3)
    scenario = load_scenario(save(plan, tmp_path, walking))  # which refuses who stands in a wall
    assert [one.heeds for one in scenario.moving] == [True, True, False]
    assert scenario.moving == tuple(walking)


def test_the_floors_have_real_sensors_localization_and_people(tmp_path: Path) -> None:
    scenario = scenario_of(replace(LOCALIZED, scenario=str(floors.make((tmp_path, 3)))))
    assert scenario.sensors == "real"
    assert {"localization", "relocate"} <= {*scenario.agents}
    assert len(scenario.moving) == floors.PEOPLE


@pytest.mark.parametrize(("gap", "through"), [(0.50, False), (0.70, True)])
def test_the_flood_knows_a_gap_that_is_too_narrow(gap: float, through: bool) -> None:
    box = ((0.0, 0.0, 6.0, 0.0), (6.0, 0.0, 6.0, 4.0), (6.0, 4.0, 0.0, 4.0), (0.0, 4.0, 0.0, 0.0))
    wall = ((3.0, 0.0, 3.0, 2.0 - gap / 2), (3.0, 2.0 + gap / 2, 3.0, 4.0))
    assert passable(box + wall, (1.0, 1.0, 0.0), (5.0, 3.0, 0.0)) is through


# Numbers ------------------------------------------------------------------------------------------


def test_the_shares_of_the_published_tables_add_up() -> None:
    tables = []
    for line in published.TABLES.splitlines():
        names = [word for word in line.split()[1:] if not word[0].isdigit()]
        tables.append(published.published(line.split()[0], *names))
    assert len(tables) == 22
    for numbers in tables:
        shares = [
            value[0] for name, value in numbers.items() if name.startswith("t") and "_p" in name
        ]
        assert sum(shares) == pytest.approx(100.0, abs=0.7)


def test_means_intervals_and_p_values_against_known_ones() -> None:
    found = statistics.spread([1.0, 2.0, 3.0, 4.0, 5.0])
    assert found is not None
    assert (found.mean, found.sd) == (3.0, pytest.approx(1.5811, abs=1e-4))
    assert (found.low, found.high) == (
        pytest.approx(1.0368, abs=1e-4),
        pytest.approx(4.9632, abs=1e-4),
    )
    assert statistics.against(found, 3.0, 1.0) == pytest.approx(1.0)
    assert statistics.against(statistics.Spread(30, 1.0, 0.0, 1.0, 1.0), 1.0, 0.0) is None
    assert statistics.paired([1.0, 2.0], [1.0, 2.0]) is None
    p = statistics.unpaired([1.0, 2.0, 3.0, 4.0, 5.0], [6.0, 7.0, 8.0, 9.0, 10.0])
    assert p == pytest.approx(0.0079, abs=1e-4)
    assert statistics.at_least(200, 200) == pytest.approx(0.05 ** (1 / 200))


def test_a_table_has_our_numbers_beside_the_published_ones() -> None:
    ours = [
        Sample("x", seed, True, True, 5.0, 1.0, tt, 99.0, 0) for seed, tt in enumerate((14.0, 15.0))
    ]
    text = compare([Column("fast", ours, published.published("5.1", "fast", "sc1"))])
    line = next(line for line in text.splitlines() if line.startswith("| TT s"))
    assert line.startswith("| TT s | 14.50 ± 0.707 [8.15, 20.85] | 14.28 ± 1.29 (p ")
    assert "| reached | 2 of 2 | - |" in text
    changes = differences("a to b", ours, ours[::-1], {"tt_s": "TT s"})
    assert "| TT s | 14.50 | 14.50 | +0 (+0.0 %) |" in changes


def test_a_run_that_did_not_arrive_has_no_time_in_a_table_but_counts_as_not_reached() -> None:
    there = Sample("x", 1, True, True, 5.0, 1.0, 14.0, 99.0, 0)
    stuck = replace(there, seed=2, reached=False, arrived=False, tt_s=60.0, td_m=7.0)
    text = compare([Column("fast", [there, stuck])])
    assert "| reached | 1 of 2 |" in text
    assert "| TT s | 14.00 |" in text
    assert "| TD m | 6.00 ± " in text
    changes = differences("a to b", [there, there], [there, stuck], {"tt_s": "TT s"})
    assert "| TT s | 14.00 | 14.00 |" in changes
    assert base._outcome([stuck])["tt_s"] is None
    assert base._outcome([there, stuck])["tt_s"] == 14.0


# The command --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["table-5.9"], "did you mean 'table-5"),
        (["utility", "--runs", "0"], "--runs 0: at least 1"),
        (["utility", "--runs", "-3"], "--runs -3: at least 1"),
        (["utility", "--jobs", "0"], "--jobs 0: at least 1"),
        (["utility", "--live"], "--live goes with all"),
        ([], "--list shows them"),
    ],
)
def test_wrong_calls_are_told_what_is_right(words: list[str], says: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=says):
        main([*words, "--out", str(tmp_path / "results")])
    assert not (tmp_path / "results").exists()


def test_the_list_says_what_each_is_and_imports_nothing_heavy() -> None:
    among = {"numpy", "scipy", "matplotlib", "msgspec", "pymunk", "rich"}
    done = heavy("armadico_tools.commands.experiment", ["--list", "--json"], among)
    assert imports_nothing(done)
    listed = done.stdout.splitlines()[0]
    found = json.loads(listed)
    assert list(found) == list(EXPERIMENTS)
    assert all(found.values())


def test_an_experiment_writes_its_runs_table_and_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(utility, "FIGURES", {"sc2": "figure-5.5"})  # one of two: less to drive
    assert main(["utility", "--runs", "1", "--jobs", "1", "--out", str(tmp_path), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["runs"] == 1
    assert said["cells"]["sc2 default"]["reached"] == 1
    folder = tmp_path / "utility"
    assert {path.name for path in folder.iterdir()} == {*said["files"], "about.json"}
    assert (folder / "figure-5.5.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "figure-5.5.svg").read_text(encoding="utf-8").startswith("<?xml")
    text = (folder / "table.md").read_text(encoding="utf-8")
    assert "*Stop rule*" in text
    assert "*P* = 100" in text
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert main(["utility", "--runs", "1", "--jobs", "1", "--out", str(tmp_path)]) == 0
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


# Time ---------------------------------------------------------------------------------------------


def test_the_least_time_is_by_the_shortest_way_of_a_disc() -> None:
    box = World("box", (), (0.0, 0.0, 6.0, 6.0), (1.0, 1.0, 0.0), {}, (), ())
    assert shortest(box, Placed(1.0, 1.0), Placed(4.0, 5.0)) == pytest.approx(5.0)
    wall = structs.replace(box, walls=((3.0, 0.0, 3.0, 4.0),))
    round_it = shortest(wall, Placed(1.0, 3.0), Placed(5.0, 3.0))
    assert 2.0 * hypot(2.0, 1.0) < round_it < 2.0 * hypot(2.0, 1.2) + 0.4


def test_a_run_that_does_not_reach_has_no_share_of_the_least_time() -> None:
    there = Sample(
        cell="x",
        seed=1,
        reached=True,
        arrived=True,
        td_m=7.0,
        fo_deg=0.0,
        tt_s=20.0,
        p_percent=100.0,
        exchanges=0,
    )
    runs = [there, structs.replace(there, reached=False)]
    assert ratios(runs, [7.5, 7.5]) == [pytest.approx(0.5), 0.0]


def test_the_last_metre_is_counted_from_when_the_goal_stays_near() -> None:
    xs = (0.0, 2.5, 1.0, 2.5, 3.0, 3.0)
    ticks = [Tick(float(t), x, 0.0, 0.0, 0.0, None, 0.0, 0.0) for t, x in enumerate(xs)]
    assert last_metre(ticks, (3.0, 0.0, 0.0)) == 2.0
    assert last_metre(ticks[:1], (3.0, 0.0, 0.0)) is None


def test_both_ways_of_ours_are_measured_by_their_names(tmp_path: Path) -> None:
    """And so they stay apart, whatever the defaults are."""
    path, _ = make((tmp_path, 7))
    brisk, default, *_ = (options_of(cell) for cell in cells_of(path))
    assert (brisk.parameters, brisk.controller) == ("brisk", None)
    assert (default.parameters, default.controller) == (None, "collaborative")


def test_its_runs_are_virtual_and_say_so(tmp_path: Path) -> None:
    assert main(["time", "--runs", "1", "--jobs", "1", "--out", str(tmp_path)]) == 0
    conditions = json.loads((tmp_path / "time" / store.CONDITIONS).read_bytes())
    assert len(conditions) == len(ARMS)
    assert {found["mode"] for found in conditions.values()} == {"virtual"}
    assert ARMS["brisk"] in (tmp_path / "time" / "table.md").read_text(encoding="utf-8")


def test_ours_are_told_again_and_again_that_the_pose_is_exact() -> None:
    """Else no wall of the map is expected, and a few metres on nobody dares to drive."""
    surveyor = Surveyor(Identity("surveyor-1"))
    for number, covariance, told in ((1, (), 1), (2, EXACT, 0), (3, (0.01, *EXACT[1:]), 1)):
        cycle = Cycle(1, number)
        surveyor.receive(RobotState(cycle, 1.0, 0.0, 0.5 * pi, 0, 0, 12, True, False), 0.1 * number)
        surveyor.receive(Pose(cycle, 2.0, 3.0, 0.5 * pi, covariance), 0.1 * number)
        out, surveyor.outbox = surveyor.outbox, []
        said = [o.message for o in out if isinstance(o, Publish)]
        assert len(said) == told
        for correction in said:
            assert isinstance(correction, Correction)
            assert (correction.x, correction.y, correction.theta) == pytest.approx((1.0, 3.0, 0.0))
            assert correction.covariance == EXACT


@pytest.mark.parametrize("arm", BASELINES)
def test_a_baseline_drives_a_plan_alone(arm: str, tmp_path: Path) -> None:
    path, _ = make((tmp_path, 7))
    (cell,) = [cell for cell in cells_of(path) if cell.name.endswith(arm)]
    found = drive_time((cell, 7))
    assert found.reached
    assert not found.collisions
    assert found.exchanges == 0
    assert found.last_metre_s is not None
    assert found.last_metre_s < 6.0


def test_other_peoples_maps_are_planned_and_driven_and_nothing_is_touched(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    sample = ("flat.map", "cellar.yaml")  # of either format the one with the tightest ways
    monkeypatch.setattr(other_maps, "MAPS", sample)
    words = ["other-maps", "--runs", "1", "--jobs", "1", "--out", str(tmp_path), "--json"]
    assert main(words) == 0
    cells = json.loads(capsys.readouterr().out)["cells"]
    assert cells == {name: {"runs": 1, "planned": 1, "reached": 1, "touched": 0} for name in sample}
    assert "No failure." in (tmp_path / "other-maps" / "table.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", other_maps.MAPS)
def test_a_seed_draws_the_same_free_places_again_and_the_next_one_others(
    name: str, tmp_path: Path
) -> None:
    world = load_world(other_maps.FOLDER / name)
    assert not world.rooms
    made = other_maps.scenarios((name, [1, 2], tmp_path))
    text = [Path(cell.scenario).read_text(encoding="utf-8") for cell in made]
    other_maps.scenarios((name, [1, 2], tmp_path))
    assert [Path(cell.scenario).read_text(encoding="utf-8") for cell in made] == text
    assert text[0] != text[1]
    circle = load_profile("pioneer-2dx").body.circle_m
    for x, y in other_maps.places(world)[::997]:
        assert world.clearance(x, y) >= circle + other_maps.ROOM_M
    for cell in made:
        assert load_scenario(cell.scenario).plan is None


def test_with_sonars_of_a_single_ray_it_gets_there_without_standing_or_shaking(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armadico.bridge.simulator.sonar.fan", lambda _cone, _rays: [(1.0, 0.0)])
    for name in ("corridor.map", "lab.yaml"):
        (cell,) = other_maps.scenarios((name, [1000], tmp_path))
        run = Drive(cell, 1000).go()
        sample = run.sample()
        assert (sample.reached, sample.collisions, sample.note) == (True, 0, "")
        turns = [tick.w for tick in run.trace.ticks]
        swings = [a * b < 0.0 and min(abs(a), abs(b)) > 0.2 for a, b in pairwise(turns)]
        assert sum(swings) < 0.05 * len(swings), "from one side to the other, cycle by cycle"


def test_a_live_runs_result_is_a_sample_with_the_shares_of_the_thesis() -> None:
    result = Result("sc4", 1, True, 1, 1, 1, 1, {"goto": 75.0, "guest": 25.0}, 1, 0, None)
    measured, shares = columns(result)
    sample = Sample(cell="x", seed=1, arrived=True, **measured, **of_thesis(shares, shares))
    assert (sample.tg_percent, sample.ta_percent) == (75.0, None)


def test_a_folder_says_what_its_runs_depend_on(tmp_path: Path) -> None:
    made = context(tmp_path)
    made.drive([SC1])
    found = json.loads((tmp_path / store.CONDITIONS).read_bytes())
    assert found[SC1.name]["mode"] == "virtual"
    assert "gothrough" not in found[SC1.name]["agents"]
    assert found[SC1.name]["software"]["source"] == made.software.source
