"""Advances a mission's procedures step by step (thesis 3.6.1; PRS). Sans-IO, and pure.

The progress of a mission is a `Course`, a message: any process with it and the mission's text can
go on. A stack of frames, one for each active procedure, has its current step, alternative and
repetition, and the time spent. A detour is a frame whose steps are a planner agent's; if it fails,
the mission goes on without it.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from msgspec.structs import replace

from armadico.agents.missions.messages import Course, Frame, PlanStep, StepEnd, StepResult, Told
from armadico.agents.missions.mission_file import (
    Mission,
    Procedure,
    Step,
    Value,
    When,
    arguments_of,
    bound,
    bound_when,
    task_class,
)
from armadico.agents.missions.task import (
    Beliefs,
    Failed,
    Going,
    Progress,
    Reach,
    Request,
    Stand,
    misfit,
)
from armadico.core.config_errors import ConfigError
from armadico.core.messages import LARGEST, LARGEST_COUNT, Message, line, next_count

# Steps that end immediately, in one update: a mission that repeats them forever blocks no agent.
UPDATE_STEPS_MOST: Final = 200

FRAMES_MOST: Final = 32
RESULTS_MOST: Final = 100
AHEAD_MOST: Final = 64

NOTE_MOST: Final = 200  # characters of a step's result that are stored


@dataclass(frozen=True)
class Outlook:
    """A mission after an update."""

    course: Course  # its progress
    request: Request | None = None  # the current request of its task; None: the mission has ended
    events: tuple[Message, ...] = ()  # to be published
    failed: str | None = None  # the reason of its failure; None: it goes on, or is done


def advance(
    mission: Mission,
    course: Course,
    beliefs: Beliefs,
    seconds: float,
    state: Reach = Reach.NONE,
    note: str = "",
) -> Outlook:
    """Advance a mission after `seconds` more of work.

    `state` is the progress of the task's request, and `note` the reason if that has failed; of one
    that is done, why that is unknown.
    """
    return _Update(mission, course, beliefs).run(seconds, state, note)


def doing(mission: Mission, course: Course) -> Step | None:
    """Return the task that is under way, or None if none has begun."""
    frame = course.frames[-1]
    step = _step(mission, frame)
    return step if step is not None and frame.begun and step.do not in mission.procedures else None


def failing(mission: Mission, course: Course, beliefs: Beliefs, state: Reach, note: str) -> str:
    """Return why the current task fails in this update; "" if it does not.

    A failing step of a detour is left out, and is not reported.
    """
    step = doing(mission, course)
    if step is None or course.frames[-1].detour:
        return ""
    update = _Update(mission, replace(course, results=()), beliefs)
    update.tick(step, state, note)
    found = update.results
    return found[0].said or "failed" if found and found[0].end is StepEnd.FAILED else ""


def again(course: Course) -> Course:
    """Return the course with the current step to be begun anew."""
    return _with_top(course, replace(course.frames[-1], begun=False, elapsed=0.0, stage=0))


def ahead(mission: Mission, course: Course) -> tuple[PlanStep, ...]:
    """Return the next tasks as if none failed, without the current one."""
    found = (*course.detour, *_to_come(mission, course))
    return found[:AHEAD_MOST]


def broken_off(mission: Mission, course: Course) -> Course:
    """Return the course with the current task to be begun anew, if it may be broken off."""
    step = doing(mission, course)
    try:
        if step is None or not task_class(step.do).breaks_off:
            return course
    except (LookupError, ImportError):  # an unknown task of a sub-plan: it fails when it is begun
        return course
    return again(course)


def merged(mission: Mission, course: Course, detour: tuple[PlanStep, ...]) -> Course:
    """Return the course with a detour before its next step (merging procedure of thesis 3.6.1).

    If the detour ends in the place to which the mission moves next, that move is left out.
    """
    end, frame = (detour[-1].place if detour else None), course.frames[-1]
    after = _steps(mission, frame)[frame.step + frame.begun :]
    step = bound(after[0], _values(frame.told)) if after else None
    plain = step is not None and step.when is None and not step.otherwise and step.repeat == 1
    drops = 1 if plain and step is not None and plan_step(step).place == end is not None else 0
    return replace(course, detour=(*course.detour, *detour)[:AHEAD_MOST], drops=drops)


def plan_step(step: Step) -> PlanStep:
    """Return a task as a message."""
    return PlanStep(step.do, _arguments(step))


# Implementation -----------------------------------------------------------------------------------


class _Update:
    """One update of a mission."""

    def __init__(self, mission: Mission, course: Course, beliefs: Beliefs) -> None:
        self._mission, self._course, self._beliefs = mission, course, beliefs
        self._events: list[Message] = []
        self._failed: str | None = None

    def run(self, seconds: float, state: Reach, note: str) -> Outlook:
        """Advance from step to step until one requests something, or the mission ends."""
        self._add_time(seconds)
        self._check_timeouts()
        for _ in range(UPDATE_STEPS_MOST):
            if not self._course.frames:
                return Outlook(self._course, None, tuple(self._events), self._failed)
            request = self._once(state, note)
            if request is not None:
                return Outlook(self._course, request, tuple(self._events))
            state, note = Reach.NONE, ""
        return Outlook(self._course, Stand(), tuple(self._events))

    @property
    def results(self) -> tuple[StepResult, ...]:
        return self._course.results

    @property
    def _frame(self) -> Frame:
        return self._course.frames[-1]

    def _set(self, **changes: object) -> None:
        self._course = _with_top(self._course, replace(self._frame, **changes))

    def _add_time(self, seconds: float) -> None:
        """Add time at work to the mission and to each step that is under way."""
        frames = tuple(
            replace(f, elapsed=min(f.elapsed + seconds, LARGEST)) if f.begun else f
            for f in self._course.frames
        )
        elapsed = min(self._course.elapsed + seconds, LARGEST)
        self._course = replace(self._course, frames=frames, elapsed=elapsed)

    def _check_timeouts(self) -> None:
        limit = self._mission.timeout_s
        if limit is not None and self._course.elapsed > limit:
            self._end(f"not done within {limit:g} s")
            return
        for depth, frame in enumerate(self._course.frames):
            step = _step(self._mission, frame)
            over = step is not None and step.timeout_s is not None
            if over and step is not None and frame.elapsed > (step.timeout_s or 0.0):
                self._course = replace(self._course, frames=self._course.frames[: depth + 1])
                self._step_failed(f"not done within {step.timeout_s:g} s")
                return

    def _once(self, state: Reach, note: str) -> Request | None:
        """Advance by one step; return its request, if there is one."""
        frame, course = self._frame, self._course
        if course.detour and not frame.begun:
            self._begin_detour()
            return None
        step = _step(self._mission, frame)
        if step is None:
            self._frame_done()
            return None
        if not frame.begun:
            self._begin(step)
            return None
        return self.tick(step, state, note)

    def _begin_detour(self) -> None:
        detour, drops = self._course.detour, self._course.drops
        self._set(step=min(self._frame.step + drops, LARGEST_COUNT), attempt=0, turn=0)
        self._course = replace(self._course, detour=(), drops=0)
        if len(self._course.frames) < FRAMES_MOST:
            self._push(Frame(detour=detour))

    def _push(self, frame: Frame) -> None:
        self._course = replace(self._course, frames=(*self._course.frames, frame))

    def _begin(self, step: Step) -> None:
        """Begin a step if its precondition holds."""
        if step.when is not None and not self._holds(step.when):
            self._inapplicable(step)
            return
        procedure = self._mission.procedures.get(step.do)
        self._set(begun=True, elapsed=0.0, stage=0, doubt="")
        if procedure is None:
            self._course = replace(self._course, tasks=next_count(self._course.tasks))
            return
        arguments = _arguments(step)
        if procedure.when is not None and not self._holds(
            bound_when(procedure.when, _values(arguments))
        ):
            self._step_failed("it does not apply: its precondition is not believed")
        elif len(self._course.frames) >= FRAMES_MOST:
            self._step_failed(f"more than {FRAMES_MOST} procedures within each other")
        else:
            self._push(Frame(procedure.name, told=arguments))

    def _inapplicable(self, step: Step) -> None:
        """Go on after a precondition that does not hold: to the next alternative, or step."""
        frame = self._frame
        own = _whole(self._mission, frame)
        assert own is not None, "a step that begins is there"
        if frame.attempt < len(own.otherwise):
            self._set(attempt=frame.attempt + 1)
        elif frame.attempt:
            self._step_failed("none of its alternatives applies")
        else:
            self._record(step, StepEnd.PASSED)
            self._next()

    def tick(self, step: Step, state: Reach, note: str) -> Request | None:
        """Update the current task; return its request if it goes on."""
        if state is Reach.DONE and note:
            self._set(doubt=line(note)[:NOTE_MOST])
        frame = self._frame
        progress = Progress(frame.elapsed, state, note, frame.stage)
        try:
            verdict = task_class(step.do)(arguments_of(step)).tick(self._beliefs, progress)
            if wrong := misfit(verdict):
                verdict = Failed(f"task {step.do!r}: look gave {verdict!r}: {wrong}")
        except ConfigError as error:
            verdict = Failed(error.message)
        except (Exception, SystemExit) as error:  # a task's code must not end the agent
            verdict = Failed(_blame(step, error))
        if isinstance(verdict, Going):
            if verdict.stage != frame.stage:
                self._set(stage=verdict.stage)
                self._course = replace(self._course, tasks=next_count(self._course.tasks))
            return verdict.request
        if isinstance(verdict, Failed):
            self._step_failed(verdict.why)
        else:
            if verdict.event is not None:
                self._events.append(verdict.event)
            self._record(step, StepEnd.DONE, verdict.said, frame.doubt)
            self._step_done()
        return None

    def _step_done(self) -> None:
        """Repeat the step, or go on to the next one."""
        frame = self._frame
        own = _whole(self._mission, frame)
        if own is not None and frame.turn + 1 < own.repeat:
            self._set(turn=frame.turn + 1, attempt=0, begun=False, elapsed=0.0, stage=0)
        else:
            self._next()

    def _next(self) -> None:
        step = min(self._frame.step + 1, LARGEST_COUNT)  # a board may have any number
        self._set(step=step, attempt=0, turn=0, begun=False, elapsed=0.0, stage=0)

    def _frame_done(self) -> None:
        """End a procedure and the step that called it; a detour is not called by a step."""
        frame, frames = self._frame, self._course.frames[:-1]
        self._course = replace(self._course, frames=frames)
        if frames and not frame.detour:
            self._step_done()

    def _step_failed(self, why: str) -> None:
        """Try the alternatives; else fail the procedure, and so on upwards."""
        while True:
            frame = self._frame
            step, own = _step(self._mission, frame), _whole(self._mission, frame)
            if step is not None:
                self._record(step, StepEnd.FAILED, why)
            if own is not None and frame.attempt < len(own.otherwise):
                self._set(attempt=frame.attempt + 1, begun=False, elapsed=0.0, stage=0)
                return
            frames = self._course.frames[:-1]
            if not frames:
                self._end(f"{step}: {why}" if step is not None else why)
                return
            self._course = replace(self._course, frames=frames)
            if frame.detour:
                return

    def _end(self, why: str) -> None:
        self._course, self._failed = replace(self._course, frames=()), line(why)

    def _record(self, step: Step, end: StepEnd, note: str = "", doubt: str = "") -> None:
        course, name = self._course, line(str(step))[:NOTE_MOST]
        result = StepResult(name, end, line(note)[:NOTE_MOST], course.elapsed, doubt)
        first = course.doubt or (doubt and f"{name}: {doubt}")
        results = (*course.results, result)[-RESULTS_MOST:]
        self._course = replace(course, results=results, doubt=first)

    def _holds(self, when: When) -> bool:
        left, alarms = self._beliefs.battery, self._beliefs.alarms
        elapsed = self._course.elapsed
        held = (
            when.battery_above is None or (left is not None and left > when.battery_above),
            when.battery_below is None or (left is not None and left < when.battery_below),
            when.alarm is None or when.alarm in alarms,
            when.no_alarm is None or when.no_alarm not in alarms,
            when.room is None or when.room == self._beliefs.room,
            when.not_room is None or when.not_room != self._beliefs.room,
            when.after_s is None or elapsed >= when.after_s,
            when.before_s is None or elapsed < when.before_s,
        )
        return all(held)


def _blame(step: Step, error: BaseException) -> str:
    """Return what a task's code raised, and where."""
    at = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{at.filename}, line {at.lineno}"
    return f"task {step.do!r} raised {type(error).__name__}: {error} ({where})"


def _with_top(course: Course, frame: Frame) -> Course:
    return replace(course, frames=(*course.frames[:-1], frame))


def _values(told: tuple[Told, ...]) -> Mapping[str, Value]:
    return {each.name: each.value for each in told}


def _arguments(step: Step) -> tuple[Told, ...]:
    return tuple(Told.of(name, value) for name, value in step.arguments)


def _steps(mission: Mission, frame: Frame) -> tuple[Step, ...]:
    """Return the list of steps of a frame."""
    if frame.detour:
        return tuple(
            Step(each.do, tuple((t.name, t.value) for t in each.told)) for each in frame.detour
        )
    procedure = mission.procedures.get(frame.procedure, Procedure(frame.procedure, ()))
    return procedure.steps


def _whole(mission: Mission, frame: Frame) -> Step | None:
    """Return a frame's current step with its alternatives; None: the frame is done."""
    steps = _steps(mission, frame)
    return steps[frame.step] if frame.step < len(steps) else None


def _step(mission: Mission, frame: Frame) -> Step | None:
    """Return a frame's current step or alternative, with arguments bound; None: done."""
    own = _whole(mission, frame)
    if own is None:
        return None
    which = min(frame.attempt, len(own.otherwise))
    step = own.otherwise[which - 1] if which else own
    return bound(step, _values(frame.told))


def _to_come(mission: Mission, course: Course) -> Iterator[PlanStep]:
    """Yield the tasks after the current one, from the top of the stack down."""
    left = [AHEAD_MOST]
    for depth in range(len(course.frames) - 1, -1, -1):
        frame = course.frames[depth]
        top = depth == len(course.frames) - 1
        first = frame.step + (course.drops if top and course.detour else 0)
        for step in _steps(mission, frame)[first + frame.begun :]:
            yield from _tasks(mission, bound(step, _values(frame.told)), left)


def _tasks(mission: Mission, step: Step, left: list[int]) -> Iterator[PlanStep]:
    """Yield the tasks of a step, once each."""
    if left[0] <= 0:
        return
    procedure = mission.procedures.get(step.do)
    if procedure is None:
        left[0] -= 1
        yield plan_step(step)
        return
    for each in procedure.steps:
        yield from _tasks(mission, bound(each, dict(step.arguments)), left)
