"""The options of `armadico faults`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from armadico.cli.parsing import at_least, between, flag, group, option, several
from armadico.launch.options import coordination_option
from armadico_tools.command_options import Series
from armadico_tools.faults import MINUTES, SEEDS, TRIALS


@dataclass(frozen=True, kw_only=True)
class Virtual:
    seeds: int | None = option(f"run N seeds (default: {SEEDS})", metavar="N", must=at_least(1))
    first: int | None = option(
        "start with seed S (default: the next one not run)", metavar="S", must=at_least(0)
    )
    minutes: float | None = option(
        f"simulate M minutes (default: {MINUTES})", metavar="M", must=between(0.2, 60)
    )
    robot: str | None = option(
        "drive this robot: a shipped profile, or a file (default: drawn)", metavar="NAME"
    )
    variant: str | None = option("run only this variant (see --list; default: drawn)", metavar="V")
    coordination: str | None = coordination_option(
        "decide by this mechanism, as armadico run does; rules of ballots alone are then not"
        " checked (default: ballots)"
    )
    excuses: bool = flag("judge each seed without each excuse, too, and count which are needed")
    planted: tuple[str, ...] = several(
        "plant defect D of --list in the product, or each (all), and count the seeds that find it;"
        " repeatable",
        metavar="D",
    )
    once: bool = flag("leave a planted defect out once a seed has found it")
    monitored: bool = flag(
        "with --planted: judge by the monitor's auditor alone, by messages and without faults"
    )
    repeat: str | None = option("repeat a case, given as JSON or as a file", metavar="CASE")


@dataclass(frozen=True, kw_only=True)
class Live:
    live: bool = flag("run trials; those with hosts use network namespaces and need root")
    trials: int | None = option(
        f"N of each kind (default: {TRIALS})", metavar="N", must=at_least(1)
    )
    seed: int | None = option("seed of moments and links (default: 0)")
    record: Path | None = option("record the trials of one kind", metavar="FILE.mcap")


@dataclass(frozen=True, kw_only=True)
class Kept:
    recording: Path | None = option("check FILE, and run nothing", metavar="FILE")
    namespace: str | None = option("check this robot (default: the only one)", metavar="NS")


@dataclass(frozen=True, kw_only=True)
class Options:
    kind: tuple[str, ...] = several(
        "use only this kind of fault, or of trial; repeatable (see --list)", metavar="K"
    )
    scenario: str | None = option(
        "drive SCENARIO to and fro: a shipped one, or a file (default: drawn; with --live straight"
        " ahead in an empty world, where only goto bids; the aims are meant for that)",
        metavar="SCENARIO",
    )
    list: bool = flag("list the kinds, the variants and the promises")
    out: Path = option(
        "write results into DIR (default: results/faults)",
        default=Path("results/faults"),
        metavar="DIR",
    )
    series: Series = group(Series)
    virtual: Virtual = group(Virtual, "on the virtual mesh")
    real: Live = group(Live, "with real processes")
    kept: Kept = group(Kept, "with a recording")
