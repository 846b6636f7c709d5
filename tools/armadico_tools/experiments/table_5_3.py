"""Table 5.3, figures 5.8 and 5.9: without gothrough, with it, and when it joins on the way."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct, structs

from armadico_tools.experiments import drawing
from armadico_tools.experiments.driving import Cell, Drive
from armadico_tools.experiments.published import published
from armadico_tools.experiments.tables import (
    MEASURES,
    OTHERS,
    RULES,
    SMOOTHNESS,
    Column,
    compare,
    differences,
)
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context, Samples

TITLE: Final = "Table 5.3: adding gothrough"
WORLDS: Final = {"rooms-a": "figure-5.8", "rooms-b": "figure-5.9"}
ARMS: Final = {"GA": ("gothrough",), "GAT": ()}
JOINS_S: Final = 5.0
SETS: Final = (None, "thesis")


class Joining(Struct, frozen=True):
    """What happened to the others when gothrough joined."""

    world: str
    seed: int
    before: tuple[str, ...]  # instances that were alive before
    kept: bool  # all of them still live, and the only other one is gothrough's
    first_held_s: float | None  # when gothrough was first obeyed, s after the mission began


def cells() -> list[Cell]:
    """Both worlds, without and with gothrough and with it joining, for both sets of parameters."""
    made = []
    for name in SETS:
        for world in WORLDS:
            base = f"{world} {name or 'default'}"
            made += [
                Cell(f"{base} {arm}", world, parameters=name, without=out)
                for arm, out in ARMS.items()
            ]
    return made + [joining(world) for world in WORLDS]


def joining(world: str) -> Cell:
    """A run without gothrough at first."""
    return Cell(f"{world} joins", world, joins="gothrough", joins_at_s=JOINS_S)


def join(task: tuple[str, int]) -> Joining:
    """One run in which gothrough joins, and who was alive before and after."""
    world, seed = task
    drive = Drive(joining(world), seed)
    before = drive.instances()
    drive.go()
    after = drive.instances()
    newcomers = [instance for instance in after if instance not in before]
    kept = after[: len(before)] == before and len(newcomers) == 1
    ticks = drive.trace.ticks
    held = next((tick.t - ticks[0].t for tick in ticks if tick.holder == "gothrough"), None)
    return Joining(world, seed, tuple(before), kept and newcomers[0].startswith("gothrough-"), held)


def run(context: Context) -> None:
    """The table, what adding gothrough changes, and whether another agent had to restart."""
    samples = context.drive(cells())
    joins = context.map(
        join, [(world, seed) for world in WORLDS for seed in context.seeds], "who was alive"
    )
    fields = Joining.__struct_fields__
    rows = (structs.replace(one, before=" ".join(one.before)) for one in joins)
    context.rows("joining", fields, map(structs.astuple, rows))
    parts = [f"# {TITLE}\n\nGA: goto and avoid; GAT: gothrough too.\n\n{RULES}\n"]
    parts += [_part(world, name or "default", samples) for name in SETS for world in WORLDS]
    parts.append(_joined(samples, joins))
    context.table("\n".join(parts))
    figure = drawing.sheet(1, 2, 12.0, 4.5)
    for axes, world in zip(figure.axes, WORLDS, strict=True):
        arms = [cell for cell in cells() if cell.name.startswith(f"{world} default")]
        runs = [(drive.cell.name.split()[2], drive) for drive in context.again(arms)]
        drawing.paths(axes, world, runs, f"{world}, seed {context.first_seed}")
    context.figure(figure, "figures-5.8-5.9")


def _part(world: str, name: str, samples: Samples) -> str:
    columns = [
        Column(arm, samples[f"{world} {name} {arm}"], published("5.3", world, arm)) for arm in ARMS
    ]
    measures = {**MEASURES, **OTHERS, **SMOOTHNESS}
    changes = differences("GA to GAT", columns[0].samples, columns[1].samples, measures)
    return f"## {world}, {name} parameters\n\n{compare(columns)}\n{changes}"


def _joined(samples: Samples, joins: list[Joining]) -> str:
    rows = []
    for world in WORLDS:
        mine = [one for one in joins if one.world == world]
        held = [one.first_held_s for one in mine if one.first_held_s is not None]
        least = f"{min(held):.1f} s" if held else "-"
        kept = f"{sum(one.kept for one in mine)} of {len(mine)} runs"
        rows.append((world, kept, f"{len(held)} of {len(mine)} runs", least))
    head = ("world", "no other restarted", "gothrough obeyed in", "first obeyed after")
    columns = [Column(f"{world}, joins", samples[f"{world} joins"]) for world in WORLDS]
    return (
        f"## Gothrough joins {JOINS_S:g} s after the mission began\n\n{table(head, rows)}\n\n"
        + compare(columns)
    )
