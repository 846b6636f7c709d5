"""Requests that wait for a person's yes: once each, for two minutes, and for that request alone.

Sans-IO: the requests, the answers and the time in, what became of them out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Final

import msgspec
from msgspec import Struct

from armadico.watch.assistant.messages import AssistantReply, AssistantRequest
from armadico.watch.assistant.policy.ledger import LAST, Entry
from armadico.watch.assistant.policy.messages import Answered, Approval, Choice

WAITS_S: Final = 120.0
"""A request waits so long for a person."""

GONE_S: Final = 10.0
"""A client that does not ask for so long what became of its request is gone, and so is that."""

LEFT: Final = "its client is gone"

MOST: Final = 8
"""Requests that wait at a time; a person who has to choose among more reads none of them."""

KEPT: Final = 64
"""Requests that are over and still known, so that a late or second answer is told what was."""

HERE_M: Final = 0.5
"""`always` is for goals this near to the approved one."""


class Always(Struct, frozen=True):
    """A person's approval for always: of later requests of a client for this place."""

    by: str  # the client
    tool: str
    text: str  # the arguments; they count where there is no goal
    section: str  # of the policy
    goal: tuple[float, float] | None  # m
    rooms: tuple[str, ...]
    person: str
    under: str = ""  # the policy and the map that it was given under, as their hash

    def covers(self, wanted: Waiting) -> bool:
        """Whether it is for a request, too."""
        asked = wanted.request
        if (self.by, self.tool, self.section) != (asked.by, asked.tool, wanted.section):
            return False
        if not set(wanted.rooms) <= set(self.rooms):
            return False
        if self.goal is None or wanted.goal is None:
            return self.goal is wanted.goal and self.text == asked.text
        (ax, ay), (bx, by) = self.goal, wanted.goal
        return (ax - bx) ** 2 + (ay - by) ** 2 <= HERE_M**2


def read(entries: Iterable[Entry]) -> list[Always]:
    """Read approvals for always from a log; of those of another version people are asked again."""
    found = []
    for each in entries:
        with suppress(msgspec.DecodeError):
            found.append(msgspec.json.decode(each.why, type=Always))
    return found


@dataclass
class Waiting:
    """One request that needs a person's yes."""

    number: int  # drawn at random
    request: AssistantRequest  # what was asked
    section: str  # of the policy
    place: str  # the goal for people; "": it has none
    goal: tuple[float, float] | None  # the goal, m; None: it has none
    why: str  # which rule asks
    rooms: tuple[str, ...]  # the rooms on its way that ask
    go: Callable[[Waiting], None]  # does it
    at: float  # when it was asked, s
    seen_at: float  # when the client asked for it last, s
    over: str = ""  # how it ended; "": it waits
    by: str = ""  # the person who answered
    outcome: AssistantReply | None = None  # the reply to the client, once there is one

    @property
    def code(self) -> str:
        """What a person repeats: of this request and no other."""
        parts = (str(self.number), self.request.tool, self.request.text, self.request.by)
        return sha256("\0".join(parts).encode()).hexdigest()[:8]

    def shown(self, now: float) -> Approval:
        """The message by which people see it."""
        left_s = max(self.at + WAITS_S - now, 0.0)
        return Approval(self.code, self.request, self.place, self.why, left_s, self.goal or ())


@dataclass
class Approvals:
    """Those that wait, and those that are over."""

    _all: dict[int, Waiting] = field(default_factory=dict)
    standing: list[Always] = field(default_factory=list)  # those for always that count
    # Those of a log that the society has not confirmed yet: they do not count.
    unproved: list[Always] = field(default_factory=list)
    # Those of a log that was changed, or that the society has not confirmed in time.
    lapsed: list[Always] = field(default_factory=list)
    under: str = ""  # the policy and the map now, as their hash

    @property
    def waiting(self) -> list[Waiting]:
        return [each for each in self._all.values() if not each.over]

    def always(self, wanted: Waiting) -> str:
        """Who has approved such a request for always; "" if nobody has."""
        now = (each for each in self.standing if each.under == self.under)
        return next((each.person for each in now if each.covers(wanted)), "")

    def allow_always(self, found: Waiting) -> Always:
        """Approve later requests like this one, too."""
        asked, place = found.request, (found.section, found.goal, found.rooms)
        new = Always(asked.by, asked.tool, asked.text, *place, found.by, self.under)
        self.standing = [*self.standing, new][-LAST:]
        return new

    def forget(self, client: str) -> Answered:
        """End the approvals for always of a client."""
        known = [*self.unproved, *self.standing]
        self.standing = [each for each in self.standing if each.by != client]
        self.unproved = [each for each in self.unproved if each.by != client]
        left = [*self.unproved, *self.standing]
        if count := len(known) - len(left):
            return Answered(f"forgotten: {count} approvals for always of {client}")
        others = ", ".join([*dict.fromkeys(each.by for each in left)][:MOST]) or "no client"
        return Answered(refusal=f"{client} has no approval for always; {others} has")

    def prove(self, without: Sequence[Always] = ()) -> None:
        """Those of the log count from now on, but for some."""
        proved = [each for each in self.unproved if each not in without]
        self.lapsed += [each for each in self.unproved if each in without]
        self.standing, self.unproved = [*proved, *self.standing][-LAST:], []

    def lapse(self) -> None:
        """None of those so far counts any more."""
        self.lapsed += [*self.unproved, *self.standing]
        self.standing, self.unproved = [], []

    def why_not(self, wanted: Waiting) -> str:
        """Why an approval for always of such a request does not count; "" if there is none."""
        if not any(each.covers(wanted) for each in self.lapsed):
            return ""
        return "; that it was approved for always is in the log, which nobody confirms"

    def add(self, wanted: Waiting) -> str:
        """Let a request wait; return why it cannot, or ""."""
        if any(each.request.by == wanted.request.by for each in self.waiting):
            return "another request of yours waits for approval: one at a time"
        if len(self.waiting) >= MOST:
            return f"{MOST} requests wait for approval already: ask again later"
        self._all[wanted.number] = wanted
        for number in [n for n, each in self._all.items() if each.over][:-KEPT]:
            del self._all[number]
        return ""

    def poll(self, number: int, by: str, now: float) -> AssistantReply:
        """The client asks what became of its request."""
        found = self._all.get(number)
        if found is None or found.request.by != by:
            why = "it ended before, or with an assistant agent that has restarted; ask again"
            return AssistantReply(refusal=f"no request of yours waits as {number}: {why}")
        found.seen_at = now
        if found.outcome is not None:
            return found.outcome
        return AssistantReply(
            f"waits for a person's approval, code {found.code}: {found.why}", approval=number
        )

    def leave(self, number: int, by: str) -> Waiting | None:
        """The client is gone; return its request, which has ended, if it waited."""
        found = self._all.get(number)
        if found is None or found.request.by != by or found.over:
            return None
        self.end(found, LEFT)
        return found

    def of(self, code: str) -> Waiting:
        """The request with a code."""
        return next(each for each in self._all.values() if each.code == code)

    def answer(self, code: str, choice: Choice, by: str, now: float) -> tuple[Answered, bool]:
        """A person answers; return the reply, and whether the request is to be done now."""
        self.expire(now)
        found = next((each for each in self._all.values() if each.code == code), None)
        if found is None:
            return Answered(refusal=f"no request with the code {code} waits"), False
        if found.over:
            return Answered(refusal=f"it is over: {found.over}"), False
        found.by = by
        if choice is Choice.NO:
            self.end(found, f"denied by {by or 'a person'}")
            return Answered(f"denied: {found.request.tool} for {found.request.by}"), False
        found.over = f"approved by {by or 'a person'}"
        return Answered(f"approved: {found.request.tool} for {found.request.by}"), True

    def expire(self, now: float) -> list[Waiting]:
        """End those that nobody has answered, and those whose client is gone; return them."""
        ended = []
        for each in self.waiting:
            if now - each.at >= WAITS_S:
                self.end(each, f"nobody has answered within {WAITS_S:.0f} s")
            elif now - each.seen_at >= GONE_S:
                self.end(each, LEFT)
            else:
                continue
            ended.append(each)
        return ended

    def end(self, waiting: Waiting, why: str) -> None:
        """End a request without doing it."""
        waiting.over = why
        waiting.outcome = AssistantReply(refusal=f"not approved: {why}")
