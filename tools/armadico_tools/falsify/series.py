"""The work of `armadico falsify`: seeds until so many cycles were driven, kept in a file."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from msgspec import Struct, to_builtins
from rich.console import Console
from rich.table import Table

from armadico.cli.options import FailedError
from armadico.cli.pool import Pool
from armadico.config.loading import read_text
from armadico.core.judgement import Judgement, all_of, no, unknown, yes
from armadico.observe.conditions import software
from armadico_tools.falsify.cases import loads
from armadico_tools.falsify.search import Found, Search, preventable, smaller
from armadico_tools.falsify.trial import Outcome, run
from armadico_tools.faults.contacts import Cause
from armadico_tools.results import Rows
from armadico_tools.series import over

FILE = "falsify.csv"

CYCLES_A_SEED = 10_000
"""Assumed before the first seeds."""


class Row(Struct, frozen=True):
    """A row for a seed; `contacts` are by cause, and `case` is the worst one, both as JSON."""

    commit: str
    robot: str
    worlds: str
    seed: int
    cycles: int
    cases: int
    contacts: str
    worth: float
    cause: str = ""
    case: str = ""

    def __post_init__(self) -> None:
        for text in (self.contacts, self.case):
            json.loads(text or "{}")

    @property
    def of(self) -> tuple[str, str, str]:
        """What a series has in common."""
        return self.commit, self.robot, self.worlds

    @property
    def by_cause(self) -> Counter[str]:
        return Counter(json.loads(self.contacts))


class Ledger:
    """The seeds that were searched on this commit, for one robot and some worlds."""

    def __init__(self, folder: Path, robot: str, worlds: Sequence[str]) -> None:
        """Open the file, and make its folder if needed. Raises FailedError, ConfigError."""
        self.robot, self._of = robot, (software().commit, robot, " ".join(worlds))
        try:
            self._rows = Rows(folder / FILE, Row)
        except OSError as error:
            raise FailedError(f"cannot keep results in {folder}: {error}") from None
        known = (
            row for row in self._rows.read() if (row.commit, row.robot, row.worlds) == self._of
        )
        self.rows = {row.seed: row for row in known}

    @property
    def cycles(self) -> int:
        """Cycles driven."""
        return sum(row.cycles for row in self.rows.values())

    def add(self, found: Found) -> None:
        worst = found.worst
        row = Row(
            *self._of,
            found.seed,
            found.cycles,
            found.cases,
            json.dumps(found.contacts),
            worst.worth,
            worst.cause,
            worst.case.dumps(),
        )
        self._rows.add(row)
        self.rows[found.seed] = row


def repeat(given: str, *, as_json: bool) -> int:
    """Repeat one case, given as JSON or as a file of it. Raises ConfigError."""
    outcome = run(loads(given if given.lstrip().startswith("{") else read_text(given)))
    if as_json:
        judgement = to_builtins(judge_case(outcome))
        print(json.dumps({**_plain(outcome), "cycles": outcome.cycles, "judgement": judgement}))
    elif outcome.cause:
        print(f"{outcome.at:.2f} s: a contact at {outcome.speed:.2f} m/s: {outcome.cause}")
    else:
        print(f"no contact in {outcome.cycles} cycles; the nearest was {outcome.worth:.2f} s away")
    return judge_case(outcome).exit_code


def judge_case(outcome: Outcome) -> Judgement:
    """Whether a case makes no contact that the sensors could have prevented."""
    if outcome.found:
        return no(outcome.cause)
    if outcome.cause == Cause.UNKNOWN.value:
        return unknown(outcome.cause, "examine the case")
    return yes() if outcome.cycles else unknown("the robot drove in no cycle")


def search(
    robots: Sequence[str],
    worlds: Sequence[str],
    cycles: int,
    first: int,
    folder: Path,
    where: int | Pool,
    *,
    as_json: bool,
) -> int:
    """Search seeds for each robot, until so many cycles were driven; the code of its judgement.

    An interrupted search shows what was found so far, but it passes never. Raises ConfigError.
    """
    ledgers = {robot: Ledger(folder, robot, worlds) for robot in robots}
    complete = all(
        _until(ledger, robot, tuple(worlds), cycles, first, where)
        for robot, ledger in ledgers.items()
    )
    judgement = all_of(judge(ledger, cycles) for ledger in ledgers.values())
    commands = [text for ledger in ledgers.values() if (text := _worst(ledger))] if complete else []
    if as_json:
        rows = {robot: _summary(ledger) for robot, ledger in ledgers.items()}
        found = {"robots": rows, "wanted": cycles, "repeat": commands}
        print(json.dumps({**found, "judgement": to_builtins(judgement)}, indent=2))
    else:
        _show(ledgers, cycles)
        for command in commands:
            print(command)
        print(judgement)
    return judgement.exit_code


def judge(ledger: Ledger, cycles: int) -> Judgement:
    """Whether so many cycles passed without a contact that the sensors could have prevented."""
    found, perhaps, _ = _shares(ledger)
    if found:
        return no(f"{ledger.robot}: {found} contacts that the sensors could have prevented")
    if perhaps:
        might = f"{ledger.robot}: {perhaps} contacts that the sensors might have prevented"
        return unknown(might, "readings fit the obstacle and others, or none: examine the cases")
    if ledger.cycles < cycles:
        driven = f"{ledger.robot}: {ledger.cycles:,} of {cycles:,} cycles were driven"
        return unknown(driven, "run the same command again: it continues")
    return yes()


def _until(
    ledger: Ledger, robot: str, worlds: tuple[str, ...], cycles: int, first: int, where: int | Pool
) -> bool:
    """Search seeds until so many cycles were driven. Returns False if interrupted."""
    seed = first
    while (left := cycles - ledger.cycles) > 0:
        mean = ledger.cycles / len(ledger.rows) if ledger.rows else CYCLES_A_SEED
        tasks: list[Search] = []
        while len(tasks) < max(1, round(left / mean)):
            if seed not in ledger.rows:
                tasks.append(Search(robot, worlds, seed))
            seed += 1
        if not over(Search.run, tasks, where, f"seeds of {robot}", lambda _, f: ledger.add(f)):
            return False
    return True


def _worst(ledger: Ledger) -> str:
    """The command that repeats the worst case, made simpler; "" if nothing was found."""
    rows = [row for row in ledger.rows.values() if preventable(row.by_cause)]
    if not rows:
        return ""
    outcome = run(loads(min(rows, key=lambda row: row.worth).case))
    if not outcome.found:
        raise FailedError(f"a case of {outcome.case.robot} is not repeatable: a fault of this tool")
    return f"armadico falsify --repeat {shlex.quote(smaller(outcome).case.dumps())}"


def _shares(ledger: Ledger) -> tuple[int, int, int]:
    """Contacts that the sensors could have prevented, of which it is unknown, and others."""
    contacts = sum((row.by_cause for row in ledger.rows.values()), Counter[str]())
    found, perhaps = preventable(contacts), contacts[Cause.UNKNOWN.value]
    return found, perhaps, contacts.total() - found - perhaps


def _summary(ledger: Ledger) -> dict[str, object]:
    rows = ledger.rows.values()
    contacts = sum((row.by_cause for row in rows), Counter())
    found, perhaps, others = _shares(ledger)
    return {
        "seeds": len(rows),
        "cases": sum(row.cases for row in rows),
        "cycles": ledger.cycles,
        "preventable": found,
        "unknown": perhaps,
        "not_preventable": others,
        "contacts": dict(contacts),
    }


def _show(ledgers: dict[str, Ledger], wanted: int) -> None:
    table = Table("robot")
    for title in ("seeds", "cases", "cycles", "contacts to prevent", "unknown", "others"):
        table.add_column(title, justify="right")
    table.add_column("contacts by cause")
    for robot, ledger in ledgers.items():
        found = _summary(ledger)
        contacts = sum((row.by_cause for row in ledger.rows.values()), Counter[str]())
        causes = "\n".join(f"{count} {cause}" for cause, count in contacts.most_common())
        driven = f"{ledger.cycles:,} of {wanted:,}"
        numbers = str(found["seeds"]), str(found["cases"]), driven, *map(str, _shares(ledger))
        whole = ledger.cycles >= wanted
        table.add_row(robot, *numbers, causes or ("none" if whole else "none so far"))
    Console().print(table)


def _plain(outcome: Outcome) -> dict[str, object]:
    return {
        "found": outcome.found,
        "cause": outcome.cause,
        "at": outcome.at,
        "speed": outcome.speed,
        "worth": outcome.worth,
    }
