"""Print what each identity may do, and which line of which class gives it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.cli.parsing import Command, argument, flag, group, option
from armadico.keys.commands.common import Society

if TYPE_CHECKING:
    from armadico.keys.rights import Table

EXAMPLES: Final = """\
  armadico keys rights --hosts lab.toml                   who may publish, query and answer what
  armadico keys rights goto                               all rights of one identity
  armadico keys rights --explain robot/cmd/goto-1f0c      who may use a key, and by which line
  armadico keys rights --explain mapping/grid             or why no identity may
  armadico keys rights --write                            derive the table again, after an upgrade
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    identity: str | None = argument(
        "print all rights of this identity (default: a summary of all)",
        metavar="IDENTITY",
        nargs="?",
    )
    explain: str | None = option(
        "print which identities may use a key, or a key expression, and which declaration of which"
        " class gives the right",
        metavar="KEY",
    )
    write: bool = flag("derive the table from the installed classes, and write it for the router")
    json: bool = flag("print the rules of Zenoh that the robot's router enforces")
    society: Society = group(Society, "the society")


def run(args: Options) -> int:
    from armadico.core.config_errors import ConfigError
    from armadico.keys import derived

    store, namespace = args.society.store, args.society.where.namespace
    listed = store.members_here()
    if not listed and (args.write or args.json):
        needs = "--write" if args.write else "--json"
        raise ConfigError(
            f"{store.folder} has no list of identities, which {needs} needs: run this on the"
            " computer that has the authority's key"
        )
    if args.write:
        table = derived.derive_again(store, namespace)
        print(f"{derived.file_of(store, namespace)}: {len(table.rights)} rights")
        return 0
    table = derived.load(store, namespace)
    if args.json:
        import json

        print(json.dumps(derived.access_control(store, namespace), indent=1))
        return 0
    if args.explain is not None:
        print("\n".join(explanation(table, args.explain, namespace)))
    elif args.identity is not None:
        print("\n".join(_of_one(table, args.identity)))
    else:
        print("\n".join(_summary(table)))
    if not listed:
        options.report(
            f"this is the table of {derived.file_of(store, namespace)}, as it was when these keys"
            " were made: `armadico keys rights` on the computer that has the authority's key"
            " compares its own with the classes"
        )
        return 0
    now = derived.derive(listed.values(), namespace)
    for line in derived.named(store, namespace, derived.contradictions(table, now)):
        options.report(line)
    return 0


def explanation(table: Table, key: str, namespace: str) -> Iterator[str]:
    """Yield who may do what on a key, and why if no identity publishes or answers on it."""
    from armadico.core.services import Kind, service_at
    from armadico.keys.rights import WORDS, Does

    key = key.removeprefix(f"{namespace}/")
    rights = table.on(key)
    for does in Does:
        identities: dict[tuple[str, str], list[str]] = {}  # by key and declaration
        for right in rights:
            if right.does is does:
                identities.setdefault((right.key, str(right.because)), []).append(right.identity)
        for (of, because), names in identities.items():
            yield f"{WORDS[does]} {of}: {', '.join(names)} ({because})"
    publish = (Does.PUT, Does.ANSWER)
    if any(right.does in publish for right in rights):
        return
    none, service = f"no identity publishes or answers on {key}", service_at(key)
    if service is None:
        yield f"{none}: no installed message has this key"
        return
    kind = service.message.__name__
    of_others = [right.key for right in table.on(service.pattern) if right.does in publish]
    if of_others:
        yield f"{none}: each publisher of {kind} has keys of its own, such as {of_others[0]}"
    else:
        attribute = "answers" if service.kind is Kind.QUERY else "provides"
        yield f"{none}: it is for {kind}, which no class of an identity has in its `{attribute}`"


def _of_one(table: Table, identity: str) -> Iterator[str]:
    from armadico.keys.rights import WORDS

    if identity not in table.speakers:
        raise UsageError(f"no identity {identity!r}; known: {', '.join(sorted(table.speakers))}")
    for right in table.of(identity):
        yield f"{WORDS[right.does]} {right.key}: {right.because}"
    for each in table.critical:
        if each.agent in table.speakers[identity]:
            yield f"may bid critical for {each.resource}: {each.because}"


def _summary(table: Table) -> Iterator[str]:
    """Yield the rights that distinguish identities, without what every agent has."""
    from armadico.keys.rights import WORDS, Does

    shown = (Does.PUT, Does.ANSWER, Does.QUERY)
    common = _common(table)
    for identity in table.speakers:
        yield identity
        for does in shown:
            keys = [
                right.key
                for right in table.of(identity)
                if right.does is does and right.because not in common
            ]
            if keys:
                yield f"  {WORDS[does]} {', '.join(keys)}"
        critical = [c.resource for c in table.critical if c.agent in table.speakers[identity]]
        if critical:
            yield f"  may bid critical for {', '.join(dict.fromkeys(critical))}"
    yield ""
    yield "Every agent also has its token, card, bids, parameters, journal and log, may stop the"
    yield "robot, and repeats latched states. All rights: armadico keys rights IDENTITY"


def _common(table: Table) -> frozenset[object]:
    """The declarations that give a right to every agent."""
    return frozenset(
        right.because for right in table.rights if right.because.what.startswith("every ")
    )


COMMAND: Final = Command(
    "armadico keys rights",
    Options,
    run,
    "Print what each identity may do. Rights are derived from what the agents' classes declare"
    " (`provides`, `answers`, `queries`, `competes_for`, `owns`), and the robot's router refuses"
    " everything else. The table is written by the verbs that make keys, on the computer that has"
    " the authority's key.",
    EXAMPLES,
)
