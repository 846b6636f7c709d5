"""Ways to break a society on the virtual mesh, and what each command shows of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from msgspec.structs import replace
from rich.console import Console

from armadico.bridge.p2os.commands import Cmd, command
from armadico.cli import doctor, goto
from armadico.core.agent import WARNING
from armadico.core.discovery import providers
from armadico.core.exchange import Bid
from armadico.core.messages import PROTOCOL, Log, MonitorReport, RobotState, Stop
from armadico.core.services import service_of
from armadico.mobile.messages import BatteryLevel, Correction, Truth
from armadico.observe.diagnosis import diagnose
from armadico.observe.findings import Demand, Finding, Sort, short, summary
from armadico.watch.commands import top
from armadico.watch.commands import why as why_command
from armadico.watch.mcp.answers import Society
from armadico.watch.page.model import Robot
from armadico.watch.teleop.messages import TeleopStatus
from tests.watch.observed import Observed

BASE = ("robot", "encoder", "sonar")
LAB = ("goto", "avoid", "interface", "path-planning")
LOG = service_of(Log)
TABLE = {"base": BASE, "lab": LAB}
DIGEST = "01234567"
DEMAND = Demand(TABLE, DIGEST, providers)


def two_hosts(name: str) -> str:
    return "base" if name in BASE else "lab"


def whole() -> Observed:
    """A society on two hosts that drives; all agents have the same host table."""
    society = Observed(hosts=two_hosts)
    for name in (*BASE, *LAB):
        on_card(society, name, table=DIGEST)
    return society.drive(3.0)


def on_card(society: Observed, name: str, **changed: Any) -> None:
    """Change what an agent's card says."""
    agent = society.agent(name)
    fill = agent.fill_card
    agent.fill_card = lambda card: replace(fill(card), **changed)


def kill(*names: str) -> Callable[[Observed], object]:
    return lambda society: [society.mesh.node(name).kill() for name in names]


def hang(*names: str) -> Callable[[Observed], object]:
    return lambda society: [society.mesh.node(name).hang() for name in names]


def cut(sources: tuple[str, ...], targets: tuple[str, ...]) -> Callable[[Observed], object]:
    return lambda society: society.mesh.cut(sources, targets)


def card(name: str, **changed: Any) -> Callable[[Observed], object]:
    return lambda society: on_card(society, name, **changed)


def says(message: Callable[[Observed], Any], every_s: float = 0.2) -> Callable[[Observed], object]:
    """Publish a message again and again."""

    def publish(society: Observed) -> None:
        society.mesh.publish(message(society))
        society.mesh.call_at(society.mesh.now + every_s, lambda _a, _b: publish(society))

    return publish


def cycle(society: Observed) -> Any:
    state = society.agent("goto").latest(RobotState)
    assert state is not None
    return state.cycle


def lost(society: Observed) -> Correction:
    return Correction(cycle(society), 0, 0, 0, (4.0, 0.0, 0.0, 4.0, 0.0, 1.0), 0.0)


def bids(bid: Bid) -> Callable[[Observed], object]:
    def plant(society: Observed) -> None:
        for name in ("goto", "avoid"):
            society.agent(name).propose = lambda *_: bid

    return plant


def second(name: str) -> Callable[[Observed], object]:
    """The card of a second instance of an agent is received, on another host."""

    def plant(society: Observed) -> None:
        first = society.agent(name).kernel.card()
        other = replace(first, instance=f"{name}-0000000000000002", host="lab")

        def answer(_a: object = None, _b: object = None) -> None:
            society.chronicle.token(other.instance, there=True, t=society.mesh.now)
            society.chronicle.learn(other, society.mesh.now)
            society.mesh.call_at(society.mesh.now + 1.0, answer)

        answer()

    return plant


def away(society: Observed) -> None:
    society.view.router(there=False, t=society.mesh.now)


def serial(society: Observed) -> None:
    """The robot agent cannot open its port."""
    society.mesh.cut(("device",), ("robot",))
    log = Log(WARNING, "cannot open /dev/ttyUSB0: permission denied")
    key = LOG.key_for(instance=society.agent("robot").instance)

    def publish(_a: object = None, _b: object = None) -> None:
        society.mesh.publish(log, key=key)
        society.mesh.call_at(society.mesh.now + 0.1, publish)

    publish()


def clock_off(society: Observed) -> None:
    for name in LAB:
        society.view.ahead[society.agent(name).instance] = 60.0


def queries_lost(society: Observed) -> None:
    """Queries do not reach the sonar agent; what it publishes arrives."""
    instance = society.agent("sonar").instance
    learn = society.chronicle.learn

    def kept(message: Any, t: float) -> None:
        if getattr(message, "instance", "") != instance:
            learn(message, t)

    society.chronicle.learn = kept  # type: ignore[method-assign]


def thinned(society: Observed) -> None:
    """The sonar agent publishes every fourth time only."""
    sonar, count = society.agent("sonar"), [0]
    publish = sonar.publish

    def some(message: Any, **names: Any) -> None:
        count[0] += 1
        if count[0] % 4 == 0:
            publish(message, **names)

    sonar.publish = some


@dataclass(frozen=True)
class Breakage:
    """A way to break a society.

    Attributes:
        plant: Breaks it.
        sort: The code of the finding that names the cause.
        named: A text that each command shows.
        demand: What should be.
    """

    plant: Callable[[Observed], object]
    sort: Sort
    named: str
    demand: Demand = field(default_factory=lambda: DEMAND)


BREAKAGES: Mapping[str, Breakage] = {
    "host paused": Breakage(hang(*LAB), Sort.HOST, "lab"),
    "host switched off": Breakage(kill(*LAB), Sort.HOST, "lab"),
    "host off, a contender lives elsewhere": Breakage(
        lambda society: (kill(*LAB)(society), society.run.enter("avoid")), Sort.HOST, "lab"
    ),
    "host of the table never started": Breakage(
        lambda _: None, Sort.HOST, "yard", Demand(TABLE | {"yard": ("gothrough",)}, DIGEST)
    ),
    "host cut off": Breakage(
        lambda society: (
            society.mesh.cut(BASE, LAB),
            society.mesh.cut(LAB, BASE),
            hang(*LAB)(society),
        ),
        Sort.HOST,
        "lab",
    ),
    "cable passes one way: queries are lost": Breakage(queries_lost, Sort.LINK, "sonar"),
    "cable passes one way: commands are lost": Breakage(
        cut(LAB, ("robot",)), Sort.LINK, "do not reach robot"
    ),
    "simulator killed": Breakage(cut(("device",), ("robot",)), Sort.DEVICE, "robot"),
    "controller deaf": Breakage(cut(("robot",), ("device",)), Sort.STALLED, "wheels do not turn"),
    "serial line without permission": Breakage(serial, Sort.DEVICE, "permission denied"),
    "agent of the base killed": Breakage(kill("sonar"), Sort.ABSENT, "sonar"),
    "agent of a host killed": Breakage(kill("goto"), Sort.ABSENT, "goto"),
    "planner killed": Breakage(kill("path-planning"), Sort.ABSENT, "path-planning"),
    "robot agent killed": Breakage(kill("robot"), Sort.ABSENT, "robot"),
    "all agents killed": Breakage(kill(*BASE, *LAB), Sort.ABSENT, "No agent is alive"),
    "agent hung": Breakage(hang("sonar"), Sort.SILENT, "sonar"),
    "planner hung": Breakage(hang("path-planning"), Sort.SILENT, "path-planning"),
    "robot agent hung": Breakage(hang("robot"), Sort.SILENT, "robot"),
    "agent slow": Breakage(thinned, Sort.SLOW, "sonar"),
    "agent of another version": Breakage(card("avoid", version="0.0.1"), Sort.VERSION, "0.0.1"),
    "agent of another protocol": Breakage(
        card("avoid", protocol=PROTOCOL + 1), Sort.VERSION, "protocol"
    ),
    "host of another table": Breakage(
        lambda society: [on_card(society, name, table="89abcdef") for name in LAB],
        Sort.TABLE,
        "89abcdef",
    ),
    "observer of another table": Breakage(
        lambda _: None, Sort.TABLE, "89abcdef", Demand(TABLE, "89abcdef")
    ),
    "two mechanisms for the wheels": Breakage(
        card("avoid", mechanisms=("wheels auction",)), Sort.MIXED, "by auction: avoid"
    ),
    "two robot agents": Breakage(second("robot"), Sort.TWICE, "two robot agents"),
    "two encoders": Breakage(second("encoder"), Sort.TWICE, "encoder/pose"),
    "second simulator": Breakage(
        says(lambda _: Truth(0, 0, 0, 0, 0, 0, 0, None, "stranger")), Sort.TWICE, "stranger"
    ),
    "router unreachable": Breakage(away, Sort.UNREACHABLE, "unreachable"),
    "clock off by a minute": Breakage(clock_off, Sort.CLOCK, "clock 60 s"),
    "agent cannot work": Breakage(
        card("robot", fault="another controller than the profile's"),
        Sort.FAULT,
        "another controller",
    ),
    "agents with different maps": Breakage(
        lambda society: (
            on_card(society, "sonar", world="flat"),
            on_card(society, "avoid", world="hall"),
        ),
        Sort.MAP,
        "flat",
    ),
    "agents with different maps of one name": Breakage(
        lambda society: (
            on_card(society, "sonar", map="01234567"),
            on_card(society, "path-planning", map="89abcdef"),
        ),
        Sort.MAP,
        "path-planning on lab: 89abcdef",
    ),
    "robot lifted: lost": Breakage(says(lost, 0.05), Sort.LOST, "lost"),
    "motors off": Breakage(
        lambda society: society.run.robot.receive(command(Cmd.ENABLE, 0), society.mesh.now),
        Sort.STOP,
        "motors",
    ),
    "stop latched": Breakage(
        lambda society: society.mesh.publish(Stop(1, True, "anna", 5)), Sort.STOP, "anna"
    ),
    "a person's stick": Breakage(
        says(lambda society: TeleopStatus(cycle(society), "anna")), Sort.HAND, "anna"
    ),
    "battery empty": Breakage(
        says(lambda society: BatteryLevel(cycle(society), 10.1, 0.05, 1e4)), Sort.BATTERY, "5 %"
    ),
    "bids that are not numbers": Breakage(
        bids(Bid(0.9, (float("nan"), 0.0))), Sort.UNSOUND, "its bid is invalid"
    ),
    "no free path": Breakage(bids(Bid(0.9, (0.0, 0.0))), Sort.BLOCKED, "no free path"),
    "the monitor misses an agent": Breakage(
        says(lambda _: MonitorReport("monitor-1", 90, True, ("battery",))), Sort.ABSENT, "battery"
    ),
}


@dataclass(frozen=True)
class Shown:
    """What the commands show of one society."""

    findings: tuple[Finding, ...]
    texts: Mapping[str, str]  # by command


def shown(society: Observed, demand: Demand = DEMAND) -> Shown:
    """What each command shows now, by the renderer of each command."""
    view, now = society.view, society.mesh.now
    findings = diagnose(view, demand, now)
    page, mcp = Robot("robot1", demand=demand), Society(None, {}, demand)
    page.view, mcp.view = view, view
    console = Console(width=500)
    with console.capture() as table:
        console.print(top.tables(top.Snapshots(view, "robot1", demand).at(now)))
    why = why_command.explained(view, now, demand, findings)
    texts = {
        "doctor": "\n".join(
            [*(line for f in findings for line in doctor.lines(f)), summary(findings)]
        ),
        "why": "\n".join(why),
        "goto": goto.remark(findings),
        "ps": "\n".join(short(findings)),
        "top": table.get(),
        "page": json.dumps(page.standing(now)),
        "mcp": json.dumps(mcp.why(now)),
    }
    return Shown(findings, texts)
