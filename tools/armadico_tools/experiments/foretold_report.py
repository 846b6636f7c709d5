"""How right rehearsals were: the table and the reliability diagram, from the rows of any runs.

    python -m armadico_tools.experiments.foretold_report FOLDER... --picture FILE.png

reads what the experiment `foretold` has kept so far in folders of results, also of several runs and
unfinished ones, and prints the table.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from statistics import mean, median
from typing import TYPE_CHECKING, Final

import msgspec
from msgspec import Struct

from armadico_tools.markdown import table
from armadico_tools.results import Result, rows_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FOUND: Final = "found.csv"
BOUNDS: Final = (0.0, 0.25, 0.5, 0.75, 0.9, 0.95, 1.0)
"""Of the bins of told probabilities; each has its upper bound, the first one both."""

SURE: Final = 1.96
"""Of Wilson's interval: 95 %."""


class Foretold(Struct, frozen=True):
    """One rehearsal of a drive, and what became of the drive; times from the rehearsal on, s.

    `met` is what the drive met that the map does not have; `least_s` to `most_s` the time that was
    told; `plain_s` and `put_s` the times of the samples that arrive: in which the map holds, and
    with something put on the way.
    """

    place: str
    robot: str
    seed: int
    met: str
    foreign: bool
    under_way: bool
    answer: str
    chance: float | None
    arrives: int
    samples: int
    despite: tuple[int, int]
    hidden_m: float
    stands: float
    lacks: tuple[str, ...]
    least_s: float | None
    most_s: float | None
    plain_s: tuple[float, ...]
    put_s: tuple[float, ...]
    clearance_m: float | None
    says: str
    arrived: bool
    time_s: float
    went_clear_m: float | None
    why: str


def kept(folders: Iterable[Path]) -> list[Foretold]:
    """The rows that are kept in folders of results, each once. Raises ConfigError."""
    found: dict[str, list[Foretold]] = {}
    for folder in folders:
        for _, row in rows_of(folder / FOUND, Result):
            found[row.key] = msgspec.json.decode(row.found, type=list[Foretold])
    return [one for each in found.values() for one in each]


# Measures -----------------------------------------------------------------------------------------


def brier(found: Iterable[Foretold]) -> float | None:
    """The mean square of the difference between told probability and what happened."""
    squares = [(one.chance - one.arrived) ** 2 for one in found if one.chance is not None]
    return mean(squares) if squares else None


def bins(found: Iterable[Foretold]) -> list[list[Foretold]]:
    """The rows by their told probability."""
    sorted_in: list[list[Foretold]] = [[] for _ in BOUNDS[1:]]
    for one in found:
        if one.chance is not None:
            chance = one.chance
            at = next(k for k, most in enumerate(BOUNDS[1:]) if chance <= most)
            sorted_in[at].append(one)
    return sorted_in


def wilson(k: int, n: int) -> tuple[float, float]:
    """Wilson's interval of a share of k in n, 95 %."""
    share, z = k / n, SURE
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * (share * (1 - share) / n + z * z / (4 * n * n)) ** 0.5
    return max(0.0, middle - half), min(1.0, middle + half)


def _within(one: Foretold) -> bool | None:
    """Whether the time was within what was told."""
    if not one.arrived or one.least_s is None or one.most_s is None:
        return None
    return one.least_s <= one.time_s <= one.most_s


def _wide(found: Iterable[Foretold]) -> str:
    """The mean width of the told times, relative to the medians of the samples."""
    wide = [
        (one.most_s - one.least_s) / median(one.plain_s)
        for one in found
        if one.least_s is not None and one.most_s is not None and one.plain_s
    ]
    return f"{mean(wide):.0%}" if wide else "-"


def _nearer(one: Foretold) -> bool | None:
    """Whether the drive came nearer to an obstacle than any sample, by more than 5 cm."""
    if one.clearance_m is None or one.went_clear_m is None:
        return None
    return one.went_clear_m < one.clearance_m - 0.05


def _of(found: Iterable[Foretold], measure: Callable[[Foretold], bool | None]) -> str:
    known = [value for one in found if (value := measure(one)) is not None]
    return f"{sum(known)} of {len(known)}"


def _row(name: str, found: Sequence[Foretold]) -> tuple[object, ...]:
    driven = [one for one in found if one.chance is not None]
    score = brier(driven)
    answers = [sum(one.answer == each for one in found) for each in ("yes", "no", "unknown")]
    told = [one.chance for one in driven if one.chance is not None]
    return (
        name,
        len(found),
        "/".join(map(str, answers)),
        f"{mean(told):.2f}" if told else "-",
        f"{mean(one.arrived for one in driven):.2f}" if driven else "-",
        "-" if score is None else f"{score:.3f}",
        _of(found, _within),
        _wide(found),
        _of(found, _nearer),
        _of((one for one in found if one.answer == "yes"), lambda one: not one.arrived),
        _of((one for one in found if one.answer == "no"), lambda one: one.arrived),
        _of((one for one in found if one.answer == "unknown"), lambda one: one.arrived),
    )


HEAD: Final = (
    *("rehearsed", "n", "yes/no/unknown", "foretold", "arrived", "Brier", "within", "wide"),
    *("nearer", "wrong yes", "wrong no", "unknown: arrived"),
)


def summed(found: Sequence[Foretold]) -> str:
    """The tables of some rehearsals, and the drives whose answer was wrong."""
    groups: list[tuple[str, list[Foretold]]] = [("**all**", list(found))]
    groups += [
        (f"**{name}**", [one for one in found if one.under_way is way])
        for name, way in (("before it begins", False), ("under way", True))
    ]
    groups += [
        (f"**{name}**", [one for one in found if one.foreign is there])
        for name, there in (("shipped worlds", False), ("foreign worlds", True))
    ]
    for field in ("robot", "met", "place"):
        for name in dict.fromkeys(getattr(one, field) for one in found):
            groups.append((name, [one for one in found if getattr(one, field) == name]))
    wrong = [one for one in found if one.answer == ("no" if one.arrived else "yes")]
    return "\n".join(
        (
            table(HEAD, [_row(*group) for group in groups if group[1]]),
            table(("foretold", "n", "mean", "arrived", "95 %"), _reliability(found)),
            table(("wrong", "seed", "rehearsal", "drive"), map(_told, wrong)),
        )
    )


def _told(one: Foretold) -> tuple[object, ...]:
    when = ", under way" if one.under_way else ""
    name = f"{one.robot} {one.place}, {one.met}{when}"
    went = f"arrived in {one.time_s:.0f} s" if one.arrived else one.why
    return name, one.seed, f"{one.answer}: {one.says}", went


def _reliability(found: Iterable[Foretold]) -> list[tuple[object, ...]]:
    rows: list[tuple[object, ...]] = []
    for low, high, those in zip(BOUNDS, BOUNDS[1:], bins(found), strict=False):
        if those:
            came = sum(one.arrived for one in those)
            least, most = wilson(came, len(those))
            told = mean(one.chance for one in those if one.chance is not None)
            rows.append(
                (
                    f"{low:.2f} to {high:.2f}",
                    len(those),
                    f"{told:.2f}",
                    f"{came / len(those):.2f}",
                    f"{least:.2f} to {most:.2f}",
                )
            )
    return rows


# The picture --------------------------------------------------------------------------------------


def draw(found: Sequence[Foretold], path: Path) -> None:
    """The reliability diagram: what happened by what was told, with Wilson's intervals."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6, 4.8))
    FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1, height_ratios=(3, 1), sharex=True)
    upper.plot((0, 1), (0, 1), color="#8a8f94", linewidth=1, linestyle=":")
    for way, name, colour in (
        (False, "before it begins", "#0072b2"),
        (True, "under way", "#d55e00"),
    ):
        _curve(upper, [one for one in found if one.under_way is way], name, colour)
    score = brier(found)
    upper.set_title(f"n = {len(found)}, Brier score {score or 0.0:.3f}", fontsize=9)
    upper.set_ylabel("arrived")
    upper.legend(fontsize=8, loc="upper left")
    lower.hist(
        [one.chance for one in found if one.chance is not None], bins=20, range=(0, 1), color="#555"
    )
    lower.set_yscale("symlog")
    lower.set_xlabel("told probability of arriving")
    lower.set_ylabel("rehearsals")
    figure.tight_layout()
    figure.savefig(path, dpi=110, metadata={"Software": None})


def _curve(axes: Axes, found: Sequence[Foretold], name: str, colour: str) -> None:
    points = []
    for those in bins(found):
        if those:
            came = sum(one.arrived for one in those)
            told = mean(one.chance for one in those if one.chance is not None)
            points.append((told, came / len(those), *wilson(came, len(those))))
    if not points:
        return
    chances, shares = [point[0] for point in points], [point[1] for point in points]
    low = [max(0.0, share - least) for _, share, least, _ in points]
    high = [max(0.0, most - share) for _, share, _, most in points]
    axes.errorbar(
        chances,
        shares,
        yerr=(low, high),
        marker="o",
        markersize=4,
        capsize=2,
        color=colour,
        label=name,
    )


def main(words: Sequence[str]) -> int:
    """Print the table of folders; with --picture FILE.png draw the diagram."""
    given = list(words)
    picture = None
    if "--picture" in given:
        at = given.index("--picture")
        picture = Path(given[at + 1])
        del given[at : at + 2]
    found = kept(map(Path, given))
    if not found:
        print("no rows in", *given, file=sys.stderr)
        return 2
    print(summed(found))
    if picture is not None:
        draw(found, picture)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
