"""How a mission goes on, step by step; and that all of it is in its published state."""

from __future__ import annotations

import sys
from collections.abc import Callable
from math import nan
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armadico.agents.missions import mission_file as missions
from armadico.agents.missions import procedures
from armadico.agents.missions.messages import Course, Frame, Photo, PlanStep, StepEnd, Told
from armadico.agents.missions.mission_file import Mission, read_mission
from armadico.agents.missions.procedures import Outlook, advance, ahead, broken_off, doing, merged
from armadico.agents.missions.task import (
    Beliefs,
    Charge,
    Drive,
    Failed,
    Going,
    Reach,
    Stand,
    Task,
)
from armadico.core.messages import decode, encode
from armadico.mobile.messages import Waypoint

IN_R1 = Beliefs(Waypoint(6.0, 2.0, 0.0), 0.02, "R1", 0.8)


def mission(*rows: str, more: str = "") -> Mission:
    return read_mission("\n".join(["steps = [", *(f"  {{ {r} }}," for r in rows), "]", more]), "m")


class Drill:
    """Drives a mission as mission planning would, each second, and keeps what was asked for."""

    def __init__(self, what: Mission, beliefs: Beliefs = IN_R1) -> None:
        self.mission, self.beliefs = what, beliefs
        self.course = Course()
        self.out = Outlook(self.course)
        self.requests: list[Any] = []
        self.look(0.0)

    def look(self, seconds: float = 1.0, state: Reach = Reach.NONE, note: str = "") -> Outlook:
        self.out = advance(self.mission, self.course, self.beliefs, seconds, state, note)
        self.course = self.out.course
        assert decode(encode(self.course), Course) == self.course
        if self.out.request is not None:
            self.requests.append(self.out.request)
        return self.out

    def done(self) -> Outlook:
        return self.look(1.0, Reach.DONE)

    def failed(self, why: str = "no way") -> Outlook:
        return self.look(1.0, Reach.FAILED, why)

    @property
    def over(self) -> bool:
        return self.out.request is None

    @property
    def results(self) -> list[tuple[str, str]]:
        return [(result.step, result.end.value) for result in self.course.results]


def test_steps_are_done_one_after_another_and_what_comes_of_them_is_kept() -> None:
    drill = Drill(mission('do = "move", to = "R1"', 'do = "take-photo"'))
    assert drill.requests == [Drive("R1")]
    assert drill.look(1.0, Reach.UNDER_WAY).request == Drive("R1")
    assert drill.done().request == Stand()
    drill.look(2.0)
    assert not drill.over
    drill.look(1.5)
    assert drill.over
    assert drill.out.failed is None
    assert drill.out.events == (Photo(0, "R1", 6.0, 2.0, 0.0, 0.02),)
    assert drill.results == [("move(R1)", "done"), ("take-photo", "done")]
    assert [result.at for result in drill.course.results] == [2.0, 5.5]


def test_a_step_whose_goal_may_be_missed_is_unsure_and_so_is_its_mission() -> None:
    drill = Drill(mission('do = "move", to = "R1"', 'do = "move", to = "R2"'))
    drill.look(1.0, Reach.DONE, "+-0.30 m")
    drill.done()
    assert [str(result) for result in drill.course.results] == [
        "move(R1) unsure: +-0.30 m",
        "move(R2) done: in R1",
    ]
    assert (drill.over, drill.out.failed) == (True, None)
    assert drill.course.doubt == "move(R1): +-0.30 m"


def test_what_fails_without_an_alternative_fails_the_mission_and_says_why() -> None:
    drill = Drill(mission('do = "move", to = "R1"', 'do = "take-photo"'))
    assert drill.failed("the door is shut").failed == "move(R1): the door is shut"
    assert drill.over
    assert drill.results == [("move(R1)", "failed")]


def test_alternatives_are_tried_one_after_another_until_one_succeeds() -> None:
    drill = Drill(
        mission(
            'do = "move", to = "A", else = [{ do = "move", to = "B" }, { do = "move", to = "C" }]',
            'do = "move", to = "D"',
        )
    )
    drill.failed()
    drill.failed()
    drill.done()
    assert drill.requests == [Drive("A"), Drive("B"), Drive("C"), Drive("D")]
    drill.failed("it is full")
    assert drill.out.failed == "move(D): it is full"


def test_an_alternative_that_fails_last_fails_the_step() -> None:
    drill = Drill(mission('do = "move", to = "A", else = [{ do = "move", to = "B" }]'))
    drill.failed()
    assert drill.failed("nor this").failed == "move(B): nor this"


PROCEDURES = """
[procedures.photo-of]
takes = ["room"]
when = { battery_above = 0.2 }
steps = [
  { do = "move", to = "$room" },
  { do = "take-photo", room = "$room" },
]
"""


def test_a_procedure_is_told_what_its_steps_are_about() -> None:
    drill = Drill(mission('do = "photo-of", room = "R1"', 'do = "move", to = "B"', more=PROCEDURES))
    assert drill.requests == [Drive("R1")]
    drill.done()
    drill.look(4.0)
    assert drill.requests[-1] == Drive("B")
    assert drill.results == [("move(R1)", "done"), ("take-photo(R1)", "done")]


def test_a_procedure_that_does_not_apply_fails_its_step() -> None:
    what = mission(
        'do = "photo-of", room = "R1", else = [{ do = "move", to = "B" }]', more=PROCEDURES
    )
    low = Drill(what, Beliefs(battery=0.1))
    assert low.requests == [Drive("B")]
    unknown = Drill(what, Beliefs())
    assert unknown.requests == [Drive("B")]
    assert unknown.results == [("photo-of(R1)", "failed")]


def test_a_failure_within_a_procedure_is_its_step_s() -> None:
    drill = Drill(
        mission('do = "photo-of", room = "R1", else = [{ do = "move", to = "B" }]', more=PROCEDURES)
    )
    drill.failed()
    assert drill.requests[-1] == Drive("B")
    assert drill.results == [("move(R1)", "failed"), ("photo-of(R1)", "failed")]


@pytest.mark.parametrize(
    ("when", "wanted"),
    [
        ("battery_above = 0.5", True),
        ("battery_below = 0.5", False),
        ('room = "R1"', True),
        ('not_room = "R1"', False),
        ('alarm = "R2"', False),
        ('no_alarm = "R2"', True),
        ("after_s = 5", False),
        ("before_s = 5", True),
        ('room = "R1", battery_below = 0.5', False),
    ],
)
def test_a_step_whose_precondition_is_not_believed_is_passed_over(when: str, wanted: bool) -> None:
    drill = Drill(mission(f'do = "move", to = "A", when = {{ {when} }}', 'do = "move", to = "B"'))
    assert drill.requests == [Drive("A" if wanted else "B")]
    assert drill.results == ([] if wanted else [("move(A)", "passed over")])


def test_instead_of_a_step_that_is_not_wanted_its_alternative_is_done() -> None:
    row = 'do = "move", to = "A", when = { room = "B" }, else = [{ do = "move", to = "C" }]'
    assert Drill(mission(row)).requests == [Drive("C")]


def test_a_step_is_repeated() -> None:
    drill = Drill(mission('do = "move", to = "A", repeat = 3', 'do = "move", to = "B"'))
    for _ in range(3):
        drill.done()
    assert drill.requests == [Drive("A")] * 3 + [Drive("B")]
    assert drill.course.tasks == 4


def test_a_step_that_takes_too_long_fails_and_so_does_a_procedure_with_all_in_it() -> None:
    row = 'do = "{}", {} timeout_s = 10.0, else = [{{ do = "move", to = "B" }}]'
    for call in (("move", 'to = "A",'), ("photo-of", 'room = "A",')):
        drill = Drill(mission(row.format(*call), more=PROCEDURES))
        for _ in range(10):
            drill.look(1.0, Reach.UNDER_WAY)
        assert drill.requests == [Drive("A")] * 11
        drill.look(1.0, Reach.UNDER_WAY)
        assert drill.requests[-1] == Drive("B")
        assert drill.course.results[-1].said == "not done within 10 s"


def test_a_mission_that_takes_too_long_fails() -> None:
    what = read_mission('timeout_s = 5.0\nsteps = [{ do = "wait", seconds = 9.0 }]', "m")
    drill = Drill(what)
    assert drill.look(6.0).failed == "not done within 5 s"


def test_one_that_repeats_what_ends_at_once_holds_nobody_up() -> None:
    drill = Drill(mission('do = "wait", seconds = 0, repeat = 1000000'))
    assert drill.out.request == Stand()
    assert drill.course.frames[-1].turn < 1000


# Tasks of others ----------------------------------------------------------------------------------


class Broken(Task):
    """Raises."""

    def tick(self, beliefs: Beliefs, progress: Any) -> Any:
        raise ZeroDivisionError("of all things")


class Leaves(Task):
    """Ends the program, as what was once a script does."""

    def tick(self, beliefs: Beliefs, progress: Any) -> Any:
        sys.exit("no camera")


class TwoStages(Task):
    """Goes somewhere, then elsewhere."""

    def tick(self, beliefs: Beliefs, progress: Any) -> Any:
        if progress.state is Reach.DONE:
            return Going(Drive("B"), progress.stage + 1)
        return Going(Drive("AB"[progress.stage]), progress.stage)


@pytest.fixture
def others(monkeypatch: pytest.MonkeyPatch) -> Callable[[type[Task]], Mission]:
    """A mission of one step, done by a task that is not installed."""

    def one(kind: type[Task]) -> Mission:
        for module in (procedures, missions):
            monkeypatch.setattr(module, "task_class", lambda _: kind)
        return mission('do = "take-photo"')

    return one


@pytest.mark.parametrize(
    ("kind", "said"), [(Broken, "ZeroDivisionError: of all thin"), (Leaves, "SystemExit: no cam")]
)
def test_a_task_whose_code_raises_fails_its_step_with_name_file_and_line(
    kind: type[Task], said: str, others: Callable[[type[Task]], Mission]
) -> None:
    failed = Drill(others(kind)).out.failed
    assert failed is not None
    assert failed.startswith(f"take-photo: task 'take-photo' raised {said}")
    assert f"({__file__}, line " in failed


@pytest.mark.parametrize(
    ("verdict", "named"),
    [
        (None, "None"),
        (Failed(None), "why"),  # type: ignore[arg-type]
        (Going(stage=-1), "stage"),
        (Going(Drive(7)), "7"),  # type: ignore[arg-type]
        (Going(Drive((1.0, nan, 0.0))), "Waypoint"),
        (Going(Charge(80.0)), "ChargeRequest"),
    ],
)
def test_a_task_that_gives_no_verdict_fails_its_step(
    verdict: Any, named: str, others: Callable[[type[Task]], Mission]
) -> None:
    class Gives(Task):
        """Returns a verdict that is none."""

        def tick(self, beliefs: Beliefs, progress: Any) -> Any:
            return verdict

    failed = Drill(others(Gives)).out.failed
    assert failed is not None
    assert failed.startswith("take-photo: task 'take-photo': ")
    assert named in failed


def test_a_task_may_want_one_thing_after_another(others: Callable[[type[Task]], Mission]) -> None:
    drill = Drill(others(TwoStages))
    first = drill.course.tasks
    drill.look(1.0, Reach.UNDER_WAY)
    assert drill.requests == [Drive("A")] * 2
    drill.done()
    assert drill.requests[-1] == Drive("B")
    assert drill.course.tasks == first + 1


# Detours ------------------------------------------------------------------------------------------


def to(place: str) -> PlanStep:
    return PlanStep("move", (Told.of("to", place),))


CHECK = PlanStep("check-alarm", (Told.of("room", "R21"),))
MOVE, SHOOT = 'do = "move", to = "{}"', 'do = "take-photo"'
HALL, R11 = MOVE.format("hall"), MOVE.format("R11")
SURVEY = (MOVE.format("R1"), SHOOT, HALL, R11, SHOOT, HALL)


def words(steps: tuple[PlanStep, ...]) -> list[str]:
    return [str(step) for step in steps]


def test_the_plan_of_the_thesis_is_merged_as_it_says() -> None:
    drill = Drill(mission(*SURVEY))
    drill.done()
    assert words(ahead(drill.mission, drill.course))[:2] == ["move(hall)", "move(R11)"]
    drill.course = broken_off(drill.mission, drill.course)  # a photo is not
    drill.course = merged(drill.mission, drill.course, (to("R21"), CHECK, to("hall")))
    assert words(ahead(drill.mission, drill.course)) == [
        *("move(R21)", "check-alarm(R21)", "move(hall)"),
        *("move(R11)", "take-photo", "move(hall)"),
    ]
    assert doing(drill.mission, drill.course) is not None
    drill.look(4.0)
    assert drill.requests[-1] == Drive("R21")
    drill.beliefs = Beliefs(IN_R1.at, 0.0, "R21", alarms=frozenset({"R21"}))
    drill.done()
    assert words(ahead(drill.mission, drill.course))[0] == "move(hall)"
    drill.look(3.0)
    drill.done()
    assert drill.requests[-1] == Drive("R11")
    drill.done()
    drill.look(4.0)
    drill.done()
    assert drill.over
    assert drill.out.failed is None
    assert [said for said in drill.results if said[0].startswith("check")] == [
        ("check-alarm(R21)", "done")
    ]
    assert drill.course.results[3].said == "the alarm in R21 is on"


def test_a_detour_that_fails_is_left_and_the_mission_goes_on() -> None:
    drill = Drill(mission(*SURVEY))
    drill.done()
    drill.course = merged(drill.mission, drill.course, (to("R21"), CHECK))
    drill.look(4.0)
    drill.failed()
    assert drill.requests[-1] == Drive("hall")
    assert not drill.over


def test_a_move_is_broken_off_and_begun_anew_after_the_detour() -> None:
    drill = Drill(mission(*SURVEY))
    drill.course = merged(
        drill.mission, broken_off(drill.mission, drill.course), (to("R21"), CHECK)
    )
    drill.look()
    assert drill.requests[-1] == Drive("R21")
    drill.beliefs = Beliefs(IN_R1.at, 0.0, "R21")
    drill.done()
    drill.look(3.0)
    assert drill.requests[-1] == Drive("R1")


def test_a_detour_in_a_detour_and_within_a_procedure_leads_back() -> None:
    drill = Drill(mission('do = "photo-of", room = "R1"', 'do = "move", to = "B"', more=PROCEDURES))
    for place in ("R21", "R22"):
        drill.course = merged(
            drill.mission, broken_off(drill.mission, drill.course), (to(place), to("X"))
        )
        drill.look()
        assert drill.requests[-1] == Drive(place)
    assert words(ahead(drill.mission, drill.course)) == [
        *("move(X)", "move(R21)", "move(X)", "move(R1)", "take-photo(R1)", "move(B)"),
    ]
    seen = []
    while not drill.over:
        seen.append(drill.requests[-1])
        drill.look(5.0, Reach.DONE)
    assert [s.to for s in seen if isinstance(s, Drive)] == ["R22", "X", "R21", "X", "R1", "B"]


# All of it is in the state ------------------------------------------------------------------------

WORLD = mission(
    'do = "photo-of", room = "R1", repeat = 2, else = [{ do = "wait", seconds = 2 }]',
    'do = "move", to = "A", when = { battery_above = 0.5 },'
    ' else = [{ do = "photo-of", room = "B" }]',
    'do = "wait", seconds = 3, repeat = 2, timeout_s = 2.5, else = [{ do = "check-alarm" }]',
    'do = "move", to = "C", timeout_s = 4.0, else = [{ do = "move", to = "D" }]',
    more=PROCEDURES,
)


class Turn:
    """What happens in one look."""

    def __init__(self, draw: Any) -> None:
        self.seconds = draw(st.sampled_from([0.0, 0.5, 1.0, 3.5]))
        self.state = draw(st.sampled_from(list(Reach)))
        room = draw(st.sampled_from(["", "R1", "B"]))
        at = draw(st.sampled_from([None, Waypoint(1.0, 2.0, 0.5)]))
        self.beliefs = Beliefs(at, 0.1, room, draw(st.sampled_from([None, 0.1, 0.9])))
        self.detour = draw(st.sampled_from([(), (), (), (to("R21"), CHECK, to("A"))]))


@st.composite
def turns(draw: Any) -> list[Turn]:
    return [Turn(draw) for _ in range(draw(st.integers(1, 40)))]


def drive(
    all_of_them: list[Turn], restarted: Callable[[Course], Course]
) -> tuple[Course, list[Any]]:
    course, on_query = Course(), []
    for turn in all_of_them:
        if turn.detour:
            course = merged(WORLD, broken_off(WORLD, restarted(course)), turn.detour)
        ahead(WORLD, restarted(course))
        out = advance(WORLD, restarted(course), turn.beliefs, turn.seconds, turn.state, "so it is")
        course = out.course
        on_query.append((out.request, out.failed, out.events, course.tasks))
        if out.request is None:
            break
    return course, on_query


@pytest.mark.long
@settings(max_examples=100, deadline=None)
@given(turns())
def test_who_goes_on_from_the_published_state_goes_the_same_way(all_of_them: list[Turn]) -> None:
    through = drive(all_of_them, lambda course: course)
    restarted = drive(all_of_them, lambda course: decode(encode(course), Course))
    assert through == restarted
    course, on_query = through
    assert all(len(result.step) > 0 for result in course.results)
    ended = [request is None for request, *_ in on_query]
    assert not any(ended[:-1])
    assert ended[-1] == (not course.frames)
    assert {result.end for result in course.results} <= {*StepEnd}


# Whatever is said to be its state -----------------------------------------------------------------

COUNT = st.integers(0, 5) | st.integers(0, 2**52)
TOLD = st.builds(
    Told.of, st.sampled_from(["to", "room", "x"]), st.sampled_from(["R1", 2.0, True, ()])
)
STEP = st.builds(
    PlanStep,
    st.sampled_from(["move", "wait", "photo-of", "no-such-task", "dock"]),
    st.lists(TOLD, max_size=2).map(tuple),
)
STEPS = st.lists(STEP, max_size=3).map(tuple)
FRAME = st.builds(
    Frame,
    st.sampled_from(["", "photo-of", "no-such-procedure"]),
    STEPS,
    st.lists(TOLD, max_size=2).map(tuple),
    COUNT,
    COUNT,
    COUNT,
    st.floats(0, 1e6),
    st.booleans(),
    COUNT,
)
COURSE = st.builds(
    Course, st.lists(FRAME, max_size=32).map(tuple), st.floats(0, 1e6), COUNT, STEPS, COUNT
)


@pytest.mark.long
@settings(max_examples=200, deadline=None)
@given(COURSE, st.sampled_from(list(Reach)), STEPS)
def test_no_state_that_anybody_can_say_raises(
    course: Course, state: Reach, detour: tuple[PlanStep, ...]
) -> None:
    for _ in range(4):
        course = decode(encode(course), Course)
        if not course.frames:
            break
        ahead(WORLD, course)
        doing(WORLD, course)
        course = merged(WORLD, broken_off(WORLD, course), detour)
        course = advance(WORLD, course, IN_R1, 1.0, state, "so it is").course
