"""Search for contacts that the robot's sensors could have prevented, under a hostile holder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.cli.parsing import Command, at_least, group, option, several
from armadico_tools.command_options import Series

ROBOTS: Final = ("pioneer-2dx", "turtlebot3-burger")
"""One with sonars, one with a laser."""

CYCLES: Final = 100_000

EXAMPLES: Final = """\
  armadico falsify                             by sonars and by laser: a few minutes
  armadico falsify --robot jackal --cycles 1000000
  armadico falsify --world my.map --seed 1000  a world and seeds of your own
  armadico falsify --repeat case.json          repeat a case, as printed with a contact
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    robot: tuple[str, ...] = several(
        f"search with this robot's profile; repeatable (default: {', '.join(ROBOTS)})",
        metavar="NAME",
    )
    world: tuple[str, ...] = several(
        "drive in this world, a shipped name or a file; repeatable (default: several)",
        metavar="WORLD",
    )
    cycles: int | None = option(
        f"until N cycles were driven with each robot, those of earlier runs on this commit included"
        f" (default: {CYCLES})",
        metavar="N",
        must=at_least(1),
    )
    seed: int | None = option(
        "begin with seed S; seeds that were searched already are left out (default: 0)",
        metavar="S",
        must=at_least(0),
    )
    out: Path = option(
        "write results into DIR (default: results/falsify)",
        default=Path("results/falsify"),
        metavar="DIR",
    )
    repeat: str | None = option("repeat a case, given as JSON or as a file", metavar="CASE")
    series: Series = group(Series)


def run(args: Options) -> int:
    """Search, or repeat a case; 1 if a contact was made that could have been prevented."""
    if args.repeat is not None:
        given = ("robot", "world", "cycles", "seed")
        used = next((name for name in given if getattr(args, name) not in (None, ())), None)
        if used is not None:
            raise UsageError(f"--{used} is not used with --repeat: the case determines it")
    options.need("cmaes", "tools")
    from armadico_tools.falsify import cases, series

    if args.repeat is not None:
        return series.repeat(args.repeat, as_json=args.series.json)
    with args.series.workers() as where:
        return series.search(
            args.robot or ROBOTS,
            args.world or cases.WORLDS,
            args.cycles or CYCLES,
            args.seed or 0,
            args.out,
            where,
            as_json=args.series.json,
        )


main = Command(
    "armadico falsify",
    Options,
    run,
    "Search for contacts that the robot's sensors could have prevented. A hostile agent holds the"
    " wheels and drives on, whatever is in the way, among people who do not heed the robot, with"
    " delayed commands and lost readings; only the robot agent and its simulator are there. Each"
    " seed is an evolution (CMA-ES) of such cases towards the worst one. Results are kept in a"
    " file, so an interrupted search continues. The worst case is printed as a command that repeats"
    " it. Exit code 1 if there is one, 3 if none was found in fewer cycles than wanted.",
    EXAMPLES,
)
