"""The virtual mesh as a star: the robot agent's process is the router of all others."""

from __future__ import annotations

import itertools
from typing import Any, ClassVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armadico.core import messages as m
from armadico.core.agent import Agent
from armadico.core.resources import WHEELS
from armadico.launch.virtual_session import VirtualSession
from armadico.mesh.presence import GRACE_S
from armadico.mesh.topology import DEFAULT_NAMESPACE
from armadico.mesh.virtual import LEASE, LIVELINESS, RECONNECT, Node, VirtualMesh
from armadico.mobile.messages import Plan, Pose

from .test_virtual_mesh import REQUEST, Asker, Listener, Planner, Word, status

SOON = 0.05
"""s; longer than any message takes."""

BACK = RECONNECT[1] + SOON
"""s; within this every client has found a router that works."""


class Member(Listener):
    """Publishes its name and a number a hundred times a second, and keeps what it receives."""

    every: ClassVar[float] = 0.01  # s
    mesh: VirtualMesh  # whose time counts: an agent's own stands still while it hangs

    def __init__(self, identity: Any) -> None:
        super().__init__(identity)
        self.count = 0
        self.routers: list[tuple[float, bool]] = []

    def on_start(self) -> None:
        self.wake_at(self.now + self.every)

    def on_wakeup(self) -> None:
        self.wake_at(self.now + self.every)
        self.count += 1
        self.publish(Word(f"{self.name} {self.count}"))

    def on_word(self, word: Word) -> None:
        self.seen.append((self.mesh.now, word.text))

    def on_appeared(self, name: str, instance: str) -> None:
        self.tokens.append((self.mesh.now, f"+{name}"))

    def on_disappeared(self, name: str, instance: str) -> None:
        self.tokens.append((self.mesh.now, f"-{name}"))

    def on_router(self) -> None:
        self.routers.append((self.mesh.now, self.reachable))

    def received(self, name: str, since: float = 0.0, until: float = 1e9) -> list[int]:
        """The numbers received from an agent within some time."""
        words = [text.split() for at, text in self.seen if since <= at <= until]
        return [int(number) for by, number in words if by == name]

    def gone(self) -> list[str]:
        """The agents that were reported as gone, in order."""
        return [news[1:] for _, news in self.tokens if news.startswith("-")]

    def came(self, since: float) -> set[str]:
        return {news[1:] for at, news in self.tokens if news.startswith("+") and at >= since}


class Robot(Member):
    """A robot agent: its process is the router."""

    name = "robot"
    owns = (WHEELS,)

    def obey(self, resource: Any, action: Any) -> None:
        """Nothing."""

    def rest(self, resource: Any) -> None:
        """Nothing."""


class World:
    """A robot agent, whose process is the router, and others."""

    def __init__(self, *names: str, seed: int = 1) -> None:
        self.mesh = VirtualMesh(seed)
        self.nodes: dict[str, Node] = {}
        for name in ("robot", *names):
            self.start(name)
        self.run(1.0)

    every = Member.every

    def start(self, name: str, kind: type[Agent] | None = None) -> Any:
        """Start an agent, for the first time or again."""
        if kind is None:
            base = Robot if name == "robot" else Member
            kind = type(name, (base,), {"name": name, "every": self.every, "mesh": self.mesh})
        starts = sum(node.name == name for node in self.mesh.nodes)
        self.nodes[name] = self.mesh.add(kind(self.mesh.identity(name, starts)), admit=False)
        return self.nodes[name].agent

    def run(self, seconds: float) -> float:
        """Let time pass, and return it."""
        self.mesh.run(self.mesh.now + seconds)
        return self.mesh.now

    def restart(self, name: str) -> Any:
        self.nodes[name].kill()
        return self.start(name)

    def __getitem__(self, name: str) -> Any:
        agent = self.nodes[name].agent
        assert isinstance(agent, Member)
        return agent

    @property
    def others(self) -> list[Any]:
        """The agents without the robot's."""
        return [self[name] for name in self.nodes if name != "robot"]


# A router that restarts ---------------------------------------------------------------------------


def test_while_the_router_is_away_its_clients_receive_nothing_and_none_is_reported_as_gone() -> (
    None
):
    world = World("goto", "avoid")
    world.nodes["robot"].kill()
    killed = world.mesh.now
    world.run(3.0)
    away = killed + LIVELINESS + SOON, world.mesh.now
    for agent in world.others:
        assert agent.routers == [(pytest.approx(killed + LIVELINESS, abs=SOON), False)]
        assert agent.gone() == []
        assert not agent.reachable
    assert world["goto"].received("avoid", *away) == []


def test_when_the_router_is_back_all_find_it_and_only_the_old_robot_agent_is_reported_as_gone() -> (
    None
):
    world = World("goto", "avoid")
    world.nodes["robot"].kill()
    world.run(3.0)
    world.start("robot")
    back = world.mesh.now
    world.run(RECONNECT[0] - 0.01)
    assert not any(agent.reachable for agent in world.others)
    world.run(BACK - RECONNECT[0])
    assert all(agent.reachable for agent in world.others)
    since = world.run(0.1)
    world.run(1.0)
    for agent in world.others:
        assert agent.gone() == []
        assert agent.came(back) >= {"robot"}
        for other in ("robot", "goto", "avoid"):
            assert other == agent.name or agent.received(other, since)
    world.run(BACK + GRACE_S)
    for agent in world.others:
        assert agent.gone() == ["robot"]
        assert len(agent.routers) == 2


def test_an_agent_that_has_gone_while_the_router_was_away_is_reported_after_the_grace_period() -> (
    None
):
    world = World("goto", "avoid")
    world.nodes["robot"].kill()
    world.run(1.0)
    world.nodes["avoid"].kill()
    world.run(1.0)
    world.start("robot")
    world.run(RECONNECT[0] + GRACE_S - SOON)
    assert world["goto"].gone() == []
    world.run(RECONNECT[1] - RECONNECT[0] + 2 * SOON)
    assert sorted(world["goto"].gone()) == ["avoid", "robot"]


def test_an_agent_that_starts_without_a_router_begins_once_it_comes() -> None:
    world = World("goto")
    world.nodes["robot"].kill()
    world.run(1.0)
    avoid = world.start("avoid")
    world.run(2.0)
    assert avoid.count == 0
    assert world["goto"].received("avoid") == []
    world.start("robot")
    world.run(BACK)
    since = world.run(BACK)
    world.run(0.1)
    assert world["goto"].received("avoid", since)
    assert avoid.received("goto", since)
    assert avoid.came(0.0) == {"robot", "goto"}


def test_an_agent_that_hangs_while_the_router_restarts_finds_it_afterwards() -> None:
    world = World("goto", "avoid")
    world.nodes["goto"].hang()
    world.run(0.1)
    world.restart("robot")
    world.run(0.7)
    assert world["avoid"].reachable
    world.nodes["goto"].resume()
    world.run(BACK)
    since = world.run(0.1)
    world.run(GRACE_S)
    assert world["goto"].reachable
    assert world["goto"].received("avoid", since)
    assert world["avoid"].gone() == ["robot"], "it was back in time"


# A router that hangs ------------------------------------------------------------------------------


def test_what_passes_a_router_that_hangs_for_less_than_the_lease_waits_and_none_is_lost() -> None:
    world = World("goto", "avoid")
    hung = world.mesh.now
    world.nodes["robot"].hang()
    world.run(LEASE - 0.1)
    assert world["goto"].received("avoid", hung + SOON) == []
    world.nodes["robot"].resume()
    world.run(0.5)
    numbers = world["goto"].received("avoid")
    assert numbers == list(range(1, len(numbers) + 1))
    assert world["avoid"].count - numbers[-1] < 5
    for agent in (*world.others, world["robot"]):
        assert agent.routers == []
        assert agent.gone() == []


def test_when_a_router_hangs_for_longer_all_are_cut_off_and_what_waited_is_lost() -> None:
    world = World("goto", "avoid")
    hung = world.mesh.now
    world.nodes["robot"].hang()
    world.run(2 * LEASE)
    for agent in world.others:
        assert agent.routers == [(pytest.approx(hung + LEASE, abs=SOON), False)]
    world.nodes["robot"].resume()
    woken = world.mesh.now
    world.run(BACK)
    assert world["goto"].received("avoid", hung + SOON, woken) == []
    assert all(agent.reachable for agent in world.others)
    lost = set(range(1, world["avoid"].count)) - set(world["goto"].received("avoid"))
    assert len(lost) * 0.01 == pytest.approx(2 * LEASE + sum(RECONNECT) / 2, abs=0.3)
    world.run(2 * GRACE_S)
    assert [agent.gone() for agent in world.others] == [[], []]
    since = world.run(0.1)
    world.run(0.1)
    for one, other in itertools.permutations(world.nodes, 2):
        assert world[one].received(other, since)


def test_a_query_waits_in_a_router_that_hangs_and_one_without_a_router_ends_at_once() -> None:
    world = World()
    asker = world.start("asker", Asker)
    world.start("planner", Planner)
    world.run(0.1)
    world.nodes["robot"].hang()
    world.mesh.publish(status(1))
    world.run(0.2)
    assert asker.got == []
    world.nodes["robot"].resume()
    world.run(SOON)
    ((_, plan),) = asker.got
    assert plan == Plan((), 1.0)
    world.nodes["robot"].kill()
    world.run(SOON)
    world.mesh.publish(status(2))
    world.run(SOON)
    assert [plan for _, plan in asker.got[1:]] == [None]


# A cut between an agent and the router ------------------------------------------------------------


@pytest.mark.parametrize("back", [False, True])
def test_a_query_from_outside_the_society_passes_its_router(back: bool) -> None:
    world = World()
    world.start("planner", Planner)
    world.run(0.1)
    got: list[m.Message | None] = []
    way = (["planner"], ["robot"]) if back else (["robot"], ["planner"])
    world.mesh.cut(*way)
    world.mesh.query(REQUEST, got.append, timeout=1.0)
    world.run(0.5)
    assert got == [], "the planner is not reached, or its reply is lost"
    world.run(0.6)
    assert got == [None]
    world.mesh.heal(*way)
    world.mesh.query(REQUEST, got.append)
    world.run(SOON)
    assert got[1:] == [Plan((), 1.0)]
    world.nodes["robot"].kill()
    world.run(SOON)
    world.mesh.query(REQUEST, got.append)
    world.run(SOON)
    assert got[2:] == [None], "without a router there is no receiver"


def test_an_agent_that_is_cut_from_the_router_for_the_lease_is_cut_off_and_comes_back() -> None:
    world = World("goto", "avoid")
    cut = world.mesh.now
    world.mesh.cut(["goto"], ["robot"], lease=True)
    world.run(3.0)
    goto, avoid = world["goto"], world["avoid"]
    assert goto.routers == [(pytest.approx(cut + LEASE, abs=SOON), False)]
    assert goto.gone() == []
    assert avoid.gone() == world["robot"].gone() == ["goto"]
    assert avoid.routers == []
    assert avoid.received("goto", cut + SOON) == goto.received("avoid", cut + LEASE + SOON) == []
    assert avoid.received("robot", world.mesh.now - 0.1)
    world.mesh.heal(["goto"], ["robot"])
    healed = world.mesh.now
    world.run(BACK)
    assert goto.reachable
    assert "goto" in avoid.came(healed)
    since = world.run(0.1)
    world.run(GRACE_S)
    assert goto.gone() == []
    assert goto.received("avoid", since)
    assert avoid.received("goto", since)


# Guests -------------------------------------------------------------------------------------------

POSE = Pose(m.Cycle(1, 2), 1.0, -2.0, 0.5)


# Fleets -------------------------------------------------------------------------------------------


class Fleet:
    """Two robots, each with a guest on its router."""

    def __init__(self) -> None:
        self.mesh = VirtualMesh(1)
        self.starts = itertools.count()
        self.robots: dict[str, Node] = {}
        self.guests: dict[str, VirtualSession] = {}
        self.got: dict[str, list[str]] = {}
        for name in ("lab/r1", "lab/r2"):
            self.start(name)
            self.guests[name] = guest = VirtualSession(self.mesh, name, "guest")
            got = self.got[name] = []
            for pattern in ("fleet/*", "encoder/*"):
                guest.subscribe(pattern, lambda key, _data, got=got: got.append(key))
        self.mesh.run(1.0)

    def start(self, name: str) -> None:
        kind = type("robot", (Robot,), {"mesh": self.mesh})
        identity = self.mesh.identity("robot", next(self.starts), name)
        self.robots[name] = self.mesh.add(kind(identity), admit=False, namespace=name)

    def crosses(self, *keys: str, by: str = "lab/r1") -> list[str]:
        """What one guest publishes, as it soon arrives at the other one."""
        (to,) = self.guests.keys() - {by}
        for key in keys:
            self.guests[by].publish(key, POSE)
        self.mesh.run(self.mesh.now + SOON)
        got = self.got[to][:]
        self.got[to].clear()
        return got


def test_robots_of_a_fleet_share_its_keys_and_no_others() -> None:
    fleet = Fleet()
    assert fleet.crosses("fleet/pose", "encoder/pose") == ["fleet/pose"]
    assert fleet.crosses("fleet/pose", "encoder/pose", by="lab/r2") == ["fleet/pose"]


# Any faults ---------------------------------------------------------------------------------------

NAMES = ("robot", "sonar", "goto", "avoid")
FAULTS = st.lists(
    st.tuples(
        st.sampled_from(["hang", "kill", "cut", "cut with lease"]),
        st.sampled_from(NAMES),
        st.floats(0.0, 6.0),  # when it begins, s
        st.floats(0.01, 3.0),  # how long it lasts, s
    ),
    max_size=6,
)


class Faulty(World):
    """A world in which several things go wrong, each for a while."""

    every = 0.1

    def __init__(self, plan: list[tuple[str, str, float, float]], seed: int) -> None:
        super().__init__(*NAMES[1:], seed=seed)
        for kind, name, at, lasts in plan:
            begins = self.mesh.now + at
            self.mesh.call_at(begins, self._begin, kind, name)
            self.mesh.call_at(begins + lasts, self._end, kind, name)

    def _begin(self, kind: str, name: str) -> None:
        node = self.nodes[name]
        if kind == "hang":
            node.hang()
        elif kind == "kill":
            if node.alive:
                node.kill()
        else:
            for way in self._ways(name):
                self.mesh.cut(*way, lease=kind == "cut with lease")

    def _end(self, kind: str, name: str) -> None:
        node = self.nodes[name]
        if kind == "hang":
            if node.hung:
                node.resume()
        elif kind == "kill":
            if not node.alive:
                self.start(name)
        else:
            for way in self._ways(name):
                self.mesh.heal(*way)

    def _ways(self, name: str) -> list[tuple[list[str], list[str]]]:
        """Between an agent and all others, both ways."""
        others = [other for other in NAMES if other != name]
        return [([name], others), (others, [name])]


@pytest.mark.long
@settings(max_examples=100)
@given(FAULTS, st.integers(0, 1000))
def test_after_any_faults_everyone_reaches_everyone_and_knows_exactly_the_living(
    plan: list[tuple[str, str, float, float]], seed: int
) -> None:
    world = Faulty(plan, seed)
    last = max((at + lasts for _, _, at, lasts in plan), default=0.0)
    world.run(last + 2 * LEASE + 2 * BACK + GRACE_S)
    since = world.mesh.now
    world.run(0.5)
    living = {name: world[name].instance for name in NAMES}
    for name, node in world.nodes.items():
        assert node.agent.reachable
        known = {(n, i) for n, i in node.driver.alive if n != name}
        assert known == {(n, i) for n, i in living.items() if n != name}
        for other in set(NAMES) - {name}:
            assert world[name].received(other, since), f"{name} receives nothing from {other}"


def test_a_namespace_without_a_robot_agent_needs_no_router() -> None:
    mesh = VirtualMesh(1)
    assert mesh.star.router(DEFAULT_NAMESPACE) is None
    one, two = (VirtualSession(mesh, name=name) for name in ("one", "two"))
    got: list[str] = []
    one.subscribe("encoder/pose", lambda key, _data: got.append(key))
    two.publish("encoder/pose", POSE)
    mesh.run(SOON)
    assert got == ["encoder/pose"]
    assert one.reachable
