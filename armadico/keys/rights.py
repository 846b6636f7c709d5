"""The rights of each identity of a society, and Zenoh's access control from them: sans-IO.

A right is one kind of Zenoh message on the keys of an expression, and has the line of the
declaration that gives it (`armadico.keys.deriving`). Nothing else is allowed. The robot's router
enforces it for all its clients. The robot agent's own process is that router, so `robot` needs no
rights.

A key has the publisher's instance, `goto-1f0c...`, so a right has `goto-$*`. That expression also
covers the instances of an agent called `goto-fast`, so rules deny those (`Table.denied`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import StrEnum
from typing import Final, NamedTuple

from msgspec import Struct

from armadico.core.installed import load_all
from armadico.core.shared import shared
from armadico.keys.expressions import covers, meet
from armadico.mesh.door import ROBOT
from armadico.mesh.topology import rooted

ROUTER: Final = "router/*"
"""The liveliness tokens of routers (`armadico.mesh.zenoh`)."""

EVERYTHING: Final = "**"


class Does(StrEnum):
    """A kind of Zenoh message from a client to the router, as its access control calls it."""

    PUT = "put"
    DELETE = "delete"
    SUBSCRIBE = "declare_subscriber"
    QUERY = "query"
    ANSWER = "declare_queryable"
    REPLY = "reply"
    TOKEN = "liveliness_token"
    WATCH = "declare_liveliness_subscriber"
    LOOK = "liveliness_query"


WORDS: Final = {
    Does.PUT: "publishes",
    Does.DELETE: "deletes",
    Does.SUBSCRIBE: "subscribes to",
    Does.QUERY: "queries",
    Does.ANSWER: "answers",
    Does.REPLY: "replies on",
    Does.TOKEN: "shows the token",
    Does.WATCH: "watches the tokens",
    Does.LOOK: "queries the tokens",
}


class Because(NamedTuple):
    """The declaration that gives a right."""

    file: str
    line: int
    what: str  # `Goto.competes_for`, or what every agent has

    def __str__(self) -> str:
        return f"{self.file}:{self.line} {self.what}"


class Right(NamedTuple):
    """One identity may send one kind of message on the keys of an expression.

    `key` is without the namespace, as in the table of services.
    """

    identity: str
    does: Does
    key: str
    because: Because


class Critical(NamedTuple):
    """An agent's bids for a resource may be critical. Its owner checks that, not the router."""

    agent: str
    resource: str
    because: Because


class Table(Struct, frozen=True):
    """The rights of a society."""

    rights: tuple[Right, ...]  # All of them. Those of `robot` are for people: it is the router.
    speakers: dict[str, tuple[str, ...]]  # by identity, what its instances begin with
    critical: tuple[Critical, ...] = ()  # the agents whose bids may be critical
    # Agents whose classes declare nothing beyond what every agent does.
    silent: tuple[str, ...] = ()

    def of(self, identity: str) -> list[Right]:
        return [right for right in self.rights if right.identity == identity]

    def allowed(self, identity: str, does: Does) -> set[str]:
        """Return the key expressions of one kind of message, without `denied`."""
        return {right.key for right in self.of(identity) if right.does is does}

    def denied(self, identity: str, does: Does) -> set[str]:
        """Return the key expressions that are another speaker's within those allowed."""
        keys = [key.split("/") for key in self.allowed(identity, does)]
        others = {one for speakers in self.speakers.values() for one in speakers}
        return {
            "/".join(instances(other) if chunk == instances(own) else chunk for chunk in chunks)
            for own in self.speakers[identity]
            for other in others.difference(self.speakers[identity])
            if _begins(other, own)
            for chunks in keys
            if instances(own) in chunks
        }

    def why(self, identity: str, does: Does, key: str) -> Right | None:
        """Return the right that allows a message; None if it is forbidden."""
        if any(covers(denied, key) for denied in self.denied(identity, does)):
            return None
        rights = (right for right in self.of(identity) if right.does is does)
        return next((right for right in rights if covers(right.key, key)), None)

    def on(self, key: str) -> list[Right]:
        """Return the rights to a key, or to keys of a key expression."""
        return [
            right
            for right in self.rights
            if meet(right.key, key)
            and not any(covers(denied, key) for denied in self.denied(right.identity, right.does))
        ]

    def speaker(self, instance: str) -> str:
        """Return the agent, or the other identity, of an instance; "" if it is of none."""
        every = {one for speakers in self.speakers.values() for one in speakers}
        return max((one for one in every if _begins(instance, one)), key=len, default="")

    def may_be_critical(self, instance: str, resource: str) -> bool:
        """Return whether an instance's bids for a resource may be critical."""
        by = self.speaker(instance)
        return any(each.agent == by and each.resource == resource for each in self.critical)

    def may_own(self, instance: str, resource: str) -> bool:
        """Return whether an instance may acknowledge a resource."""
        by, ack = self.speaker(instance), f"resource/{resource}/ack"
        mine = (name for name, speakers in self.speakers.items() if by in speakers)
        return any(self.why(name, Does.PUT, ack) for name in mine)

    def access_control(
        self,
        namespace: str,
        robots: Iterable[str] = (),
        users: Mapping[str, Sequence[str]] | None = None,
    ) -> dict[str, object]:
        """Return Zenoh's `access_control` for the robot's router.

        A subject is an identity with its user names. What the router sends to a client is not
        restricted, because it follows from what that client could declare.

        Args:
            namespace: The robot's.
            robots: The namespaces of the robots that share keys with it. Their routers are
                clients of this one and may subscribe to those keys.
            users: The user names of each identity; by default `<namespace>/<identity>`.
        """
        load_all()  # what robots share
        told = _rule("told", Does, [EVERYTHING], flow="egress")
        shares = [rooted(namespace, f"{first}/**") for first in sorted(shared())]
        rules = [told, _rule("shared keys", [Does.SUBSCRIBE], shares)]
        subjects: list[dict[str, object]] = []
        policies: list[dict[str, object]] = []

        def add(
            name: str, own: Sequence[dict[str, object]], usernames: Sequence[str], *common: str
        ) -> None:
            if not usernames:  # for Zenoh that would be everybody
                return
            rules.extend(own)
            subjects.append({"id": name, "usernames": [*usernames]})
            ids = [*common, *(str(rule["id"]) for rule in own)]
            policies.append({"rules": ids, "subjects": [name]})

        for identity in self.speakers:
            if identity != ROBOT:
                name = f"{namespace}/{identity}"
                known = [name] if users is None else users.get(identity, ())
                add(name, [*self._rules(namespace, identity)], known, "told")
        for robot in robots:
            watches = _rule(f"{robot}: router", [Does.WATCH, Does.LOOK], [rooted(robot, ROUTER)])
            add(f"{robot}/{ROBOT}", [watches], [f"{robot}/{ROBOT}"], "told", "shared keys")
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": rules,
            "subjects": subjects,
            "policies": policies,
        }

    def _rules(self, namespace: str, identity: str) -> Iterator[dict[str, object]]:
        """One rule for all kinds of messages with the same keys, and one for those denied."""
        found: dict[tuple[tuple[str, ...], tuple[str, ...]], list[Does]] = {}
        for does in Does:
            if keys := self.allowed(identity, does):
                denied = self.denied(identity, does)
                found.setdefault((tuple(sorted(keys)), tuple(sorted(denied))), []).append(does)
        for number, ((allow, deny), kinds) in enumerate(found.items()):
            rule = f"{namespace}/{identity}: {number}"
            yield _rule(rule, kinds, [rooted(namespace, key) for key in allow])
            if deny:
                keys_of = [rooted(namespace, key) for key in deny]
                yield _rule(f"{rule} not", kinds, keys_of, permission="deny")


def instances(speaker: str) -> str:
    """Return the expression of all instances of an agent, or of another identity."""
    return f"{speaker}-$*"


def _begins(name: str, speaker: str) -> bool:
    return name.startswith(f"{speaker}-")


def _rule(
    name: str,
    does: Iterable[Does],
    keys: Sequence[str],
    *,
    flow: str = "ingress",
    permission: str = "allow",
) -> dict[str, object]:
    return {
        "id": name,
        "messages": [each.value for each in does],
        "flows": [flow],
        "permission": permission,
        "key_exprs": list(keys),
    }
