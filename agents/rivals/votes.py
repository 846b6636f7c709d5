"""Mechanisms that weigh what every behaviour says of every action of one list."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import exp
from typing import Annotated, Final, Literal

from msgspec import Meta, Struct, field

from armadico.agents.rivals.arbiter import REST, Arbiter, Decision, Speeds, Wish
from armadico.agents.rivals.grid import SPEEDS, TURNS, actions, areas, peak
from armadico.agents.rivals.proposer import Arbitrated
from armadico.core import parameters
from armadico.core.messages import Cycle, Description, RobotState
from armadico.core.parameters import AgentName
from armadico.mobile.motion import Body

Weight = Annotated[float, Meta(ge=0, le=10)]
Share = Annotated[float, Meta(ge=0, le=1)]


class Voted(Arbiter, hooks=("scores", "choose")):
    """The action with the best score; a subclass computes `scores`."""

    def scores(self, rated: Mapping[str, Wish], grid: Sequence[Speeds], body: Body) -> list[float]:
        """Return each action's score."""
        raise NotImplementedError("scores(self, rated, grid, body) returns the scores")

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        about = self.latest(Description)
        if about is None:
            return Decision(REST, {})
        body = Body.of(about)
        grid = actions(body)
        rated = {name: wish for name, wish in wishes.items() if len(wish.votes) == len(grid)}
        if not rated:
            return Decision(REST, {})
        return self.choose(rated, grid, self.scores(rated, grid, body))

    def choose(
        self, rated: Mapping[str, Wish], grid: Sequence[Speeds], scores: Sequence[float]
    ) -> Decision:
        """Return the best action, and who is for it."""
        return best_of(rated, grid, scores)


def best_of(rated: Mapping[str, Wish], grid: Sequence[Speeds], scores: Sequence[float]) -> Decision:
    """Return the action with the best score, between its neighbours by a parabola each way."""
    best = max(range(len(grid)), key=lambda i: scores[i])
    v, w = grid[best]
    row, column = divmod(best, len(TURNS))
    if 0 < row < len(SPEEDS) - 1:
        here = best - len(TURNS), best, best + len(TURNS)
        v = peak([grid[i][0] for i in here], [scores[i] for i in here])
    if 0 < column < len(TURNS) - 1:
        here = best - 1, best, best + 1
        w = peak([grid[i][1] for i in here], [scores[i] for i in here])
    return Decision((v, w), shares(rated, best))


def shares(rated: Mapping[str, Wish], best: int) -> dict[str, float]:
    """Return how much each behaviour is for an action, as shares of 1.

    A vote counts by how far it is above the behaviour's mean: who likes every action has no part in
    the choice.
    """
    above = {n: w.votes[best] - sum(w.votes) / len(w.votes) for n, w in rated.items()}
    total = sum(max(each, 0.0) for each in above.values())
    return {name: max(each, 0.0) / total for name, each in above.items()} if total > 0.0 else {}


class Mode(Struct, frozen=True, forbid_unknown_fields=True):
    """The weights of the votes in one mode, by agent; 1 if it is not named."""

    weights: dict[AgentName, Weight] = {}


class DamnParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of DAMN's arbiter."""

    cruise: Mode = Mode({"avoid": 1.0})
    close: Mode = Mode({"avoid": 2.0})  # while a behaviour's bid is critical
    smooth: Annotated[float, Meta(ge=0, le=5)] = 0.7  # columns: width of the smoothing of turns


class Damn(Voted):
    """Each behaviour votes for and against every action; the largest weighted sum wins.

    Rosenblatt (1997), DAMN: votes by each behaviour's own evaluation, weights by the mode, smoothed
    over the turn rates. Speed and turn rate are voted on together, as the text has it for degrees
    of freedom that depend on each other (2.4.5); Navlab had an arbiter for each.
    """

    name = "damn"
    parameters = DamnParameters
    p: DamnParameters

    def scores(
        self,
        rated: Mapping[str, Wish],
        grid: Sequence[Speeds],
        body: Body,  # noqa: ARG002
    ) -> list[float]:
        critical = any(wish.critical for wish in rated.values())
        weights = (self.p.close if critical else self.p.cruise).weights
        sums = [0.0] * len(grid)
        for name, wish in rated.items():
            weight = weights.get(name, 1.0)
            for i, vote in enumerate(wish.votes):
                sums[i] += weight * vote
        return smoothed(sums, self.p.smooth)


def smoothed(scores: Sequence[float], width: float) -> list[float]:
    """Return the scores, smoothed over the turn rates of each speed by a Gaussian."""
    if width <= 0.0:
        return list(scores)
    kernel = {k: exp(-0.5 * (k / width) ** 2) for k in range(-2, 3)}
    found, columns = [], len(TURNS)
    for i in range(len(scores)):
        row, column = divmod(i, columns)
        near = {k: g for k, g in kernel.items() if 0 <= column + k < columns}
        summed = sum(g * scores[row * columns + column + k] for k, g in near.items())
        found.append(summed / sum(near.values()))
    return found


class ConstrainedParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of the constrained optimum."""

    speed: Weight = 1.0  # for the speed itself
    weights: dict[AgentName, Weight] = field(default_factory=lambda: {"avoid": 0.4})  # else 1
    window_s: Annotated[float, Meta(gt=0, le=10)] = 0.8  # what the ramps reach in this time


class Constrained(Voted):
    """The best action among those that no behaviour forbids and that the ramps can reach.

    Simmons (1996), the curvature-velocity method below TCA: constraints cut actions out, and a
    weighted sum of speed, free way and heading chooses among the rest. A vote of -1 is a
    constraint.
    """

    name = "constrained"
    parameters = ConstrainedParameters
    p: ConstrainedParameters

    def scores(self, rated: Mapping[str, Wish], grid: Sequence[Speeds], body: Body) -> list[float]:
        p, state = self.p, self.latest(RobotState)
        v0, w0 = (0.0, 0.0) if state is None else (state.v, state.w)
        low, high = v0 - body.v_decel * p.window_s, v0 + body.v_accel * p.window_s
        turn = body.w_accel * p.window_s
        found = []
        for i, (v, w) in enumerate(grid):
            votes = {name: wish.votes[i] for name, wish in rated.items()}
            if min(votes.values()) <= -1.0:
                found.append(-20.0)
                continue
            outside = not low <= v <= high or abs(w - w0) > turn
            score = p.speed * v / body.v_max
            score += sum(p.weights.get(name, 1.0) * vote for name, vote in votes.items())
            found.append(score - 10.0 * outside)
        return found


class FuzzyParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of the fuzzy blending."""

    # "and": min over b of max(1 - C, D), all that applies; "or": max over b of min(C, D)
    blend: Literal["and", "or"] = "and"
    cut: Share = 0.9  # share of the largest desirability from which an action counts


class Fuzzy(Voted):
    """Desirability of each action, blended by each behaviour's context; then its centroid.

    Saffiotti, Konolige and Ruspini (1995), Saphira: a behaviour has a desirability function D over
    the controls, and a context C in which it applies. Here C is its utility, and D is 1 for its
    best vote. By Yavuz and Bradshaw (2002) the union of the truncated sets is taken ("or").
    """

    name = "fuzzy"
    parameters = FuzzyParameters
    p: FuzzyParameters

    def scores(
        self,
        rated: Mapping[str, Wish],
        grid: Sequence[Speeds],
        body: Body,  # noqa: ARG002
    ) -> list[float]:
        found = []
        for i in range(len(grid)):
            pairs = [(wish.utility, 0.5 + 0.5 * wish.votes[i]) for wish in rated.values()]
            if self.p.blend == "and":
                found.append(min(max(1.0 - c, d) for c, d in pairs))
            else:
                found.append(max(min(c, d) for c, d in pairs))
        return found

    def choose(
        self, rated: Mapping[str, Wish], grid: Sequence[Speeds], scores: Sequence[float]
    ) -> Decision:
        """Return the centroid of the best actions, by desirability."""
        top = max(scores)
        if top <= 0.0:
            return Decision(REST, {})
        weights = {
            i: score * area
            for i, (score, area) in enumerate(zip(scores, areas(), strict=True))
            if score >= self.p.cut * top
        }
        total = sum(weights.values())
        v = sum(weight * grid[i][0] for i, weight in weights.items()) / total
        w = sum(weight * grid[i][1] for i, weight in weights.items()) / total
        return Decision((v, w), shares(rated, max(weights, key=lambda i: scores[i])))


DAMN: Final = Arbitrated(
    Damn.name, needs="rate", about="the action with the most votes, weighted by the mode"
)
CONSTRAINED: Final = Arbitrated(
    Constrained.name,
    needs="rate",
    about="the best of what no behaviour forbids and the ramps can reach",
)
FUZZY: Final = Arbitrated(
    Fuzzy.name, needs="rate", about="the centroid of what is desirable in the present context"
)
