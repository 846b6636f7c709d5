"""The contracts of agents and of owners of resources, under a virtual clock.

class TestWeaver(AgentContract):
    agent = Weaver                # takes part in `scenario`, beside its agents

class TestLamp(ResourceContract):
    owner = Lamp
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Never, cast

from armadico.config.loading import set_values
from armadico.config.scenarios import load_scenario
from armadico.contracts.contract import Contract
from armadico.core import messages as m
from armadico.core.agent import Agent, Identity
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import AGENTS, agent_class, installed
from armadico.core.driver import Output
from armadico.core.judgement import Judgement, all_of, no, unknown, whether, yes
from armadico.core.outgoing import Publish, SendQuery
from armadico.core.resources import Resource
from armadico.core.services import latched
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mesh.virtual import Node
from armadico.observe.measures import Phase, RunWatch
from armadico.testing.society import Society, bidder

COMMON: tuple[type[m.Message], ...] = (
    *(m.Log, m.Claim, m.Command, m.Ack, m.ParameterChange),
    *(service.message for service in latched()),
)
"""What every agent may publish without declaring it."""

AWAY_S = 0.5
"""Time from a kill to the restart."""

UNTRIED = "its actions are messages, and no valid one was given"

KILLS_S = (0.1, 1.3, 4.1)
"""Times of kills after the mission began, s."""


@dataclass
class Done:
    """What one run showed of the agent."""

    watch: RunWatch
    sent: list[tuple[str, bytes]] = field(default_factory=list)  # key and message, in order
    published: set[type[m.Message]] = field(default_factory=set)
    asked: set[type[m.Message]] = field(default_factory=set)
    bids: list[m.BidRecord] = field(default_factory=list)
    instances: list[Node] = field(default_factory=list)


Fault = Callable[[Rehearsal, Node, float], None]
"""Called regularly with the run, the agent's newest node, and the time since the beginning, s."""


class AgentContract(Contract):
    """The checks of one agent.

    Attributes:
        agent: Its class.
        scenario: A scenario in which it has something to do.
        besides: Other agents that it needs.
        without: Agents of the scenario that it replaces.
        limit_s: Time limit of a run, s.
    """

    agent: ClassVar[type[Agent]] = Agent
    scenario: ClassVar[str] = "sc2"
    besides: ClassVar[tuple[str, ...]] = ()
    without: ClassVar[tuple[str, ...]] = ()
    limit_s: ClassVar[float] = 60.0

    def check_is_complete(self) -> Judgement:
        """Its name, its messages and its parameters fit together, and its card can be sent."""
        kind = self.agent
        if not kind.name:
            return no("the class has no `name`")
        found = [self._as_installed()]
        agent = kind(Identity(f"{kind.name}-1"))
        agent.kernel.start(0.0)
        for message in (agent.kernel.card(), agent.kernel.history()):
            m.decode(m.encode(message), type(message))
        for each in (*kind.provides, *kind.answers, *kind.queries):
            agent.key_of(each)
        return all_of((yes(), *found))

    def _as_installed(self) -> Judgement:
        name = self.agent.name
        if name not in installed(AGENTS):
            return yes()
        return whether(
            agent_class(name) is self.agent,
            f"the entry point {name!r} leads to another class",
            "correct the entry point in pyproject.toml",
        )

    def check_does_what_it_declares(self) -> Judgement:
        """It publishes what it `provides` and queries what is in `queries`; its bids are valid."""
        done, kind = self._plain, self.agent
        unsaid = done.published - {*kind.provides, *COMMON}
        unasked = done.asked - {*kind.queries, m.Ask}
        bad = [record.reason for record in done.bids if record.unsound]
        bids = [record for record in done.bids if record.utility is not None]
        critical = {bid.resource for bid in bids if bid.critical}
        critical -= {resource.name for resource in kind.critical_for}
        silent = [each.__name__ for each in kind.provides if each not in done.published]
        return all_of(
            (
                whether(not unsaid, f"publishes {_names(unsaid)}", "add them to `provides`"),
                whether(not unasked, f"queries {_names(unasked)}", "add them to `queries`"),
                whether(
                    not critical,
                    f"bids critical for {', '.join(sorted(critical))}",
                    "add the resource to `critical_for`",
                ),
                whether(not bad, f"an invalid bid: {bad[0] if bad else ''}"),
                whether(
                    None if silent or (kind.competes_for and not bids) else True,
                    f"in {self.scenario} it did not publish {', '.join(silent) or 'a bid'}",
                    "name a `scenario` in which it has something to do",
                ),
            )
        )

    def check_repeats_itself(self) -> Judgement:
        """The same seed gives the same messages: no clock and no random numbers of its own."""
        one, other = self._plain.sent, self._run().sent
        if one == other:
            return yes()
        at = next(
            (k for k, pair in enumerate(zip(one, other, strict=False)) if len({*pair}) > 1), 0
        )
        key = one[at][0] if at < len(one) else "?"
        return no(f"message {at + 1}, on {key}, differs", "use self.now and self.rng")

    def check_works_after_a_restart(self) -> Judgement:
        """An instance that is killed and started again joins and works."""

        def fault(run: Rehearsal, node: Node, elapsed: float) -> None:
            if elapsed >= 2.0 and len(done.instances) == 1 and node.alive:
                node.kill()
            if elapsed >= 2.0 + AWAY_S and len(done.instances) == 1:
                self._enter(run, done)

        done = self._begun()
        self._drive(done, fault)
        if len(done.instances) < 2:
            return unknown(f"{self.scenario} ended before the restart", "name a longer `scenario`")
        after = done.instances[-1]
        return all_of(
            (
                whether(after.driver.started, f"did not join again: {after.driver.refusal}"),
                self._unharmed(done, "restarted"),
            )
        )

    def check_may_be_killed_at_any_step(self) -> Judgement:
        """Killed or hung at any time, nothing is touched and no other agent fails."""
        found = []
        for at in KILLS_S:
            for what in ("kill", "hang"):

                def fault(
                    _run: Rehearsal, node: Node, elapsed: float, at: float = at, what: str = what
                ) -> None:
                    if elapsed >= at and node.alive and not node.hung:
                        getattr(node, what)()

                done = self._begun()
                self._drive(done, fault, limit_s=at + 6.0)
                found.append(self._unharmed(done, f"{what} after {at:g} s"))
        return all_of(found)

    def check_refuses_bad_parameters(self) -> Judgement:
        """Unknown names and wrong types are refused; what is `changeable` can be changed."""
        kind = self.agent
        agent = kind(Identity(f"{kind.name}-1"))
        try:
            set_values(agent.p, ["no_such_parameter=1"])
        except ConfigError:
            pass
        else:
            return no("an unknown parameter was accepted", "derive from Parameters, frozen=True")
        agent.kernel.start(0.0)
        rows = {row.name: row for row in agent.kernel.tune(m.ParametersRequest(), 0.0).parameters}
        found = [yes()]
        for name in kind.changeable:
            keep = m.ParametersRequest((m.Setting(name, rows[name].json),), "test")
            refusal = agent.kernel.tune(keep, 0.0).refusal
            found.append(whether(not refusal, f"{name}: its own value is refused: {refusal}"))
            for bad in ("{}", "NaN", '"no value"'):
                reply = agent.kernel.tune(m.ParametersRequest((m.Setting(name, bad),), "test"), 0.0)
                found.append(whether(bool(reply.refusal), f"{name} = {bad} was accepted"))
        return all_of(found)

    # Runs -----------------------------------------------------------------------------------------

    @cached_property
    def _plain(self) -> Done:
        return self._run()

    def _run(self) -> Done:
        done = self._begun()
        self._drive(done, lambda _run, _node, _elapsed: None)
        return done

    def _begun(self) -> Done:
        name, given = self.agent.name, load_scenario(self.scenario)
        # An installed agent is started by the launcher, with the scenario's facts as parameters.
        launched = name in installed(AGENTS) and agent_class(name) is self.agent
        besides = (*self.besides, name) if launched else self.besides
        without = self.without if launched else (*self.without, name)
        options = Options(
            seed=1,
            sensors="ideal",
            limit=self.limit_s,
            without=tuple(each for each in without if each in given.agents),
            besides=tuple(each for each in besides if each not in given.agents),
        )
        run = Rehearsal(prepared(given, options), options)
        done = Done(run.watch)
        self._rehearsal, self._launched = run, launched
        self._enter(run, done)
        return done

    def _enter(self, run: Rehearsal, done: Done) -> None:
        name = self.agent.name
        if not self._launched:
            node = run.add(self.agent)
        elif done.instances:
            node = run.enter(name)
        else:
            node = run.mesh.node(name, run.namespace)
        done.instances.append(node)
        send = node._send

        def noted(out: list[Output]) -> None:
            for item in out:
                if isinstance(item, Publish):
                    done.sent.append((item.key, m.encode(item.message)))
                    done.published.add(type(item.message))
                elif isinstance(item, SendQuery):
                    done.asked.add(type(item.request))
            send(out)

        vars(node)["_send"] = noted

    def _drive(self, done: Done, fault: Fault, limit_s: float | None = None) -> None:
        run = self._rehearsal
        began: list[float] = []
        kept: dict[tuple[Node, m.Cycle, str], m.BidRecord] = {}

        def progress(watch: RunWatch) -> None:
            began[:] = began or [run.mesh.now]
            for node in done.instances:  # an agent keeps its last 50 only
                kept.update({(node, b.cycle, b.resource): b for b in node.agent.kernel.bids})
            elapsed = run.mesh.now - began[0]
            fault(run, done.instances[-1], elapsed)
            if limit_s is not None and elapsed >= limit_s:
                watch.phase = Phase.DONE

        run.run(progress)
        done.watch = run.watch
        done.bids = list(kept.values())

    def _unharmed(self, done: Done, what: str) -> Judgement:
        touched = done.watch.result().collisions
        return whether(
            None if touched is None else not touched,
            f"{what}: {'unknown whether it touched anything' if touched is None else 'touched'}",
        )


def _names(kinds: set[type[m.Message]]) -> str:
    return ", ".join(sorted(kind.__name__ for kind in kinds))


class ResourceContract(Contract):
    """The checks of an agent that owns resources.

    Attributes:
        owner: Its class.
        action: A valid action of its first resource, not the neutral one; None: the neutral one.
    """

    owner: ClassVar[type[Agent]] = Agent
    action: ClassVar[object] = None

    @property
    def resource(self) -> Resource:
        """The resource that is judged."""
        return self.owner.owns[0]

    def check_obeys_its_holder(self) -> Judgement:
        """It executes a valid command, and acknowledges what it does."""
        if self._untried:
            return unknown(UNTRIED, "set `action`")
        society, seen = self._society()
        society.run(3.0)
        acks = [ack for ack in seen.acks if ack.obeyed is not None]
        return all_of(
            (
                whether(bool(acks), "no command was obeyed in 3 s"),
                whether(bool(seen.obeyed), "`obey` was not called"),
                whether(
                    self.resource.message is not None or any(ack.measured for ack in acks),
                    "`measure` returns values of another shape than the resource's parameters",
                ),
            )
        )

    def check_rests_without_a_holder(self) -> Judgement:
        """When its holder is killed it comes to rest."""
        if self._untried:
            return unknown(UNTRIED, "set `action`")
        society, seen = self._society()
        society.run(3.0)
        society.nodes["contender"].kill()
        before, obeyed = len(seen.rests), len(seen.obeyed)
        society.run(self.resource.silence(0.1) + 3.0)
        return all_of(
            (
                whether(obeyed > 0, "no command was obeyed before"),
                whether(len(seen.rests) > before, "`rest` was not called"),
            )
        )

    def check_refuses_what_it_cannot_do(self) -> Judgement:
        """`beyond` refuses numbers that no such device can reach."""
        if self.resource.message is not None:
            return yes()
        owner = self.owner(Identity("owner-1"))
        owner.kernel.start(0.0)
        wild = tuple(1e6 * scale for scale in self.resource.scale)
        return whether(
            bool(owner.beyond(self.resource, cast("Never", wild))),
            f"{wild} is accepted",
            "return from `beyond` which limit an action exceeds",
        )

    def check_works_after_a_restart(self) -> Judgement:
        """A restarted owner is obeyed again, and no second owner joins beside it."""
        if self._untried:
            return unknown(UNTRIED, "set `action`")
        society, seen = self._society()
        society.run(3.0)
        society.nodes[self.owner.name].kill()
        society.run(1.0)
        obeyed = len(seen.obeyed)
        society.join(seen.kind, start=1)
        society.run(8.0)
        return whether(len(seen.obeyed) > obeyed, "after its restart no command is obeyed")

    @property
    def _untried(self) -> bool:
        return self.resource.message is not None and self.action is None

    def _society(self) -> tuple[Society, Seen]:
        seen = Seen(self.owner)
        resource = self.resource
        action = resource.neutral if self.action is None else self.action
        rival = bidder(
            "contender", 0.5, competes_for=(resource,), action=action, needs=(), reacts_to=None
        )
        society = Society(seen.kind, rival)
        society.mesh.watch(lambda _k, ack, _t: seen.note(ack, resource.name), m.Ack)
        return society, seen


class Seen:
    """What an owner does: a class like it that keeps its calls."""

    def __init__(self, owner: type[Agent]) -> None:
        self.acks: list[m.Ack] = []
        self.obeyed: list[object] = []
        self.rests: list[str] = []
        seen = self

        def obey(self: Agent, resource: Resource, action: Never) -> None:
            seen.obeyed.append(action)
            owner.obey(self, resource, action)

        def rest(self: Agent, resource: Resource) -> None:
            seen.rests.append(resource.name)
            owner.rest(self, resource)

        self.kind: type[Agent] = type(owner.__name__, (owner,), {"obey": obey, "rest": rest})

    def note(self, ack: m.Message, resource: str) -> None:
        if isinstance(ack, m.Ack) and ack.resource == resource:
            self.acks.append(ack)
