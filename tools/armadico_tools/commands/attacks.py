"""Attack a society of real processes, and print what each attack did."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UnknownError, UsageError
from armadico.cli.parsing import Command, argument, at_least, flag, option, several
from armadico.core.errors import no_such
from armadico.core.judgement import Judgement, no, unknown, yes
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from armadico_tools.attacks.lab import Killed
    from armadico_tools.attacks.running import Outcome

EXAMPLES: Final = """\
  armadico attacks --list                   what each attack does
  armadico attacks stop release             these two, on a society without keys
  armadico attacks --keys                   a stranger on a society with keys
  armadico attacks --keys --as goto         a program that has goto's key
  armadico attacks --keys --as mcp --table  the same with mcp's, as a table in Markdown
  armadico attacks --keys --links           which certificates and passwords get a link
  sudo .venv/bin/armadico attacks --keys --floods    do killed agents come back meanwhile?
  sudo .venv/bin/armadico attacks --keys --soak 60   an hour of kills and renewed certificates
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    names: tuple[str, ...] = argument(
        "attacks; see --list (default: all)", nargs="*", metavar="NAME"
    )
    keys: bool = flag("attack a society with keys (default: without)")
    who: tuple[str, ...] = several(
        "attack with the key of this member; may be repeated (default: without a key)",
        "--as",
        metavar="MEMBER",
    )
    links: bool = flag("with --keys: only try to get a link, in every wrong way")
    floods: bool = flag(
        "with --keys: flood the port of a lab of three computers, which are network namespaces"
        " (needs root), kill each agent in turn, and measure when it is back and how long no new"
        " command was obeyed"
    )
    soak: int | None = option(
        "soak the same lab for so many minutes (needs root; with and without --keys): kill an agent"
        " each 15 s, and print why no new command was obeyed for longer than 0.4 s",
        metavar="MINUTES",
        must=at_least(1),
    )
    certificates: int = option(
        "with --soak --keys: certificates of the other computers are valid for so long, s",
        default=60,
        metavar="S",
        must=at_least(36),
    )
    seconds: int = option("attack for so long, s", default=3, metavar="S", must=at_least(1))
    json: bool = flag("print JSON")
    table: bool = flag("print a table in Markdown, as the page of security has it")
    list: bool = flag("list the attacks")


def run(args: Options) -> int:
    """Run attacks, each on a society that works; the exit code is that of `judged`."""
    from armadico_tools.attacks import running
    from armadico_tools.attacks.attempts import ATTEMPTS
    from armadico_tools.testbed import PlaceError

    for name in args.names:
        if name not in ATTEMPTS:
            raise UsageError(no_such("attack", name, ATTEMPTS))
    for option_name, given in (("as", args.who), ("links", args.links), ("floods", args.floods)):
        if given and not args.keys:
            raise UsageError(f"--{option_name} needs --keys")
    options.end_as_by_ctrl_c()
    if args.soak is not None:
        return _soak(args, args.soak)
    if args.floods:
        return _floods(as_json=args.json)
    chosen = [ATTEMPTS[name] for name in args.names or ATTEMPTS]
    if args.list:
        for each in chosen:
            print(f"{each.name:<18}{each.state:<9}{each.text}")
        return 0
    outcomes: list[Outcome] = []
    try:
        for outcome in running.run(
            chosen, args.who, args.seconds, keys=args.keys, links=args.links, report=options.report
        ):
            outcomes.append(outcome)
            if not (args.json or args.table):
                print(f"{outcome.who:<28}{outcome.name:<18}{outcome.text}", flush=True)
    except PlaceError as error:
        raise FailedError(str(error)) from None
    finally:
        _print_whole(args, outcomes)
    judgement = judged(outcomes, keys=args.keys)
    options.report(f"judgement: {judgement}")
    return judgement.exit_code


def judged(outcomes: Sequence[Outcome], *, keys: bool) -> Judgement:
    """Whether no stranger got a link to a society with keys, and each attack was made.

    Who has a key, or attacks a society without keys, has a link, or it has attacked nothing.
    """
    if keys and any(o.is_stranger and (o.linked or o.effects) for o in outcomes):
        return no("a stranger got a link")
    shut = [o.name for o in outcomes if not o.linked and not (keys and o.is_stranger)]
    if shut or not outcomes:
        what = f"{', '.join(shut)}: the attacker got no link" if shut else "no attack"
        return unknown(f"{what}, so nothing was tried", "run it again, on a machine with less load")
    return yes()


def _print_whole(args: Options, outcomes: Sequence[Outcome]) -> None:
    """Print all outcomes at the end, where each was not printed before."""
    if args.json:
        print(json.dumps([outcome._asdict() for outcome in outcomes], indent=1))
    elif args.table:
        print(_table(outcomes))


def _table(outcomes: Sequence[Outcome]) -> str:
    """The outcomes as a table: a row for each attack, a column for each attacker."""
    whos = list(dict.fromkeys(outcome.who for outcome in outcomes))
    texts = {(o.name, o.who): o.text if o.effects or not o.linked else "-" for o in outcomes}
    rows = (
        [f"`{name}`", *(texts.get((name, who), "not tried") for who in whos)]
        for name in dict.fromkeys(outcome.name for outcome in outcomes)
    )
    return table(["attack", *whos], rows)


def _soak(args: Options, minutes: int) -> int:
    """Print what a soak found; 1 if an agent did not come back, or a link was lost for good."""
    from tempfile import TemporaryDirectory

    from armadico_tools.attacks.soak import soak
    from armadico_tools.hosts.namespaces import lacking
    from armadico_tools.testbed import PlaceError

    if (trouble := lacking()) is not None:
        raise FailedError(trouble)
    with TemporaryDirectory(prefix="armadico-soak-") as folder:
        options.report(f"soaking a lab {'with' if args.keys else 'without'} keys: {minutes} min")
        try:
            found = soak(
                Path(folder),
                minutes,
                keys=args.keys,
                certificate_s=args.certificates,
                report=options.report,
            )
        except PlaceError as error:
            raise FailedError(str(error)) from None
    print("\n".join(found.lines))
    if not found.kills:
        raise UnknownError("nothing is known: no agent was killed")
    return int(not found.holds)


def _floods(*, as_json: bool) -> int:
    """Print what followed each kill; 1 if an agent did not come back."""
    from tempfile import TemporaryDirectory

    from armadico_tools.attacks import lab
    from armadico_tools.hosts.namespaces import lacking
    from armadico_tools.testbed import PlaceError

    if (trouble := lacking()) is not None:
        raise FailedError(trouble)
    found: list[Killed] = []
    with TemporaryDirectory(prefix="armadico-lab-") as folder:
        options.report("setting up a lab of three computers")
        try:
            for each in lab.recoveries(Path(folder)):
                found.append(each)
                if not as_json:
                    held = ", the holder" if each.held else ""
                    print(
                        f"{each.flood:<44}{each.agent + ' on ' + each.host + held:<34}"
                        f"back {_shown(each.back):<8}pause {each.paused:.2f} s",
                        flush=True,
                    )
        except PlaceError as error:
            raise FailedError(str(error)) from None
    if as_json:
        print(json.dumps([each._asdict() for each in found], indent=1))
    else:
        print(f"\n{_summary(found)}")
    if not found:
        raise UnknownError("nothing is known: no agent was killed")
    return int(any(each.back is None for each in found))


def _summary(found: Sequence[Killed]) -> str:
    """The longest times by flood, as a table of the page."""
    from armadico_tools.attacks.lab import ROBOT

    rows = []
    for flood in dict.fromkeys(each.flood for each in found):
        of = [each for each in found if each.flood == flood]
        back = [[e.back for e in of if (e.host == ROBOT) is here] for here in (True, False)]
        worst = (_shown(None if None in b else max(filter(None, b), default=None)) for b in back)
        pauses = (
            max((e.paused for e in of if e.held is held), default=None) for held in (True, False)
        )
        pause = ("-" if p is None else f"{p:.2f} s" for p in pauses)
        rows.append((flood, *worst, *pause))
    back_here, back_there = "back, robot's computer", "back, another"
    return table(
        ("flood", back_here, back_there, "pause, holder killed", "pause, other"),
        rows,
    )


def _shown(seconds: float | None) -> str:
    return "never" if seconds is None else f"{seconds:.1f} s"


main = Command(
    "armadico attacks",
    Options,
    run,
    "Start a society of real processes with a port on the loopback, attack it with a hand-written"
    " peer, and print what each attack did: to the robot, by the line to its controller; to the"
    " processes; to what watchers show. Exit code 1 if a stranger got a link to a society with"
    " keys, or had an effect, 3 if an attacker that should have a link got none.",
    EXAMPLES,
)
