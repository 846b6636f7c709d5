"""Experiments: the same seeds give the same bytes, and nothing that was finished is lost."""

from __future__ import annotations

import dataclasses
import json
import os
from contextlib import closing
from itertools import pairwise
from math import hypot
from pathlib import Path

import pytest
from msgspec import Struct
from msgspec.structs import replace

from armadico.cli.options import FailedError, UsageError
from armadico.config.loading import read_text
from armadico.config.scenarios import load_scenario
from armadico.config.shipped import find
from armadico.core.config_errors import ConfigError
from armadico.observe.conditions import software
from armadico_tools.commands.experiment import main
from armadico_tools.experiments import CELLS as CELLS_FILES
from armadico_tools.experiments import cells, gate, runner, tables, titles
from armadico_tools.experiments.driving import (
    Cell,
    Drive,
    Kill,
    Sample,
    drive,
    scenario_of,
)
from armadico_tools.experiments.floor_plans import (
    PASSAGE_M,
    floor_plan,
    passable,
    save,
)
from armadico_tools.experiments.lifted import LIFTED, Lift
from armadico_tools.experiments.made_worlds import DISC_M, MADE, made
from armadico_tools.experiments.runner import Context, Experiment, Part, driven
from armadico_tools.experiments.tables import compare
from tests.programs import call, heavy, imports_nothing

SC1 = Cell("sc1 collaborative", "sc1", without=("gothrough",))
FAST = Cell("sc1 fast", "sc1", controller="fast", without=("gothrough",))


def context(folder: Path, runs: int = 1, jobs: int = 1) -> Context:
    folder.mkdir(parents=True, exist_ok=True)
    return Context(out=folder, runs=runs, workers=jobs, source="here")


def about(runs: int = 2, first_seed: int = 1000, source: str = "s") -> runner.About:
    return runner.About(
        experiment="x", first_seed=first_seed, runs=runs, source=source, software=software()
    )


def declared(*cells: Cell) -> Experiment:
    """An experiment of nothing but these cells."""
    return Experiment(parts=(driven(lambda _: cells),), report=lambda _: "what came of it")


# Runs ---------------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_same_seeds_give_the_same_bytes_however_many_processes(tmp_path: Path) -> None:
    context(tmp_path / "one", runs=2).run(declared(SC1, FAST), "x")
    context(tmp_path / "two", runs=2, jobs=2).run(declared(SC1, FAST), "x")
    one, two = ((tmp_path / name / "runs.csv").read_bytes() for name in ("one", "two"))
    assert one == two
    assert one.count(b"\n") == 5


@pytest.mark.long
def test_interrupted_runs_are_kept_and_not_driven_again(tmp_path: Path) -> None:
    SEEN.clear()
    with pytest.raises(KeyboardInterrupt):
        context(tmp_path / "cut", runs=3).map(interrupted, [(SC1, 1000), (SC1, 1001)], "runs")
    found = tmp_path / "cut" / "found.csv"
    kept = found.read_text(encoding="utf-8")
    assert kept.count("\n") == 2
    with found.open("a", encoding="utf-8") as file:
        file.write(kept.splitlines()[1][:40])  # as a kill in the middle of a line leaves it
    experiment = Experiment(parts=(driven(lambda _: [SC1], interrupted),), report=lambda _: "")
    context(tmp_path / "cut", runs=3).run(experiment, "x")
    assert SEEN == [1000, 1001, 1001, 1002]
    context(tmp_path / "whole", runs=3).run(declared(SC1), "x")
    cut, whole = ((tmp_path / name / "runs.csv").read_bytes() for name in ("cut", "whole"))
    assert cut == whole


SEEN: list[int] = []


def interrupted(task: tuple[Cell, int]) -> Sample:
    """A run; the second one ends by Ctrl-C."""
    SEEN.append(task[1])
    if len(SEEN) == 2:
        raise KeyboardInterrupt
    return drive(task)


class Square(Struct, frozen=True):
    of: int
    square: float


def square(of: int) -> Square:
    """What takes long, and ends in the middle of the third."""
    SQUARED.append(of)
    if len(SQUARED) == 3:
        raise KeyboardInterrupt
    return Square(of, float("nan") if of == 1 else float(of**2))


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


def test_a_part_knows_what_the_parts_before_it_have_found(tmp_path: Path) -> None:
    SQUARED[:] = [0] * 3  # so that it ends nowhere
    experiment = Experiment(
        parts=(
            Part("squares", square, lambda context: context.seeds),
            Part("more", square, lambda context: [one.of + 1 for one in context.found["squares"]]),
        ),
        report=lambda context: f"{sum(one.square for one in context.found['more'])}",
    )
    made = context(tmp_path, runs=2)
    made.run(experiment, "Squares")
    assert (tmp_path / "more.csv").read_text() == "of,square\n1001,1002001.0\n1002,1004004.0\n"
    assert (tmp_path / "table.md").read_text().startswith("# Squares\n\n\n\n2006005.0\n\nCommit ")
    assert {path.name for path in made.files} == {"squares.csv", "more.csv", "table.md"}


def test_a_folder_of_other_runs_is_moved_aside_and_more_runs_go_on(tmp_path: Path) -> None:
    folder = tmp_path / "x"

    def claimed(by: runner.About) -> Path | None:
        moved, lock = runner.claim(folder, by)
        lock.close()
        return moved

    assert claimed(about()) is None
    (folder / "runs.csv").write_text("precious", encoding="utf-8")
    assert claimed(about(runs=5)) is None
    for number, other in enumerate((about(2), about(5, 0), about(5, 0, "t")), start=1):
        assert claimed(other) == tmp_path / f"x.kept-{number}"
    assert (tmp_path / "x.kept-1" / "runs.csv").read_text(encoding="utf-8") == "precious"
    assert [path.name for path in folder.iterdir()] == ["about.json"]


def test_a_folder_that_no_experiment_made_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "gate").mkdir()
    (tmp_path / "gate" / "letter.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(FailedError, match=r"gate.*--out"):
        main(["gate", "--runs", "1", "--out", str(tmp_path)])
    assert [path.name for path in (tmp_path / "gate").iterdir()] == ["letter.txt"]


def test_a_folder_in_which_another_process_runs_is_named_and_left_alone(tmp_path: Path) -> None:
    with closing(context(tmp_path)) as first, closing(context(tmp_path, runs=2)) as second:
        first.claim("table-5.1")
        with pytest.raises(runner.NotOursError, match=f"another process .* in {tmp_path}"):
            second.claim("table-5.1")
    second.claim("table-5.1")
    second.close()


# Results of a run ---------------------------------------------------------------------------------


def test_the_fast_controller_stops_where_it_comes_to_rest() -> None:
    sample = drive((FAST, 1000))
    assert sample.arrived
    assert not sample.note
    assert 13.0 < sample.tt_s < 15.5  # s of simulation; it is calibrated to 14.3
    assert sample.fo_deg > 5.0  # it does not turn to the goal's heading
    assert not sample.reached


@pytest.mark.long
def test_a_robot_that_gets_nowhere_is_stuck_before_the_time_limit() -> None:
    run = Drive(Cell("x", "sc1", without=("goto", "avoid", "gothrough")), 1000)
    sample = run.go().sample()
    assert sample.note == "stuck"
    assert not sample.arrived
    assert 60.0 < sample.tt_s < run.rehearsal.limit


@pytest.mark.parametrize("name", MADE)
def test_a_made_world_is_the_same_again_and_can_be_driven(name: str) -> None:
    found = made(name, 3)
    assert found == made(name, 3) != made(name, 4)
    assert all(passable(found.solid, *leg, DISC_M) for leg in found.legs)
    scenario = scenario_of(Cell("x", world=name), 3)
    assert len(scenario.moving) == len(found.unknown) + len(found.people)


def test_a_killed_driver_is_replaced_at_once_by_ballots_and_late_by_an_arbiter() -> None:
    killed = Cell("x", world="clutter", kill=Kill(after_s=(8.0, 9.0)))
    ballots, auction = (
        drive((replace(killed, coordination=name), 1)) for name in (None, "auction")
    )
    assert ballots.undriven_s is not None
    assert auction.undriven_s is not None
    assert ballots.undriven_s < 1.0 < 2.0 < auction.undriven_s  # it is started again after 2 s


@pytest.mark.long
def test_any_process_may_be_the_killed_one_and_the_time_without_a_command_is_known() -> None:
    killed = Cell("x", world="clutter", kill=Kill(who="any", after_s=(8.0, 9.0)))
    found = [drive((killed, seed)) for seed in (3, 4)]
    assert [one.killed for one in found] == ["robot", "sonar"]
    for one in found:  # 2 s until a new process joins, in which nothing can be obeyed or decided
        assert one.unobeyed_s is not None
        assert one.unobeyed_s > 2.0


def test_a_run_that_is_over_before_the_kill_says_so() -> None:
    late = Cell("x", "sc1", kill=Kill(after_s=(500.0, 600.0)))
    sample = drive((late, 1))
    assert sample.reached
    assert sample.note == "nothing was killed"
    assert sample.undriven_s is None


def test_proposals_grow_with_the_bidders_and_ballots_do_not() -> None:
    more = {}
    for name in (None, "auction"):
        few, many = (
            drive((Cell("x", world="hall", bidders=n, coordination=name), 1)).messages_per_cycle
            for n in (3, 12)
        )
        assert few is not None
        assert many is not None
        more[name] = many - few
    assert more[None] < 1.0
    assert more["auction"] == pytest.approx(9.0, abs=0.2)


# Floor plans --------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_floor_plan_is_the_same_again_can_be_passed_and_loads(seed: int, tmp_path: Path) -> None:
    plan = floor_plan(seed)
    assert plan == floor_plan(seed)
    assert passable(plan.world.walls, plan.start, plan.goal, PASSAGE_M)
    scenario = load_scenario(save(plan, tmp_path))
    assert hypot(scenario.start[0] - plan.start[0], scenario.start[1] - plan.start[1]) < 1e-9
    assert scenario.plan == "rooms"


def test_the_price_of_the_gate_is_that_of_pairs_that_arrived(tmp_path: Path) -> None:
    here, experiment = context(tmp_path, runs=3), gate.GATE
    here.found["plans"] = [tmp_path / f"plan-{seed}.toml" for seed in here.seeds]
    tasks = experiment.parts[1].tasks(here)
    for with_, without in zip(tasks[::2], tasks[1::2], strict=True):
        switched = replace(without[0], name=with_[0].name, parameters=None)
        assert (switched, without[1]) == with_
        assert "reflex = false" in Path(str(without[0].parameters)).read_text(encoding="utf-8")
    last = here.seeds[-1]  # the only one that does not arrive with the gate, and touches without

    def sample(cell: Cell, seed: int) -> Sample:
        gated, arrived = cell.parameters is None, cell.parameters is not None or seed != last
        tt = (10.3 if gated else 10.0) if arrived else 99.0
        touched = int(not gated and seed == last)
        return Sample(cell.name, seed, arrived, arrived, 1.0, 0.0, tt, 0.0, 0, collisions=touched)

    here.found["runs"] = [sample(*task) for task in tasks]
    rows = experiment.report(here).splitlines()[2:]
    assert len(rows) == 6
    assert all(row.endswith("| 3 | 2 | 3 | 0 | 1 | 2 | 3.0 [3.0, 3.0] |") for row in rows)


# Numbers ------------------------------------------------------------------------------------------


@pytest.mark.long
def test_means_and_intervals_against_known_ones() -> None:
    found = tables.spread([1.0, 2.0, 3.0, 4.0, 5.0])
    assert found is not None
    assert (found.mean, found.sd) == (3.0, pytest.approx(1.5811, abs=1e-4))
    assert (found.low, found.high) == (
        pytest.approx(1.0368, abs=1e-4),
        pytest.approx(4.9632, abs=1e-4),
    )


def test_a_run_that_did_not_arrive_has_no_time_in_a_table_but_counts_as_not_reached() -> None:
    there = Sample("x", 1, True, True, 5.0, 1.0, 14.0, 99.0, 0)
    stuck = replace(there, seed=2, reached=False, arrived=False, tt_s=60.0, td_m=7.0)
    text = compare({"fast": [there, stuck]})
    assert "| reached | 1 of 2 |" in text
    assert "| TT s | 14.00 |" in text
    assert "| TD m | 6.00 ± " in text
    assert runner.outcome([stuck])["tt_s"] is None
    assert runner.outcome([there, stuck])["tt_s"] == 14.0


# The command --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["table-5.9"], "'table-5"),
        (["table-5.1", "--runs", "0"], r"--runs .*\b0\b"),
        (["table-5.1", "--runs", "-3"], "--runs .*-3"),
        (["table-5.1", "--jobs", "0"], r"--jobs .*\b0\b"),
        ([], "--list"),
    ],
)
def test_wrong_calls_are_corrected(words: list[str], expected: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=expected):
        main([*words, "--out", str(tmp_path / "results")])
    assert not (tmp_path / "results").exists()


def test_the_list_has_titles_and_imports_nothing_heavy() -> None:
    among = {"numpy", "scipy", "matplotlib", "msgspec", "pymunk", "rich"}
    done = heavy("armadico_tools.commands.experiment", ["--list", "--json"], among)
    assert imports_nothing(done)
    listed = done.stdout.splitlines()[0]
    found = json.loads(listed)
    assert list(found) == list(titles())
    assert all(found.values())


OWN = """
from armadico_tools.experiments.runner import Experiment, Part

def doubled(of: int) -> int:
    return 2 * of

parts = (Part("numbers", doubled, lambda context: context.seeds, None),)
OWN = Experiment(parts, lambda context: f"sum {sum(context.found['numbers'])}", title="Doubles")
"""


def test_another_packages_experiment_is_found_by_its_entry_point(tmp_path: Path) -> None:
    (tmp_path / "own_doubles.py").write_text(OWN)
    info = tmp_path / "own_doubles-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own-doubles\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[armadico.experiments]\ndoubles = own_doubles:OWN\n")
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    assert "Of the package own-doubles" in call("experiment", "--list", env=env).stdout
    words = ("experiment", "doubles", "--runs", "2", "--jobs", "1", "--out", str(tmp_path))
    assert call(*words, env=env).returncode == 0
    table = (tmp_path / "doubles" / "table.md").read_text(encoding="utf-8")
    assert table.startswith("# Doubles\n")
    assert "sum 4002" in table


CELLS = """\
title = "Two controllers"
[[rows]]
scenario = "sc1"
[[arms]]
name = "fast"
controller = "fast"
[[arms]]
name = "all"
"""


@pytest.mark.long
def test_a_file_of_cells_is_an_experiment_and_runs_again_give_the_same_bytes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "two.toml"
    file.write_text(CELLS, encoding="utf-8")
    words = [str(file), "--runs", "1", "--jobs", "1", "--out", str(tmp_path), "--json"]
    assert main(words) == 3
    printed = json.loads(capsys.readouterr().out)
    assert printed["title"] == "Two controllers"
    (few,) = printed["lacking"]
    assert "--runs 6" in few
    assert printed["cells"]["sc1 all"]["reached"] == 1
    folder = tmp_path / "two"
    assert {path.name for path in folder.iterdir()} == {
        *printed["files"],
        "about.json",
        "found.csv",
    }
    assert "| arrived | 1 of 1 | 1 of 1 |" in (folder / "table.md").read_text(encoding="utf-8")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert main(words) == 3
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('title = "Two controllers"\n', "", "title"),
        ("[[rows]]", "[[columns]]", "columns"),
        ('scenario = "sc1"', 'name = "sc1"', "scenario"),
        ('scenario = "sc1"', 'scenario = "sc1"\nrobots = 2', "robots = 2.*tasks"),
        ('controller = "fast"', 'told = "yes"', "sc1 fast.*coordination"),
        ('controller = "fast"', 'with = ["lier"]', "sc1 fast.*lier.*liar"),
        ('controller = "fast"', 'kill = { who = "gotto" }', "sc1 fast.*'gotto'.*goto"),
        ('scenario = "sc1"', 'scenario = "fleet"\nrobots = 2\nkill = {}', "kill is for one robot"),
        ('controller = "fast"', "kill = { after_s = [20, 8] }", "kill.after_s.*least first"),
        ('controller = "fast"', 'told = "y"\ncoordination = "auction"', "sc1 fast.*told.*yes"),
        ('name = "all"', 'name = ""', "arms: one has no name"),
        ('title = "Two', 'measures = ["time"]\ntitle = "Two', "measure.*'time'.*tt_s"),
    ],
)
def test_a_wrong_file_of_cells_is_refused(
    old: str, new: str, expected: str, tmp_path: Path
) -> None:
    file = tmp_path / "two.toml"
    file.write_text(CELLS.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigError, match=rf"two\.toml.*{expected}"):
        main([str(file), "--out", str(tmp_path / "results")])
    assert not (tmp_path / "results").exists()


def made_up(cell: str, seed: int, tt_s: float, *, clean: bool = True) -> Sample:
    touched = 0 if clean else 1
    return Sample(cell, seed, clean, clean, 5.0, 1.0, tt_s, 99.0, 0, collisions=touched)


def test_arms_are_compared_seed_by_seed_and_corrected_together() -> None:
    one = [made_up("one", seed, 30.0 + seed) for seed in range(20)]
    two = [made_up("two", seed, 33.0 + seed, clean=seed > 9) for seed in range(20)]
    found = cells.compared({"row": {"one": one, "two": two}}, ("clean", "tt_s"), "one")
    clean, time = found
    assert (clean.measure, clean.pairs, clean.difference) == ("clean", 20, -0.5)
    assert clean.p == pytest.approx(2 / 2**10)
    assert (time.pairs, time.difference) == (10, 3.0)  # only where both arrived
    assert [one.p_corrected for one in found] == pytest.approx([2 * clean.p] * 2)


def test_a_comparison_without_a_pair_has_a_line_and_counts_in_no_correction() -> None:
    one, two = ([made_up(name, seed, 30.0, clean=False) for seed in range(8)] for name in "ab")
    clean, time = cells.compared({"row": {"a": one, "b": two}}, ("clean", "tt_s"), "a")
    assert (time.measure, time.pairs, time.difference, time.p_corrected) == ("tt_s", 0, None, None)
    assert clean.p == clean.p_corrected


def test_rows_are_pooled_by_the_mean_of_each_seed_over_those_that_have_both() -> None:
    def arms(more: float, *, clean: bool = True) -> dict[str, list[Sample]]:
        late = [made_up("b", seed, 30.0 + more * seed, clean=clean) for seed in range(8)]
        return {"a": [made_up("a", seed, 30.0) for seed in range(8)], "b": late}

    rows = {"one": arms(1.0), "two": arms(3.0), "three": arms(9.0, clean=False)}
    found = cells.compared(rows, ("tt_s",), "a", pooled=True)[-1]
    assert (found.row, found.pairs) == (cells.ALL, 8)
    assert found.mean == pytest.approx(30.0 + 2.0 * 3.5)
    assert found.mean_against == 30.0


def mechanisms(**contended: int | None) -> tuple[cells.Tables, dict[str, dict[str, list[Sample]]]]:
    """A row of ballots, and of coordinations that drive the same, each contended in some cycles."""
    of = {"ballots": Cell("ballots"), **{n: Cell(n, coordination=n) for n in contended}}
    made = {name: [made_up(name, seed, 30.0 + seed) for seed in range(8)] for name in of}
    for name, cycles in contended.items():
        made[name] = [replace(one, contended=cycles) for one in made[name]]
    return {"row": of}, {"row": made}


def test_a_mechanism_that_had_nothing_to_decide_is_no_tie_with_ballots() -> None:
    tables, made = mechanisms(executive=0, queue=2, auction=50, central=None)
    made["row"]["auction"][3] = replace(made["row"]["auction"][3], tt_s=34.0)
    silent = cells.undecided(tables, made, "ballots")
    assert {arm for _, arm in silent} == {"executive", "queue", "central"}
    assert "is not known" in silent["row", "central"], "that nobody counted is no contention"
    made["row"]["executive"][0] = replace(made["row"]["executive"][0], contended=None)
    partly = cells.undecided(tables, made, "ballots")
    assert "is not known" in partly["row", "executive"], "the other runs do not speak for this one"
    assert silent["row", "executive"].startswith("not contended")
    assert "to the last digit" in silent["row", "queue"]
    found = cells.compared(made, ("tt_s",), "ballots", pooled=True, silent=silent)
    pairs = {(one.row, one.arm): (one.pairs, one.p) for one in found}
    for row in ("row", cells.ALL):
        for arm in ("executive", "queue", "central"):
            assert pairs[row, arm] == (0, None)
        assert pairs[row, "auction"][0] == 8
    silent = cells.undecided(tables, made, "executive")
    found = cells.compared(made, ("tt_s",), "executive", pooled=True, silent=silent)
    assert {one.pairs for one in found} == {0}, "nor is anything compared with it"


def test_cycles_in_which_several_agents_bid_are_counted() -> None:
    alone = Cell("x", "sc1", coordination="auction", without=("avoid", "gothrough"))
    assert drive((alone, 1000)).contended == 0
    assert drive((Cell("x", world="slalom", coordination="auction"), 1000)).contended
    assert drive((SC1, 1000)).contended is None


def test_what_robots_of_a_fleet_compete_for_is_counted_too(tmp_path: Path) -> None:
    file = tmp_path / "pair.toml"
    fleet = read_text(find("scenarios", "fleet")).partition("tasks = [")[0]
    file.write_text(f"{fleet}tasks = [[3.0, 1.5, 0.0]]\n", encoding="utf-8")
    pair = Cell("x", str(file), robots=2, coordination="central")
    assert drive((pair, 1)).contended
    assert drive((replace(pair, coordination=None), 1)).contended is None


@pytest.mark.long
def test_a_mission_is_a_row_too_and_its_mechanism_says_nothing_where_nobody_contends(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "two.toml"
    text = CELLS.replace('"sc1"', '"surveillance"').replace("controller =", "coordination =")
    file.write_text(
        text.replace('coordination = "fast"', 'coordination = "executive"'), encoding="utf-8"
    )
    words = [str(file), "--runs", "1", "--jobs", "1", "--out", str(tmp_path), "--json"]
    assert main(words) == 3
    printed = json.loads(capsys.readouterr().out)
    assert printed["cells"]["surveillance all"]["reached"] == 1
    assert printed["lacking"][0].startswith("surveillance, fast: not contended")


def test_a_measure_that_no_run_has_is_named_and_the_exit_code_tells_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "two.toml"
    file.write_text('measures = ["tt_s", "undriven_s"]\nruns = 1\n' + CELLS, encoding="utf-8")
    out = tmp_path / "results"
    assert main([str(file), "--jobs", "1", "--json", "--out", str(out)]) == 3
    assert "no run has the measure undriven_s" in json.loads(capsys.readouterr().out)["lacking"]
    assert "no run has the measure undriven_s" in (out / "two" / "table.md").read_text("utf-8")


@pytest.mark.parametrize("name", CELLS_FILES)
def test_the_scenarios_of_each_shipped_file_exist(name: str) -> None:
    _, found = cells.read(CELLS_FILES[name])
    for cell, _seed in found.parts[0].tasks(Context(out=Path(), runs=1, source="here")):
        assert scenario_of(cell).sensors == cell.sensors


@pytest.mark.long
def test_with_sonars_of_a_single_ray_it_gets_there_without_standing_or_shaking(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("armadico.bridge.simulator.sonar.fan", lambda _cone, _rays: [(1.0, 0.0)])
    for name in ("sc4", "rooms-a"):
        run = Drive(Cell("x", name), 1000).go()
        sample = run.sample()
        assert (sample.reached, sample.collisions, sample.note) == (True, 0, "")
        turns = [truth.w for truth, _ in run.ticks]
        swings = [a * b < 0.0 and min(abs(a), abs(b)) > 0.2 for a, b in pairwise(turns)]
        assert sum(swings) < 0.05 * len(swings), "from one side to the other, cycle by cycle"


def test_a_folder_has_the_conditions_of_its_runs(tmp_path: Path) -> None:
    made = context(tmp_path)
    made.run(declared(SC1), "x")
    found = json.loads((tmp_path / runner.CONDITIONS).read_bytes())
    assert found[SC1.name]["mode"] == "virtual"
    assert "gothrough" not in found[SC1.name]["agents"]
    assert found[SC1.name]["software"]["source"] == made.software.source


def _found_at_once(task: tuple[Cell, int]) -> Lift:
    cell, seed = task
    return Lift(cell.name, seed, 9.0, 1.0, 0.0, 0.0, 0, 0, 0.01)


def test_an_experiment_whose_rows_are_no_runs_ends_with_its_table(tmp_path: Path) -> None:
    run = context(tmp_path)
    part = dataclasses.replace(LIFTED.parts[0], measure=_found_at_once)
    run.run(dataclasses.replace(LIFTED, parts=(part,)), "Lifted")
    assert "9.0" in (tmp_path / "table.md").read_text(encoding="utf-8")
