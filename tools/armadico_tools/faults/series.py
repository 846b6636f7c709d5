"""The sum of many seeds or trials, and the file that counts them over time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Final, NamedTuple, TypeVar

from msgspec import Struct, json, structs

from armadico.cli.pool import Pool
from armadico.observe.conditions import source_hash
from armadico_tools import series
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.excuses import Strict
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.monitored import Monitored
from armadico_tools.faults.plan import Case, Outcome
from armadico_tools.faults.shrink import Shrinker
from armadico_tools.faults.sightings import Sight
from armadico_tools.faults.variants import case_of
from armadico_tools.faults.workload import run, when_broken
from armadico_tools.results import Kept, Rows

if TYPE_CHECKING:
    from armadico_tools.faults.trials import Trial

T = TypeVar("T")
R = TypeVar("R")

OUTCOMES: Final = "outcomes.csv"
SEEDS: Final = "seeds.csv"
TRIALS: Final = "trials.csv"

CAMPAIGN: Final = 1000
CAMPAIGN_S: Final = 60.0
"""After this many seeds of this mean duration (s), every situation must have occurred. The rarest
(an equal bid that is about to collide takes over) occurs in one of a hundred seeds of a minute."""


class Only(NamedTuple):
    """What seeds do not draw."""

    kinds: tuple[str, ...] = ()
    scenario: str | None = None
    robot: str | None = None
    variant: str | None = None
    coordination: str | None = None


EVERYTHING: Final = Only()


@dataclass(frozen=True)
class Task:
    """One seed, for a worker process.

    `calm`: without its faults; `strict`: judged without each excuse, too; `monitored`: judged by
    the monitor's auditor alone. With a planted defect the run ends at the first promise that is
    broken.
    """

    seed: int
    lasts: float  # s
    only: Only = EVERYTHING
    planted: str = ""
    calm: bool = False
    strict: bool = False
    monitored: bool = False

    def run(self) -> Outcome:
        """Draw the seed's case, and run it."""
        case = case_of(self.seed, self.lasts, *self.only)
        faults = () if self.calm else case.faults
        case = structs.replace(case, planted=self.planted, faults=faults)
        until = frozenset(Promise) if self.planted else frozenset()
        checker = Monitored if self.monitored else Strict if self.strict else Checker
        return run(case, until, checker)


@dataclass
class Summary:
    """Sums over the seeds that were run."""

    seeds: int = 0
    seconds: float = 0.0
    missions: int = 0
    driven_m: float = 0.0
    longest_s: float = 0.0
    overconfident_s: float = 0.0  # longest time of moving with a pose wrong beyond its covariance
    faults: Counter[str] = field(default_factory=Counter)
    violations: Counter[str] = field(default_factory=Counter)
    broken: list[Outcome] = field(default_factory=list)
    contacts: Counter[str] = field(default_factory=Counter)  # by the reason that voids them, or ""
    moving_s: dict[str, float] = field(default_factory=dict)  # likewise
    sights: Counter[str] = field(default_factory=Counter)
    ends: Counter[str] = field(default_factory=Counter)  # of missions (`workload.End`)
    needed: dict[str, Counter[str]] = field(default_factory=dict)  # seeds by excuse and promise
    variants: dict[str, Summary] = field(default_factory=dict)  # the same of each variant
    nested: bool = False  # whether it is that of a variant
    narrowed: bool = False  # whether only some kinds were selected
    unchecked: dict[Promise, str] = field(default_factory=dict)  # by the mechanism; what of each
    figures: dict[str, list[dict[str, float]]] = field(default_factory=dict)  # by kind of trial
    failed: dict[str, list[str]] = field(default_factory=dict)  # errors of trials, by kind

    def add(self, outcome: Outcome) -> None:
        self.seeds += 1
        self.seconds += outcome.case.lasts
        self.missions += outcome.missions
        self.driven_m += outcome.driven_m
        self.longest_s = max(self.longest_s, outcome.longest_s or 0.0)
        self.overconfident_s = max(self.overconfident_s, outcome.overconfident_s)
        self.faults.update(outcome.faults)
        self.violations.update(promise for promise, _, _ in outcome.violations)
        self.contacts.update(outcome.contacts)
        for why, seconds in outcome.moving_s.items():
            self.moving_s[why] = self.moving_s.get(why, 0.0) + seconds
        self.sights.update(outcome.sights)
        self.ends.update(outcome.ends)
        for excuse, promises in outcome.needed.items():
            self.needed.setdefault(excuse, Counter()).update(promises)
        if outcome.figures:
            self.figures.setdefault(outcome.kind, []).append(outcome.figures)
        if outcome.violations:
            self.broken.append(outcome)

        if not self.nested and not outcome.kind:
            part = self.variants.setdefault(outcome.case.variant, Summary(nested=True))
            part.add(outcome)

    def count(self, promise: Promise) -> int | None:
        """How often a promise was broken; None: none of it was checked."""
        found = self.violations[promise.name]
        return None if not found and self.unchecked.get(promise) == "" else found

    def reached_per_hour(self) -> float:
        """Missions reached in an hour of simulation."""
        return 3600.0 * self.missions / self.seconds if self.seconds else 0.0

    def void_contacts(self) -> dict[str, int]:
        """Contacts that do not count, by reason."""
        return {why: count for why, count in sorted(self.contacts.items()) if why and count}

    def void_shares(self) -> dict[str, float]:
        """The share of the moving time in which contacts are void, by reason."""
        whole = sum(self.moving_s.values()) or 1.0
        return {why: s / whole for why, s in sorted(self.moving_s.items()) if why and s}

    def void_share(self) -> float | None:
        """The share of the moving time in which contacts are void; None: nothing moved."""
        return sum(self.void_shares().values()) if sum(self.moving_s.values()) else None

    def figures_of(self) -> dict[str, object]:
        """The figures of a variant, for JSON."""
        return {
            "seeds": self.seeds,
            "missions_per_hour": round(self.reached_per_hour(), 1),
            "contacts": dict(sorted(self.contacts.items())),
            "void_share": None if (share := self.void_share()) is None else round(share, 4),
            "broken": len(self.broken),
        }

    def plain(self) -> dict[str, object]:
        """The sums, for JSON."""
        return {
            "seeds": self.seeds,
            "simulated_s": round(self.seconds, 1),
            "missions": self.missions,
            "missions_per_hour": round(self.reached_per_hour(), 1),
            "ends": dict(sorted(self.ends.items())),
            "variants": {name: part.figures_of() for name, part in sorted(self.variants.items())},
            "driven_m": round(self.driven_m, 1),
            "longest_to_move_s": round(self.longest_s, 3),
            "longest_unsaid_s": round(self.overconfident_s, 2),
            "faults": dict(sorted(self.faults.items())),
            "contacts": self.contacts[""],
            "void_contacts": self.void_contacts(),
            "moving_s": round(sum(self.moving_s.values()), 1),
            "void_share": {why: round(share, 4) for why, share in self.void_shares().items()},
            "needed": self.needed,
            "sights": {sight.name: self.sights[sight.name] for sight in Sight},
            "never": [sight.name for sight in missing(self)],
            "violations": {promise.name: self.count(promise) for promise in Promise},
            "not_checked": {promise.name: what for promise, what in self.unchecked.items()},
            "broken": [
                {
                    "seed": o.case.seed,
                    "variant": o.case.variant,
                    "scenario": o.case.scenario,
                    "robot": o.case.robot,
                    "violations": o.violations,
                }
                for o in self.broken
            ],
        }


class Line(Struct, frozen=True):
    """One figure of one kind of trial, over a series; times are ms."""

    kind: str
    figure: str
    counts: str
    trials: int
    median: float
    worst: float
    aim_median: float | None
    aim_worst: float | None

    @property
    def kept(self) -> bool:
        """Whether the aim was reached."""
        within = self.aim_worst is None or self.worst <= self.aim_worst
        return within and (self.aim_median is None or self.median <= self.aim_median)


def lines(summary: Summary, trials: Iterable[Trial]) -> list[Line]:
    """A line for each figure that was measured."""
    found = []
    for trial in trials:
        rows = summary.figures.get(trial.name, [])
        for f in trial.figures:
            values = [row[f.name] for row in rows if f.name in row]
            if values:
                numbers = len(values), round(median(values), 1), max(values)
                found.append(Line(trial.name, f.name, f.text, *numbers, f.median, f.worst))
    return found


class Ran(Struct, frozen=True):
    """A row for a seed or a trial; `violations` counts them by promise."""

    commit: str
    seed: int
    scenario: str
    seconds: float
    kinds: str = ""  # of faults, if only some were selected; of a trial
    faults: int = 0
    violations: str = ""
    what: str = ""  # the first violation
    figures: str = ""  # counts or measurements, as JSON

    def __post_init__(self) -> None:
        json.decode(self.figures or "{}", type=dict[str, object])


class Ledger:
    """The file that counts seeds or trials, with the commit of each."""

    def __init__(self, folder: Path, commit: str, name: str = SEEDS) -> None:
        """Open the file, and make its folder if needed. Raises OSError."""
        self._rows = Rows(folder / name, Ran)
        self.path = self._rows.path
        self._commit = commit

    def next_seed(self) -> int:
        """The seed after the largest that was run on this commit, with any faults."""
        return max((ran.seed + 1 for ran in self._mine()), default=0)

    def count(self) -> tuple[int, int]:
        """The number of seeds run on this commit, and of those that broke a promise."""
        mine = self._mine()
        return len({ran.seed for ran in mine}), sum(bool(ran.violations) for ran in mine)

    def add(self, outcome: Outcome, kinds: Sequence[str] = ()) -> None:
        case = outcome.case
        broken = Counter(promise for promise, _, _ in outcome.violations)
        counted = outcome.figures or {
            name: getattr(outcome, name)
            for name in ("longest_s", "missions", "driven_m", "contacts", "moving_s", "ends")
        } | {"variant": case.variant, "robot": case.robot}
        self._rows.add(
            Ran(
                *(self._commit, case.seed, case.scenario, case.lasts),
                kinds=outcome.kind or " ".join(kinds),
                faults=sum(outcome.faults.values()),
                violations=" ".join(f"{name}:{count}" for name, count in sorted(broken.items())),
                what=outcome.violations[0][2] if outcome.violations else "",
                figures=json.encode(counted).decode(),
            )
        )

    def _mine(self) -> list[Ran]:
        return [ran for ran in self._rows.read() if ran.commit == self._commit]


def kept(
    path: Path,
    function: Callable[[T], R],
    tasks: Sequence[T],
    where: int | Pool,
    done: Callable[[T, R], None],
    new: Callable[[T, R], None] = lambda _task, _result: None,
) -> bool:
    """Apply a function of this package to tasks in processes, unless the file has the result.

    Results are stored for this code. `done` is called with each, `new` with each that the file did
    not have. Returns False if it was interrupted. Raises OSError if the file cannot be used.
    """
    stored = Kept(path, function, source_hash(*sorted(Path(__file__).parent.glob("*.py"))))
    known, missing = series.known(stored, tasks, repr)
    for at, result in known.items():
        done(tasks[at], result)

    def keep(task: T, result: R) -> None:
        stored.add(repr(task), result)
        new(task, result)
        done(task, result)

    return series.over(function, [tasks[at] for at in missing], where, "seeds", keep)


def smallest(
    outcome: Outcome, tries: int, step: Callable[[], None] = lambda: None
) -> tuple[Case, str]:
    """A small case that breaks the promise that an outcome broke first, and that promise.

    It makes at most `tries` runs, and calls `step` after each.
    """
    promise = Promise[outcome.violations[0][0]]
    shrinker = Shrinker(lambda case: when_broken(case, promise), tries, step=step)
    return shrinker.shrink(outcome.case), promise.name


def missing(summary: Summary) -> list[Sight]:
    """Situations that a campaign of this size must show, and that never occurred."""
    if summary.seeds < CAMPAIGN or summary.seconds < CAMPAIGN * CAMPAIGN_S or summary.narrowed:
        return []
    return [sight for sight in Sight if not summary.sights[sight.name]]
