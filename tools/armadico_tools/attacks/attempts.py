"""The attempts: what a peer sends that knows all that the society has published so far."""

# ruff: noqa: ARG001 - every attempt has the same arguments

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import cbor2

from armadico_tools.attacks.peer import Peer, repeat

BEST: Final = 0.99
STEERS: Final = (0.3, 0.8)
"""An action that no agent orders on the straight way: m/s, rad/s."""

JUMP: Final = 2**32
LARGEST: Final = 2**52 - 1
DRIVES, STOPPED, RESTS = "drives", "stopped", "rests"
"""The state of the robot in which an attempt is made."""

Values = list[object]


@dataclass
class Known:
    """What an observer of the society knows, for the attacker to use.

    Attributes:
        cycle: The robot's newest.
        ballot: The holder's; its last field is the holder's instance.
        counter, press: Of the newest stop.
        mission: The counter and the mission's number of the newest trajectory.
        origin: The newest message with the odometry's origin.
        alive: The instances of the agents by name.
        tape: Messages of an earlier day: time (s), key and payload.
        state: The robot's newest state.
        me: The member whose key the attacker has; "" without one.
    """

    cycle: Values = field(default_factory=lambda: [0, 0])
    ballot: Values = field(default_factory=lambda: [0, 0.0, False, ""])
    counter: int = 0
    press: int = 0
    mission: tuple[int, int] = (0, 0)
    origin: Values = field(default_factory=list)
    alive: dict[str, str] = field(default_factory=dict)
    tape: list[tuple[float, str, bytes]] = field(default_factory=list)
    state: Values = field(default_factory=list)
    description: Values = field(default_factory=list)
    person: str = "person-anna-0123456789abcdef"
    me: str = ""

    @property
    def holder(self) -> str:
        return str(self.ballot[3])

    def instance(self, name: str) -> str:
        return self.alive.get(name, f"{name}-0123456789abcdef")

    @property
    def term(self) -> int:
        assert isinstance(self.ballot[0], int)
        return self.ballot[0]

    def ahead(self, cycles: int = 0) -> Values:
        epoch, number = self.cycle
        assert isinstance(number, int)
        return [epoch, number + cycles]

    def beyond(self, counter: int) -> int:
        return (counter + 1) % (LARGEST + 1)


Act = Callable[[Peer, Known, float], None]


@dataclass(frozen=True)
class Attempt:
    """One row of the table. `act` lasts the given time (s)."""

    name: str
    state: str
    text: str
    act: Act


ATTEMPTS: Final[dict[str, Attempt]] = {}


def attempt(name: str, state: str, text: str) -> Callable[[Act], Act]:
    def keep(act: Act) -> Act:
        ATTEMPTS[name] = Attempt(name, state, text, act)
        return act

    return keep


def _me(k: Known) -> str:
    """An instance of the member that it is, or of a stranger."""
    return _own(k.me.partition("+")[0] or "stranger")


def _own(prefix: str) -> str:
    return f"{prefix}-{secrets.randbits(64):016x}"


def _names(k: Known, own: str, *more: str) -> list[str]:
    """Instances under which a message may be published: its own, others', and none."""
    others = (k.holder, k.instance("interface"), k.instance("avoid"), k.instance("robot"))
    return list(dict.fromkeys((own, *others, k.person, *more)))


def _latched(k: Known, key: str, own: str) -> list[str]:
    """The keys on which a latched state may come: of all publishers, shared, and repeated."""
    names = _names(k, own)
    return [key, *(f"{key}/{n}" for n in names), *(f"repeat/{n}" for n in names)]


def _drive(p: Peer, k: Known, ballot: Values, instance: str) -> None:
    claim = ["wheels", ballot, k.cycle, BEST, False, list(STEERS), list(STEERS)]
    command = ["wheels", k.cycle, ballot, list(STEERS)]
    for part in (f"/{instance}", ""):
        p.put(f"resource/wheels/utility{part}", *claim)
        p.put(f"robot/cmd{part}", *command)
        p.put(f"resource/wheels/cmd{part}", *command)


@attempt("nothing", DRIVES, "send nothing, to see what the machine's load does")
def _nothing(p: Peer, k: Known, seconds: float) -> None:
    time.sleep(seconds)


# Reading and driving ------------------------------------------------------------------------------


@attempt("listen", DRIVES, "subscribe to everything")
def _listen(p: Peer, k: Known, seconds: float) -> None:
    p.listen("**")
    time.sleep(seconds)


@attempt("contend", DRIVES, "claim and command in its own name, with the best bid")
def _contend(p: Peer, k: Known, seconds: float) -> None:
    own = _me(k)
    token = p.token(f"agent/{own[:-17]}/{own}")
    term = k.term
    repeat(seconds, 40, lambda _: _drive(p, k, [max(term, k.term) + 1, BEST, True, own], own))
    del token


@attempt("drive-as-holder", DRIVES, "command on the holder's key with the holder's ballot")
def _as_holder(p: Peer, k: Known, seconds: float) -> None:
    repeat(seconds, 60, lambda _: _drive(p, k, k.ballot, k.holder))


@attempt("drive-as-other", DRIVES, "claim and command in another contender's name")
def _as_other(p: Peer, k: Known, seconds: float) -> None:
    others = [name for name in ("avoid", "gothrough", "goto") if name != k.me]

    def act(number: int) -> None:
        name = k.instance(others[number % len(others)])
        _drive(p, k, [k.term + 1, BEST, True, name], name)

    repeat(seconds, 30, act)


@attempt("release-as-holder", DRIVES, "release the wheels in the holder's name")
def _release_wheels(p: Peer, k: Known, seconds: float) -> None:
    def act(_: int) -> None:
        for part in (f"/{k.holder}", ""):
            p.put(f"robot/cmd{part}", "wheels", k.cycle, k.ballot, None)
            p.put(f"resource/wheels/utility{part}", "wheels", k.ballot, k.cycle, None)

    repeat(seconds, 10, act)


@attempt("stick", DRIVES, "drive by hand")
def _stick(p: Peer, k: Known, seconds: float) -> None:
    own = _me(k)
    repeat(seconds, 20, lambda n: p.put(f"teleop/stick/{own}", k.cycle, own, n + 1, 0.3, 0.8, True))


@attempt("goal", RESTS, "request a mission")
def _goal(p: Peer, k: Known, seconds: float) -> None:
    p.ask("mission/request", [5.0, 3.0, 0.0], [], False, within=1.0)
    for key in ("mission/order", "explore/request"):
        p.ask(key, *(["m", "go to 3 3", 0.5, "x"] if key == "mission/order" else [0, 0, 3, 3]))
    time.sleep(max(seconds - 2.0, 0.0))


@attempt("trajectory", RESTS, "publish a path to drive")
def _trajectory(p: Peer, k: Known, seconds: float) -> None:
    own = _me(k)
    counter = k.beyond(k.mission[0])
    way = [[4.0, 3.0, 0.0]]
    values = [counter, secrets.randbits(40), way]
    repeat(seconds, 4, lambda _: p.put_all(_latched(k, "trajectory", own), *values))


@attempt("drive-at-rest", RESTS, "command a robot that has no mission")
def _at_rest(p: Peer, k: Known, seconds: float) -> None:
    own = k.instance("goto")
    repeat(seconds, 40, lambda _: _drive(p, k, [k.term + 1, BEST, False, own], own))


# The emergency stop -------------------------------------------------------------------------------


@attempt("stop", DRIVES, "press the emergency stop")
def _stop(p: Peer, k: Known, seconds: float) -> None:
    own, press = _me(k), secrets.randbits(63)

    def act(_: int) -> None:
        p.put_all(_latched(k, "robot/stop", own), k.beyond(k.counter), True, "stranger", press)

    repeat(seconds, 10, act)


@attempt("release", STOPPED, "release a person's emergency stop")
def _release(p: Peer, k: Known, seconds: float) -> None:
    own = _me(k)

    def act(number: int) -> None:
        counter = k.beyond(k.counter + number % 3)
        for key in (*_latched(k, "robot/stop", own), *_latched(k, "robot/release", own)):
            p.put(key, counter, False, "stranger", k.press)

    repeat(seconds, 10, act)


@attempt("release-by-state", STOPPED, "publish states of the robot that show no stop")
def _release_by_state(p: Peer, k: Known, seconds: float) -> None:
    def act(number: int) -> None:
        state = list(k.state)
        state[0] = k.ahead(number % 2)
        state[9] = [k.beyond(k.counter), False, "stranger", k.press]
        p.put("robot/state", *state)

    repeat(seconds, 20, act)


@attempt("release-large", STOPPED, "release with counters far ahead, in rising steps")
def _release_large(p: Peer, k: Known, seconds: float) -> None:
    own = _me(k)

    def act(number: int) -> None:
        counter = (k.counter + (number + 1) * (JUMP - 1)) % (LARGEST + 1)
        for key in (*_latched(k, "robot/stop", own), *_latched(k, "robot/release", own)):
            p.put(key, counter, False, "stranger", k.press)

    repeat(seconds, 10, act)


@attempt("drive-stopped", STOPPED, "command a robot that is stopped")
def _drive_stopped(p: Peer, k: Known, seconds: float) -> None:
    own = k.instance("goto")
    repeat(seconds, 40, lambda _: _drive(p, k, [k.term + 1, BEST, True, own], own))


# Tokens, cards and replies ------------------------------------------------------------------------


@attempt("tokens", DRIVES, "2,000 forged tokens")
def _tokens(p: Peer, k: Known, seconds: float) -> None:
    names = ("goto", "avoid", "robot", "sonar", "stranger")
    began = time.monotonic()
    kept = [p.token(f"agent/{names[n % 5]}/{_own(names[n % 5])}") for n in range(2000)]
    time.sleep(max(began + seconds - time.monotonic(), 0.1))
    del kept


@attempt("drop-tokens", DRIVES, "declare and drop the tokens of the agents that are there")
def _drop(p: Peer, k: Known, seconds: float) -> None:
    def act(_: int) -> None:
        for name, instance in list(k.alive.items()):
            token = p.token(f"agent/{name}/{instance}")
            token.undeclare()  # type: ignore[no-untyped-call]

    repeat(seconds, 10, act)


@attempt("router-token", DRIVES, "declare and drop tokens of routers")
def _router(p: Peer, k: Known, seconds: float) -> None:
    def act(_: int) -> None:
        token = p.token(f"router/{secrets.randbits(128):032x}")
        token.undeclare()  # type: ignore[no-untyped-call]

    repeat(seconds, 10, act)


@attempt("cards", DRIVES, "answer for all cards, with another protocol")
def _cards(p: Peer, k: Known, seconds: float) -> None:
    def reply(_: str) -> tuple[str, Values] | None:
        name, instance = next(iter(k.alive.items()), ("goto", k.holder))
        return f"agent/{name}/{instance}/card", [name, instance, "x", 1, "0", 99, [], [], []]

    p.answer("agent/*/*/card", reply)
    for name, instance in k.alive.items():
        p.answer(f"agent/{name}/{instance}/card", reply)
    kept = [p.token(f"agent/{n}/{_own(n)}") for n in k.alive]
    time.sleep(seconds)
    del kept


@attempt("replies", DRIVES, "answer the society's other queries: plans, bids, parameters")
def _replies(p: Peer, k: Known, seconds: float) -> None:
    for pattern in ("path/plan", "agent/*/*/bids", "agent/*/*/parameters", "mission/request", "**"):
        p.answer(pattern, lambda key: (key, [[[9.0, 9.0, 0.0]], ""]) if "*" not in key else None)
    time.sleep(seconds)


# States of others ---------------------------------------------------------------------------------


@attempt("end-mission", DRIVES, "publish a path without waypoints")
def _end_mission(p: Peer, k: Known, seconds: float) -> None:
    own = _me(k)

    def act(number: int) -> None:
        counter, mission = k.mission
        p.put_all(_latched(k, "trajectory", own), k.beyond(counter), mission + number % 2, [])

    repeat(seconds, 5, act)


@attempt("origin", DRIVES, "shift the odometry's origin by 5 m")
def _origin(p: Peer, k: Known, seconds: float) -> None:
    if not k.origin:
        return
    own = _me(k)

    def act(number: int) -> None:
        origin = list(k.origin)
        assert isinstance(origin[0], int)
        origin[0], origin[1] = origin[0] + number + 1, secrets.randbits(63)
        origin[4] = 5.0
        p.put_all(_latched(k, "encoder/origin", own), *origin)
        p.put_all([f"encoder/initial/{n}" for n in _names(k, own)], 0.0, 5.0, 1.5)

    repeat(seconds, 5, act)


@attempt("pose", DRIVES, "publish poses and corrections that are wrong")
def _pose(p: Peer, k: Known, seconds: float) -> None:
    flat = [0.001] * 9

    def act(_: int) -> None:
        p.put("encoder/pose", k.ahead(1), 2.0, 4.0, 1.5, [], 0)
        p.put("localization/correction", k.ahead(1), 2.0, 4.0, 1.5, flat, 1.0, False, 0)

    repeat(seconds, 20, act)


@attempt("obstacles", DRIVES, "publish a wall in front of the robot")
def _obstacles(p: Peer, k: Known, seconds: float) -> None:
    wall = [[0.35, y / 10] for y in range(-4, 5)]
    near = [0.35, 0.0]

    def act(_: int) -> None:
        for name in ("sonar", "laser", "stranger"):
            p.put(f"{name}/obstacles", k.ahead(), near, near, None, None, wall)
        p.put("robot/sonar", k.ahead(), 5.0, [[0.2, 0.0, 0.0, 0.2]])

    repeat(seconds, 20, act)


@attempt("states", DRIVES, "publish states of the robot: strays, other epochs, cycles ahead")
def _states(p: Peer, k: Known, seconds: float) -> None:
    other = secrets.randbits(62)

    def act(number: int) -> None:
        state = list(k.state)
        for cycle in (k.ahead(3), k.ahead(1 + number % 4), [other, number], k.ahead(10_000)):
            state[0] = cycle
            p.put("robot/state", *state)

    repeat(seconds, 20, act)


@attempt("acks", DRIVES, "publish acknowledgements that the largest term is 2^52")
def _acks(p: Peer, k: Known, seconds: float) -> None:
    top: Values = [LARGEST, 1.0, True, _own("goto")]

    def act(number: int) -> None:
        near: Values = [k.term + JUMP * (number % 3), 1.0, True, _own("goto")]
        p.put("resource/wheels/ack", "wheels", k.ahead(1), top if number % 2 else near)

    repeat(seconds, 20, act)


@attempt("ballots", DRIVES, "claims with terms of 2^52, and in rising steps of 2^32")
def _ballots(p: Peer, k: Known, seconds: float) -> None:
    own = _own("goto")

    def act(number: int) -> None:
        for term in (LARGEST, k.term + JUMP, k.term + number * JUMP):
            for name in (own, k.holder, k.instance("avoid")):
                ballot: Values = [min(term, LARGEST), 1.0, True, name]
                claim = ["wheels", ballot, k.cycle, 1.0, True, [0.0, 0.0], [0.0, 0.0]]
                p.put(f"resource/wheels/utility/{name}", *claim)
                p.put("resource/wheels/utility", *claim)
                p.put(f"robot/cmd/{name}", "wheels", k.cycle, ballot, [0.0, 0.0])

    repeat(seconds, 20, act)


@attempt("description", DRIVES, "describe the robot as a slow one")
def _description(p: Peer, k: Known, seconds: float) -> None:
    if not k.description:
        return
    slow = list(k.description)
    slow[5] = slow[6] = 0.02
    repeat(seconds, 10, lambda _: p.put("robot/description", *slow))


@attempt("tuning", DRIVES, "change the parameters of agents, by the latched state and by query")
def _tuning(p: Peer, k: Known, seconds: float) -> None:
    own = _me(k)
    setting = ["v_max", "0.05"]
    settings = [[name, setting] for name in ("goto", "robot")]
    for name, instance in k.alive.items():
        p.ask(f"agent/{name}/{instance}/parameters", [setting], "stranger", within=0.2)
    values = [k.beyond(1), secrets.randbits(63), settings]
    repeat(seconds, 5, lambda _: p.put_all(_latched(k, "tuning", own), *values))


@attempt("boards", DRIVES, "publish boards of missions and tasks")
def _boards(p: Peer, k: Known, seconds: float) -> None:
    own = _me(k)

    def act(number: int) -> None:
        p.put_all(_latched(k, "mission/board", own), number + 9, 1, [], [], False)
        p.put_all(_latched(k, "tasks/board", own), number + 9, 1, 0, [], [], 0)
        p.put("mission/status", 0, "reached", 0.0, 0, "", 0, 0.0, 0.0)

    repeat(seconds, 5, act)


@attempt("orders", DRIVES, "order launchers to end agents, and cancel missions, by query")
def _orders(p: Peer, k: Known, seconds: float) -> None:
    for order in ("stop", "restart", "kill", "start"):
        for name in ("goto", "robot"):
            p.ask("wakeup/*", order, name, 0, "stranger", within=0.2)
    p.ask("mission/cancel", 0, "stranger", within=0.2)
    p.ask("mission/request", None, within=0.2)
    monitors = [i for n, i in k.alive.items() if n in ("monitor", "wakeup")]

    def act(_: int) -> None:
        for own in (*monitors, _own("monitor")):
            report = [own, 0, True, ["goto", "robot"], "stranger", []]
            p.put(f"monitor/{own}", *report)

    repeat(max(seconds - 2.0, 0.5), 5, act)


@attempt("log", DRIVES, "write lines into the log in another's name")
def _log(p: Peer, k: Known, seconds: float) -> None:
    repeat(seconds, 5, lambda _: p.put(f"log/{k.instance('robot')}", 40, "FORGED: on fire", ""))


# Keys, payloads and floods ------------------------------------------------------------------------


@attempt("wildcards", DRIVES, "publish on key expressions instead of keys")
def _wildcards(p: Peer, k: Known, seconds: float) -> None:
    press = secrets.randbits(63)
    expressions = ("**", "robot/**", "robot/cmd/*", "robot/*/*", "robot/cmd/go$*", "robot/st$*/**")

    def act(_: int) -> None:
        for key in expressions:
            p.put(key, "wheels", k.cycle, k.ballot, list(STEERS))
            p.put(key, "wheels", k.ballot, k.cycle, None)
            p.put(key, k.beyond(k.counter), True, "stranger", press)

    repeat(seconds, 20, act)


@attempt("deletes", DRIVES, "delete keys")
def _deletes(p: Peer, k: Known, seconds: float) -> None:
    keys = ("**", "robot/**", "robot/state", f"robot/cmd/{k.holder}", "resource/wheels/ack")

    def act(_: int) -> None:
        for key in keys:
            p.delete(key)

    repeat(seconds, 20, act)


@attempt("malformed", DRIVES, "NaN, wrong shapes, tags, deep nesting and 70 kB on each key")
def _malformed(p: Peer, k: Known, seconds: float) -> None:
    nan, inf = float("nan"), float("inf")
    deep = b"\x81" * 5000 + b"\x00"
    tagged = b"\xc4\x82\x3a\x00\x0f\x42\x3f\xc2\x5a\x00\x00\xff\xff" + b"\xff" * 65535
    payloads = (b"", b"\xff", deep, tagged, bytes(70_000), cbor2.dumps([nan] * 12))
    keys = (
        *(f"robot/cmd/{k.holder}", f"resource/wheels/utility/{k.holder}", "resource/wheels/ack"),
        *("robot/state", "robot/sonar", "encoder/pose", "sonar/obstacles", "trajectory/x"),
        *("robot/stop/x", "tuning/x", "log/x", "mission/status"),
    )

    def act(_: int) -> None:
        for key in keys:
            for payload in payloads:
                p.put_bytes(key, payload)
        p.put(f"robot/cmd/{k.holder}", "wheels", k.cycle, k.ballot, [nan, inf])
        p.put(f"robot/cmd/{k.holder}", "wheels", k.cycle, k.ballot, [1e9, -1e9])

    repeat(seconds, 4, act)


@attempt("flood", DRIVES, "10,000 messages a second on the keys of the drive")
def _flood(p: Peer, k: Known, seconds: float) -> None:
    own = _own("goto")
    small = cbor2.dumps(["wheels", k.cycle, [1, 0.1, False, own], [0.0, 0.0]])
    keys = (
        *(f"robot/cmd/{k.holder}", f"robot/cmd/{own}", f"resource/wheels/utility/{own}"),
        *(
            "sonar/obstacles",
            "robot/state",
            f"log/{own}",
            f"robot/stop/{own}",
            "resource/wheels/ack",
        ),
    )
    repeat(seconds, 1250, lambda _: p.put_bytes_all(keys, small))


@attempt("flood-large", DRIVES, "64 KiB messages, 500 a second")
def _flood_large(p: Peer, k: Known, seconds: float) -> None:
    points = [[40.0, y / 100] for y in range(3400)]
    large = cbor2.dumps([k.cycle, None, None, None, None, points])[:65_536]
    keys = ("sonar/obstacles", "robot/state", f"robot/cmd/{k.holder}", "stranger/obstacles", "x")
    repeat(seconds, 100, lambda _: p.put_bytes_all(keys, large))


@attempt("queries", DRIVES, "1,000 queries a second for everything")
def _queries(p: Peer, k: Known, seconds: float) -> None:
    began = time.monotonic()
    while time.monotonic() < began + seconds:
        p.ask("agent/*/*/card", within=0.05)
        p.ask("**", within=0.05)


# Replays ------------------------------------------------------------------------------------------


def _replay(p: Peer, k: Known, seconds: float, speed: float) -> None:
    if not k.tape:
        return
    began, first = time.monotonic(), k.tape[0][0]
    while time.monotonic() < began + seconds:
        turn = time.monotonic()
        for at, key, data in k.tape:
            wait = turn + (at - first) / speed - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            if time.monotonic() > began + seconds:
                return
            p.put_bytes(key, data)


@attempt("replay", DRIVES, "play a recording of an earlier day while the robot drives")
def _replay_driving(p: Peer, k: Known, seconds: float) -> None:
    _replay(p, k, seconds, 1.0)


@attempt("replay-100x", DRIVES, "the same at 100 times the speed")
def _replay_fast(p: Peer, k: Known, seconds: float) -> None:
    _replay(p, k, seconds, 100.0)


@attempt("replay-at-rest", RESTS, "play it to a robot without a mission")
def _replay_rest(p: Peer, k: Known, seconds: float) -> None:
    _replay(p, k, seconds / 2, 1.0)
    _replay(p, k, seconds / 2, 100.0)


@attempt("replay-stopped", STOPPED, "play it, with a release of a stop, to a stopped robot")
def _replay_stopped(p: Peer, k: Known, seconds: float) -> None:
    _replay(p, k, seconds / 2, 1.0)
    _replay(p, k, seconds / 2, 100.0)
