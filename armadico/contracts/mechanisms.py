"""The contract of coordination mechanisms: what each must keep, whatever it decides.

class TestLoudest(MechanismContract):
    coordination = "loudest"      # as its entry point names it
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Final

from armadico.contracts.contract import Contract
from armadico.core import messages as m
from armadico.core.agent import Agent
from armadico.core.cycles import CycleClock
from armadico.core.discovery import agent_class
from armadico.core.judgement import Judgement, all_of, unknown, whether
from armadico.core.mechanisms import chosen, coordination, decides, lacks, vain
from armadico.core.parameters import Social
from armadico.core.resources import WHEELS, Resource
from armadico.mesh.virtual import Node, VirtualMesh
from armadico.testing.society import ResourceOwner, RobotOwner, bidder

FIRST, SECOND = "first", "second"
"""The agents that compete. The first bids more, and its action is the larger one."""

BEGINS_S: Final = 1.0  # all agents have joined and listened
KNOWN_S: Final = 5.0  # after a start or a kill it decides within this
SETTLED_S: Final = 2.0  # of that, the last: no transition goes on

ALL, NEAR = 0.99, 0.05  # a share of all of it; how far a command may be from a wish, of the first's

CURE: Final = "set `resource` to what it decides about"
SHARES: Final = "`share` is this agent's part of the resource's command, 0 to 1"

STILL: Final = (
    "nothing but rest was commanded, and both agents want to move",
    "if it follows agents by their names, drive with them: armadico faults --coordination NAME",
)
"""One that follows neither agent has not been seen to decide; one that rests always is none."""


@dataclass
class Decided:
    """What one run showed."""

    mesh: VirtualMesh
    nodes: dict[str, Node] = field(default_factory=dict)
    obeyed: list[tuple[float, m.Command]] = field(default_factory=list)
    shares: list[tuple[float, float, float]] = field(default_factory=list)  # time, both agents'

    def run(self, seconds: float) -> None:
        self.mesh.run(self.mesh.now + seconds)

    def since(self, at: float) -> list[m.Command]:
        return [command for t, command in self.obeyed if t > at]

    @property
    def followed(self) -> str:
        """The agent that alone had a share at the end; "" if none had all of it throughout."""
        settled = [each for at, *each in self.shares if at > self.mesh.now - SETTLED_S]
        for index, name in enumerate((FIRST, SECOND)):
            if settled and all(each[index] >= ALL > each[1 - index] for each in settled):
                return name
        return ""


class MechanismContract(Contract):
    """The checks of one mechanism, with two agents that compete for a resource of numbers.

    Attributes:
        coordination: Its name, as of an entry point in the group `armadico.coordinations`.
        resource: What it decides about.
    """

    coordination: ClassVar[str] = ""
    resource: ClassVar[Resource] = WHEELS

    def check_decides(self) -> Judgement:
        """While agents bid, commands are obeyed in each cycle, some move, and shares are sound."""
        if (untried := self._untried) is not None:
            return untried
        run = self._run(0.8, 0.4)
        begun = run.mesh.now
        run.run(KNOWN_S)
        cycles = int(KNOWN_S / self._period)
        obeyed = {command.cycle for command in run.since(begun)}
        sums = [first + second for _, first, second in run.shares]
        return all_of(
            (
                whether(any(map(self._moves, run.since(begun))) or None, *STILL),
                whether(
                    len(obeyed) > 0.8 * cycles,
                    f"commands of {len(obeyed)} of {cycles} cycles were obeyed",
                ),
                whether(
                    all(-1e-9 <= each <= 1.0 + 1e-6 for each in sums),
                    f"the shares of all agents were {min(sums):g} to {max(sums):g}",
                    SHARES,
                ),
            )
        )

    def check_stays_within_what_is_proposed(self) -> Judgement:
        """Each number that is commanded is between the agents' wishes and rest.

        Both agents want the same direction, once one way and once the other, so a command of
        another sign than theirs is nobody's wish, and a larger one is more than any agent wants.
        """
        if (untried := self._untried) is not None:
            return untried
        moved = 0
        for way in (1.0, -1.0):
            run = self._run(0.8, 0.4, way)
            run.run(KNOWN_S)
            moved += any(self._moves(command) for _, command in run.obeyed)
            for _, command in run.obeyed:
                action = command.action if isinstance(command.action, tuple) else ()
                names = self.resource.parameters
                for name, x, most in zip(names, action, self._action(way), strict=bool(action)):
                    if not min(0.0, most) - 1e-9 <= x <= max(0.0, most) + 1e-9:
                        return whether(
                            False,
                            f"{name} {x:g} is commanded, and the agents want {0.5 * most:g} and"
                            f" {most:g}",
                            "command what agents want, or what is between that and rest",
                        )
        return whether(moved == 2 or None, *STILL)

    def check_commands_what_its_shares_say(self) -> Judgement:
        """One agent's command is commanded while all of the share is that agent's.

        And what is commanded changes with what the agents want.
        """
        if (untried := self._untried) is not None:
            return untried
        for run in self._opposed:
            parts = self._parts(run)
            if any(parts) and not any(first + second for _, first, second in run.shares):
                return whether(False, "it moves, and no agent has a share of that", SHARES)
            wanted = {FIRST: 1.0, SECOND: 0.5}.get(run.followed)
            if wanted is None or not (off := [x for x in parts if abs(x - wanted) > NEAR]):
                continue
            return whether(
                False,
                f"all of the share is {run.followed}'s, and {off[0] / wanted:g} of what it wants"
                " is commanded",
                SHARES,
            )
        alone = [self._parts(self._both(*bids)) for bids in ((0.8, None), (None, 0.8))]
        largest = [max(parts, default=0.0) for parts in alone]
        if not any(largest):
            return whether(None, *STILL)
        return whether(
            abs(largest[0] - largest[1]) > NEAR or None,
            "the same is commanded for an agent that wants all and for one that wants half of it",
            "make the command of what agents want",
        )

    def unchecked(self) -> tuple[str, ...]:
        """What no check judges: which bid is followed, and whether that drives well."""
        if self._untried is not None:
            return ()
        runs = self._opposed
        seen = {
            (FIRST, SECOND): "the larger one",
            (SECOND, FIRST): "the smaller one",
            (FIRST, FIRST): "that of one agent, whatever the utilities",
            (SECOND, SECOND): "that of one agent, whatever the utilities",
        }.get((runs[0].followed, runs[1].followed), "neither of them alone")
        if not all(any(self._parts(run)) for run in runs):
            seen = "none"
        told = (
            "which bid it prefers, which each mechanism may choose: of bids of 0.8 and 0.4, made by"
            f" each of two agents in turn, it followed {seen}"
        )
        if self.resource != WHEELS:
            return (told,)
        name = self.coordination
        drive = f"armadico experiment rivals --pilot --mechanism {name}"
        return told, f"how it drives: {drive}, and armadico faults --coordination {name}"

    def check_rests_without_bids(self) -> Judgement:
        """While no agent bids, nothing but rest is commanded."""
        if (untried := self._untried) is not None:
            return untried
        run = self._run(None, None)
        begun = run.mesh.now
        run.run(KNOWN_S)
        moved = [command for command in run.since(begun) if self._moves(command)]
        return whether(not moved, f"{len(moved)} commands were obeyed, and no agent bids")

    def check_goes_on_after_a_kill(self) -> Judgement:
        """With a new arbiter, or without one of the agents, it decides again."""
        if (untried := self._untried) is not None:
            return untried
        run, arbiter = self._run(0.8, 0.4), coordination(self.coordination).arbiter
        run.run(2.0)
        before = len(run.obeyed)
        killed = run.nodes[arbiter or FIRST]
        killed.kill()
        at = run.mesh.now
        run.run(self.resource.silence(self._period) + 2.0)
        late = [c for c in run.since(at) if c.ballot.instance == killed.agent.instance]
        if arbiter:
            self._join(run, agent_class(arbiter), 1)
        again = run.mesh.now
        run.run(KNOWN_S)
        return all_of(
            (
                whether(before > 0, "no command was obeyed before"),
                whether(len(late) <= 2, f"{len(late)} commands of a killed process were obeyed"),
                whether(bool(run.since(again)), "after the kill no command is obeyed"),
            )
        )

    def check_repeats_itself(self) -> Judgement:
        """The same seed gives the same commands: no clock and no random numbers of its own."""
        if (untried := self._untried) is not None:
            return untried
        found = []
        for _ in range(2):
            run = self._run(0.8, 0.4)
            run.run(KNOWN_S)
            found.append([(c.cycle, c.action) for _, c in run.obeyed])
        return whether(found[0] == found[1], "commands differ", "use self.now and self.rng")

    # Runs -----------------------------------------------------------------------------------------

    @property
    def _period(self) -> float:
        return self.resource.period_s or 0.1

    def _moves(self, command: m.Command) -> bool:
        return command.action not in (None, self.resource.neutral)

    @property
    def _untried(self) -> Judgement | None:
        """Why it cannot be judged here; None: it can."""
        if lacking := lacks(coordination(self.coordination), {}):
            return unknown(lacking)
        agents = {}
        for name in (FIRST, SECOND):
            kind = self._bidder(name, None, 1.0, 1.0)
            agents[name] = kind(VirtualMesh(1).identity(name), self._parameters(kind))
        if chosen(self.resource, agents[FIRST], CycleClock(self._period))[1] is None:
            return self._elsewhere()
        if nothing := vain(coordination(self.coordination), agents):
            return unknown(nothing)
        return None

    def _elsewhere(self) -> Judgement:
        """Why a mechanism for something else cannot be judged, and whether `resource` helps."""
        found = coordination(self.coordination)
        about, name = getattr(found, "resource", None), decides(found)
        why = f"it decides about {name or 'something else'}, and not about {self.resource.name}"
        if about is None or (isinstance(about, Resource) and about.message is None):
            return unknown(why, CURE)
        return unknown(f"{why}; a resource of one owner, with numbers, is judged here alone")

    def _action(self, way: float) -> tuple[float, ...]:
        """What the first agent wants: half of each number's scale, with signs in turn."""
        return tuple(
            way * (0.5 if index % 2 == 0 else -0.5) * size
            for index, size in enumerate(self.resource.scale)
        )

    @cached_property
    def _opposed(self) -> tuple[Decided, Decided]:
        """Two runs, in which the first and the second agent has the larger utility."""
        return self._both(0.8, 0.4), self._both(0.4, 0.8)

    def _both(self, first: float | None, second: float | None) -> Decided:
        """A run of two agents, for long enough."""
        run = self._run(first, second)
        run.run(KNOWN_S)
        return run

    def _parts(self, run: Decided) -> list[float]:
        """What was commanded at the end, in parts of what the first agent wants."""
        most = self._action(1.0)[0]
        late = run.since(run.mesh.now - SETTLED_S)
        return [c.action[0] / most for c in late if isinstance(c.action, tuple)]

    def _bidder(self, name: str, utility: float | None, share: float, way: float) -> type[Agent]:
        wanted: Callable[[float], float | None] = lambda _now: utility  # noqa: E731
        action = tuple(share * x for x in self._action(way))
        return bidder(
            name, wanted, competes_for=(self.resource,), action=action, needs=(), reacts_to=None
        )

    def _parameters(self, kind: type[Agent]) -> Any:
        return kind.parameters(social=Social(coordination=self.coordination))

    def _join(self, run: Decided, kind: type[Agent], start: int = 0) -> None:
        identity = run.mesh.identity(kind.name, start)
        run.nodes[kind.name] = run.mesh.add(kind(identity, self._parameters(kind)), admit=False)

    def _run(self, first: float | None, second: float | None, way: float = 1.0) -> Decided:
        """An owner, two agents, and the arbiter if it has one; they have begun."""
        run = Decided(VirtualMesh(1))
        owners: list[type[ResourceOwner]] = [RobotOwner]
        if self.resource != WHEELS:
            owners.append(type("Owner", (ResourceOwner,), {"name": "o", "owns": (self.resource,)}))
        for kind in owners:
            owner = kind(run.mesh.identity(kind.name))
            run.mesh.add(owner, admit=False)
        run.obeyed = owner.obeyed
        arbiter = coordination(self.coordination).arbiter
        agents = [self._bidder(FIRST, first, 1.0, way), self._bidder(SECOND, second, 0.5, way)]
        for each in (*agents, *((agent_class(arbiter),) if arbiter else ())):
            self._join(run, each)

        def look(_key: str, ack: m.Message, _now: float) -> None:
            assert isinstance(ack, m.Ack), "acks are watched"
            sides = [run.nodes[name].agent.kernel for name in (FIRST, SECOND)]
            first, second = (side.bidding(self.resource).contender.share for side in sides)
            run.shares.append((run.mesh.now, first, second))

        run.mesh.watch(look, m.Ack)
        run.run(BEGINS_S)
        return run
