"""Learning of utilities: from runs in which chance decides for seconds who drives.

In a run by the coordination `exploring` each agent's utility is random for 2 of every 4 s. What the
agent with the largest one saved is the robot's progress along the way until the next draw, less the
average from like situations, over the pace; ridge regression on the features of its bid predicts
it. Whether it then held the wheels all the time does not matter: what is learnt is the worth of a
large bid, whatever becomes of it. That is one step of policy improvement on the own utilities.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from statistics import fmean
from typing import Final

import numpy as np
from msgspec import Struct, structs

from armadico.agents.rivals.learned import PERIOD, drawn, features, ordinary
from armadico.core.exchange import Bid
from armadico.core.messages import Message
from armadico.core.parameters import TURN_MARGIN_M
from armadico.launch.society import LIMIT_SPEED
from armadico.mobile.behaviour import Behaviour
from armadico.mobile.messages import Truth
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.swept_path import free_path
from armadico_tools.campaign.learn import Search, Task
from armadico_tools.experiments.driving import LATE, Cell, Drive

RIDGE: Final = 3.0
"""Of all weights but the first. The features are numbers of about 1."""

EPISODES: Final = 60
"""An agent with fewer keeps its own utility."""

CONTACT_S: Final = 4.0
"""What a contact costs: as much as the whole time until the next draw."""

NEAR_M: Final = 3.0
FREE_M: Final = (0.8, 1.6)
"""Borders of like situations: of the way to go, and of the free way straight ahead."""


class Episode(Struct, frozen=True):
    """What followed from a random draw."""

    agent: str  # that bid most by it
    features: tuple[float, ...]
    like: str  # the situation, of those that are like each other
    gained_s: float  # progress until the next draw, over the pace


class Explored(Drive):
    """A run by `exploring`, with its episodes."""

    def __init__(self, cell: Cell, seed: int) -> None:
        super().__init__(cell, seed)
        self.episodes: list[Episode] = []
        self._begun: tuple[Episode, float, int] | None = None  # with the way to go, and contacts

    def _tick(self, truth: Message) -> None:
        super()._tick(truth)
        assert isinstance(truth, Truth), "it watches nothing else"
        rivals = [
            node.agent
            for node in self.rehearsal.mesh.nodes
            if node.alive and isinstance(node.agent, Behaviour) and node.agent.route.waypoints
        ]
        newest = rivals[0].cycles.newest if rivals and self.watch.mission else None
        if newest is None or self.watch.done or newest.number % PERIOD:
            return
        to_go = rivals[0].route.to_go(truth.x, truth.y)
        if self._begun is not None:
            episode, before, contacts = self._begun
            gained = (before - to_go) / LIMIT_SPEED - CONTACT_S * (truth.collisions > contacts)
            self.episodes.append(
                Episode(episode.agent, episode.features, episode.like, round(gained, 4))
            )
            self._begun = None
        found = []
        for agent in rivals:
            last = agent.kernel.bids[-1] if agent.kernel.bids else None
            if last is None or not last.utility or newest.number - last.cycle.number > LATE:
                continue
            bid = Bid(last.utility, last.wanted, last.critical)
            if not ordinary(bid):
                return  # the draw decides nothing
            if (known := features(agent, bid)) is not None:
                rounded = tuple(round(x, 5) for x in known)
                found.append((drawn(agent.name, newest), agent.name, rounded))
        if len(found) > 1:  # one alone drives whatever it bids
            _, name, rounded = max(found)
            like = f"{to_go > NEAR_M} {_free(rivals[0])}"
            self._begun = Episode(name, rounded, like, 0.0), to_go, truth.collisions


def _free(agent: Behaviour) -> int:
    """How much way is free straight ahead, of three classes."""
    obstacles = agent.latest(Obstacles)
    points = () if obstacles is None else obstacles.points
    free = free_path(points, 1.0, 0.0, agent.body.outline, TURN_MARGIN_M)
    return sum(free > border for border in FREE_M)


def exploring(search: Search) -> list[Task]:
    """The runs of a search by chance, in its worlds."""
    tasks = (search.task((), index) for index in range(search.size.search))
    return [
        (structs.replace(cell, name=f"{cell.world} exploring", coordination="exploring"), seed)
        for cell, seed in tasks
    ]


def explore(task: Task) -> list[Episode]:
    """The episodes of one run, for a worker process."""
    run = Explored(*task)
    run.go()
    return run.episodes


class Fitted(Struct, frozen=True):
    """The learned utility of one agent: a line of the history."""

    agent: str
    episodes: int
    gained_s: float  # mean, less the average from like situations
    explained: float | None  # share of the variance, each episode predicted from all others
    weights: tuple[float, ...]  # none: too few episodes

    @property
    def setting(self) -> str:
        """It as AGENT.KEY=VALUE."""
        return f"{self.agent}.social.utility=[{', '.join(f'{w:.4g}' for w in self.weights)}]"


def fit(episodes: Sequence[Episode], agents: Sequence[str]) -> list[Fitted]:
    """Predict what each agent's bid saves, s, from its features, by ridge regression."""
    likes = defaultdict(list)
    for one in episodes:
        likes[one.like].append(one.gained_s)
    average = {like: fmean(values) for like, values in likes.items()}
    found = []
    for agent in agents:
        ours = [one for one in episodes if one.agent == agent]
        y = np.array([one.gained_s - average[one.like] for one in ours])
        mean = float(y.mean()) if ours else 0.0
        if len(ours) < EPISODES:
            found.append(Fitted(agent, len(ours), round(mean, 4), None, ()))
            continue
        x = np.array([one.features for one in ours])
        penalty = RIDGE * np.eye(x.shape[1])
        penalty[0, 0] = 0.0
        inverse = np.linalg.inv(x.T @ x + penalty)
        weights = inverse @ x.T @ y
        leverage = np.einsum("ij,jk,ik->i", x, inverse, x)
        left_out = (y - x @ weights) / (1.0 - leverage)
        # An episode's mean of the others, too, does not contain itself.
        plain = (y - mean) * len(ours) / (len(ours) - 1)
        explained = 1.0 - float((left_out**2).sum() / (plain**2).sum())
        digits = tuple(float(f"{w:.4g}") for w in weights)
        found.append(Fitted(agent, len(ours), round(mean, 4), round(explained, 4), digits))
    return found
