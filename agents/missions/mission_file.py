"""Missions: procedures in the manner of PRS, written in TOML (thesis 3.6.1).

A mission is a list of steps. A step does a task (`armadico.tasks`) or another procedure of the
file; its other keys are in `HEAD`. A mission is read with the places of a world. Errors are
reported with file and line before the robot moves: unknown names, procedures that call themselves,
places that cannot be reached.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from msgspec import Meta, Struct, field
from msgspec.structs import replace

from armadico.agents.interface.messages import MissionOrder
from armadico.agents.missions.messages import Told
from armadico.agents.missions.task import Task
from armadico.config.lines import line_of
from armadico.config.loading import convert, document, read_text
from armadico.config.shipped import counted_from, find
from armadico.core.config_errors import ConfigError, advice
from armadico.core.discovery import TASKS, installed
from armadico.core.discovery import load as load_installed
from armadico.core.errors import UnknownNameError, no_such

if TYPE_CHECKING:
    from armadico.config.places import Places

Share = Annotated[float, Meta(ge=0, le=1)]
Seconds = Annotated[float, Meta(gt=0, le=1e6)]
Value = str | float | bool | tuple[float, ...]
Arguments = tuple[tuple[str, Value], ...]  # by name, in the order of the file

Key = tuple[str | int, ...]  # the position of a value in a mission's file

LONGEST: Final = 16_000  # characters of a mission's text, which is sent in messages

STEPS_MOST: Final = 1000  # different calls of procedures that are checked

# Limits of a step's arguments, and of their characters together: the board contains them all.
ARGUMENTS_MOST, ARGUMENTS_CHARACTERS = 16, 256

LARGEST_WHOLE: Final = 2**53  # beyond it a float is not an exact integer

DEEPEST: Final = 8  # nested procedures

NAME: Final = re.compile(r"[\w-]{1,64}\Z")

# The keys of every step; the others are arguments of its task or procedure.
HEAD: Final = ("do", "when", "else", "timeout_s", "repeat")


class When(Struct, frozen=True, forbid_unknown_fields=True):
    """A precondition: all that is given must hold. An unknown battery level fails both tests."""

    battery_above: Share | None = None  # share of a full battery
    battery_below: Share | None = None
    alarm: str | None = None  # a room with an active alarm
    no_alarm: str | None = None  # a room without one
    room: str | None = None  # where the robot is
    not_room: str | None = None  # where it is not
    after_s: Seconds | None = None  # of the mission's time at work
    before_s: Seconds | None = None


class Step(Struct, frozen=True):
    """One step: its task or procedure, the arguments, and the alternatives."""

    do: str
    arguments: Arguments = ()
    when: When | None = None  # if it does not hold: the alternatives, or the next step
    otherwise: tuple[Step, ...] = ()  # `else`: tried one after another if it fails
    timeout_s: float | None = None
    repeat: int = 1

    def __str__(self) -> str:
        """In the notation of the thesis: move(R1)."""
        arguments = ", ".join(str(value) for _, value in self.arguments)
        return f"{self.do}({arguments})" if arguments else self.do


class Procedure(Struct, frozen=True):
    """A sequence of steps."""

    name: str
    steps: tuple[Step, ...]
    goal: str = ""
    takes: tuple[str, ...] = ()  # the names of its arguments; its steps refer to them by `$name`
    when: When | None = None  # if it does not hold, the calling step fails


class Mission(Struct, frozen=True):
    """A parsed mission; its own steps are those of the procedure called ""."""

    name: str
    title: str
    priority: float
    procedures: dict[str, Procedure]
    scenario: str | None = None  # the default scenario
    timeout_s: float | None = None
    on_alarm: str = ""  # the task or procedure for a room with an alarm; empty: ignore alarms
    energy: str = "charge"  # if the energy does not suffice for a path: charge, risk or fail
    text: str = ""

    @property
    def does(self) -> frozenset[str]:
        """The names of all tasks that it may do."""
        left = [step for procedure in self.procedures.values() for step in procedure.steps]
        found = {self.on_alarm}
        while left:
            step = left.pop()
            found.add(step.do)
            left += step.otherwise
        return frozenset(found - self.procedures.keys() - {""})

    def order(self, priority: float | None, by: str) -> MissionOrder:
        """Return the order for it; without a priority the mission's own counts."""
        return MissionOrder(self.name, zlib.compress(self.text.encode()), priority, by)


class _Head(Struct, frozen=True, forbid_unknown_fields=True):
    do: str
    when: When | None = None
    otherwise: list[dict[str, object]] = field(default_factory=list, name="else")
    timeout_s: Seconds | None = None
    repeat: Annotated[int, Meta(ge=1, le=1_000_000)] = 1


Steps = Annotated[list[dict[str, object]], Meta(min_length=1)]


class _Procedure(Struct, frozen=True, forbid_unknown_fields=True):
    steps: Steps
    goal: str = ""
    takes: tuple[str, ...] = ()
    when: When | None = None


class _File(Struct, frozen=True, forbid_unknown_fields=True):
    steps: Steps
    title: str = ""
    scenario: str | None = None
    priority: Share = 0.5
    timeout_s: Seconds | None = None
    on_alarm: str = ""
    energy: Literal["charge", "risk", "fail"] = "charge"
    procedures: dict[str, _Procedure] = {}


def load_mission(
    name_or_path: str | Path,
    places: Places | None = None,
    start: tuple[float, float] | None = None,
) -> Mission:
    """Load a shipped mission by its name, or a TOML file. Raises ConfigError with file and line.

    A scenario that is a file is relative to the mission's folder. Places are checked if those of
    its world are given, and that they can be reached if the position `start`, m, is.
    """
    path = find("missions", name_or_path)
    text = read_text(path)
    mission = read_mission(text, path.stem, places, start, path)
    if mission.scenario is None:
        return mission
    scenario = counted_from(path, mission.scenario)
    try:
        find("scenarios", scenario)
    except ConfigError as error:
        raise ConfigError(error.message, path, line_of(text, ("scenario",))) from None
    return replace(mission, scenario=scenario)


def read_mission(
    text: str,
    name: str,
    places: Places | None = None,
    start: tuple[float, float] | None = None,
    file: Path | str | None = None,
) -> Mission:
    """Parse a mission's text; see `load_mission`."""
    try:
        return _Reader(text, file or name, name).read(places, start)
    except RecursionError:  # the text may come from another program: it must not end this one
        raise ConfigError("lists and tables too deep within each other", file or name) from None


@cache
def task_class(name: str) -> type[Task]:
    """Return the class of an installed task. Raises UnknownNameError or ImportError."""
    return load_installed(TASKS, name, Task)


def arguments_of(step: Step) -> Task.Arguments:
    """Return a step's arguments as its task declares them. Raises ConfigError."""
    return convert(_as_written(step), task_class(step.do).Arguments, step.do, "")


def _as_written(step: Step) -> dict[str, object]:
    """Return a step's arguments with integers restored: messages have all numbers as floats."""
    return {name: _whole(value) for name, value in step.arguments}


def _whole(value: object) -> object:
    if isinstance(value, tuple):
        return tuple(map(_whole, value))
    if isinstance(value, float) and value.is_integer() and abs(value) <= LARGEST_WHOLE:
        return int(value)
    return value


def bound(step: Step, to: Mapping[str, Value]) -> Step:
    """Return the step with each `$name` replaced by the argument of its procedure."""
    if not to:
        return step
    arguments = tuple((key, _bound(value, to)) for key, value in step.arguments)
    return Step(
        step.do,
        arguments,
        None if step.when is None else bound_when(step.when, to),
        tuple(bound(other, to) for other in step.otherwise),
        step.timeout_s,
        step.repeat,
    )


def bound_when(when: When, to: Mapping[str, Value]) -> When:
    """Return the precondition with each `$name` replaced."""
    return When(*(_bound(getattr(when, key), to) for key in when.__struct_fields__))


def _bound(value: Any, to: Mapping[str, Value]) -> Any:
    return to.get(value[1:], value) if isinstance(value, str) and value[:1] == "$" else value


class _Reader:
    """Parses one mission, and reports errors with their position."""

    def __init__(self, text: str, file: Path | str, name: str) -> None:
        self._text, self._file, self._name = text, file, name
        if len(text) > LONGEST:
            raise ConfigError(f"must have at most {LONGEST:,} characters (got {len(text):,})", file)
        self._given = convert(document(text, file), _File, file, text)
        self._tasks = installed(TASKS)
        self._known = sorted({*self._tasks, *self._given.procedures})
        self._checked: set[tuple[str, Arguments]] = set()

    def read(self, places: Places | None, start: tuple[float, float] | None) -> Mission:
        """Parse the whole mission. Raises ConfigError."""
        given, name = self._given, self._name
        if not NAME.match(name):
            raise ConfigError(
                f"a mission's name must consist of letters, digits, - and _ (got {name!r})",
                self._file,
            )
        self._check_names()
        bodies = {"": _Procedure(given.steps), **given.procedures}
        procedures = {
            key: Procedure(
                key, self._steps(body.steps, self._at(key)), body.goal, body.takes, body.when
            )
            for key, body in bodies.items()
        }
        self._check_circles(procedures)
        mission = Mission(
            name,
            given.title or name,
            given.priority,
            procedures,
            given.scenario,
            given.timeout_s,
            given.on_alarm,
            given.energy,
            self._text,
        )
        self._check_on_alarm(mission, places)
        uncalled = [key for key, body in procedures.items() if not body.takes]
        for key in uncalled:
            self._check_procedure(mission, key, (), places, start, 0)
        return mission

    # Implementation ------------------------------------------------------------------------------

    def _wrong(self, key: Key, message: str) -> ConfigError:
        return ConfigError(message, self._file, line_of(self._text, key))

    @staticmethod
    def _at(procedure: str) -> Key:
        return ("procedures", procedure) if procedure else ()

    def _check_names(self) -> None:
        for name, body in self._given.procedures.items():
            key = self._at(name)
            if not NAME.match(name):
                raise self._wrong(
                    key,
                    f"a procedure's name must consist of letters, digits, - and _ (got {name!r})",
                )
            if name in self._tasks:
                raise self._wrong(
                    key, f"procedure {name!r} has the name of a task: give it another name"
                )
            for each in body.takes:
                if each in HEAD or not NAME.match(each):
                    raise self._wrong(
                        (*key, "takes"), f"takes {each!r}: a reserved or invalid name"
                    )

    def _steps(self, given: Sequence[Mapping[str, object]], at: Key) -> tuple[Step, ...]:
        return tuple(self._step(step, (*at, "steps", n)) for n, step in enumerate(given))

    def _step(self, given: Mapping[str, object], at: Key, *, within: bool = True) -> Step:
        head = {key: value for key, value in given.items() if key in HEAD}
        if "do" not in head:
            known = advice(next(iter(given), ""), HEAD)
            raise self._wrong(at, f"a step needs a key do; {known}")
        read = convert(head, _Head, self._file, self._text, at)
        if read.do not in self._known:
            what = "task or procedure"
            raise self._wrong((*at, "do"), no_such(what, read.do, self._known))
        if read.otherwise and not within:
            raise self._wrong((*at, "else"), "else within else: call a procedure that has it")
        others = enumerate(read.otherwise)
        arguments = tuple(
            self._argument(key, value, at) for key, value in given.items() if key not in HEAD
        )
        return Step(
            read.do,
            arguments,
            read.when,
            tuple(self._step(step, (*at, "else", n), within=False) for n, step in others),
            read.timeout_s,
            read.repeat,
        )

    def _argument(self, key: str, value: object, at: Key) -> tuple[str, Value]:
        if isinstance(value, bool | str):
            return key, value
        try:
            if isinstance(value, list) and all(isinstance(n, int | float) for n in value):
                return key, tuple(map(float, value))
            if isinstance(value, int | float):
                return key, float(value)
        except OverflowError:
            raise self._wrong((*at, key), f"{key}: the number is too large") from None
        raise self._wrong((*at, key), f"{key}: expected a string, a number or a list of numbers")

    def _check_circles(self, procedures: Mapping[str, Procedure]) -> None:
        """Raises ConfigError for procedures that call themselves, or are nested too deep."""

        def follow(name: str, chain: tuple[str, ...]) -> None:
            for key, step in _every(procedures[name].steps, (*self._at(name), "steps")):
                if step.do not in procedures:
                    continue
                calls = (*chain, step.do)
                if step.do in chain:
                    circle = " -> ".join(calls[chain.index(step.do) :])
                    raise self._wrong((*key, "do"), f"procedure {step.do!r} calls itself: {circle}")
                if len(calls) > DEEPEST:
                    whole = " -> ".join(calls)
                    raise self._wrong((*key, "do"), f"{whole}: nested more than {DEEPEST} deep")
                if step.do not in done:
                    follow(step.do, calls)
            done.add(name)

        done: set[str] = set()
        for name in procedures:
            follow(name, (name,) if name else ())

    def _check_on_alarm(self, mission: Mission, places: Places | None) -> None:
        """Raises ConfigError if `on_alarm` names nothing, or something that takes no room."""
        do, key = mission.on_alarm, ("on_alarm",)
        if not do:
            return
        if do not in self._known:
            raise self._wrong(key, no_such("task or procedure", do, self._known))
        procedure = mission.procedures.get(do)
        takes = task_class(do).Arguments.__struct_fields__ if procedure is None else procedure.takes
        if "room" not in takes:
            raise self._wrong(key, f"{do} takes no room: it needs an argument room")
        if places is not None and not places.rooms:
            raise self._wrong(key, f"the world {places.world.name!r} has no rooms for an alarm")
        # It is called with the room that has the alarm: any room stands for all.
        call = Step(do, (("room", _roomy(places)),))
        if procedure is None:
            self._check_task(call, key, places, None)
        else:
            self._check_call(procedure, call, key)
            self._check_procedure(mission, do, call.arguments, places, None, 0)

    def _check_procedure(
        self,
        mission: Mission,
        name: str,
        arguments: Arguments,
        places: Places | None,
        start: tuple[float, float] | None,
        depth: int,
    ) -> None:
        """Check what a procedure does with these arguments."""
        if (name, arguments) in self._checked:
            return
        self._checked.add((name, arguments))
        if len(self._checked) > STEPS_MOST:
            raise ConfigError(f"more than {STEPS_MOST} different calls of procedures", self._file)
        procedure, to = mission.procedures[name], dict(arguments)
        if procedure.when is not None:
            self._check_when(bound_when(procedure.when, to), (*self._at(name), "when"), places)
        for key, step in _every(procedure.steps, (*self._at(name), "steps")):
            plain = bound(step, to)
            self._check_arguments(plain, key)
            if plain.when is not None:
                self._check_when(plain.when, (*key, "when"), places)
            if plain.do in mission.procedures:
                self._check_call(mission.procedures[plain.do], plain, key)
                self._check_procedure(mission, plain.do, plain.arguments, places, start, depth + 1)
            else:
                self._check_task(plain, key, places, start)

    def _check_arguments(self, step: Step, key: Key) -> None:
        sent = [Told.of(name, value) for name, value in step.arguments]
        characters = sum(len(each.json) for each in sent)
        if len(sent) > ARGUMENTS_MOST or characters > ARGUMENTS_CHARACTERS:
            most = f"at most {ARGUMENTS_MOST}, {ARGUMENTS_CHARACTERS} characters together"
            raise self._wrong(key, f"{step.do!r} has too many arguments: {most}")
        for name, value in step.arguments:
            if isinstance(value, str) and value[:1] == "$":
                raise self._wrong(
                    (*key, name), f"{name} = {value!r}: the procedure takes no {value[1:]!r}"
                )

    def _check_call(self, procedure: Procedure, step: Step, key: Key) -> None:
        given = [name for name, _ in step.arguments]
        for name in given:
            if name not in procedure.takes:
                known = advice(name, (*procedure.takes, *HEAD))
                raise self._wrong((*key, name), f"unknown key {name} of {step.do!r}; {known}")
        for name in procedure.takes:
            if name not in given:
                raise self._wrong(key, f"{step.do!r} needs an argument {name}: {name} = ...")

    def _check_task(
        self, step: Step, key: Key, places: Places | None, start: tuple[float, float] | None
    ) -> None:
        try:
            kind = task_class(step.do)
        except (UnknownNameError, ImportError) as error:
            raise self._wrong((*key, "do"), str(error)) from None
        names = kind.Arguments.__struct_fields__
        for name, _ in step.arguments:
            if name not in names:
                known = advice(name, (*names, *HEAD))
                raise self._wrong((*key, name), f"unknown key {name} of {step.do!r}; {known}")
        converted = convert(_as_written(step), kind.Arguments, self._file, self._text, key)
        given = dict(step.arguments)
        named = [
            name
            for name in (kind.places if places is not None else ())
            if isinstance(place := getattr(converted, name), str) and (place or name in given)
        ]
        for name in named:
            assert places is not None, "else no place is checked"
            place = getattr(converted, name)
            try:
                places.of(place)
            except ConfigError as error:
                raise self._wrong((*key, name), error.message) from None
            if start is not None and [*places.unreachable(start, [place])]:
                where = f"({start[0]:g}, {start[1]:g})"
                raise self._wrong(
                    (*key, name),
                    f"{place!r} cannot be reached from {where}: no way in"
                    f" {places.world.name!r} is as wide as the robot",
                )

    def _check_when(self, when: When, key: Key, places: Places | None) -> None:
        if not any(getattr(when, name) is not None for name in when.__struct_fields__):
            raise self._wrong(key, f"when is empty; {advice('', when.__struct_fields__)}")
        for name in ("alarm", "no_alarm", "room", "not_room"):
            room = getattr(when, name)  # the value of a `$name` may be of any type
            if room is not None and not isinstance(room, str):
                raise self._wrong((*key, name), f"{name} = {room!r}: expected a room's name")
            if room is not None and places is not None and room not in places.rooms:
                known = advice(room, places.rooms)
                raise self._wrong(
                    (*key, name), f"no room {room!r} in {places.world.name!r}; {known}"
                )


def _roomy(places: Places | None) -> str:
    """Return a room of the world in which the robot can turn; without a world, any name."""
    if places is not None:
        for room in places.rooms:
            with suppress(ConfigError):
                places.of(room)
                return room
    return "room"


def _every(steps: Sequence[Step], at: Key) -> Iterator[tuple[Key, Step]]:
    """Yield steps and their alternatives, each with its position."""
    for n, step in enumerate(steps):
        yield (*at, n), step
        for k, other in enumerate(step.otherwise):
            yield (*at, n, "else", k), other
