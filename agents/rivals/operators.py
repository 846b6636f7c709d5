"""ARA's operators, which combine behaviours into one."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Final

from msgspec import Meta

from armadico.agents.rivals.arbiter import REST, Arbiter, Decision, Speeds, Wish
from armadico.agents.rivals.grid import actions
from armadico.agents.rivals.layers import ACTIVE
from armadico.agents.rivals.proposer import Arbitrated
from armadico.agents.rivals.votes import best_of
from armadico.core import parameters
from armadico.core.agent import Identity
from armadico.core.messages import Cycle, Description
from armadico.core.parameters import Naming
from armadico.mobile.motion import Body

Share = Annotated[float, Meta(ge=0, le=1)]
Tree = str | tuple[str, list["Tree"]]

WORD: Final = re.compile(r"[-+&#(),]|[\w*.][\w*.-]*")


def _behaviours(rule: str) -> list[str]:
    return [word.partition("*")[0] for word in WORD.findall(rule) if word not in "-+&#(),"]


Rule = Annotated[str, Naming(_behaviours)]


class OperatorsParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of ARA's operators.

    `rule` is a behaviour's name or an operator with its arguments in brackets: `+` the first that
    is active, of which only one should be; `-` the largest activation times priority, which a name
    has after a `*`; `&` what satisfies all, of names alone; `#` the first whose trigger holds, kept
    until it ends. The last argument of `+` and `#` needs no trigger.
    """

    rule: Rule = "#(teleop, relocate, -(avoid, gothrough), &(goto, avoid))"
    active: Share = ACTIVE  # the activation from which a trigger condition holds
    ends: Share = 0.4  # below this it no longer does


class Operators(Arbiter):
    """Behaviours combined by the operators +, -, & and # of ARA (Neves and Oliveira 1997)."""

    name = "operators"
    parameters = OperatorsParameters
    p: OperatorsParameters

    def __init__(self, identity: Identity, parameters: OperatorsParameters | None = None) -> None:
        """Raises ValueError for a rule that cannot be read."""
        super().__init__(identity, parameters)
        self._rule = parsed(self.p.rule)
        self._kept: dict[int, int] = {}  # by operator #: which argument is active

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        found = self._combined(self._rule, wishes)
        return Decision(REST, {}) if found is None else Decision(found[1], found[2])

    def _combined(
        self, tree: Tree, wishes: Mapping[str, Wish]
    ) -> tuple[float, Speeds, dict[str, float]] | None:
        """An activation, an action and shares; None: nothing is proposed."""
        if isinstance(tree, str):
            name, _, factor = tree.partition("*")
            wish = wishes.get(name)
            if wish is None or wish.utility <= 0.0:
                return None
            activation = 1.0 if wish.critical else wish.utility
            return activation * float(factor or 1), wish.action, {name: 1.0}
        operator, arguments = tree
        if operator == "&":
            return self._intersection(arguments, wishes)
        parts = {i: self._combined(each, wishes) for i, each in enumerate(arguments)}
        able = {i: part for i, part in parts.items() if part is not None}
        if not able:
            return None
        if operator == "-":
            return max(able.values(), key=lambda part: part[0])
        last = len(arguments) - 1
        triggered = [i for i, part in able.items() if part[0] >= self.p.active or i == last]
        chosen, kept = min(triggered, default=-1), self._kept.get(id(tree), last)
        holds = kept in able and able[kept][0] >= self.p.ends
        if operator == "#" and holds and kept != last and not 0 <= chosen < kept:
            chosen = kept
        self._kept[id(tree)] = chosen
        return able.get(chosen)

    def _intersection(
        self, names: list[Tree], wishes: Mapping[str, Wish]
    ) -> tuple[float, Speeds, dict[str, float]] | None:
        """The action whose least vote is the largest."""
        about = self.latest(Description)
        if about is None:
            return None
        grid = actions(Body.of(about))
        rated = {n: wishes[n] for n in map(str, names) if n in wishes}
        rated = {n: wish for n, wish in rated.items() if len(wish.votes) == len(grid)}
        if not any(wish.utility > 0.0 for wish in rated.values()):
            return None
        scores = [min(wish.votes[i] for wish in rated.values()) for i in range(len(grid))]
        found = best_of(rated, grid, scores)
        activation = max(wish.utility for wish in rated.values())
        return activation, found.action, dict(found.shares)


def parsed(rule: str) -> Tree:
    """Read a rule. Raises ValueError."""
    words = WORD.findall(rule)
    if "".join(words) != "".join(rule.split()):
        raise ValueError(f"rule {rule!r}: expected names, the operators + - & # and brackets")
    tree, rest = _read(words, rule)
    if rest:
        raise ValueError(f"rule {rule!r}: nothing may follow the last bracket")
    return tree


def _read(words: list[str], rule: str) -> tuple[Tree, list[str]]:
    if not words or words[0] in "(),":
        raise ValueError(f"rule {rule!r}: a name or an operator is missing")
    first, *rest = words
    if first not in "+-&#":
        return first, rest
    if rest[:1] != ["("]:
        raise ValueError(f"rule {rule!r}: expected a bracket after {first}")
    arguments: list[Tree] = []
    while rest[:1] != [")"]:
        argument, rest = _read(rest[1:], rule)
        arguments.append(argument)
        if rest[:1] not in ([","], [")"]):
            raise ValueError(f"rule {rule!r}: expected a comma or a closing bracket")
    return (first, arguments), rest[1:]


OPERATORS: Final = Arbitrated(
    Operators.name, needs="rate", about="behaviours combined by ARA's operators + - & #"
)
