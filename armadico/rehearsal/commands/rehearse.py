"""Tell what would happen before the robot moves: drive a fork of the running society virtually."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.cli.parsing import (
    FILE,
    BadValueError,
    Command,
    Must,
    argument,
    at_least,
    between,
    ends_with,
    flag,
    group,
    option,
    several,
)
from armadico.launch.options import X_Y_DEG, set_option
from armadico.mesh.topology import default_namespace
from armadico.mobile.geometry import Pose2

if TYPE_CHECKING:
    from armadico.core.messages import Message
    from armadico.observe.journeys import Journey
    from armadico.observe.watching import Presence
    from armadico.rehearsal.answer import Rehearsed
    from armadico.rehearsal.fork import Errand
    from armadico.rehearsal.present import Present

EXAMPLES: Final = """\
  armadico rehearse goto 8 1 90                   what would happen if it were sent there
  armadico rehearse goto kitchen                  to a place by its name
  armadico rehearse goto 8 1 --samples 8 --picture paths.svg
  armadico rehearse mission rounds
  armadico rehearse --without avoid               the present mission, without an agent
  armadico rehearse goto 8 1 --set goto.v_max=0.8
  armadico rehearse goto 8 1 --kill localization@10
  armadico rehearse goto 8 1 --json               small JSON; --full has the paths
  armadico rehearse goto 12.6 1.2 --world house --from 1 1 90   without a running society
  armadico rehearse goto 8 1 --recording run.mcap --at 12.5   what would have happened if
  armadico rehearse --recording run.mcap --drive 1   and what did happen
"""

WHAT: Final = "expected goto X Y [DEG], goto NAME, mission FILE, or nothing: the present mission"


class Kill(NamedTuple):
    """An agent that is killed, and when, s after the beginning."""

    agent: str
    at: float


def _kill(text: str) -> Kill:
    name, at, when = text.partition("@")
    try:
        value = float(when) if at else math.nan
    except ValueError:
        value = math.nan
    if not name or not 0.0 <= value < math.inf:
        raise BadValueError(f"{text!r}: expected AGENT@S, as in localization@10")
    return Kill(name, value)


@dataclass(frozen=True, kw_only=True)
class Options:
    what: tuple[str, ...] = argument(
        "goto X Y [DEG]: to a pose in the world frame, m and degrees; goto NAME: to a place of the"
        " world; mission FILE: a mission of several tasks; nothing: the present mission goes on",
        nargs="*",
        metavar="WHAT",
        default=(),
    )
    sets: tuple[str, ...] = set_option()
    without: tuple[str, ...] = several("leave out an agent; may be repeated", metavar="AGENT")
    kills: tuple[Kill, ...] = several(
        "kill an agent S seconds after the beginning; may be repeated",
        "--kill",
        read=_kill,
        metavar="AGENT@S",
    )
    samples: int = option(
        "drive N samples (default: 4)", default=4, metavar="N", must=between(1, 1000)
    )
    within: float = option(
        "answer S seconds after the society is joined, or the recording is read: what has not ended"
        " by then is unknown (default: 30)",
        default=30.0,
        read=options.seconds,
        metavar="S",
    )
    seed: int = option(
        "seed of the first sample (default: 0)",
        default=0,
        metavar="N",
        must=between(0, 2**62, "expected 0 to 2^62"),
    )
    recording: Path | None = option(
        "rehearse from a moment of this recording, instead of a running society",
        metavar="FILE.mcap",
        must=FILE,
    )
    at: float | None = option(
        "that moment, s from the recording's first message",
        metavar="T",
        must=Must(lambda at: 0.0 <= at < math.inf, "expected at least 0, the first message"),
    )
    drive: int | None = option(
        "rehearse the recording's N-th drive from when it began, and compare",
        metavar="N",
        must=at_least(1),
    )
    start: Pose2 | None = option(
        "without a running society: the default one, whose robot stands at this pose of --world: m,"
        " m, degrees",
        "--from",
        **X_Y_DEG,
    )
    profile: str | None = option(
        "with --from: the robot's profile, a shipped name, or a file (default: pioneer-2dx)",
        metavar="NAME",
    )
    world: str | None = option(
        "the map, if the society's is not here under its name", metavar="MAP"
    )
    json: bool = flag("print the answer as a small JSON object")
    full: bool = flag("print all of it as JSON, with the samples and their paths")
    picture: Path | None = option(
        "draw the paths of all samples on the map",
        metavar="FILE.svg",
        must=ends_with(".svg", "the name of a picture"),
    )
    mesh: options.Recorded = group(options.Recorded, "the mesh")


def run(args: Options) -> int:
    """Rehearse, print the answer, and return the exit code of its judgement."""
    _check(args)
    errand = errand_of(args)
    from armadico.rehearsal.crew import Crew
    from armadico.rehearsal.fork import fork
    from armadico.rehearsal.rehearse import drive, made_map

    options.end_as_by_ctrl_c()
    with ExitStack() as stack:
        crew = stack.enter_context(Crew())  # it loads while the society is observed
        driven = None
        if args.recording is not None:
            now, driven = _recorded(args, args.recording)
            began = time.monotonic()
        else:
            now, began = _now(args)
        if driven is not None:
            import msgspec

            from armadico.rehearsal.fork import PATH_PLANNER

            direct = PATH_PLANNER not in now.names  # the society took the goal without a plan
            errand = msgspec.structs.replace(errand, goal=driven.goal, direct=direct)
        made = stack.enter_context(made_map(now))
        of = fork(now, errand, world=args.world, made=made)
        found = drive(
            of,
            args.samples,
            args.within,
            seed=args.seed,
            crew=crew,
            done=_progress(stack, args.samples),
            began=began,
        )
    if args.start is None and args.recording is None:
        from armadico.rehearsal.store import note

        namespace = args.mesh.namespace or default_namespace()
        note(namespace, errand, found, named=args.world)
    show(args, found, driven)
    return found.judgement.exit_code


def _check(args: Options) -> None:
    """Raises UsageError for options that do not go together."""
    when = args.at is not None or args.drive is not None
    if (args.recording is None) == when:
        raise UsageError("--at T (or --drive N) and --recording FILE.mcap: give both, or none")
    if args.drive is not None and (args.at is not None or args.what):
        raise UsageError(f"--drive {args.drive}: it has its own moment and goal")
    if args.start is not None and (args.world is None or args.recording is not None):
        raise UsageError("--from X Y DEG: needs --world MAP, and no recording")
    if args.profile is not None and args.start is None:
        raise UsageError(f"--profile {args.profile}: it is for --from X Y DEG")
    if args.picture is not None and not args.picture.parent.is_dir():  # known before the drives
        raise UsageError(f"--picture {args.picture}: no folder {args.picture.parent}")
    if args.start is not None and not args.what:
        raise UsageError("--from X Y DEG: name what is rehearsed, goto X Y or mission FILE")


def _now(args: Options) -> tuple[Present, float]:
    """The present from which the rehearsal begins, and when `--within` began."""
    if args.start is not None:
        from armadico.config.slots import slot
        from armadico.rehearsal.virtual import standing

        assert args.world is not None, "it was checked"
        besides = slot("missions").besides if args.what[:1] == ("mission",) else ()
        return standing(args.world, args.start, args.profile, besides), time.monotonic()
    return _observed(args)


def _observed(args: Options) -> tuple[Present, float]:
    from armadico.rehearsal.rehearse import observe

    live = replace(args.mesh, namespace=args.mesh.namespace or default_namespace())
    with live.joined() as mesh:
        began = time.monotonic()
        return observe(mesh, began + args.within), began


def _recorded(args: Options, path: Path) -> tuple[Present, Journey | None]:
    """The present at a moment of a recording, and the drive that began then. Raises UsageError."""
    from armadico.core.discovery import RECORDINGS, installed
    from armadico.observe.watching import Presence
    from armadico.rehearsal.present import kinds, present_at

    reader = next(iter(installed(RECORDINGS).values()), None)
    if reader is None:
        raise options.FailedError(f"{path}: no installed package reads recordings")
    try:
        wanted = (*kinds(), Presence)
        messages, _ = reader.load()(path, wanted, args.mesh.namespace or None, options.report)
    except (ValueError, OSError) as error:
        raise UsageError(f"{path}: {error}") from None
    messages.sort(key=lambda row: row[0])
    driven = None if args.drive is None else _driven(messages, args.drive, path)
    if driven is not None:
        return present_at(messages, driven.began), driven
    assert args.at is not None, "it was checked"
    began, ended = messages[0][0], messages[-1][0]
    if args.at > ended - began:
        raise UsageError(f"--at {args.at:g}: the recording ends after {ended - began:.1f} s")
    return present_at(messages, began + args.at), None


def _driven(
    messages: Sequence[tuple[float, Message | Presence]], number: int, path: Path
) -> Journey:
    """The N-th drive of a recording that has ended. Raises UsageError."""
    from armadico.observe.journeys import Journeys
    from armadico.observe.view import View
    from armadico.observe.watching import Presence

    journeys, view = Journeys(), View()
    for t, message in messages:
        if not isinstance(message, Presence):
            view.learn(message, t)
            journeys.update(message, view, t)
    if number > len(journeys.done):
        raise UsageError(f"--drive {number}: {path} has {len(journeys.done)} that have ended")
    return journeys.done[number - 1]


def errand_of(args: Options) -> Errand:
    """What is to be rehearsed. Raises UsageError."""
    from armadico.config.named import like_number
    from armadico.rehearsal.fork import Errand

    goal, mission = None, None
    match args.what:
        case ():
            pass
        case ("goto", first, *more) if not like_number(first):
            goal = _named(args, " ".join((first, *more)))
        case ("goto", *numbers) if len(numbers) in (2, 3):
            x, y, *heading = map(_number, numbers)
            goal = (x, y, math.radians(heading[0]) if heading else None)
        case ("mission", name):
            mission = name
        case _:
            raise UsageError(f"{' '.join(args.what)}: {WHAT}")
    if mission is not None:
        from armadico.config.shipped import find

        mission = str(find("missions", mission).resolve())
    return Errand(
        goal=goal, mission=mission, without=args.without, sets=args.sets, kills=args.kills
    )


def _named(args: Options, name: str) -> tuple[float, float, float | None]:
    """The pose of a place, as of `armadico goto`. Raises UsageError, ConfigError."""
    if args.recording is not None and args.world is None:  # another society may run here
        raise UsageError(f"goto {name}: names need the recording's world: give --world MAP")
    namespace = args.mesh.namespace or default_namespace()
    place = options.known_gazetteer(args.world, namespace).of(name)
    return place.x, place.y, place.heading


def _number(text: str) -> float:
    from armadico.core.messages import LARGEST

    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST:
        raise UsageError(f"goto: {text!r}: expected a number of at most {LARGEST:g}; {WHAT}")
    return value


def _progress(stack: ExitStack, samples: int) -> Callable[[int], None]:
    from armadico.cli.pool import progress

    step = stack.enter_context(progress("rehearsal", samples))
    return lambda _: step()


def show(args: Options, found: Rehearsed, driven: Journey | None = None) -> None:
    """Print the answer, what happened in a drive, and draw the picture."""
    differs = "" if driven is None else _compared(driven, found)
    if args.picture is not None and found.runs:
        from armadico.rehearsal.picture import drawn

        args.picture.write_text(drawn(found), encoding="utf-8")
    elif args.picture is not None:  # an older file would be taken for this one's
        options.report(f"--picture {args.picture}: not written, since nothing was driven")
    if args.full:
        print(json.dumps(found.full | ({"driven": differs} if differs else {})))
    elif args.json:
        print(json.dumps(found.small | ({"driven": differs} if differs else {})))
    else:
        for line in found.lines:
            print(options.shown(line))
        if differs:
            print(options.shown(differs))


def _compared(driven: Journey, found: Rehearsed) -> str:
    """How a drive differed; "" if nothing was rehearsed."""
    if found.goal is None:
        return ""
    import msgspec

    from armadico.observe.journeys import compared
    from armadico.rehearsal.store import noted_of

    return compared(driven, msgspec.to_builtins(noted_of(found, driven.began)))


main: Final = Command(
    "armadico rehearse",
    Options,
    run,
    "Tell what would happen, before the robot moves. A virtual society is made of what the running"
    " one knows now, and drives several samples of it on spare cores; the running one is only"
    " observed. Exit code 0: yes, it arrives in all samples as on the map; 1: no; 3: unknown.",
    EXAMPLES,
)
