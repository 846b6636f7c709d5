"""Foretold drives: each is rehearsed from what the robot knows, then driven by another seed."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from functools import cache
from math import hypot, pi
from pathlib import Path
from random import Random
from typing import Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from armadico.config.moving import Moving
from armadico.config.profile import Body, load_profile
from armadico.config.scenarios import Scenario, load_scenario
from armadico.config.worlds import World, load_world
from armadico.core.config_errors import ConfigError
from armadico.core.judgement import Judgement, unknown
from armadico.core.messages import Message
from armadico.launch.options import Options
from armadico.launch.society import prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import Truth
from armadico.observe.audit.chart import joined
from armadico.rehearsal.answer import Rehearsed, answer
from armadico.rehearsal.fork import Errand, fork
from armadico.rehearsal.rehearse import driven
from armadico.rehearsal.sample import ARRIVED, Sample
from armadico.rehearsal.virtual import Attended
from armadico.runtime.errors import AgentFailedError, MissionRefusedError, SocietyError
from armadico_tools.experiments.foretold_report import Foretold, draw, summed
from armadico_tools.experiments.runner import Context, Experiment, Part, flat

SAMPLES: Final = 8
UNDER_WAY_S: Final = 6.0
"""The second rehearsal, of the mission as it goes on, is so long after the beginning."""

SEEN_S: Final = 2.0
"""The robot stands for so long before it is sent: it sees what a person would have it see."""

Driven = Generator[tuple[int, Sample], None, None]

ROBOTS: Final = ("pioneer-2dx", "jackal")
"""By sonars, and by laser."""

WORLDS: Final = ("sc4", "rooms-a", "rooms-b", "house", "offices", "hall", "floor")
"""Shipped ones, in which drives are drawn."""

NEAR_M, FAR_M = 2.5, 4.5
"""A drive's goal is so far from its start."""

LONG_M: Final = 9.0
"""With every third seed at most so far, and at least `FAR_M`: more of the way is out of sight."""

LONGEST_M: Final = 9.0
"""Scenarios of a given folder with a longer way are left out."""

ROOM_M: Final = 0.12
"""A drawn goal can be reached by a robot that has so much room to each side, by a plain search."""

DRAWS: Final = 400

AS_MAPPED, FURNITURE, PEOPLE, GLASS = "as mapped", "furniture", "people", "glass"
SITUATIONS: Final = {AS_MAPPED: 0.45, FURNITURE: 0.3, PEOPLE: 0.15, GLASS: 0.1}
"""What a drawn drive meets that the map does not have, and how often. Chosen."""

NOTE: Final = (
    "Each drive is rehearsed with eight samples, without a time within which to answer: before it"
    " begins, after the robot has stood for 2 s, and every second one again 6 s after it began."
    " Two thirds are of 2.5 to 4.5 m, too short for something to be put on the way, and say little"
    " about *stands*; the others are of up to 9 m."
    " The rehearsal gets what the society publishes, not the truth. *Foretold*: the mean of the"
    " probabilities of arriving that were told; *arrived*: the share of drives that did, without a"
    " collision. *Brier*: the mean square of the difference. *Within*: drives whose time is within"
    " what was told, of those that arrived; *wide*: the mean width of the told times, relative to"
    " the medians. *Nearer*: drives that came nearer to an obstacle than any sample in"
    " which the map holds, by more than 5 cm. *Wrong yes*: drives that did not arrive, of those"
    " whose answer was yes; *wrong no*: drives that did, of those whose answer was no."
)


class Task(Struct, frozen=True):
    """A drive: a robot in a world, drawn by the seed; or a scenario's own, from a file."""

    place: str
    robot: str
    seed: int
    own: bool = False
    under_way: bool = False

    @property
    def name(self) -> str:
        """The place, for people."""
        return Path(self.place).stem


def tasks(context: Context) -> list[Task]:
    """All places with the first seed, in a drawn order, then with the next: a part is fair."""
    places = [(name, False) for name in WORLDS]
    if context.logs is not None:
        places += [(str(path.resolve()), False) for path in sorted(context.logs.glob("*.map"))]
        owned = [path for path in sorted(context.logs.glob("*.toml")) if _is_short(path)]
        places += [(str(path.resolve()), True) for path in owned]
    found: list[Task] = []
    for seed in context.seeds:
        every = [(place, robot, seed, own) for place, own in places for robot in ROBOTS]
        Random(f"foretold/{seed}").shuffle(every)
        found += [Task(*each, under_way=k % 2 == 0) for k, each in enumerate(every)]
    return found


def _is_short(path: Path) -> bool:
    """Whether a scenario is on a map, and its straight way is short."""
    given = load_scenario(path)
    if given.goal is None or given.plan == "seen":
        return False
    return hypot(given.goal[0] - given.start[0], given.goal[1] - given.start[1]) <= LONGEST_M


@cache
def _world(name: str) -> World:
    return load_world(name)


def scenario_of(task: Task) -> tuple[str, Scenario] | None:
    """What it meets, and the scenario with real sensors; None: nothing can be drawn there."""
    if task.own:
        given = load_scenario(task.place)
        met = FURNITURE if given.moving else AS_MAPPED
        if given.sensors == "glass":
            met = GLASS
        else:
            given = replace(given, sensors="real")
        given = replace(given, robot=task.robot, agents=(), plan="rooms", waypoints=())
        return met, prepared(given, Options())
    rng = Random(f"foretold/{task.name}/{task.robot}/{task.seed}")
    chart, body = _world(task.place), load_profile(task.robot).body
    far = task.seed % 3 == 0
    drive = _drive(chart, body, rng, *((FAR_M, LONG_M) if far else (NEAR_M, FAR_M)))
    if drive is None:
        return None
    start, goal = drive
    met = rng.choices([*SITUATIONS], [*SITUATIONS.values()])[0]
    drawn = Scenario(
        name="foretold",
        title=f"a drawn drive in {chart.name}",
        world=task.place,
        start=start,
        goal=goal,
        plan="rooms",
        robot=task.robot,
        sensors="glass" if met == GLASS else "real",
        moving=tuple(_moving(met, chart, body, start, goal, rng)),
    )
    return met, prepared(drawn, Options())


def _place(chart: World, rng: Random) -> tuple[float, float]:
    x1, y1, x2, y2 = chart.bounds
    return rng.uniform(x1, x2), rng.uniform(y1, y2)


def _drive(
    chart: World, body: Body, rng: Random, near: float, far: float
) -> tuple[Pose2, Pose2] | None:
    """A start and a goal, `near` to `far` m apart, between which a plain search finds a way."""
    nothing = np.empty((0, 2))
    for _ in range(DRAWS):
        start, goal = _place(chart, rng), _place(chart, rng)
        if not near <= hypot(goal[0] - start[0], goal[1] - start[1]) <= far:
            continue
        if min(chart.clearance(*start), chart.clearance(*goal)) < body.goal_room_m:
            continue
        apart = body.width_m / 2 + ROOM_M
        if joined(chart.barriers, chart.bounds, nothing, apart, start, goal):
            turns = rng.uniform(-pi, pi), rng.uniform(-pi, pi)
            return (*start, turns[0]), (*goal, turns[1])
    return None


def _moving(
    met: str, chart: World, body: Body, start: Pose2, goal: Pose2, rng: Random
) -> Iterator[Moving]:
    """What no map has: one or two boxes, or one or two people, about the straight way."""
    if met not in (FURNITURE, PEOPLE):
        return
    for _ in range(rng.choice((1, 1, 2))):
        for _ in range(DRAWS):
            along, aside = rng.uniform(0.2, 0.9), rng.uniform(-1.2, 1.2)
            away = hypot(goal[0] - start[0], goal[1] - start[1])
            ahead = (goal[0] - start[0]) / away, (goal[1] - start[1]) / away
            at = (
                round(start[0] + along * away * ahead[0] - aside * ahead[1], 3),
                round(start[1] + along * away * ahead[1] + aside * ahead[0], 3),
            )
            size = round(rng.uniform(0.3, 1.2), 2), round(rng.uniform(0.2, 0.7), 2)
            ends = min(hypot(at[0] - end[0], at[1] - end[1]) for end in (start, goal))
            room = 0.35 if met == PEOPLE else 0.0
            if chart.inside(*at) and chart.clearance(*at) > room and ends > body.circle_m + 0.7:
                if met == FURNITURE:
                    yield Moving(kind="box", at=at, size=size)
                else:
                    yield Moving(kind="person", at=at, speed=0.7, heeds=rng.random() < 0.5)
                break


class Foreteller(Rehearsal):
    """The drive, which is rehearsed on the way."""

    def __init__(self, scenario: Scenario, seed: int, *, under_way: bool) -> None:
        super().__init__(scenario, Options(seed=seed))
        self._under_way = under_way
        self._attended = Attended(self)
        self.told: list[tuple[float, Rehearsed]] = []
        self.clear_m: list[float | None] = []  # the least after each of these
        self.mesh.watch(self._on_truth, Truth, namespace=self.namespace)

    def start(self) -> None:
        super().start()
        self.mesh.run(self.mesh.now + SEEN_S)
        self._tell(0.0, Errand(goal=self.scenario.goal))

    def goes_on(self, elapsed: float) -> bool:
        if self._under_way and elapsed >= UNDER_WAY_S and not self.over:
            self._under_way = False
            self._tell(elapsed, Errand())
        return super().goes_on(elapsed)

    def _on_truth(self, _key: str, truth: Message, _now: float) -> None:
        if isinstance(truth, Truth) and truth.clearance is not None and not self.over:
            now = truth.clearance
            self.clear_m = [now if least is None else min(least, now) for least in self.clear_m]

    def _tell(self, at: float, errand: Errand) -> None:
        self.clear_m.append(None)
        try:
            of = fork(self._attended.now(), errand)
        except ConfigError as error:  # no mission is under way: it waits, or has just failed
            of = unknown(str(error))
        if isinstance(of, Judgement):
            self.told.append((at, Rehearsed(judgement=of)))
            return
        first = (self.options.seed + 1) * 1_000_000 + round(at) * 1000
        runs = driven(of, range(first, first + SAMPLES), _in_turn)
        found = answer(runs, lacks=of.lacks, unforked=of.unforked, rate=of.rate, vague=of.vague)
        self.told.append((at, found))


def _in_turn(drives: Callable[[int], Sample], seeds: Sequence[int]) -> Driven:
    for k, seed in enumerate(seeds):
        yield k, drives(seed)


def foretell(task: Task) -> list[Foretold]:
    """One drive with its rehearsals, for a worker process; empty if there is no such drive."""
    made = scenario_of(task)
    if made is None:
        return []
    met, scenario = made
    run = Foreteller(scenario, task.seed, under_way=task.under_way)
    try:
        done = run.run()
        passed, tt_s, why = done.passed, done.tt_s, done.why
    except MissionRefusedError as error:
        passed, tt_s, why = False, 0.0, error.reason
    except (AgentFailedError, SocietyError) as error:
        passed, tt_s, why = False, 0.0, str(error).splitlines()[-1]
    return [
        Foretold(
            place=task.name,
            robot=task.robot,
            seed=task.seed,
            met=met,
            foreign=task.place not in WORLDS,
            under_way=at > 0.0,
            answer=str(told.judgement.answer),
            chance=told.chance,
            arrives=told.arrives,
            samples=told.samples,
            despite=told.despite,
            hidden_m=told.hidden_m,
            stands=told.stands,
            lacks=told.lacks,
            least_s=told.time_s[0] if told.time_s else None,
            most_s=told.time_s[-1] if told.time_s else None,
            plain_s=_times(told, held=True),
            put_s=_times(told, held=False),
            clearance_m=None if told.clearance is None else told.clearance[0],
            says=told.says,
            arrived=passed,
            time_s=round(tt_s - at, 1),
            went_clear_m=clear_m,
            why=why,
        )
        for (at, told), clear_m in zip(run.told, run.clear_m, strict=True)
    ]


def _times(told: Rehearsed, *, held: bool) -> tuple[float, ...]:
    """The times of the samples that arrive, in which the map holds, or does not."""
    runs = (run for run in told.runs if run.end == ARRIVED and run.holds is held)
    return tuple(sorted(round(run.time_s, 1) for run in runs))


def _each(found: Sequence[Sequence[Foretold]]) -> list[Foretold]:
    return [one for each in found for one in each]


def report(context: Context) -> str:
    """The tables; the reliability diagram is beside them."""
    found = _each(context.found["drives"])
    if found:
        draw(found, context.file("reliability.png"))
    return summed(found)


FORETOLD: Final = Experiment(
    note=NOTE,
    parts=(Part("drives", foretell, tasks, rows=lambda found: flat(_each(found))),),
    report=report,
    runs=6,
)
