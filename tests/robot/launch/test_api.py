"""`armadico.run`: what the command does, for a notebook; nothing is printed, nothing is left."""

from __future__ import annotations

import pickle
import re
import sys
import tempfile
from itertools import pairwise
from math import hypot, pi
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from msgspec.structs import replace

import armadico
from armadico.config.scenarios import Scenario, ideal, load_scenario
from armadico.launch.api import Holding, Run
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.observe.measures import Mark, RunWatch
from tests.runtime_folder import fresh_folder

SHORT = Scenario(
    name="short",
    world="empty",
    sensors="ideal",
    start=(0.0, 0.0, 0.0),
    goal=(1.0, 0.0, 0.0),
    agents=("encoder", "sonar", "goto", "interface"),
)


@pytest.fixture(scope="module")
def sc4() -> Run:
    return armadico.run("sc4", virtual=True, seed=7, sensors="ideal")


@pytest.mark.long
def test_a_virtual_run_is_the_commands(sc4: Run) -> None:
    assert sc4.measures == Rehearsal(ideal(load_scenario("sc4")), Options(seed=7)).run()
    assert sc4 == armadico.run("sc4", virtual=True, seed=7, sensors="ideal")


def test_the_path_has_a_pose_for_each_time_from_the_start_to_the_goal(sc4: Run) -> None:
    assert sc4.path.shape == (len(sc4.times), 3)
    assert sc4.path[0] == pytest.approx(sc4.scenario.start, abs=0.02)
    assert hypot(*(sc4.path[-1, :2] - sc4.scenario.goal[:2])) < 0.15
    assert sc4.times[0] == 0.0
    assert np.all(np.diff(sc4.times) > 0)
    assert sc4.times[-1] == pytest.approx(sc4.measures.tt_s, abs=1e-3)
    steps = np.hypot(*np.diff(sc4.path[:, :2], axis=0).T)
    assert steps.sum() == pytest.approx(sc4.measures.td_m, abs=1e-3)


def test_holders_are_who_drove_one_after_another(sc4: Run) -> None:
    agents = [held.agent for held in sc4.holders]
    assert set(agents) <= set(sc4.scenario.agents)
    assert sum(a != b for a, b in pairwise(agents)) == sc4.measures.exchanges
    assert all(held.start < held.end for held in sc4.holders)
    assert all(a.end <= b.start for a, b in pairwise(sc4.holders))
    driven = sum(held.end - held.start for held in sc4.holders if held.agent == "goto")
    assert 100 * driven / sc4.measures.tt_s == pytest.approx(sc4.measures.shares["goto"], abs=5.0)


def test_a_gap_ends_a_holding() -> None:
    watch = RunWatch("made up", (1.0, 0.0, 0.0))
    who = ("a", "a", None, None, "a", "b")
    watch.driven.marks += [Mark(5.0 + t, 0.0, 0.0, 0.0, name) for t, name in enumerate(who)]
    assert Run.of(SHORT, watch).holders == (
        Holding("a", 0.0, 2.0),
        Holding("a", 4.0, 5.0),
        Holding("b", 5.0, 5.0),
    )


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"goal": (1, 2)}, "goal (1, 2): expected finite x and y in m and a heading in rad"),
        ({"start": (0, 0, float("nan"))}, "start (0, 0, nan): expected finite"),
        ({"goal": (1, 1, 90)}, "goal (1, 1, 90)"),
        ({"scenario": replace(SHORT, goal=(1, 0, -90))}, "math.radians(-90)"),
        ({"scenario": replace(SHORT, waypoints=((1, 0),))}, "waypoint 1 (1, 0): expected finite"),
        ({"besides": "batery-sensor"}, "no agent 'batery-sensor'"),
    ],
)
def test_poses_and_names_that_will_not_do_are_told_in_words(
    wrong: dict[str, Any], says: str
) -> None:
    with pytest.raises((armadico.ConfigError, armadico.UnknownNameError)) as refused:
        armadico.run(**{"scenario": SHORT, "virtual": True} | wrong)
    assert says in str(refused.value)


def test_poses_are_in_metres_and_radians() -> None:
    done = armadico.run("sc1", virtual=True, start=(0.0, 0.0, pi / 2), goal=(1.0, 0.5, -pi / 2))
    assert done.scenario.start == (0.0, 0.0, pi / 2)
    assert done.scenario.goal == (1.0, 0.5, -pi / 2)
    assert done.path[-1, 2] == pytest.approx(-pi / 2, abs=0.1)


def test_another_robot_and_without_somebody() -> None:
    done = armadico.run("sc1", virtual=True, profile="amigobot", without=["gothrough"])
    assert done.scenario.robot == "amigobot"
    assert "gothrough" not in done.measures.shares


def test_what_cannot_draw_leaves_no_empty_folder(sc4: Run, tmp_path: Path) -> None:
    pytest.importorskip("armadico.watch")
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(sys.modules, "matplotlib", None)
        with pytest.raises(ImportError):
            sc4.plot(tmp_path / "new" / "picture.png")
    assert not (tmp_path / "new").exists(), "no empty folder where nothing draws"
    picture = sc4.plot(tmp_path / "new" / "picture.png")
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_a_run_is_drawn_without_a_word_to_pyplot(sc4: Run, tmp_path: Path) -> None:
    pytest.importorskip("armadico.watch")
    plt = pytest.importorskip("matplotlib.pyplot")
    mpl = pytest.importorskip("matplotlib")
    before = mpl.get_backend()
    mpl.use("svg")  # as a notebook has one of its own
    try:
        sc4.plot(tmp_path / "run.png")
        assert mpl.get_backend() == "svg"
        assert not plt.get_fignums()
    finally:
        mpl.use(before)


class Ahead(armadico.Behaviour):
    """Straight on, for no goal."""

    name = "ahead"
    needs_goal = False

    def propose(self, pose: armadico.Pose, obstacles: armadico.Obstacles) -> armadico.Bid:
        return armadico.Bid(0.5, self.limited(0.2, 0.0, obstacles))


def test_a_class_of_ones_own_drives_without_a_goal_and_until_the_limit() -> None:
    nowhere = Scenario(world="empty", start=(0, 0, 0))
    done = armadico.run(nowhere, virtual=True, limit=10.0, joins=[Ahead])
    assert done.measures.shares == {"ahead": 100.0}
    assert done.measures.td_m > 1.0
    assert (done.measures.reached, done.measures.limit_s) == (None, 10.0)
    assert armadico.run(nowhere, virtual=True, limit=5.0).measures.td_m == 0.0
    assert armadico.run(SHORT, virtual=True, joins=[Ahead]).measures.reached


@pytest.mark.parametrize("wrong", [{"limit": 0.0}, {"limit": float("nan")}, {"joins": [Ahead]}])
def test_what_makes_no_sense_is_refused_before_anybody_starts(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        armadico.run(SHORT, **wrong)


@pytest.mark.parametrize(
    "wrong",
    [{"goal": (1, 2, "x")}, {"start": 5}, {"limit": "a"}, {"joins": ["x"]}, {"seed": "x"}],
    ids=repr,
)
def test_an_argument_of_a_wrong_type_is_named_with_its_value(wrong: dict[str, Any]) -> None:
    ((name, value),) = wrong.items()
    with pytest.raises(TypeError, match=re.escape(f"{name}={value!r}: expected")):
        armadico.run(SHORT, virtual=True, **wrong)


def test_progress_is_told_while_it_runs() -> None:
    seen: list[float] = []
    armadico.run(SHORT, virtual=True, progress=lambda watch: seen.append(watch.elapsed))
    assert len(seen) > 2
    assert seen == sorted(seen)


@pytest.mark.parametrize(
    ("wrong", "error", "says"),
    [
        ({"scenario": "sc11"}, armadico.ConfigError, "'sc1'"),
        ({"profile": "amigobo"}, armadico.ConfigError, "'amigobot'"),
        ({"without": ["gotho"]}, armadico.UnknownNameError, "'goto'"),
        (
            {"without": ["encoder"]},
            armadico.MissionRefusedError,
            "^the mission was refused: .*encoder/pose",
        ),
        ({"namespace": "robot2"}, ValueError, "namespace"),
    ],
)
def test_what_cannot_be_driven_is_an_error_of_its_kind(
    wrong: dict[str, object], error: type[Exception], says: str
) -> None:
    with pytest.raises(error, match=says):
        armadico.run(**{"scenario": "sc1", "virtual": True} | wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "error",
    [
        armadico.AbsentError("no robot answers", "robot1"),
        armadico.MissionRefusedError("no way"),
    ],
)
def test_an_error_comes_from_a_worker_as_it_was(error: armadico.SocietyError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)


# As processes -------------------------------------------------------------------------------------


@pytest.fixture
def apart(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A mesh of the test's own, inherited by every process."""
    monkeypatch.setenv(RUNTIME_VARIABLE, fresh_folder())
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


def children() -> set[int]:
    return {child.pid for child in psutil.Process().children(recursive=True)}


@pytest.mark.long
@pytest.mark.live
@pytest.mark.usefixtures("apart")
def test_a_run_as_processes_says_the_same_and_leaves_nothing(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    before = children()
    there: set[int] = set()
    done = armadico.run(
        SHORT, namespace="api-run-test", progress=lambda _: there.update(children() - before)
    )
    assert done.measures.passed, done
    assert {held.agent for held in done.holders} == {"goto"}
    assert done.path.shape == (len(done.times), 3)
    assert len(there) == 7, "simulator, robot agent, its guard and four agents"
    assert children() == before
    assert list(tmp_path.iterdir()) == [], "nor a folder of logs"
    assert capfd.readouterr() == ("", "")


@pytest.mark.live
@pytest.mark.usefixtures("apart")
def test_a_run_that_fails_is_an_error_with_last_words_and_leaves_no_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("armadico.launch.local.ANSWER_S", 2.0)
    before = children()
    with pytest.raises(armadico.RunFailedError, match="did not answer") as caught:
        armadico.run(SHORT, namespace="api-run-test", robot="tcp://127.0.0.1:1")
    assert "is the simulator running" in str(caught.value)
    assert children() == before


@pytest.mark.live
@pytest.mark.usefixtures("apart")
def test_whoever_is_interrupted_leaves_no_process() -> None:
    before = children()

    def interrupt(_: RunWatch) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        armadico.run(SHORT, namespace="api-run-test", progress=interrupt)
    assert children() == before
