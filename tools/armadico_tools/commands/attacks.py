"""Attack a society of real processes, and print what each attack did."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, argument, at_least, flag, option, several
from armadico.core.errors import no_such

if TYPE_CHECKING:
    from armadico_tools.attacks.running import Outcome

EXAMPLES: Final = """\
  armadico attacks --list                   what each attack does
  armadico attacks stop release             these two, on a society without keys
  armadico attacks --keys                   a stranger on a society with keys
  armadico attacks --keys --as goto         a program that has goto's key
  armadico attacks --keys --links           which certificates and passwords get a link
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
    seconds: int = option("attack for so long, s", default=3, metavar="S", must=at_least(1))
    json: bool = flag("print JSON")
    list: bool = flag("list the attacks")


def run(args: Options) -> int:
    """Run attacks, each on a society that works; 1 if a stranger got a link or had an effect."""
    from armadico_tools.attacks import running
    from armadico_tools.attacks.attempts import ATTEMPTS

    for name in args.names:
        if name not in ATTEMPTS:
            raise UsageError(no_such("attack", name, ATTEMPTS))
    if (args.who or args.links) and not args.keys:
        raise UsageError(f"--{'as' if args.who else 'links'} needs --keys")
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
            if not args.json:
                print(f"{outcome.who:<28}{outcome.name:<18}{outcome.text}", flush=True)
    except running.VictimError as error:
        raise FailedError(str(error)) from None
    finally:
        if args.json:
            print(json.dumps([outcome._asdict() for outcome in outcomes], indent=1))
    return int(args.keys and any(o.is_stranger and (o.linked or o.effects) for o in outcomes))


main = Command(
    "armadico attacks",
    Options,
    run,
    "Start a society of real processes with a port on the loopback, attack it with a hand-written"
    " peer, and print what each attack did: to the robot, by the line to its controller; to the"
    " processes; to what watchers show. Exit code 1 if a stranger got a link to a society with"
    " keys, or had an effect.",
    EXAMPLES,
)
