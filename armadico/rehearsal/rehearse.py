"""A rehearsal from beginning to end: the samples of a fork on spare cores, and the answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from armadico.core.judgement import Judgement
from armadico.core.messages import MonitorReport
from armadico.core.services import SETTINGS
from armadico.mobile.messages import BatteryLevel
from armadico.observe.view import WINDOW_S
from armadico.observe.watching import QUERY_S, Watcher, show
from armadico.rehearsal.answer import RISK, Rehearsed, answer, hidden_m, without_samples
from armadico.rehearsal.crew import GRACE_S, Crew
from armadico.rehearsal.fork import Errand, Fork, fork
from armadico.rehearsal.present import Account, Present, absent, present, provides, unheard
from armadico.rehearsal.sample import ARRIVED, UNENDED, Forked, Sample, sample
from armadico.rehearsal.store import note

if TYPE_CHECKING:
    from armadico.mesh.zenoh import ZenohMesh

SAMPLES: Final = 4
WITHIN_S: Final = 30.0
"""By default a rehearsal answers after so long, with what has ended by then."""

LEAST_S: Final = WINDOW_S / 2 + 0.1
"""A society is observed for so long at least: before, a diagnosis does not know who is too slow."""

MOST_S: Final = 6.0
"""And at most for so long, while something has not been received: the level of a full battery is
published every 5 s."""

STEP_S: Final = 0.1
JOIN_S: Final = 2.0
"""How long to wait for the robot's router."""

PATIENCE: Final = 3.0
"""A sample with something put on its way fails after so many times the median time of those without
anything that arrive. Chosen."""

Done = Callable[[int], None]
"""Called with the number of samples that have ended."""

Results = Callable[
    [Callable[[int], Sample], Sequence[int]], Generator[tuple[int, Sample], None, None]
]
"""Applies a function to all seeds, as `Crew.results`."""


def observe(mesh: ZenohMesh, until: float = float("inf")) -> Present:
    """The present of the society on an open, joined mesh, until a time by `time.monotonic` at most.

    It publishes nothing.
    """
    watcher, account = Watcher([mesh]), Account()
    began = watcher.clock() / 1e9
    account.view.begin(began)
    watcher.watch_alive()
    watcher.watch_router(account.view)
    watcher.subscribe()
    end = min(time.monotonic() + MOST_S, until)
    least, ask_at = time.monotonic() + LEAST_S, 0.0
    while (now := time.monotonic()) < end:
        if now >= ask_at:
            ask_at = now + QUERY_S / 2
            watcher.query_cards()
            watcher.query(SETTINGS.pattern, QUERY_S)
        for item in watcher.until(min(now + STEP_S, end)):
            show(account, item)
        if time.monotonic() >= least and _complete(account, watcher.clock() / 1e9):
            break
    return present(account, watcher.clock() / 1e9)


def _complete(account: Account, now: float) -> bool:
    """Whether everything has arrived that the society's agents publish again and again."""
    view = account.view
    whole = view.complete and view.alive.keys() <= account.parameters.keys()
    known = (view.state, view.pose, view.description, view.mission)
    charge = view.level is not None or not provides(view, BatteryLevel)
    faults = bool(view.reports) or not provides(view, MonitorReport)
    seen = bool(account.obstacles) and not unheard(account, now)
    alive = not absent(account, now)
    return (
        whole and alive and all(each is not None for each in known) and charge and faults and seen
    )


def drive(
    of: Fork | Judgement,
    samples: int,
    within_s: float,
    *,
    seed: int = 0,
    crew: Crew,
    done: Done = lambda _: None,
    began: float,
) -> Rehearsed:
    """Drive samples of a fork and return the answer; with a judgement nothing is driven.

    The answer comes within `within_s`, counted from `began` (by `time.monotonic`); samples that
    have not ended by then are unknown. The first one has `seed`, the others what follows. `done` is
    called after each sample.
    """
    if isinstance(of, Judgement):
        return without_samples(of, time.monotonic() - began)
    until = began + within_s
    crew.until = until + GRACE_S
    crew.prepare(_warm, of)
    runs = driven(of, range(seed, seed + samples), crew.results, until, done)
    return answer(
        runs,
        lacks=of.lacks,
        unforked=(*of.unforked, *unkilled(of, runs)),
        rate=of.rate,
        vague=of.vague,
        start=of.scenario.start[:2],
        goal=of.scenario.goal,
        world=of.scenario.world,
        took_s=time.monotonic() - began,
    )


def unkilled(of: Fork, runs: Sequence[Sample]) -> list[str]:
    """The kills that no sample has reached."""
    longest = max((run.time_s for run in runs), default=0.0)
    return [
        f"the kill of {name} at {at:g} s: no sample lasted for so long"
        for name, at in of.kills
        if at > longest
    ]


def driven(
    of: Fork,
    seeds: Sequence[int],
    results: Results,
    until: float = float("inf"),
    done: Done = lambda _: None,
) -> list[Sample]:
    """The samples of a fork, in the order of their seeds, until a time by `time.monotonic`.

    In the first half of them the map holds. These tell how much of the way is out of sight, and how
    long a robot takes that nothing stops. So in the others something is put on the way only where
    it may change the answer, and they do not try for ever.
    """
    half = (len(seeds) + 1) // 2
    runs = _each(of, seeds[:half], None, results, until, done)
    times = [run.time_s for run in runs if run.end == ARRIVED]
    puts = times and of.rate.chance(hidden_m(runs)) > RISK
    patience_s = PATIENCE * median(times) if puts else None
    return runs + _each(of, seeds[half:], patience_s, results, until, lambda n: done(half + n))


def _each(
    of: Fork,
    seeds: Sequence[int],
    patience_s: float | None,
    results: Results,
    until: float,
    done: Done,
) -> list[Sample]:
    runs: dict[int, Sample] = {}
    if time.monotonic() < until:  # later the crew may have ended
        with closing(results(partial(_sample, of, until, patience_s), seeds)) as found:
            for index, run in found:
                runs[index] = run
                done(len(runs))
    why, puts = "it was stopped when the time was over", patience_s is not None
    ended = Sample(seed=0, end=UNENDED, why=why, puts=puts)
    return [runs.get(k, replace(ended, seed=each)) for k, each in enumerate(seeds)]


@contextmanager
def made_map(now: Present) -> Iterator[str | None]:
    """The file of the map that a society makes meanwhile, for the block; None: it makes none."""
    if now.world or now.grid is None or not now.grid.rows:
        yield None
        return
    from armadico.config.grid_map import cells_of, save

    with TemporaryDirectory(prefix="armadico-rehearsal-") as folder:
        path = Path(folder, "made.yaml")
        save(cells_of(now.grid), path)
        yield str(path)


def _warm(of: Fork) -> None:
    Forked(of, 0, lambda: False)


def _sample(of: Fork, until: float, patience_s: float | None, seed: int) -> Sample:
    return sample(of, seed, lambda: time.monotonic() > until, patience_s=patience_s)


def rehearsed(
    mesh: ZenohMesh,
    errand: Errand,
    *,
    samples: int = SAMPLES,
    within_s: float = WITHIN_S,
    seed: int = 0,
    world: str | None = None,
    done: Done = lambda _: None,
) -> Rehearsed:
    """Rehearse an errand of the society on an open, joined mesh, which is only observed.

    The society is observed by a session of its own, which is closed again: a subscription on the
    caller's mesh would stay. Raises ConfigError for an errand that this society cannot have, and
    UnknownNameError.
    """
    began = time.monotonic()
    with Crew() as crew:
        with type(mesh)(mesh.namespace, mesh.where) as own:
            own.wait_joined(min(JOIN_S, within_s))
            now = observe(own, began + within_s)
        with made_map(now) as made:
            of = fork(now, errand, world=world, made=made)
            found = drive(of, samples, within_s, seed=seed, crew=crew, done=done, began=began)
    note(mesh.namespace, errand, found, named=world)
    return found
