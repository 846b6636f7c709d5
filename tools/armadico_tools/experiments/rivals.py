"""The rivals study: coordination mechanisms side by side where agents' wishes conflict.

`docs/rivals-plan.md` has the hypotheses, measures and tests, and was there before any run;
`rivals-plan-2.md` has those of two goals and of batteries. The seeds of the studies' worlds follow
from their text, so nobody has chosen or seen them; `--pilot` drives other worlds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import sha256
from json import dumps
from pathlib import Path
from statistics import fmean, median
from typing import Final

from msgspec import Struct
from msgspec.structs import replace

from armadico.cli.options import FailedError, UsageError
from armadico.core.errors import no_such
from armadico.core.installed import entries, loaded
from armadico.core.mechanisms import GROUP, Coordination, all_coordinations, coordination, lacks
from armadico.core.messages import BALLOTS
from armadico.core.resources import WHEELS
from armadico_tools.experiments import BEHAVIOURS, SITUATIONS, Rivals, paired
from armadico_tools.experiments.bidders import Recharge, Visit
from armadico_tools.experiments.driving import Cell, Drive, Kill, Sample, drive
from armadico_tools.experiments.runner import Context, Experiment, Part
from armadico_tools.experiments.tables import number
from armadico_tools.markdown import table

PLAN: Final = Path(__file__).parents[3] / "docs" / "rivals-plan.md"
PLAN_2: Final = PLAN.with_name("rivals-plan-2.md")
FURTHER: Final = "\n## Further runs"
"""With what the second plan continues that was added after its runs: files of cells, with seeds of
their own. Its own seeds do not depend on that."""

LIAR: Final = "liar"
SECOND: Final = {"two-goals": (Visit.name,), "battery": ("battery-sensor", Recharge.name)}
"""The situations of the second plan, and the agents that take part in them. They have a table of
their own, and are driven with the default behaviours alone."""

SECONDARY: Final = ("people", LIAR, *SECOND)
"""Situations of the default behaviours alone, outside the first plan's primary tables."""

UNMEASURED: Final = (LIAR, *SECOND)
"""Situations without yardsticks: one controller cannot drive for several agents."""

KILLED_IN: Final = "clutter"
REPLACED: Final = ("goto", "avoid", "gothrough")
"""The agents that a yardstick drives without: it coordinates nothing."""

CONTESTED_PERCENT: Final = 20.0
"""A world takes part if by ballots at least so many cycles are contested."""

CANDIDATES: Final = 2
"""Worlds that are tried for each that is wanted."""

CLEAN_MARGIN: Final = 0.05
TIME_MARGIN: Final = 0.05
"""The smallest effects of interest: 5 points of clean runs, 5 % of the time."""

LEVEL: Final = 0.05
LEAST_WORLDS: Final = 30
LEAST_WORLDS_2: Final = 16
"""For a verdict, by the first and by the second plan."""
FEW: Final = "too few worlds"

BIDDERS: Final = (3, 6, 12, 24)
COUNTED: Final = 3  # runs for each number of bidders

NOTE: Final = (
    "By the plans, `docs/rivals-plan.md` and `docs/rivals-plan-2.md`. *Clean*: the goal is reached"
    " and nothing touched; with two goals both are reached, and a battery is never empty. Each"
    " world is driven once by each mechanism, and compared with ballots in the same worlds:"
    " *clean alone* are the worlds that only the mechanism, or only ballots, drove clean;"
    " difference of the shares with Newcombe's 95 % interval, McNemar's exact p, corrected by Holm"
    " over the mechanisms of the table. *Time*: ratio of the driving times where both are clean"
    " (Hodges and Lehmann, 95 %); *same*: p of two one-sided tests of 5 %. Verdicts: *better* or"
    " *worse* in clean runs, corrected p < 0.05; *not worse*: the interval is above -5 points."
    " No verdict with fewer than 30 worlds, or 16 by the second plan."
)


# Runs ---------------------------------------------------------------------------------------------


def seed_of(situation: str, index: int, *, pilot: bool) -> int:
    """The seed of a world: of the study by the plan's text, of a pilot not. Raises FailedError."""
    if pilot:
        text = "pilot"
    else:
        plan = PLAN_2 if situation in SECOND else PLAN
        try:
            text = plan.read_text(encoding="utf-8").partition(FURTHER)[0]
        except OSError:
            raise FailedError(
                f"{plan.name} is not there: the study needs a checkout; --pilot does not"
            ) from None
    return int.from_bytes(sha256(f"{text}\0{situation}\0{index}".encode()).digest()[:6])


def arms(chosen: Rivals) -> dict[str, Cell]:
    """The mechanisms by name, ballots first.

    By default these are all for the wheels but those of `left_out`, without presets and those whose
    numbers are learnt. Each tells agents of their share what its authors have it tell, unless
    something else is chosen. Raises UsageError.
    """
    known = _known()
    found = {BALLOTS: Cell(BALLOTS)}
    for name in chosen.mechanism or [each for each in _usual() if each not in left_out(chosen)]:
        if name == BALLOTS:
            continue
        if name not in known:
            raise UsageError(no_such("mechanism", name, [BALLOTS, *known]))
        if lacking := lacks(known[name], {}):
            raise UsageError(f"--mechanism {name}: {lacking}")
        for told in (chosen.told if known[name].arbiter else ()) or ("",):
            title = f"{name} told {told}" if told else name
            found[title] = Cell(title, coordination=name, told=told or None)
    return found


def _known() -> dict[str, Coordination]:
    return {
        name: each
        for name, each in sorted(all_coordinations().items())
        if getattr(each, "resource", WHEELS) == WHEELS
    }


def _usual() -> list[str]:
    """Those that are compared by default, installed or not."""
    return [
        name
        for name, each in _known().items()
        if not getattr(each, "without", "") and not getattr(each, "tuned", False)
    ]


def left_out(chosen: Rivals) -> dict[str, str]:
    """The mechanisms that cannot be compared here though none was chosen, each with the reason."""
    known = _known()
    names = () if chosen.mechanism else _usual()
    found = {name: lacking for name in names if (lacking := lacks(known[name], {}))}
    if not chosen.mechanism:
        fit = {point.name for point, _ in loaded(GROUP)}
        why = "its package cannot be loaded; the message on stderr has the reason"
        found |= {point.name: why for point in entries(GROUP) if point.name not in fit}
    return found


def cell(situation: str, behaviours: str, arm: Cell) -> Cell:
    """An arm in a situation."""
    besides = SECOND.get(situation, (LIAR,) if situation == LIAR else ())
    return replace(
        arm,
        name=f"{situation} {behaviours} {arm.name}",
        world=KILLED_IN if situation == LIAR else situation,
        besides=besides,
        parameters=BEHAVIOURS[behaviours],
        sets=_placed(arm, besides[-1]) if situation in SECOND else (),
    )


def _placed(arm: Cell, name: str) -> tuple[str, ...]:
    """Settings by which a mechanism that names agents names this one: directly above goto."""
    arbiter = coordination(arm.coordination).arbiter if arm.coordination else ""
    names = ["teleop", "relocate", "avoid", "gothrough", name, "goto"]
    order = dumps(names)
    groups = dumps([["teleop"], ["relocate"], ["avoid"], [name], ["gothrough", "goto"]])
    wires = [(name, "goto"), ("gothrough", "goto"), ("gothrough", name)]
    wires += [("avoid", "gothrough"), ("avoid", name), ("avoid", "goto")]
    tables = ", ".join(f'{{source = "{a}", target = "{b}"}}' for a, b in wires)
    sources = ", ".join(f'{{name = "{each}"}}' for each in names)
    methods = dumps([[each] for each in names])
    rule = f"#(teleop, relocate, -(avoid, gothrough), &({name}, avoid), &(goto, avoid))"
    of_arbiter = {
        "priority": f"order={order}",
        "resolver": f"order={groups}",
        "twist-mux": f"sources=[{sources}]",
        "behaviour-tree": f"order={order}",
        "arbitration-graph": f"order={order}",
        "sequencing": f"methods={methods}",
        "subsumption": f"wires=[{tables}]",
        "operators": f"rule={dumps(rule)}",
    }
    if name == Recharge.name:  # it, not the mission's goal, is what an empty battery makes stronger
        of_arbiter["schemas"] = f"scarce={{{name} = 1.5, avoid = 0.75}}"
    return (f"{arbiter}.{of_arbiter[arbiter]}",) if arbiter in of_arbiter else ()


def measured(task: tuple[Cell, int]) -> Sample:
    """How contested a world is, by a run with other delays than the study's."""
    of, seed = task
    return Drive(of, seed, mesh_seed=seed + 1).go().sample()


def _situations(context: Context, behaviours: str) -> list[str]:
    """Those that are driven; by default the secondary ones with default behaviours alone."""
    usual = behaviours == next(iter(BEHAVIOURS))
    return list(
        context.rivals.situation or [name for name in SITUATIONS if usual or name not in SECONDARY]
    )


def _chosen_behaviours(context: Context) -> list[str]:
    return list(context.rivals.behaviours or BEHAVIOURS)


def _candidates(context: Context) -> list[tuple[Cell, int]]:
    """Worlds to measure, by ballots."""
    pilot = context.rivals.pilot
    return [
        (cell(world, behaviours, Cell(BALLOTS)), seed_of(world, index, pilot=pilot))
        for behaviours in _chosen_behaviours(context)
        for world in dict.fromkeys(
            KILLED_IN if name == LIAR else name for name in _situations(context, behaviours)
        )
        for index in range(CANDIDATES * context.runs)
    ]


def _worlds(context: Context, situation: str, behaviours: str) -> list[int]:
    """The seeds of the first worlds that are contested enough."""
    name = cell(KILLED_IN if situation == LIAR else situation, behaviours, Cell(BALLOTS)).name
    found = [
        one.seed
        for one in context.found["worlds"]
        if one.cell == name and (one.contested_percent or 0.0) >= CONTESTED_PERCENT
    ]
    return found[: context.runs]


def _runs(context: Context) -> list[tuple[Cell, int]]:
    return [
        (cell(situation, behaviours, arm), seed)
        for behaviours in _chosen_behaviours(context)
        for situation in _situations(context, behaviours)
        for arm in arms(context.rivals).values()
        for seed in _worlds(context, situation, behaviours)
    ]


def alone(situation: str, name: str) -> Cell:
    """A yardstick in a situation; it has no other set of behaviours."""
    title = f"{situation} {name} alone"
    return Cell(title, world=situation, without=REPLACED, besides=(name,))


def _alone(context: Context) -> list[tuple[Cell, int]]:
    """The yardsticks in the worlds of the comparison, each once; not where others want to drive."""
    return list(
        dict.fromkeys(
            (alone(situation, name), seed)
            for behaviours in _chosen_behaviours(context)
            for situation in _situations(context, behaviours)
            if situation not in UNMEASURED
            for name in context.rivals.yardstick
            for seed in _worlds(context, situation, behaviours)
        )
    )


def _killed(context: Context) -> list[tuple[Cell, int]]:
    """One process dies, of one and of two of each; with the first behaviours only."""
    behaviours = _chosen_behaviours(context)[0]
    if KILLED_IN not in _situations(context, behaviours):
        return []
    return [
        (replace(_faulty(behaviours, arm), name=_killed_name(arm, two=two), redundant=two), seed)
        for arm in arms(context.rivals).values()
        for two in (False, True)
        for seed in _worlds(context, KILLED_IN, behaviours)
    ]


def _faulty(behaviours: str, arm: Cell) -> Cell:
    return replace(cell(KILLED_IN, behaviours, arm), kill=Kill())


def _killed_name(arm: Cell, *, two: bool) -> str:
    return f"killed {arm.name}, {'two' if two else 'one'} of each"


def _counted(context: Context) -> list[tuple[Cell, int]]:
    """Runs that count messages; the second plan has none."""
    pilot = context.rivals.pilot
    if {*_situations(context, _chosen_behaviours(context)[0])} <= {*SECOND}:
        return []
    return [
        (
            replace(arm, name=f"{bidders} bidders {arm.name}", world="hall", bidders=bidders),
            seed_of("hall", index, pilot=pilot),
        )
        for arm in arms(context.rivals).values()
        for bidders in BIDDERS
        for index in range(min(COUNTED, context.runs))
    ]


# Analysis -----------------------------------------------------------------------------------------


class Contrast(Struct, frozen=True):
    """A mechanism against ballots in the same worlds; `verdict` is by the plan."""

    mechanism: str
    worlds: int
    clean: int
    touched: int
    reached: int
    seconds: float | None  # median of its clean runs
    only_mechanism: int
    only_ballots: int
    difference: float
    low: float
    high: float
    p: float
    p_corrected: float
    both_clean: int
    ratio: float | None
    ratio_low: float | None
    ratio_high: float | None
    same_p: float
    verdict: str


def contrasts(by_arm: Mapping[str, Sequence[Sample]], least: int = LEAST_WORLDS) -> list[Contrast]:
    """Each mechanism against ballots; the samples of all are in the same order of worlds.

    With fewer than the `least` worlds there is no verdict.
    """
    found = [
        one
        for name, samples in by_arm.items()
        if name != BALLOTS and (one := _contrast(name, samples, by_arm[BALLOTS])) is not None
    ]
    corrected = paired.holm([one.p for one in found])
    return [
        replace(one, p_corrected=p, verdict=_verdict(replace(one, p_corrected=p), least))
        for one, p in zip(found, corrected, strict=True)
    ]


def _contrast(name: str, ours: Sequence[Sample], theirs: Sequence[Sample]) -> Contrast | None:
    both = list(zip(ours, theirs, strict=True))
    share = paired.shares([(a.clean, b.clean) for a, b in both])
    if share is None:
        return None
    times = [(a.tt_s, b.tt_s) for a, b in both if a.clean and b.clean]
    ratio = paired.ratio(times)
    seconds = [one.tt_s for one in ours if one.clean]
    return Contrast(
        mechanism=name,
        worlds=share.n,
        clean=len(seconds),
        touched=sum(bool(one.collisions) for one in ours),
        reached=sum(one.reached for one in ours),
        seconds=median(seconds) if seconds else None,
        only_mechanism=share.only_first,
        only_ballots=share.only_second,
        difference=share.difference,
        low=share.low,
        high=share.high,
        p=share.p,
        p_corrected=1.0,
        both_clean=len(times),
        ratio=None if ratio is None else ratio.difference,
        ratio_low=None if ratio is None else ratio.low,
        ratio_high=None if ratio is None else ratio.high,
        same_p=paired.sameness(times, TIME_MARGIN),
        verdict="",
    )


def _verdict(one: Contrast, least: int) -> str:
    if one.worlds < least:
        return FEW
    if one.p_corrected < LEVEL:
        words = ["better" if one.difference > 0.0 else "worse"]
    else:
        words = ["not worse" if one.low > -CLEAN_MARGIN else "undecided"]
    if one.ratio_low is not None and one.ratio_high is not None:
        if one.same_p < LEVEL:
            words.append("as fast")
        elif one.ratio_high < 1.0:
            words.append("faster")
        elif one.ratio_low > 1.0:
            words.append("slower")
    return ", ".join(words)


def pooled(
    found: Sequence[Sample], names: Sequence[str], situations: Sequence[str], behaviours: str
) -> dict[str, list[Sample]]:
    """The samples of each arm over several situations, in the same order of worlds."""
    by_cell: dict[str, list[Sample]] = {}
    for one in found:
        by_cell.setdefault(one.cell, []).append(one)
    return {
        name: [
            sample
            for situation in situations
            for sample in by_cell.get(cell(situation, behaviours, Cell(name)).name, [])
        ]
        for name in names
    }


def report(context: Context) -> str:
    names, found = list(arms(context.rivals)), context.found["runs"]
    missing = left_out(context.rivals)
    context.lacking += [f"Not compared: {name}; {why}" for name, why in missing.items()]
    parts: list[str] = [_measured_worlds(context)]
    rows: list[tuple[object, ...]] = []
    for behaviours in _chosen_behaviours(context):
        of_set = _situations(context, behaviours)
        primary = [name for name in of_set if name not in SECONDARY]
        second = [name for name in of_set if name in SECOND]
        pools = [("the primary situations", primary)] if primary else []
        pools += [("the second plan's situations", second)] if len(second) > 1 else []
        for title, situations in (*pools, *((name, [name]) for name in of_set)):
            of = pooled(found, names, situations, behaviours)
            both = len(second) > 1 and situations == second
            made = contrasts(of, LEAST_WORLDS_2 if both else LEAST_WORLDS)
            rows += [(behaviours, title, *_fields(one)) for one in made]
            parts.append(f"## {behaviours.capitalize()} behaviours, {title}\n\n{_table(of, made)}")
    if rows and not context.rivals.pilot and {row[-1] for row in rows} == {FEW}:
        context.lacking.append(
            f"No verdict: too few worlds in each table; expected {LEAST_WORLDS}, and"
            f" {LEAST_WORLDS_2} over the situations of the second plan"
        )
    context.rows("contrasts", ("behaviours", "situation", *Contrast.__struct_fields__), rows)
    parts += [_table_of_kills(context, names), _table_of_messages(context, names)]
    return "\n\n".join(filter(None, [*parts, *_table_of_yardsticks(context)]))


def _fields(one: Contrast) -> list[object]:
    values = [getattr(one, name) for name in Contrast.__struct_fields__]
    return [round(value, 6) if isinstance(value, float) else value for value in values]


def _measured_worlds(context: Context) -> str:
    by_cell: dict[str, list[float]] = {}
    for one in context.found["worlds"]:
        by_cell.setdefault(one.cell, []).append(one.contested_percent or 0.0)
    rows = [
        (
            name.removesuffix(f" {BALLOTS}"),
            len(values),
            sum(value >= CONTESTED_PERCENT for value in values),
            min(context.runs, sum(value >= CONTESTED_PERCENT for value in values)),
            f"{median(values):.0f}",
        )
        for name, values in by_cell.items()
    ]
    head = ("situation", "worlds measured", "contested enough", "driven", "contested %, median")
    return f"## Worlds\n\n{table(head, rows)}"


def _table_of_yardsticks(context: Context) -> list[str]:
    """Counts alone, in the worlds of each set of behaviours: no test, and no verdict."""
    if not context.rivals.yardstick:
        return []
    rows: list[tuple[object, ...]] = []
    for behaviours in _chosen_behaviours(context):
        for situation in _situations(context, behaviours):
            if situation in UNMEASURED:
                continue
            worlds = _worlds(context, situation, behaviours)
            ballots = cell(situation, behaviours, Cell(BALLOTS)).name
            by_cell = {
                BALLOTS: [one for one in context.found["runs"] if one.cell == ballots],
                **{
                    name: [
                        one
                        for one in context.found["alone"]
                        if one.cell == alone(situation, name).name and one.seed in worlds
                    ]
                    for name in context.rivals.yardstick
                },
            }
            rows += [(situation, behaviours, n, *_counts(of)) for n, of in by_cell.items() if of]
    text = (
        "One controller drives alone, without " + ", ".join(REPLACED) + ". It coordinates nothing,"
        " so it is no rival: no row is tested, corrected for, or has a verdict."
    )
    head = ("situation", "worlds of", "driven by", *COUNTS)
    return [f"## Yardsticks, outside the comparison\n\n{text}\n\n{table(head, rows)}"]


COUNTS: Final = ("worlds", "clean", "touched", "reached", "TT s of the clean, median")


def _counts(of: Sequence[Sample]) -> tuple[object, ...]:
    """The columns `COUNTS`."""
    times = [one.tt_s for one in of if one.clean]
    touched, reached = sum(bool(one.collisions) for one in of), sum(one.reached for one in of)
    return len(of), len(times), touched, reached, f"{median(times):.1f}" if times else "-"


def _table(of: Mapping[str, Sequence[Sample]], made: Sequence[Contrast]) -> str:
    head = (
        *("mechanism", *COUNTS),
        *("clean alone: it, ballots", "difference [95 %]", "p", "corrected"),
        *("time, ratio [95 %]", "same p", "verdict"),
    )
    rows: list[tuple[object, ...]] = [(BALLOTS, *_counts(of[BALLOTS]), *["-"] * 7)]
    for one in made:
        ratio = "-"
        if one.ratio is not None:
            ratio = f"{number(one.ratio)} [{_end(one.ratio_low)}, {_end(one.ratio_high)}]"
        rows.append(
            (
                *(one.mechanism, one.worlds, one.clean, one.touched, one.reached),
                f"{one.seconds:.1f}" if one.seconds is not None else "-",
                f"{one.only_mechanism}, {one.only_ballots}",
                f"{one.difference:+.2f} [{one.low:+.2f}, {one.high:+.2f}]",
                *(f"{p:.3g}" for p in (one.p, one.p_corrected)),
                *(ratio, f"{one.same_p:.3g}", one.verdict),
            )
        )
    return table(head, rows)


def _end(value: float | None) -> str:
    return "-" if value is None else number(value)


def _table_of_kills(context: Context, names: Sequence[str]) -> str:
    found: list[Sample] = context.found["kills"]
    rows = []
    for name in names:
        for two in (False, True):
            of = [one for one in found if one.cell == _killed_name(Cell(name), two=two)]
            hit = [one.undriven_s for one in of if one.undriven_s is not None]
            if of:
                rows.append(
                    (
                        *(name, "two" if two else "one", f"{len(hit)} of {len(of)}"),
                        *(sum(one.reached for one in of), sum(one.clean for one in of)),
                        f"{median(hit):.2f} ({max(hit):.2f})" if hit else "-",
                    )
                )
    head = ("mechanism", "of each", "runs with a kill", "reached", "clean")
    text = "The process that the robot obeys is killed at 8 to 20 s; a new one joins after 2 s."
    shown = table((*head, "undriven s: median (most)"), rows)
    return f"## One process killed\n\n{text}\n\n{shown}" if rows else ""


def _table_of_messages(context: Context, names: Sequence[str]) -> str:
    found: list[Sample] = context.found["contenders"]
    if not found:
        return ""
    rows = []
    for name in names:
        means = []
        for bidders in BIDDERS:
            of = [one for one in found if one.cell == f"{bidders} bidders {name}"]
            means.append(fmean([one.messages_per_cycle or 0.0 for one in of]))
        slope = (means[-1] - means[0]) / (BIDDERS[-1] - BIDDERS[0])
        rows.append((name, *(f"{mean:.2f}" for mean in means), f"{slope:.3f}"))
    head = ("mechanism", *(f"{bidders} bidders" for bidders in BIDDERS), "for each more")
    text = "Claims, commands, proposals and awards of the wheels in a cycle."
    return f"## Messages\n\n{text}\n\n{table(head, rows)}"


RIVALS: Final = Experiment(
    note=NOTE,
    parts=(
        Part("worlds", measured, _candidates),
        Part("runs", drive, _runs),
        Part("alone", drive, _alone),
        Part("kills", drive, _killed),
        Part("contenders", drive, _counted),
    ),
    report=report,
    runs=24,
    first_seed=0,
    seeds="seeds of the worlds by the plans' text, or of a pilot, as in runs.csv",
)
