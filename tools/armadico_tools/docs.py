"""Write the generated parts of the documentation again: `python -m armadico_tools.docs`.

A part stands between `<!-- generated: NAME -->` and `<!-- end: NAME -->` in a Markdown file of the
checkout. Its text comes from the code itself: the table of services, the messages, the
agents' classes, the table of transitions. `--check` writes nothing and fails if a part is stale.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import textwrap
import tomllib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import cbor2

from armadico.config.discovery import summary
from armadico.config.scenarios import society
from armadico.core.agent import Agent
from armadico.core.coordination import TRANSITIONS, Event, State
from armadico.core.messages import (
    Ack,
    Ballot,
    Claim,
    Command,
    Cycle,
    Log,
    Message,
    Stick,
    Stop,
    Truth,
    encode,
)
from armadico.core.services import SERVICES, TOKEN, Service, matches
from armadico.launch.wakeup import Wakeup
from armadico_tools.docs_fields import fields_of, messages
from armadico_tools.kept_results import outcomes, pairs, smoothness
from armadico_tools.markdown import table

ROOT: Final = Path(__file__).resolve().parents[2]
"""The checkout: the documentation is not installed."""

PART: Final = re.compile(r"(<!-- generated: ([\w -]+?) -->\n).*?(<!-- end: \2 -->)", re.DOTALL)

ALL: Final = "all agents"


class UnknownPartError(LookupError):
    """A document names a part that does not exist."""


def documents(root: Path = ROOT) -> list[Path]:
    """Every Markdown file that may have generated parts."""
    return [root / "README.md", *sorted((root / "docs").glob("*.md"))]


def rewritten(text: str) -> str:
    """The text with each of its generated parts as it should be. Raises UnknownPartError."""

    def part(found: re.Match[str]) -> str:
        write = PARTS.get(found[2])
        if write is None:
            raise UnknownPartError(f"no part {found[2]!r}; there are: {', '.join(PARTS)}")
        return f"{found[1]}\n{write()}\n\n{found[3]}"

    return PART.sub(part, text)


def stale(root: Path = ROOT) -> list[Path]:
    """The documents whose generated parts are stale."""
    return [path for path in documents(root) if _read(path) != rewritten(_read(path))]


def main(argv: Sequence[str] | None = None) -> int:
    """Write all of them, or with `--check` only look."""
    parser = argparse.ArgumentParser(prog="python -m armadico_tools.docs", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; fail if it is stale")
    args = parser.parse_args(argv)
    old = stale()
    for path in old:
        if not args.check:
            path.write_text(rewritten(_read(path)), encoding="utf-8")
        print(f"{path.relative_to(ROOT)}: {'stale' if args.check else 'written'}")
    return 1 if args.check and old else 0


# Who publishes and receives what ------------------------------------------------------------------


def entries(group: str) -> dict[str, str]:
    """The entry points of a group, as our two project files have them."""
    found: dict[str, str] = {}
    for folder in (ROOT, ROOT / "tools"):
        with (folder / "pyproject.toml").open("rb") as file:
            found |= tomllib.load(file)["project"]["entry-points"].get(group, {})
    return found


def agents() -> dict[str, type[Agent]]:
    """Our own agents' classes, by name."""
    found: dict[str, type[Agent]] = {}
    for name, value in entries("armadico.agents").items():
        module, _, attribute = value.partition(":")
        if find_spec(module) is not None:
            found[name] = getattr(import_module(module), attribute)
    return found


def peers() -> dict[str, type[Agent]]:
    """All who are on the mesh: the agents, and the wakeup agent of `armadico up`."""
    return agents() | {Wakeup.name: Wakeup}


def _names(names: Iterator[str]) -> str:
    return ", ".join(names)


def _provides(kind: type[Agent], service: Service) -> bool:
    if service.message is Command:
        return any(matches(service.pattern, r.command_pattern) for r in kind.competes_for)
    if service.message is Claim:
        return bool(kind.competes_for)
    if service.message is Ack:
        return bool(kind.owns)
    return service.message in (*kind.provides, *kind.answers)


def _requests(kind: type[Agent], service: Service) -> bool:
    receives = any(
        to.message is service.message and matches(service.pattern, to.pattern)
        for to in kind.subscriptions()
    )
    return receives or service.message in kind.asks


def providers(service: Service) -> str:
    """Who publishes it, or answers it."""
    if service.message is Log or service.key.startswith(("agent/", "journal/")):
        return ALL
    if service.message is Stop:
        return "any process"
    if service.message is Stick:
        return "any hand"
    if service.message is Truth:
        return "the simulator"
    found = _names(name for name, kind in peers().items() if _provides(kind, service))
    return found or "the holder"


def requesters(service: Service) -> str:
    """Which agents receive it, or query it."""
    every = peers()
    asking = [name for name, kind in every.items() if _requests(kind, service)]
    others = "its owner" if service.message is Command else "people and tools"
    return ALL if len(asking) == len(every) else ", ".join(asking) or others


# The parts ----------------------------------------------------------------------------------------


def keys() -> str:
    """The table of services, with who provides and who requests each."""

    def rows() -> Iterator[Sequence[str]]:
        for s in SERVICES:
            what = f"[{s.message.__name__}]({_anchor(s.message)})"
            if s.reply is not None:
                what += f" -> [{s.reply.__name__}]({_anchor(s.reply)})"
            rate = "" if s.rate_hz is None else f"{s.rate_hz:g}"
            fresh = "" if s.fresh_cycles is None else str(s.fresh_cycles)
            yield (
                *(f"`{_angled(s.key)}`", what, s.kind.value, rate, fresh),
                *(providers(s), requesters(s), s.meaning),
            )
        token = f"`{_angled(TOKEN)}`"
        yield token, "none", "liveliness token", "", "", ALL, ALL, "its agent is alive"

    head = ("key", "message", "kind", "Hz", "cycles", "provided by", "requested by", "meaning")
    return table(head, rows())


def fields() -> str:
    """Every message: what it is, and its fields in the order of the wire."""
    parts = []
    for kind in messages():
        rows = (
            (str(f.index), f"`{f.name}`", f.type, f.default, f.meaning) for f in fields_of(kind)
        )
        body = table(("", "field", "type and range", "if left out", ""), rows)
        text = _docstring(kind)
        parts.append(f"### {kind.__name__}\n\n{text}\n\n{body if kind.__struct_fields__ else ''}")
    return "\n\n".join(part.rstrip() for part in parts)


def transitions() -> str:
    """The contender's table: state, event, next state, what is done."""
    rows = (
        (state.value, event.value, after.value, step.value)
        for (state, event), (after, step) in TRANSITIONS.items()
    )
    return table(("state", "event", "next state", "what is done"), rows)


def diagram() -> str:
    """The same as a state diagram that GitHub draws."""
    ids = {state: state.name.title().replace("_", "") for state in State}
    lines = ["```mermaid", "stateDiagram-v2", f"    [*] --> {ids[State.IDLE]}"]
    lines += [f'    state "{state.value}" as {name}' for state, name in ids.items()]
    arrows: dict[tuple[State, State], list[Event]] = {}
    for (state, event), (after, _) in TRANSITIONS.items():
        arrows.setdefault((state, after), []).append(event)
    for (state, after), events in arrows.items():
        label = " / ".join(event.name.lower().replace("_", " ") for event in events)
        lines.append(f"    {ids[state]} --> {ids[after]}: {label}")
    return "\n".join([*lines, "```"])


def example() -> str:
    """A command and the claim that goes with it, as they are on the wire."""
    cycle, ballot = Cycle(7, 42), Ballot(3, 0.75, critical=False, instance="mine-0123456789abcdef")
    claim = Claim("wheels", ballot, cycle, 0.75, wanted=(0.5, 0.0), commanded=(0.4, 0.1))
    parts = []
    for message in (Command("wheels", cycle, ballot, (0.4, 0.1)), claim):
        data = encode(message)
        shown = json.dumps(cbor2.loads(data))
        hexed = "\n".join(textwrap.wrap(data.hex(" "), 90))
        parts.append(
            f"`{type(message).__name__}`, {len(data)} bytes: `{shown}`\n\n```text\n{hexed}\n```"
        )
    return "\n\n".join(parts)


def commands(package: str) -> str:
    """Commands of a package, each with the first line of its module."""

    def rows() -> Iterator[Sequence[str]]:
        for name, value in entries("armadico.commands").items():
            module = value.partition(":")[0]
            if module.startswith(package):
                yield f"`armadico {name}`", summary(module)

    return table(("command", "what it does"), rows())


def agent_list(*, asked_for: bool = False) -> str:
    """The agents of a society, or those beside them, which take part if they are asked for."""
    usual = (society().robot, *society().agents)
    rows = (
        (f"`{name}`", summary(kind.__module__), _names(r.name for r in kind.competes_for))
        for name, kind in agents().items()
        if (name in usual) != asked_for
    )
    return table(("agent", "what it is", "competes for"), rows)


def patterns() -> str:
    """The agent pattern of the thesis (figure 3.6), filled in by what each class declares."""
    kinds = peers()
    rows = []
    for name, kind in kinds.items():
        hears = {message.__name__ for message in (*kind.hears, *kind.needs)}
        sources = (*kind.hears, *kind.needs, *kind.asks)
        with_ = [
            n for n, k in kinds.items() if {*k.provides, *k.answers} & {*sources} and n != name
        ]
        rivals = [n for n, k in kinds.items() if {*k.competes_for} & {*kind.competes_for}]
        rows.append(
            (
                f"`{name}`",
                (kind.__doc__ or "").splitlines()[0],
                ", ".join(sorted(hears)),
                ", ".join(with_),
                ", ".join(resource.name for resource in kind.competes_for),
                ", ".join(n for n in rivals if n != name),
            )
        )
    head = ("agent", "goal", "internal state: receives", "collaborates with", "competes for")
    return table((*head, "against"), rows)


ABRUPT_TO_SMOOTH: Final = [
    (f"thesis {comparison} abrupt", f"thesis {comparison} smooth")
    for comparison in ("last-heard", "same-cycle")
]
WITHOUT_TO_WITH: Final = [
    (f"{world} thesis GA", f"{world} thesis GAT") for world in ("rooms-a", "rooms-b")
]

PARTS: Final[dict[str, Callable[[], str]]] = {
    "keys": keys,
    "fields": fields,
    "transitions": transitions,
    "diagram": diagram,
    "example": example,
    "commands": lambda: commands("armadico."),
    "laboratory": lambda: commands("armadico_tools."),
    "agents": agent_list,
    "patterns": patterns,
    "more agents": partial(agent_list, asked_for=True),
    "runs in nine scenarios": partial(outcomes, "thesis-nine-scenarios"),
    "runs of 5-2": partial(outcomes, "thesis-5.2"),
    "smoothness of 5-2": partial(smoothness, "thesis-5.2"),
    "pairs of 5-2": lambda: pairs("thesis-5.2", ABRUPT_TO_SMOOTH),
    "runs of 5-3": partial(outcomes, "thesis-5.3"),
    "pairs of 5-3": lambda: pairs("thesis-5.3", WITHOUT_TO_WITH),
    "runs of 5-2-2": partial(outcomes, "thesis-5.2.2"),
    "runs of 5-2-5": partial(outcomes, "thesis-5.2.5"),
}


# Inside -------------------------------------------------------------------------------------------


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def _anchor(kind: type[Message]) -> str:
    return f"#{kind.__name__.lower()}"


def _angled(key: str) -> str:
    return key.replace("{", "<").replace("}", ">")


def _docstring(kind: type[Any]) -> str:
    return re.sub(r"\s+", " ", kind.__doc__ or "").strip().replace("``", "`")


if __name__ == "__main__":
    sys.exit(main())
