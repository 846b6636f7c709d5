"""The BARN challenge: through fields of cylinders without a map, with its own rule and score."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from pathlib import Path
from statistics import fmean
from typing import Final

from msgspec.structs import replace as changed

from armadico.cli.options import UsageError
from armadico.config.mapwriter import write_map
from armadico.config.profile import load_profile
from armadico.core.messages import Message
from armadico.launch.society import Options, profile_of
from armadico.mobile.messages import Truth
from armadico_tools.experiments import Barn
from armadico_tools.experiments.barn_worlds import (
    CLIPS,
    GOAL,
    LIMIT_S,
    REACHED_M,
    SHIPPED,
    START,
    STARTED_M,
    BarnWorld,
    read_worlds,
)
from armadico_tools.experiments.driving import Cell, Drive, Sample, picture
from armadico_tools.experiments.runner import Context, Experiment, driven
from armadico_tools.markdown import table

ROBOTS: Final = ("jackal", "pioneer-2dx", "pioneer-16")
PARAMETERS: Final = "swift"

TUNED: Final = (1, 2, 3)
"""Parameters were chosen in worlds with these remainders by 6; those with 4 and 5 are reported."""

WAIT_S: Final = 30.0
"""A robot that has not moved after this time is too late; the challenge waits without limit."""

WORST: Final = 10

NOTE: Final = (
    "Each world by the challenge's rule: the clock starts when the robot has moved 0.1 m and stops"
    " within 1 m of the goal, 10 m ahead; any contact ends the run, and so do 100 s. Score: optimal"
    " time over the time, which counts as at least 2 (until 2023: 4) and at most 8 optimal times; 0"
    " if the goal is not reached. The agents have no map. Sensors without error. *Figures of other"
    " planners are of a Jackal in Gazebo; these are of this project's simulator, and of the public"
    " worlds.*"
)


class BarnDrive(Drive):
    """One run by the challenge's rule."""

    def __init__(self, cell: Cell, seed: int) -> None:
        super().__init__(cell, seed)
        self.began: float | None = None  # when it has moved
        self.ended: float | None = None
        self.touched = False
        self.rehearsal.mesh.watch(lambda _k, message, _t: self._locate(message), Truth)

    @property
    def seconds(self) -> float:
        """Time by the challenge's clock, s."""
        if self.began is None:
            return 0.0
        return (self.rehearsal.mesh.now if self.ended is None else self.ended) - self.began

    def sample(self) -> Sample:
        """The row of this run, judged by the challenge's rule."""
        reached = self.ended is not None and not self.touched and self.seconds < LIMIT_S
        note = "" if reached else "touched" if self.touched else "too late"
        return changed(
            super().sample(),
            reached=reached,
            arrived=reached,
            collisions=int(self.touched),
            tt_s=round(self.seconds, 3),
            note=f"refused: {self.refused}" if self.refused else note,
        )

    def _options(self) -> Options:
        options = super()._options()
        return Options(**{**options.__dict__, "limit": LIMIT_S + WAIT_S})

    def _over(self) -> bool:
        return self.ended is not None or self.seconds >= LIMIT_S

    def _locate(self, truth: Message) -> None:
        """Update the clock with the robot's true pose."""
        assert isinstance(truth, Truth)
        now = self.rehearsal.mesh.now
        if self.began is None:
            if hypot(truth.x - START[0], truth.y - START[1]) < STARTED_M:
                return
            self.began = now
        if self.ended is None:
            self.touched = truth.collisions > 0
            if self.touched or hypot(truth.x - GOAL[0], truth.y - GOAL[1]) <= REACHED_M:
                self.ended = now


def drive(task: tuple[Cell, int]) -> Sample:
    """One run, for a worker process."""
    cell, seed = task
    return BarnDrive(cell, seed).go().sample()


def write(world: BarnWorld, folder: Path, v_max: float | None) -> Path:
    """Write a world and its scenario. Returns the scenario's file."""
    name = f"barn-{world.number:03d}"
    write_map(world.world(), folder / f"{name}.map")
    limit = "" if v_max is None else f"v_max = {v_max}\n"
    path = folder / f"{name}.toml"
    path.write_text(
        f'title = "BARN {world.number}"\nworld = "{name}.map"\n'
        f'start = {list(START)}\ngoal = {list(GOAL)}\nplan = "seen"\nsensors = "ideal"\n{limit}',
        encoding="utf-8",
    )
    return path


CLIP_SCORE: Final = 1.0 / CLIPS[0]
"""The highest possible score."""


def parts(numbers: Sequence[int]) -> dict[str, list[int]]:
    """The worlds: all, those used to choose parameters, and the others."""
    found = {
        "all": list(numbers),
        "tuned on": [n for n in numbers if n % 6 in TUNED],
        "not tuned on": [n for n in numbers if n % 6 not in TUNED],
    }
    return {name: some for name, some in found.items() if some}


def score_of(world: BarnWorld, one: Sample, clip: float = CLIPS[0]) -> float:
    """The challenge's score of a run."""
    return world.score(one.tt_s if one.reached else None, clip)


def summarized(runs: Sequence[tuple[BarnWorld, Sample]]) -> dict[str, float]:
    """Shares of the runs, the mean time of those that reached the goal, scores."""
    times = [one.tt_s for _, one in runs if one.reached]
    new, old = (fmean(score_of(world, one, clip) for world, one in runs) for clip in CLIPS)
    return {
        "runs": len(runs),
        "reached": fmean(one.reached for _, one in runs),
        "touched": fmean(bool(one.collisions) for _, one in runs),
        "too_late": fmean(not one.reached and not one.collisions for _, one in runs),
        "seconds": fmean(times) if times else 0.0,
        "score": new,
        "score_until_2023": old,
    }


# The experiment -----------------------------------------------------------------------------------


def check(chosen: Barn) -> None:
    """Raises ConfigError for an unknown robot or a wrong file, UsageError for no such world."""
    for name in chosen.robots:
        load_profile(profile_of(name) or name)
    known = read_worlds(chosen.data or SHIPPED)
    for number in chosen.worlds:
        if number not in known:
            kept = "" if chosen.data else " (every sixth is kept for the challenge's own test)"
            raise UsageError(
                f"--worlds {number}: no such world; there are {len(known)} from {min(known)}"
                f" to {max(known)}{kept}"
            )


def _robots(context: Context) -> list[str]:
    return list(dict.fromkeys(profile_of(n) or n for n in context.barn.robots or ROBOTS))


def _cells(context: Context) -> list[Cell]:
    """Each world for each robot; writes their files into the folder."""
    chosen, worlds = context.barn, _worlds(context)
    folder = context.out / "worlds"
    folder.mkdir(exist_ok=True)
    files = {n: write(world, folder, chosen.v_max) for n, world in worlds.items()}
    return [
        Cell(f"{robot}-{n}", str(path), parameters=PARAMETERS, robot=robot)
        for robot in _robots(context)
        for n, path in files.items()
    ]


def _worlds(context: Context) -> dict[int, BarnWorld]:
    chosen = context.barn
    worlds = read_worlds(chosen.data or SHIPPED)
    return {n: worlds[n] for n in chosen.worlds or worlds}


def _report(context: Context) -> str:
    """Tables of all, and pictures of the worst."""
    worlds, robots = _worlds(context), _robots(context)
    found, rows = context.samples, []
    context.summary = {}
    for robot in robots:
        for part, numbers in parts(list(worlds)).items():
            summary = summarized([(worlds[n], s) for n in numbers for s in found[f"{robot}-{n}"]])
            context.summary[f"{robot}, {part}"] = summary
            runs, *shares = summary.values()
            rows.append((robot, part, runs, *(f"{share:.3f}" for share in shares)))
    scores = sorted(
        (
            (score_of(world, one), robot, n, one)
            for robot in robots
            for n, world in worlds.items()
            for one in found[f"{robot}-{n}"]
        ),
        key=lambda row: row[:3],
    )
    listed = []
    for score, robot, n, one in [row for row in scores if row[0] < CLIP_SCORE][:WORST]:
        what = one.note or f"{one.tt_s:.1f} s, {one.td_m:.1f} m"
        run = BarnDrive(context.cells[one.cell], one.seed).go()
        picture(run, context.file(f"{one.cell}-{one.seed}.png"), what)
        listed.append((robot, n, one.seed, f"{score:.3f}", what))
    context.rows(
        "scores",
        ("robot", "world", "seed", "score", "touched", "seconds"),
        [(r, n, s.seed, f"{score:.4f}", s.collisions, s.tt_s) for score, r, n, s in scores],
    )
    v_max = context.barn.v_max
    limit = "" if v_max is None else f"No faster than {v_max:g} m/s.\n\n"
    header = ("robot", "worlds", "runs", "reached", "touched", "too late", "s", "score", "of 0.25")
    of_worst = table(("robot", "world", "seed", "score", "what happened"), listed)
    return f"{limit}{table(header, rows)}\n\n## The worst\n\n{of_worst}"


BARN: Final = Experiment(note=NOTE, parts=(driven(_cells, drive),), report=_report, runs=1)
