"""Tables 5.1 to 5.5 of the thesis with their figures of paths, and its scenarios localized."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Final

from msgspec import Struct, structs

from armadico.config.loading import read_text
from armadico.config.parameters import load_set
from armadico.config.shipped import resource_path
from armadico_tools.experiments import drawing
from armadico_tools.experiments.driving import LOCALIZING, Cell, Drive, Sample
from armadico_tools.experiments.published import published
from armadico_tools.experiments.runner import Context, Experiment, Part, driven
from armadico_tools.experiments.tables import (
    MEASURES,
    OTHERS,
    RULES,
    SMOOTHNESS,
    Block,
    arms,
    cell,
    change,
    failures,
    sections,
    spread_of,
)
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALL: Final = {**MEASURES, **OTHERS, **SMOOTHNESS}


def _reported(of: dict[str, Sequence[Block]]) -> Callable[[Context], str]:
    return lambda context: f"{RULES}\n\n{sections(of, context.samples)}"


def _paths(
    context: Context, name: str, panels: dict[str, tuple[str, dict[str, str]]], columns: int
) -> Iterable[tuple[str, Figure]]:
    """A panel for each title: a world, and its paths by label and name of the cell."""
    rows = len(panels) // columns
    figure = drawing.sheet(rows, columns, 11.0 + (rows == 1), 8.0 if rows > 1 else 4.5)
    for axes, (title, (world, cells)) in zip(figure.axes, panels.items(), strict=True):
        runs = list(zip(cells, context.again(cells.values()), strict=True))
        drawing.paths(axes, world, runs, f"{title}, seed {context.first_seed}")
    yield name, figure


# Table 5.1 ----------------------------------------------------------------------------------------

SCENARIOS: Final = ("sc1", "sc2", "sc3", "sc4")
CONTROLLERS: Final = ("fast", "precise", "collaborative")

TABLE_5_1: Final = Experiment(
    note="Goto and avoid only, as in the thesis.",
    parts=(
        driven(
            lambda _: [
                Cell(f"{scenario} {name}", scenario, name, without=("gothrough",))
                for scenario in SCENARIOS
                for name in CONTROLLERS
            ]
        ),
    ),
    report=_reported(
        {
            scenario: [
                arms((c, f"{scenario} {c}", published("5.1", c, scenario)) for c in CONTROLLERS),
                *(
                    change(
                        f"{name} to collaborative",
                        f"{scenario} {name}",
                        f"{scenario} collaborative",
                        {**MEASURES, "exchanges": "exchanges"},
                    )
                    for name in ("fast", "precise")
                ),
            ]
            for scenario in SCENARIOS
        }
    ),
    figures=lambda context: _paths(
        context,
        "paths",
        {name: (name, {c: f"{name} {c}" for c in CONTROLLERS}) for name in SCENARIOS},
        columns=2,
    ),
)

# Table 5.2 ----------------------------------------------------------------------------------------

EXCHANGES: Final = ("abrupt", "smooth")
DECIDED: Final = ("goto", "avoid")
"""The agents that take part, and whose exchanges follow the arm."""

COORDINATIONS: Final = {
    "same-cycle": (),
    "last-heard": ("social.margin=0.0", 'social.comparison="last-heard"'),
}
"""Ours (bids of one cycle, a margin), and 3.10's: a new bid against the last claim received."""

SETTINGS: Final = {
    "safe": ("Default rules", None, False),
    "thesis": ("The thesis's rules", "thesis", False),
    "free": ("The thesis's rules, controller without ramps", "thesis", True),
}
"""By short name: title, set of parameters, and whether the controller has no ramps."""

NO_RAMP: Final = 30.0
"""m/s^2 and rad/s^2: a step of 1 m/s within a fraction of a cycle."""


def cells_5_2(context: Context) -> list[Cell]:
    """All arms; writes parameter sets and a profile without ramps into the folder."""
    folder = context.out
    robot = folder / "no-ramps.toml"
    robot.write_text(_without_ramps(), encoding="utf-8")
    made = []
    for short, (_, base, free) in SETTINGS.items():
        for coordination, social in COORDINATIONS.items():
            path = folder / f"{base or 'default'}-{coordination}.toml"
            path.write_text(_set(base, social), encoding="utf-8")
            made += [
                Cell(
                    f"{short} {coordination} {exchange}",
                    "sc4",
                    exchange=exchange,
                    parameters=str(path),
                    without=("gothrough",),
                    robot=str(robot) if free else None,
                )
                for exchange in EXCHANGES
            ]
    return made


def _set(base: str | None, social: tuple[str, ...]) -> str:
    """A parameter set with other settings for exchanges."""
    given = dict.fromkeys(DECIDED, ()) | (load_set(base) if base else {})
    lines = []
    for agent, words in given.items():
        settings = [word for word in words if not word.startswith("social.")]
        settings += social if agent in DECIDED else ()
        lines += [f"[{agent}]", *(word.replace("=", " = ", 1) for word in settings)]
    return "\n".join(lines) + "\n"


def _without_ramps() -> str:
    """The Pioneer's profile, with a controller without ramps."""
    text = read_text(resource_path("robots", "pioneer-2dx"))
    names = "v_accel|v_decel|w_accel|w_decel"
    return re.sub(rf"^({names}) = .*$", rf"\1 = {NO_RAMP}", text, flags=re.MULTILINE)


def _sections_5_2() -> dict[str, Sequence[Block]]:
    made: dict[str, Sequence[Block]] = {}
    for short, (title, *_) in SETTINGS.items():
        blocks = []
        for name in COORDINATIONS:
            first, second = (f"{short} {name} {exchange}" for exchange in EXCHANGES)
            blocks.append(
                arms(
                    (
                        (f"{name}, {e}", f"{short} {name} {e}", published("5.2", e))
                        for e in EXCHANGES
                    ),
                    ALL,
                )
            )
            blocks.append(change(f"{name}: abrupt to smooth", first, second, ALL))
        for e in EXCHANGES:
            arm = (f"{short} last-heard {e}", f"{short} same-cycle {e}")
            blocks.append(change(f"{e}: last-heard to same-cycle", *arm, ALL))
        made[title] = blocks
    return made


TABLE_5_2: Final = Experiment(
    note=(
        "World `sc4` (figure 5.7), goto and avoid only, as in the thesis. *same-cycle* compares"
        " bids of one cycle, with the resource's margin; *last-heard* is 3.10 as written: a new bid"
        " against the last claim received, no margin. Jerk and steps are of the true speeds and the"
        " obeyed commands, sampled at 10 Hz."
    ),
    parts=(driven(cells_5_2),),
    report=_reported(_sections_5_2()),
    figures=lambda context: _paths(
        context,
        "figure-5.7",
        {
            f"{SETTINGS[short][0]}, last-heard": (
                "sc4",
                {exchange: f"{short} last-heard {exchange}" for exchange in EXCHANGES},
            )
            for short in ("safe", "thesis")
        },
        columns=2,
    ),
)

# Table 5.3 ----------------------------------------------------------------------------------------

WORLDS: Final = ("rooms-a", "rooms-b")
ARMS: Final = {"GA": ("gothrough",), "GAT": ()}
JOINS_S: Final = 5.0
SETS: Final = {"default": None, "thesis": "thesis"}


class Joining(Struct, frozen=True):
    """Effects on the other agents when gothrough joined."""

    world: str
    seed: int
    before: str  # live instances before
    kept: bool  # they are alive, and gothrough is the only new one
    first_held_s: float | None  # when gothrough was first obeyed, s after the mission began


def joining(world: str) -> Cell:
    """A run that gothrough joins later."""
    return Cell(f"{world} joins", world, joins="gothrough", joins_at_s=JOINS_S)


def join(task: tuple[str, int]) -> Joining:
    """One run that gothrough joins, with the live instances before and after."""
    world, seed = task
    drive = Drive(joining(world), seed)
    before = drive.instances()
    drive.go()
    after = drive.instances()
    newcomers = [instance for instance in after if instance not in before]
    kept = after[: len(before)] == before and len(newcomers) == 1
    ticks = drive.trace.ticks
    held = next((tick.t - ticks[0].t for tick in ticks if tick.holder == "gothrough"), None)
    kept = kept and newcomers[0].startswith("gothrough-")
    return Joining(world, seed, " ".join(before), kept, held)


def _report_5_3(context: Context) -> str:
    rows = []
    for world in WORLDS:
        mine = [one for one in context.found["joining"] if one.world == world]
        held = [one.first_held_s for one in mine if one.first_held_s is not None]
        least = f"{min(held):.1f} s" if held else "-"
        kept = f"{sum(one.kept for one in mine)} of {len(mine)} runs"
        rows.append((world, kept, f"{len(held)} of {len(mine)} runs", least))
    head = ("world", "no other restarted", "gothrough obeyed in", "first obeyed after")
    made: dict[str, Sequence[Block]] = {
        f"{world}, {name} parameters": [
            arms((arm, f"{world} {name} {arm}", published("5.3", world, arm)) for arm in ARMS),
            change("GA to GAT", f"{world} {name} GA", f"{world} {name} GAT", ALL),
        ]
        for name in SETS
        for world in WORLDS
    }
    made[f"Gothrough joins {JOINS_S:g} s after the mission began"] = [
        lambda _: f"{table(head, rows)}\n",
        arms((f"{world}, joins", f"{world} joins", None) for world in WORLDS),
    ]
    return _reported(made)(context)


TABLE_5_3: Final = Experiment(
    note="GA: goto and avoid; GAT: gothrough too.",
    parts=(
        driven(
            lambda _: [
                *(
                    Cell(f"{world} {name} {arm}", world, parameters=given, without=out)
                    for name, given in SETS.items()
                    for world in WORLDS
                    for arm, out in ARMS.items()
                ),
                *map(joining, WORLDS),
            ]
        ),
        Part("joining", join, lambda context: [(w, s) for w in WORLDS for s in context.seeds]),
    ),
    report=_report_5_3,
    figures=lambda context: _paths(
        context,
        "figures-5.8-5.9",
        {world: (world, {arm: f"{world} default {arm}" for arm in ARMS}) for world in WORLDS},
        columns=2,
    ),
)

# Tables 5.4 and 5.5 -------------------------------------------------------------------------------

SENSORS: Final = {"simulated": "ideal", "real": "real"}
"""The thesis's two columns, and the sensors for them here."""

LOCALIZED: Final = Cell("localized", "", besides=LOCALIZING, sensors="real")
"""A column that the thesis lacks: the agent of 3.6.3 was designed but not built."""


def _with_real_sensors(of: str, note: str, simulated: str, real: str) -> Experiment:
    """A scenario with both kinds of sensors, and with localization; all agents take part.

    `real` is the scenario with the obstacles of the real run, if that is another one.
    """
    where = {"simulated": simulated, "real": real}
    cells = [Cell(name, where[name], sensors=sensors) for name, sensors in SENSORS.items()]
    cells.append(structs.replace(LOCALIZED, scenario=real))
    names = [one.name for one in cells]
    of_thesis = {name: published(of, name) for name in SENSORS}
    columns = [(name, name, of_thesis.get(name)) for name in names]

    def figures(context: Context) -> Iterable[tuple[str, Figure]]:
        figure = drawing.sheet(1, 3, 18.0, 7.0)
        for axes, name, drive in zip(figure.axes, names, context.again(names), strict=True):
            echoes = drive.watch.echoes[:: max(1, len(drive.watch.echoes) // 6000)]
            xs, ys = [x for x, _ in echoes], [y for _, y in echoes]
            axes.scatter(xs, ys, s=2, color="#8796a3", linewidths=0, rasterized=True)
            drawing.by_holder(axes, drive, f"{simulated}, {name}, seed {context.first_seed}")
        yield "trajectories", figure

    return Experiment(
        note=note,
        parts=(driven(lambda _: cells),),
        report=_reported({"": [arms(columns), lambda found: failures(chain(*found.values()))]}),
        figures=figures,
    )


TABLE_5_4: Final = _with_real_sensors(
    "5.4",
    "v at most 0.4 m/s, all agents take part. The thesis drove each column once, on a real Pioneer"
    " for *real*; ours is a simulation with the sensors `real` ([worlds](worlds.md#sensors)), and"
    " *localized* has the agent of 3.6.3 as well. There is less furniture than in the text.",
    "offices",
    "offices",
)
TABLE_5_5: Final = _with_real_sensors(
    "5.5",
    "v at most 0.4 m/s, all agents take part, as in table 5.4. The thesis's TT of 152.71 s over"
    " 51 m is 0.33 m/s. P and FO are by the true pose: the interface agent uses the encoders' pose,"
    " so a run may end far from the goal with the goal reported as reached, as the thesis's real"
    " run did. The real columns are `floor-people`: five people walk, a box is left in the"
    " corridor, and the path is planned.",
    "floor",
    "floor-people",
)

# Localization -------------------------------------------------------------------------------------

NINE: Final = (*SCENARIOS, *WORLDS, "house", "offices", "floor")
LOCALIZATION_ARMS: Final = {"odometry": (), "localized": LOCALIZING}
"""Agents besides the scenario's own."""


def _report_localization(context: Context) -> str:
    samples = context.samples
    head = ("scenario", "arm", "reached", "touched", "P %", "pose m", "at the end m", "deg", "TT s")
    rows = [
        (scenario, arm, *_accuracy(samples[f"{scenario} {arm}"]))
        for scenario in NINE
        for arm in LOCALIZATION_ARMS
    ]
    localized = failures(one for name in NINE for one in samples[f"{name} localized"])
    return f"{RULES}\n\n{table(head, rows)}\n\n{localized}"


def _accuracy(samples: Sequence[Sample]) -> tuple[str, ...]:
    return (
        f"{sum(one.reached for one in samples)} of {len(samples)}",
        str(sum(bool(one.collisions) for one in samples)),
        *(
            cell(spread_of(samples, field))
            for field in ("p_percent", "pose_m", "pose_end_m", "pose_end_deg", "tt_s")
        ),
    )


LOCALIZATION: Final = Experiment(
    note=(
        "Sensors `real` ([worlds](worlds.md)): odometry errors are drawn for each run, smooth walls"
        " are mirrors. The pose error is the distance of the published pose from the true one: its"
        " median over a run, and at the run's end. Scenario 1 has no walls to localize by; in 2 and"
        " 3 the map does not have the obstacle, in 2 it is the only wall. Seeds 9001 to 9008 chose"
        " parameters."
    ),
    parts=(
        driven(
            lambda _: [
                Cell(f"{scenario} {arm}", scenario, besides=besides, sensors="real")
                for scenario in NINE
                for arm, besides in LOCALIZATION_ARMS.items()
            ]
        ),
    ),
    report=_report_localization,
)
