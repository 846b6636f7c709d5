"""The answer of a rehearsal: what its samples have in common, in a sentence, and as JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from json import dumps
from math import exp, log, sqrt
from statistics import NormalDist, mean, median
from typing import Any, Final

from msgspec import Struct, to_builtins

from armadico.core.judgement import Answer, Judgement, no, unknown, yes
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import unseen_m
from armadico.observe.jsons import Json, JsonObject
from armadico.observe.slowness import Spot
from armadico.rehearsal.sample import ARRIVED, BROKEN, FAILED, REFUSED, UNENDED, Sample
from armadico.rehearsal.sight import Rate

SPOTS: Final = 3
"""Most slow places in an answer."""

SPOT_S: Final = 2.0
"""A place where the samples are slow for less time on average is not named."""

LISTED: Final = 4
"""Most items of a list in the small JSON."""

TEXT: Final = 110
"""Most bytes of the text of an item there."""

SAYS: Final = 400
"""And of the sentence."""

GRANTED: Final = 1450
"""Most bytes of the small JSON."""


RISK: Final = 0.1
"""Above this probability of not arriving, for what nobody sees, the answer is unknown. Chosen: on a
way whose surroundings in sight are as mapped, the answer is yes up to 12 m out of sight, and up to
14 m if neither of two samples gets past what is put there."""


PRIOR: Final = 0.5
"""Arrivals, and failures, of the beta distribution of a probability of arriving, before any sample:
a few samples do not show that it always arrives, nor that it never does (Jeffreys' prior)."""


SURE: Final = 0.9
"""The probability that one more drive takes a time within the interval that is told."""

SPREAD: Final = 0.1
"""Standard deviation of the logarithm of the time, before any sample: 10 %. Chosen. Samples are
driven on the same map, and may agree by more than a drive agrees with them."""

WORTH: Final = 2
"""So many deviations of samples weigh as much as `SPREAD`. Chosen."""


class Refusal(Struct, frozen=True):
    """Who refuses, for which reason, in how many samples."""

    by: str
    why: str
    samples: int


class Rehearsed(Struct, frozen=True, kw_only=True):
    """The answer. Lengths are m, times s."""

    # Yes if it arrives in all samples in which the map holds. No if it arrives in none, and nothing
    # stands in them whose size is not known. Unknown else, and where something that nobody knows
    # would decide.
    judgement: Judgement
    # The number of samples in which the map holds and it arrives without a collision.
    arrives: int = 0
    samples: int = 0  # the number of samples in which the map holds
    # Of the samples with something put on the way, out of sight, that ended: in how many it
    # arrives, and their number.
    despite: tuple[int, int] = (0, 0)
    despite_s: float | None = None  # the largest time of those that arrive; None: none does
    hidden_m: float = 0.0  # how much of the way is out of sight now, the median
    stands: float = 0.0  # the probability that something stands there that the map does not have
    # The probability of arriving, by both kinds of samples; None: none ended.
    chance: float | None = None
    # How long it takes if it arrives: the median of the samples in which the map holds, between the
    # ends of their `interval`, or of that of samples with something put on the way, if it ends
    # later; empty: none arrives.
    time_s: tuple[float, ...] = ()
    way_m: float = 0.0  # their median length
    # The least distance to an obstacle in these samples, and where the robot is then.
    clearance: tuple[float, float, float] | None = None
    # Where it is slow or unsure, the slowest first: mean time over the samples, and why.
    slow: tuple[Spot, ...] = ()
    drives: dict[str, float] = {}  # the share of each agent in driving, 0 to 1
    battery: float | None = None  # the least share left at the end; None: not known
    refused: tuple[Refusal, ...] = ()  # what is refused, by whom
    fails: dict[str, int] = {}  # the reasons of samples that do not arrive, with their numbers
    unseen_m: float = 0.0  # the length of the path through what nobody has seen
    lacks: tuple[str, ...] = ()  # what a plain yes would need and nobody knows
    unforked: tuple[str, ...] = ()  # what the virtual societies were without
    runs: tuple[Sample, ...] = ()  # the samples
    # Where the robot is, x and y in m; None: nothing was driven.
    start: tuple[float, float] | None = None
    goal: Pose2 | None = None  # the goal; None: a mission, or nothing was driven
    world: str = ""  # the map, for a picture; "": there is none
    took_s: float | None = None  # how long the answer took

    @property
    def says(self) -> str:
        """The answer in one sentence."""
        if not self.samples:
            cure = f" -> {self.judgement.cure}" if self.judgement.cure else ""
            return f"{self.judgement.answer}: {self.judgement.reason}{cure}"
        said = [f"arrives in {self.arrives} of {self.samples}"]
        if self.judgement.answer is Answer.UNKNOWN and self.arrives < self.samples:
            said = [self._unended, *(said if self.arrives else ())]
        if self.time_s:
            least, middle, most = self.time_s
            said.append(f"in {middle:.0f} s ({least:.0f} to {most:.0f}) over {self.way_m:.1f} m")
        if self.clearance is not None:
            away, x, y = self.clearance
            said.append(f"at least {away:.2f} m clear, at ({x:.1f}, {y:.1f})")
        said += [
            f"slow at ({s.x:.1f}, {s.y:.1f}) for {s.seconds:.0f} s: {s.why}" for s in self.slow[:1]
        ]
        if self.hidden_m:
            said.append(self.hides)
        if self.battery is not None:
            said.append(f"{self.battery:.0%} of the battery is left")
        said += [f"refused by {each.by}: {each.why}" for each in self.refused[:1]]
        said += [f"{n} of {self.samples}: {why}" for why, n in [*self.fails.items()][:1]]
        if self.unseen_m:
            said.append(f"{self.unseen_m:.1f} m of the path lead through what nobody has seen")
        if self.lacks:
            more = f" and {len(self.lacks) - 1} more" if len(self.lacks) > 1 else ""
            said.append(f"not known: {self.lacks[0]}{more}")
        return "; ".join(said)

    @property
    def hides(self) -> str:
        """What the answer owes to the map alone."""
        way = f" of {self.way_m:.1f}" if self.way_m else ""
        told = f"{self.hidden_m:.1f}{way} m are out of sight now"
        arrives, samples = self.despite
        if samples:
            told += f": with something put there it arrives in {arrives} of {samples}"
        if more := sum(not (run.holds or _ended(run)) for run in self.runs):
            told += f"; {more} with something there did not end"
        return told

    @property
    def _unended(self) -> str:
        """Which samples leave it unknown: they failed, did not end, or their agents raised."""
        ends = Counter(run.end for run in self.runs if run.holds)
        took = "" if self.took_s is None else f" after {self.took_s:.0f} s"
        words = {
            FAILED: "did not arrive",
            UNENDED: f"had not ended{took}",
            BROKEN: "could not go on",
        }
        told = (f"{ends[end]} of {self.samples} {what}" for end, what in words.items() if ends[end])
        return f"not known: {', '.join(told)}"

    @property
    def lines(self) -> list[str]:
        """The answer for people, one line for each thing."""
        if not self.samples:
            return [self.says]
        said = [f"{self.judgement.answer}: {self.says}"]
        if self.drives:
            shares = (f"{name} {share:.0%}" for name, share in self.drives.items())
            said.append(f"  drives: {', '.join(shares)}")
        said += [
            f"  slow or unsure at ({s.x:.1f}, {s.y:.1f}), {s.seconds:.0f} s: {s.why}"
            for s in self.slow
        ]
        said += [
            f"  refused by {r.by} in {r.samples} of {self.samples}: {r.why}" for r in self.refused
        ]
        said += [f"  {n} of {self.samples}: {why}" for why, n in self.fails.items()]
        said += [f"  not known: {each}" for each in self.lacks]
        said += [f"  left out: {each}" for each in self.unforked]
        if self.judgement.cure:
            said.append(f"  -> {self.judgement.cure}")
        return said

    @property
    def small(self) -> JsonObject:
        """The answer as JSON of less than 1.5 kB, also if all of it is written in ASCII."""
        found: JsonObject = {
            "answer": str(self.judgement.answer),
            "says": _cut(self.says, SAYS),
            "arrives": self.arrives,
            "of": self.samples,
        }
        if self.judgement.answer is not Answer.YES:
            found["why"] = _cut(self.judgement.reason, 2 * TEXT)
            if self.judgement.cure:
                found["cure"] = _cut(self.judgement.cure, 2 * TEXT)
        found |= {name: value for name, value in self._numbers.items() if value is not None}
        lists: dict[str, list[Any]] = {
            "refused": [{"by": r.by, "why": _cut(r.why), "of": r.samples} for r in self.refused],
            "fails": [{"why": _cut(why), "of": n} for why, n in self.fails.items()],
            "lacks": [_cut(each) for each in self.lacks],
            "drives": [*self.drives.items()],
            "slow": [{**to_builtins(s), "why": _cut(s.why)} for s in self.slow],
            "unforked": [_cut(each) for each in self.unforked],
        }
        for name, items in lists.items():
            for count in range(1, min(LISTED, len(items)) + 1):
                some = items[:count]
                longer: JsonObject = {**found, name: dict(some) if name == "drives" else some}
                if _size(longer) > GRANTED:
                    return found
                found = longer
        return found

    @property
    def _numbers(self) -> JsonObject:
        """What the small JSON has if it is known."""
        at, hidden, times = self.clearance, bool(self.hidden_m), self.time_s
        return {
            "time_s": [round(t, 1) for t in times] if times else None,
            "way_m": round(self.way_m, 1) if times else None,
            "clearance_m": at and at[0],
            "clearance_at": at and at[1:],
            "battery": None if self.battery is None else round(self.battery, 3),
            "chance": None if self.chance is None else round(self.chance, 2),
            "hidden_m": round(self.hidden_m, 1) if hidden else None,
            "stands": round(self.stands, 2) if hidden else None,
            "despite": self.despite if self.despite[1] else None,
            "despite_s": None if self.despite_s is None else round(self.despite_s, 1),
            "unseen_m": round(self.unseen_m, 1) if self.unseen_m else None,
            "took_s": None if self.took_s is None else round(self.took_s, 1),
        }

    @property
    def full(self) -> JsonObject:
        """All of it as JSON, with the samples' paths."""
        found: JsonObject = to_builtins(self)
        found["judgement"] = {
            "answer": str(self.judgement.answer),
            "reason": self.judgement.reason,
            "cure": self.judgement.cure,
        }
        return {"says": self.says, **found}


def _size(value: Json) -> int:
    return len(dumps(value))


def _cut(text: str, most: int = TEXT) -> str:
    """The beginning of a text that has at most so many bytes as JSON in ASCII."""
    while (size := _size(text)) > most:
        text = text[: len(text) * most // size]
    return text


def without_samples(judgement: Judgement, took_s: float | None = None) -> Rehearsed:
    """The answer where nothing can be driven."""
    return Rehearsed(judgement=judgement, took_s=took_s)


def answer(
    runs: Sequence[Sample],
    *,
    lacks: Sequence[str] = (),
    unforked: Sequence[str] = (),
    rate: Rate | None = None,
    vague: int = 0,
    start: tuple[float, float] | None = None,
    goal: Pose2 | None = None,
    world: str = "",
    took_s: float | None = None,
) -> Rehearsed:
    """The answer of some samples of one fork; `rate` and `vague` are the fork's."""
    driven, runs = runs, [run for run in runs if run.holds]
    put = [run for run in driven if not run.holds]
    arrived = [run for run in runs if run.end == ARRIVED]
    hidden = hidden_m(runs)
    stands = rate.chance(hidden) if rate is not None else 0.0
    plain, despite = _counted(runs), _counted(put)
    past = _probability(despite)
    chance = (1.0 - stands) * _probability(plain) + stands * past if plain[1] else None
    if runs and all(run.end == REFUSED for run in runs):
        chance = 0.0  # the planner decides, no draw does
    unseen = max((unseen_m(run.unseen) for run in runs), default=0.0)
    missing = [*lacks]
    shown = past if despite[1] or not put else 0.0  # none ended: nothing speaks for getting past it
    if stands * (1.0 - shown) > RISK:
        missing.append(
            f"what stands on the {hidden:.1f} m of the way that are out of sight: something that"
            f" the map does not have, with a probability of {stands:.0%}"
        )
    if unseen:
        missing.append(f"{unseen:.1f} m of the way, which nobody has seen on the map")
    cycles: Counter[str] = Counter()
    for run in runs:
        cycles.update(run.shares)
    whole = cycles.total()
    clearances = [run.clearance for run in runs if run.clearance is not None]
    batteries = [run.battery for run in runs if run.battery is not None]
    fails = Counter(_short(run.why) for run in runs if run.end in (FAILED, UNENDED, BROKEN))
    return Rehearsed(
        judgement=_judged(runs, lacks, missing, vague),
        arrives=len(arrived),
        samples=len(runs),
        despite=despite,
        despite_s=max((run.time_s for run in put if run.end == ARRIVED), default=None),
        hidden_m=hidden,
        stands=stands,
        chance=chance,
        time_s=_times(arrived, [run for run in put if run.end == ARRIVED]),
        way_m=median(run.way_m for run in arrived) if arrived else 0.0,
        clearance=min(clearances, default=None),
        slow=_slow(runs),
        drives={name: round(n / whole, 3) for name, n in cycles.most_common()},
        battery=min(batteries, default=None),
        refused=_refusals(runs),
        fails=dict(fails.most_common()),
        unseen_m=unseen,
        lacks=tuple(missing),
        unforked=tuple(unforked),
        runs=tuple(driven),
        start=start,
        goal=goal,
        world=world,
        took_s=took_s,
    )


def _times(plain: Sequence[Sample], put: Sequence[Sample]) -> tuple[float, ...]:
    """See `Rehearsed.time_s`: of the samples that arrive.

    Samples with something put there count as if it stood there: `stands` is told too small.
    """
    if not plain:
        return ()
    times = [run.time_s for run in plain]
    least, most = interval(times)
    if put:
        most = max(most, interval([run.time_s for run in put])[1])
    return least, median(times), most


def interval(times: Sequence[float]) -> tuple[float, float]:
    """Where the time of one more drive is, with a probability of `SURE`, from those of N samples.

    The prediction interval of a normal distribution of the logarithm of the time. The prior of its
    mean is flat, that of its variance inverse chi-squared. So the interval is that of Student's t
    distribution with `WORTH` + N - 1 degrees of freedom (Gelman et al., *Bayesian Data Analysis*,
    section 3.3).
    """
    logs = [log(max(time, 1e-3)) for time in times]  # it may stand at the goal
    middle, free = mean(logs), WORTH + len(logs) - 1
    squares = WORTH * SPREAD**2 + sum((each - middle) ** 2 for each in logs)
    half = student(free) * sqrt(squares / free * (1.0 + 1.0 / len(logs)))
    return exp(middle - half), exp(middle + half)


def student(free: int) -> float:
    """The quantile of Student's t distribution that both tails of `SURE` leave out.

    By the expansion of Abramowitz and Stegun, 26.7.5; 1 % too small for 2 degrees of freedom.
    """
    z = NormalDist().inv_cdf(0.5 + SURE / 2.0)
    terms = (
        z,
        (z**3 + z) / 4.0,
        (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0,
        (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0,
    )
    return sum((term / free**k for k, term in enumerate(terms)), 0.0)


def hidden_m(runs: Sequence[Sample]) -> float:
    """How much of the way is out of sight, by samples in which the map holds."""
    told = [run for run in runs if run.end == ARRIVED] or runs
    return median(run.hidden_m for run in told) if told else 0.0


def _ended(run: Sample) -> bool:
    return run.end not in (UNENDED, BROKEN)


def _counted(runs: Sequence[Sample]) -> tuple[int, int]:
    """In how many samples it arrives, and how many ended."""
    return sum(run.end == ARRIVED for run in runs), sum(map(_ended, runs))


def _probability(counted: tuple[int, int]) -> float:
    return (counted[0] + PRIOR) / (counted[1] + 2 * PRIOR)


def _judged(
    runs: Sequence[Sample], lacks: Sequence[str], missing: Sequence[str], vague: int
) -> Judgement:
    """The answer of samples; `lacks` are those of `missing` that make a failure uncertain, too."""
    ends = Counter(run.end for run in runs)
    bad = [run for run in runs if run.end in (FAILED, REFUSED)]
    broken = dict.fromkeys(_short(run.why) for run in runs if run.end == BROKEN)
    could_not = f"{ends[BROKEN]} of {len(runs)} could not go on: {'; '.join(broken)}"
    if bad:
        reasons = dict.fromkeys(_short(run.why) for run in bad)
        fails = f"it does not arrive in {len(bad)} of {len(runs)}: {'; '.join(reasons)}"
        if len(bad) == len(runs) and (ends[REFUSED] or not (vague or lacks)):
            return no(fails)
        if broken:
            fails = f"{fails}; {could_not}"
        if vague and not ends[REFUSED]:
            things = f"{vague} thing{'s' * (vague > 1)} off the map"
            return unknown(
                f"{fails}; {things} stand in them as they are seen from here, with a size that is"
                " not known, or may be people",
                "ask again when the robot is nearer to them",
            )
        if lacks and not ends[REFUSED]:
            return unknown(f"{fails}, if this makes no difference: {'; '.join(lacks)}")
        return unknown(fails)
    if not runs:
        return unknown("nothing was driven")
    if broken:
        return unknown(could_not)
    if ends[UNENDED]:
        reasons = dict.fromkeys(_short(run.why) for run in runs if run.end == UNENDED)
        return unknown(
            f"{ends[UNENDED]} of {len(runs)} did not end: {'; '.join(reasons)}",
            "give it more time: --within S",
        )
    if missing:
        return unknown(f"it arrives, if this makes no difference: {'; '.join(missing)}")
    return yes()


def _short(why: str) -> str:
    return why.partition("\n")[0]


def _refusals(runs: Sequence[Sample]) -> tuple[Refusal, ...]:
    counts = Counter(_short(run.why) for run in runs if run.end == REFUSED)
    return tuple(Refusal(_refuses(why), why, n) for why, n in counts.most_common())


def _refuses(why: str) -> str:
    """Who refuses for a reason: the interface agent passes on what the planner says."""
    own = (
        *("the robot's pose", "under way", "moves", "no encoder", "has the robot driven"),
        *("no mission planning agent", "no path planning agent"),
    )
    return "interface" if any(words in why for words in own) else "path-planning"


def _slow(runs: Sequence[Sample]) -> tuple[Spot, ...]:
    """The places where the samples are slow, with the mean time over all of them."""
    found: dict[tuple[float, float], list[Spot]] = {}
    for run in runs:
        for spot in run.spots:
            found.setdefault((spot.x, spot.y), []).append(spot)
    means = [
        Spot(
            x,
            y,
            round(sum(each.seconds for each in spots) / len(runs), 1),
            Counter({e.why: e.seconds for e in spots}).most_common(1)[0][0],
        )
        for (x, y), spots in found.items()
    ]
    slowest = sorted(means, key=lambda spot: (-spot.seconds, spot.x, spot.y))
    return tuple(spot for spot in slowest if spot.seconds >= SPOT_S)[:SPOTS]
