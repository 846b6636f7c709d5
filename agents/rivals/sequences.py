"""One behaviour, or one set of them, at a time: sequencing, motivation and contracts."""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot, inf
from typing import Annotated, ClassVar, Final, Literal

from msgspec import Meta

from armadico.agents.rivals.arbiter import REST, Arbiter, Decision, Wish
from armadico.agents.rivals.layers import ACTIVE
from armadico.agents.rivals.mechanisms import mixed
from armadico.agents.rivals.proposer import Arbitrated
from armadico.core import parameters
from armadico.core.agent import Identity
from armadico.core.messages import Cycle, Message
from armadico.core.parameters import AgentName
from armadico.mobile.messages import Pose

Seconds = Annotated[float, Meta(gt=0, le=600)]
Share = Annotated[float, Meta(ge=0, le=1)]


class Progress:
    """Whether the robot leaves the place where it is, within a time."""

    def __init__(self, metres: float = 0.2) -> None:
        self._metres, self._at, self.since = metres, (inf, inf), inf

    def update(self, pose: Pose | None, now: float) -> float:
        """Return for how long the robot has been at one place, s."""
        if (
            pose is not None
            and not hypot(pose.x - self._at[0], pose.y - self._at[1]) < self._metres
        ):
            self._at, self.since = (pose.x, pose.y), now
        return max(now - self.since, 0.0)

    def restart(self, now: float) -> None:
        self.since = now


class SequencingParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of the sequencer. A method is a set of agents; the first of them decides when."""

    methods: tuple[tuple[AgentName, ...], ...] = (
        ("teleop",),
        ("relocate",),
        ("avoid",),
        ("gothrough",),
        ("goto",),
    )  # an event of an earlier one interrupts a later one; the last needs no event
    begins: Share = ACTIVE  # the first agent's utility from which its method is enabled
    succeeds: Share = 0.2  # below this it has succeeded
    patience_s: Seconds = 8.0  # at one place for so long, a method has failed
    retry_s: Seconds = 8.0  # and is not tried again for so long
    within: Literal["best", "mean"] = "best"  # of the agents of a method


class Sequencing(Arbiter):
    """One method at a time, until its success test holds or it notices that it fails.

    Firby (1989), RAP: methods with success tests, and the next method after a failure. Gat (1992),
    ATLANTIS: cognizant failure, a method that notices by itself that it does not get on. An event
    enables a method, as between the landmarks of SSS (Connell 1992). Within a method several
    behaviours may be averaged, as the skills of 3T are (Bonasso et al. 1997).
    """

    name = "sequencing"
    parameters = SequencingParameters
    receives: ClassVar[tuple[type[Message], ...]] = (Pose,)
    p: SequencingParameters

    def __init__(self, identity: Identity, parameters: SequencingParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._method: tuple[str, ...] = ()
        self._failed: dict[tuple[str, ...], float] = {}  # until when
        self._progress = Progress()

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        p, lead = self.p, wishes.get(self._method[0]) if self._method else None
        stays = self._progress.update(self.latest(Pose), self.now)
        if lead is not None and stays > p.patience_s:
            self._failed[self._method] = self.now + p.retry_s
            self.log(f"{self._method[0]} has failed: {stays:.0f} s at one place")
            lead = None
        done = lead is None or (
            lead.utility < p.succeeds and not lead.critical and self._method != p.methods[-1]
        )
        before = p.methods if done else p.methods[: p.methods.index(self._method)]
        enabled = next((each for each in before if self._event(each, wishes)), None)
        chosen = enabled or (self._fallback(wishes) if done else self._method)
        if chosen != self._method:
            self._method = chosen
            self._progress.restart(self.now)
        here = {name: wishes[name] for name in chosen if name in wishes}
        here = {name: wish for name, wish in here.items() if wish.utility > 0.0}
        if not here:
            return Decision(REST, {})
        if p.within == "mean":
            return mixed(here, {name: wish.utility for name, wish in here.items()})
        name = max(here, key=lambda each: (here[each].utility, here[each].critical))
        return Decision(here[name].action, {name: 1.0})

    def _event(self, method: tuple[str, ...], wishes: Mapping[str, Wish]) -> bool:
        wish = wishes.get(method[0])
        if wish is None or self.now < self._failed.get(method, 0.0):
            return False
        return wish.utility >= self.p.begins or wish.critical

    def _fallback(self, wishes: Mapping[str, Wish]) -> tuple[str, ...]:
        """The last method that has not failed and whose first agent wishes anything."""
        able = [each for each in reversed(self.p.methods) if each[0] in wishes]
        fit = [each for each in able if self.now >= self._failed.get(each, 0.0)]
        return next(iter(fit or able), self.p.methods[-1])


class MotivationParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of motivation. Motivation grows from 0 to 1, times the utility."""

    slow_s: Seconds = 4.0  # impatience while the holder gets on
    fast_s: Seconds = 0.4  # otherwise
    tolerates_s: Seconds = 1.0  # at one place for so long, the holder does not get on
    gives_up_s: Seconds = 10.0  # acquiescence: at one place for so long, the holder yields


class Motivation(Arbiter):
    """Impatience takes over from a holder that does not get on, and acquiescence yields.

    Parker (1998), ALLIANCE: each behaviour set has a motivation that grows with impatience, slowly
    while another does the task and fast once that one fails; it acts when the motivation reaches
    the threshold. A set that finds that it fails itself gives up. The sets of one robot inhibit
    each other: one is active.
    """

    name = "motivation"
    parameters = MotivationParameters
    receives: ClassVar[tuple[type[Message], ...]] = (Pose,)
    p: MotivationParameters

    def __init__(self, identity: Identity, parameters: MotivationParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._level: dict[str, float] = {}
        self._holder, self._since, self._at = "", 0.0, 0.0
        self._progress = Progress(0.1)

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        p, past = self.p, min(self.now - self._at, 1.0) if self._at else 0.0
        self._at = self.now
        stays = self._progress.update(self.latest(Pose), self.now)
        if self._holder and (self._holder not in wishes or stays > p.gives_up_s):
            self._holder = ""
        slowly = bool(self._holder) and stays <= p.tolerates_s
        for name, wish in wishes.items():
            grows = past / (p.slow_s if slowly else p.fast_s) * wish.utility
            level = 1.0 if wish.critical else min(self._level.get(name, 0.0) + grows, 1.0)
            self._level[name] = 0.0 if name == self._holder else level
        self._level = {name: level for name, level in self._level.items() if name in wishes}
        ready = [name for name, level in self._level.items() if level >= 1.0]
        if ready:
            self._holder = max(ready, key=lambda n: (wishes[n].critical, wishes[n].utility, n))
            self._level = {}
            self._progress.restart(self.now)
        if not self._holder:
            return Decision(REST, {})
        return Decision(wishes[self._holder].action, {self._holder: 1.0})


class ContractParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of the contract net."""

    tenure_s: Seconds = 0.5


class Contract(Arbiter):
    """The task is announced, the best bid gets it for a tenure, and only then it is open again.

    Smith (1980), contract net: announcement, bids, award. Each cycle's pose announces the task to
    all agents. It ends before its time if the contractor withdraws, or for a critical bid.
    """

    name = "contract"
    parameters = ContractParameters
    p: ContractParameters

    def __init__(self, identity: Identity, parameters: ContractParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._contractor, self._until = "", 0.0

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        mine = wishes.get(self._contractor)
        urgent = any(wish.critical for wish in wishes.values())
        open_again = self.now >= self._until or mine is None
        if open_again or (urgent and mine is not None and not mine.critical):
            self._contractor = max(
                wishes, key=lambda n: (urgent and wishes[n].critical, wishes[n].utility, n)
            )
            self._until = self.now + self.p.tenure_s
        return Decision(wishes[self._contractor].action, {self._contractor: 1.0})


SEQUENCING: Final = Arbitrated(
    Sequencing.name, about="one method at a time, until it succeeds or notices that it fails"
)
MOTIVATION: Final = Arbitrated(
    Motivation.name, about="impatience with a holder that does not get on, and acquiescence"
)
CONTRACT: Final = Arbitrated(Contract.name, about="the best bid, for a tenure: contract net")
