"""The generated parts of the documentation: services, messages, transitions, agents, commands.

The line `<!-- generated: NAME -->` of a page stands for a part. It is replaced when the site is
built (`site.py`); parts are not committed.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from armadico.agents.rivals.systems import MECHANISMS, SYSTEMS
from armadico.agents.supervision.wakeup import Wakeup
from armadico.config.scenarios import society
from armadico.core.agent import Agent
from armadico.core.coordination import TRANSITIONS, Event, State
from armadico.core.discovery import AGENTS, find, summary
from armadico.core.messages import Ack, Claim, Command, Log, Message, Stop, Void
from armadico.core.parameters import Parameters
from armadico.core.services import TOKEN, Service, matches
from armadico.mobile.messages import Truth
from armadico.watch.teleop.messages import Stick
from armadico_tools.docs_fields import fields_of, ours, parameters_of
from armadico_tools.markdown import table

ROOT: Final = Path(__file__).resolve().parents[2]
"""The checkout: the documentation is not installed."""

PART: Final = re.compile(r"^<!-- generated: (.*) -->$", re.MULTILINE)

ALL: Final = "all agents"


def filled(text: str) -> str:
    """A page with its generated parts. Raises KeyError for an unknown part."""
    return PART.sub(lambda part: PARTS[part[1]](), text)


# Providers ----------------------------------------------------------------------------------------


def entries(group: str) -> dict[str, str]:
    """The entry points of a group in both project files."""
    found: dict[str, str] = {}
    for folder in (ROOT, ROOT / "tools"):
        with (folder / "pyproject.toml").open("rb") as file:
            found |= tomllib.load(file)["project"]["entry-points"].get(group, {})
    return found


def agents() -> dict[str, type[Agent]]:
    """The shipped agents' classes, by name."""
    found: dict[str, type[Agent]] = {}
    for name, value in entries("armadico.agents").items():
        module, _, attribute = value.partition(":")
        if find_spec(module) is not None:
            found[name] = getattr(import_module(module), attribute)
    return found


def peers() -> dict[str, type[Agent]]:
    """The agents, and the wakeup agent of `armadico up`."""
    return agents() | {Wakeup.name: Wakeup}


def _provides(kind: type[Agent], service: Service) -> bool:
    if service.message is Command:
        return any(matches(service.pattern, r.command_pattern) for r in kind.competes_for)
    if service.message is Claim:
        return bool(kind.competes_for)
    if service.message is Ack:
        return bool(kind.owns)
    return service.message in (*kind.provides, *kind.answers)


def providers(service: Service) -> str:
    """The agents that publish or answer a service, in words."""
    if service.message is Log or service.key.startswith(("agent/", "journal/")):
        return ALL
    if service.message is Stop:
        return "any process"
    if service.message is Stick:
        return "any hand"
    if service.message is Truth:
        return "the simulator"
    if service.message is Void:
        return "the robot's router"
    found = [name for name, kind in peers().items() if _provides(kind, service)]
    return ", ".join(found) or "the holder"


# The parts ----------------------------------------------------------------------------------------


def keys() -> str:
    """The table of services, with their providers."""

    def link(kind: type[Message]) -> str:
        return f"[{kind.__name__}](#{kind.__name__.lower()})"

    def angled(key: str) -> str:
        return f"`{key}`".replace("{", "<").replace("}", ">")

    rows = [
        (
            angled(s.key),
            link(s.message) + ("" if s.reply is None else f" -> {link(s.reply)}"),
            s.kind.value,
            "" if s.rate_hz is None else f"{s.rate_hz:g}",
            "" if s.fresh_cycles is None else s.fresh_cycles,
            providers(s),
            s.meaning,
        )
        for s in ours()[0]
    ]
    token = (angled(TOKEN), "none", "liveliness token", "", "", ALL, "its agent is alive")
    head = ("key", "message", "kind", "Hz", "cycles", "provided by", "meaning")
    return table(head, [*rows, token])


def fields() -> str:
    """Every message with its fields in the order of the wire."""
    parts = []
    for kind in ours()[1]:
        rows = (
            (str(f.index), f"`{f.name}`", f.type, f.default, f.meaning) for f in fields_of(kind)
        )
        body = table(("", "field", "type and range", "if left out", ""), rows)
        text = re.sub(r"\s+", " ", kind.__doc__ or "").strip().replace("``", "`")
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
    """The transitions as a state diagram that GitHub draws."""
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


def commands(package: str) -> str:
    """The commands of a package, each with the first line of its module."""
    rows = [
        (f"`armadico {name}`", summary(value.partition(":")[0]))
        for name, value in entries("armadico.commands").items()
        if value.startswith(package)
    ]
    return table(("command", "what it does"), rows)


def agent_list(*, asked_for: bool = False) -> str:
    """The agents of a society, or the optional ones."""
    usual = (society().robot, *society().agents)
    rows = (
        (f"`{name}`", find(AGENTS, name).summary, ", ".join(r.name for r in kind.competes_for))
        for name, kind in agents().items()
        if (name in usual) != asked_for
    )
    return table(("agent", "what it is", "competes for"), rows)


def parameters() -> str:
    """A table for each agent: its parameters, their ranges and defaults."""
    parts = []
    for name, kind in agents().items():
        shared = set(Parameters.__struct_fields__)
        rows = [
            (
                f"`{each.name}`" + (" *" if each.name in kind.changeable else ""),
                each.type,
                each.default,
                each.meaning,
            )
            for each in parameters_of(kind.parameters)
            if each.name.partition(".")[0] not in shared
        ]
        body = table(("parameter", "type and range", "default", ""), rows) if rows else "None."
        parts.append(f"## {name}\n\n{body}")
    return "\n\n".join(parts)


def shared_parameters() -> str:
    """The parameters that every agent has."""
    rows = [(f"`{p.name}`", p.type, p.default, p.meaning) for p in parameters_of(Parameters)]
    return table(("parameter", "type and range", "default", ""), rows)


def mechanisms() -> str:
    """The coordinations beside ballots."""
    offers = {"": "", "rate": "votes", "vector": "vectors"}
    rows = [
        (
            f"`{name}`",
            each.about,
            f"`{each.arbiter}`",
            ", ".join(
                filter(None, (offers[each.needs], "the extra `rivals`" * bool(each.library)))
            ),
        )
        for name, each in sorted(MECHANISMS.items())
    ]
    return table(("`--coordination`", "what decides", "its agent", "needs"), rows)


def systems() -> str:
    """The systems of the thesis's chapter 2, and what stands for them."""
    rows = [
        (
            each.title + " (sequencing only)" * each.sequencing,
            each.section,
            f"`{name}`" if each.mechanism else "-",
            " ".join((f"`{each.mechanism}`", *map("`{}`".format, each.sets)))
            if each.mechanism
            else "-",
            each.lacks,
        )
        for name, each in SYSTEMS.items()
    ]
    head = ("system", "thesis", "`--coordination`", "mechanism", "missing or different")
    return table(head, [(*map(str, row),) for row in rows])


PARTS: Final[dict[str, Callable[[], str]]] = {
    "keys": keys,
    "fields": fields,
    "transitions": transitions,
    "diagram": diagram,
    "commands": lambda: commands("armadico."),
    "laboratory": lambda: commands("armadico_tools."),
    "agents": agent_list,
    "more agents": partial(agent_list, asked_for=True),
    "parameters": parameters,
    "shared parameters": shared_parameters,
    "mechanisms": mechanisms,
    "systems": systems,
}
