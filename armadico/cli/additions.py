"""What packages add to the commands that run a society: options, and what they do.

An entry point of the group `armadico.options` names a frozen dataclass derived from `Addition`. Its
fields are options, as in `armadico.cli.parsing`; its methods are called at the stages of a run:

    @dataclass(frozen=True, kw_only=True)
    class Lamp(Addition):
        title = "the lamp"
        lamp: str | None = option("light this lamp during the run", metavar="URL")

        @contextmanager
        def beside(self, start: Start) -> Iterator[None]:
            with nullcontext() if self.lamp is None else lit(self.lamp):
                yield

A command knows none of them by name. Each gets its own values only. One that brings an existing
option, fails on import or raises an error of its own is reported and left out.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Final

from armadico.cli.options import BROKEN, WRONGLY_USED, FailedError, Mesh
from armadico.cli.parsing import Command, UsageError, flags_of, given
from armadico.cli.parsing import added as declared
from armadico.core.discovery import OPTIONS
from armadico.core.installed import left_out, loaded

if TYPE_CHECKING:
    from types import TracebackType

    from armadico.config.scenarios import Scenario
    from armadico.launch.api import Run as Finished
    from armadico.launch.run import RobotRun
    from armadico.launch.society import Options
    from armadico.mesh.virtual import VirtualMesh

DRIVING: Final = ("run", "explore", "mission run")
"""The commands that drive a scenario."""

REFUSALS: Final[tuple[type[Exception], ...]] = (
    *WRONGLY_USED,
    *(error for error in BROKEN if error is not ImportError),
    OSError,
)
"""What an addition may raise; other errors are its own faults."""


@dataclass(frozen=True, kw_only=True)
class Start:
    """A society that starts, or is joined."""

    scenario: Scenario | None  # its scenario; None for `armadico up` without one
    mesh: Mesh  # the options of the way to it
    namespaces: Sequence[str] = ()  # the robots'
    alone: bool = True  # whether one robot drives a scenario, not a fleet
    virtual: bool = False  # whether it runs under a virtual clock
    # Its virtual mesh; None before it is made, and in a live run.
    on: VirtualMesh | None = field(default=None, compare=False)
    limit: float | None = None  # the time limit of the command line, s
    seeds: Sequence[int] = ()  # those of all runs of the command
    seed: int = 0  # that of this run
    series: bool = False  # whether there may be several runs, by `--runs`

    @property
    def world(self) -> str | None:
        """The world by name or path, or None."""
        return None if self.scenario is None else self.scenario.world

    def of_run(self, path: Path, seed: int | None = None) -> Path:
        """The file of one run; in a series its name ends with the seed."""
        seed = self.seed if seed is None else seed
        return path.with_stem(f"{path.stem}-{seed}") if self.series else path


@dataclass(frozen=True, kw_only=True)
class Addition:
    """The options of a package, and what it does; the methods are called in this order.

    `armadico up` calls `check` and `beside` only.
    """

    commands: ClassVar[Collection[str]] = DRIVING
    """The commands that have these options: those of `DRIVING`, or "up"."""

    title: ClassVar[str] = "from other packages"
    """The title of these options in `--help`."""

    examples: ClassVar[Sequence[str]] = ()
    """Further examples for `--help` of the command that each begins with."""

    fleets: ClassVar[bool] = False
    """Whether the options are for runs of several robots, too; `driven` and `done` are not."""

    def check(self, start: Start) -> None:
        """Raise UsageError or FailedError before anything starts."""

    def changed(self, options: Options) -> Options:
        """The options of the run with what this needs."""
        return options

    def beside(self, start: Start) -> AbstractContextManager[object]:  # noqa: ARG002
        """A context around the society: entered before its start, left after its end.

        Of a virtual run, all agents have joined. On leaving, an OSError costs no measures.
        """
        return nullcontext()

    def driven(self, start: Start, run: RobotRun, *, interrupted: bool) -> None:
        """The run is over, or was interrupted, and its society is still there."""

    def done(self, start: Start, run: Finished) -> None:
        """Use a finished run. An OSError is reported with the measures."""


def added(command: str) -> tuple[Addition, ...]:
    """The field of what packages add to a command."""
    return declared(partial(_installed, command))


def _installed(command: str, taken: Collection[str]) -> list[type[Addition]]:
    """The usable additions to a command, whose own flags are `taken`."""
    found, flags = [], {*taken}
    for point, kind in loaded(OPTIONS, Addition):
        try:
            if command not in kind.commands:
                continue
            if not all(isinstance(text, str) for text in (kind.title, *kind.examples)):
                raise TypeError("title and examples must be texts")
            Command("", kind, lambda _: 0, "", "").parse([])  # no word of it may be required
            own = flags_of(kind)
        except (Exception, SystemExit) as error:
            left_out(point, f"its options: {type(error).__name__}: {error}")
            continue
        if both := next((flag for flag in own if flag in flags), None):
            left_out(point, f"the option {both} exists")
            continue
        flags |= {*own}
        found.append(kind)
    return found


@contextmanager
def _excused(addition: Addition, *, before: bool = False) -> Iterator[None]:
    """Report an error of an addition's own code, and continue.

    Before the start it is a FailedError if the user gave one of its options.
    """
    try:
        yield
    except REFUSALS:
        raise
    except (Exception, SystemExit) as error:
        why = f"{type(error).__name__}: {error}"
        if before and (flags := given(addition)):
            raise FailedError(f"{flags[0]}: {why}") from error
        for point, kind in loaded(OPTIONS, Addition):
            if kind is type(addition):
                left_out(point, why)


def checked(additions: Sequence[Addition], start: Start) -> None:
    """Raises UsageError or FailedError for options that this start does not have."""
    for each in additions:
        if not start.alone and not each.fleets and (flags := given(each)):
            name = "" if start.scenario is None else start.scenario.name
            raise UsageError(f"{flags[0]} is for the run of one robot, and {name} is a fleet's")
        with _excused(each, before=True):
            each.check(start)


def changed(additions: Sequence[Addition], options: Options) -> Options:
    """The options of a run with what the additions need."""
    for each in additions:
        with _excused(each, before=True):
            found: object = each.changed(options)
            if not isinstance(found, type(options)):
                raise TypeError(f"`changed` returned {found!r}")
            options = found
    return options


@contextmanager
def beside(additions: Sequence[Addition], start: Start) -> Iterator[None]:
    """What the additions do around a society."""
    with ExitStack() as stack:
        for each in additions:
            with _excused(each, before=True):
                context = each.beside(start)
                context.__enter__()
                stack.push(partial(_leave, each, context))
        yield


def _leave(
    addition: Addition,
    context: AbstractContextManager[object],
    kind: type[BaseException] | None,
    error: BaseException | None,
    traceback: TracebackType | None,
) -> bool:
    """Leave what an addition does around a society; its own errors cost no measures."""
    handled = False
    with _excused(addition):
        handled = bool(context.__exit__(kind, error, traceback))
    return handled  # noqa: RET504 - after an error that was reported, too


@contextmanager
def recording(
    additions: Sequence[Addition], start: Start, report: Callable[[str], None]
) -> Iterator[None]:
    """As `beside`; what cannot be written after the run is reported, and raises nothing.

    A full disk then costs the recording, not the measures of the run.
    """
    with ExitStack() as stack:
        stack.enter_context(beside(additions, start))
        yield
        with reported(report):
            stack.close()


def driven(
    additions: Sequence[Addition], start: Start, run: RobotRun, *, interrupted: bool = False
) -> None:
    """Let the additions use the society of a run that is over."""
    for each in additions:
        with _excused(each):
            each.driven(start, run, interrupted=interrupted)


def done(
    additions: Sequence[Addition], start: Start, run: Finished, report: Callable[[str], None]
) -> None:
    """Let the additions use a finished run; what they cannot write is reported."""
    for each in additions:
        with _excused(each), reported(report):
            each.done(start, run)


@contextmanager
def reported(report: Callable[[str], None]) -> Iterator[None]:
    """Report an OSError in a line."""
    try:
        yield
    except OSError as error:
        report(": ".join(map(str, filter(None, (error.filename, error.strerror or error)))))
