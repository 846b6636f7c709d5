"""The attempts: what a peer sends that knows all that the society has published so far.

Each is a function that is called with 0, 1, 2 and so on until its time is over.
"""

# ruff: noqa: ARG001 - every attempt has the same arguments

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import cbor2

from armadico_tools.attacks.peer import Peer

BEST: Final = 0.99
STEERS: Final = (0.3, 0.8)
"""An action that no agent orders on the straight way: m/s, rad/s."""

JUMP: Final = 2**32
LARGEST: Final = 2**52 - 1
POINTS: Final = [[40.0, y / 100] for y in range(3400)]
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
        drawn: A random number, the same during an attempt.
        seconds: How long an attempt lasts.
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
    drawn: int = 0
    seconds: float = 0.0

    @property
    def holder(self) -> str:
        return str(self.ballot[3])

    @property
    def own(self) -> str:
        """An instance of the member that it is, or of a stranger."""
        return self.forged(self.me.partition("+")[0] or "stranger")

    def forged(self, name: str) -> str:
        """An instance of an agent that does not exist."""
        return f"{name}-{self.drawn:016x}"

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

    def names(self) -> list[str]:
        """Instances under which a message may be published: its own, and others'."""
        others = (self.holder, *map(self.instance, ("interface", "avoid", "robot")), self.person)
        return list(dict.fromkeys((self.own, *others)))

    def latched(self, *keys: str) -> list[str]:
        """The keys on which latched states may come: of all publishers, shared, and repeated."""
        names = self.names()
        repeated = [f"repeat/{name}" for name in names]
        return [*keys, *(f"{key}/{name}" for key in keys for name in names), *repeated]


Act = Callable[[Peer, Known, int], None]


@dataclass(frozen=True)
class Attempt:
    """One row of the table. `act` is called `hertz` times a second; 0: once."""

    name: str
    state: str
    text: str
    hertz: float
    act: Act

    def make(self, p: Peer, k: Known, seconds: float) -> None:
        """Make it for a duration, s; its tokens end with it."""
        k.drawn, k.seconds = secrets.randbits(40), seconds
        began, number = time.monotonic(), 0
        end = began + seconds
        while number == 0 or (self.hertz and time.monotonic() < end):
            self.act(p, k, number)
            number += 1
            due = began + number / self.hertz if self.hertz else end
            time.sleep(max(due - time.monotonic(), 0.0))
        p.drop_tokens()


ATTEMPTS: Final[dict[str, Attempt]] = {}


def attempt(state: str, text: str, *, hertz: float = 0.0) -> Callable[[Act], Act]:
    """Add a function to `ATTEMPTS`."""

    def keep(act: Act) -> Act:
        name = act.__name__.replace("_", "-")
        ATTEMPTS[name] = Attempt(name, state, text, hertz, act)
        return act

    return keep


def _drive(p: Peer, k: Known, instance: str, ballot: Values | None = None) -> None:
    ballot = ballot or [k.term + 1, BEST, True, instance]
    claim = ["wheels", ballot, k.cycle, BEST, False, list(STEERS), list(STEERS)]
    p.put(_of("resource/wheels/utility", instance), *claim)
    commands = _of("robot/cmd", instance) + _of("resource/wheels/cmd", instance)
    p.put(commands, "wheels", k.cycle, ballot, list(STEERS))


def _of(key: str, instance: str) -> list[str]:
    """The key of an instance, and the one that all shared in protocol 2."""
    return [f"{key}/{instance}", key]


def _token(instance: str) -> str:
    return f"agent/{instance.rpartition('-')[0]}/{instance}"


@attempt(DRIVES, "send nothing, to see what the machine's load does")
def nothing(p: Peer, k: Known, n: int) -> None:
    pass


# Reading and driving ------------------------------------------------------------------------------


@attempt(DRIVES, "subscribe to everything")
def listen(p: Peer, k: Known, n: int) -> None:
    p.listen("**")


@attempt(DRIVES, "claim and command in its own name, with the best bid", hertz=40)
def contend(p: Peer, k: Known, n: int) -> None:
    if n == 0:
        p.token(_token(k.own))
    _drive(p, k, k.own)


@attempt(DRIVES, "command on the holder's key with the holder's ballot", hertz=60)
def drive_as_holder(p: Peer, k: Known, n: int) -> None:
    _drive(p, k, k.holder, k.ballot)


@attempt(DRIVES, "claim and command in another contender's name", hertz=30)
def drive_as_other(p: Peer, k: Known, n: int) -> None:
    others = [name for name in ("avoid", "gothrough", "goto") if name != k.me]
    _drive(p, k, k.instance(others[n % len(others)]))


@attempt(DRIVES, "release the wheels in the holder's name", hertz=10)
def release_as_holder(p: Peer, k: Known, n: int) -> None:
    p.put(_of("robot/cmd", k.holder), "wheels", k.cycle, k.ballot, None)
    p.put(_of("resource/wheels/utility", k.holder), "wheels", k.ballot, k.cycle, None)


@attempt(DRIVES, "drive by hand", hertz=20)
def stick(p: Peer, k: Known, n: int) -> None:
    p.put(f"teleop/stick/{k.own}", k.cycle, k.own, n + 1, 0.3, 0.8, True)


@attempt(RESTS, "request a mission")
def goal(p: Peer, k: Known, n: int) -> None:
    p.ask("mission/request", [5.0, 3.0, 0.0], [], False, within=1.0)
    p.ask("mission/order", "m", "go to 3 3", 0.5, "x")
    p.ask("explore/request", 0, 0, 3, 3)


@attempt(RESTS, "publish a path to drive", hertz=4)
def trajectory(p: Peer, k: Known, n: int) -> None:
    p.put(k.latched("trajectory"), k.beyond(k.mission[0]), k.drawn, [[4.0, 3.0, 0.0]])


@attempt(RESTS, "command a robot that has no mission", hertz=40)
def drive_at_rest(p: Peer, k: Known, n: int) -> None:
    own = k.instance("goto")
    _drive(p, k, own, [k.term + 1, BEST, False, own])


# The emergency stop -------------------------------------------------------------------------------


@attempt(DRIVES, "press the emergency stop", hertz=10)
def stop(p: Peer, k: Known, n: int) -> None:
    p.put(k.latched("robot/stop"), k.beyond(k.counter), True, "stranger", k.drawn)


@attempt(STOPPED, "release a person's emergency stop", hertz=10)
def release(p: Peer, k: Known, n: int) -> None:
    _release(p, k, k.beyond(k.counter + n % 3))


@attempt(STOPPED, "publish states of the robot that show no stop", hertz=20)
def release_by_state(p: Peer, k: Known, n: int) -> None:
    state = list(k.state)
    state[0] = k.ahead(n % 2)
    state[9] = [k.beyond(k.counter), False, "stranger", k.press]
    p.put("robot/state", *state)


@attempt(STOPPED, "release with counters far ahead, in rising steps", hertz=10)
def release_large(p: Peer, k: Known, n: int) -> None:
    _release(p, k, (k.counter + (n + 1) * (JUMP - 1)) % (LARGEST + 1))


def _release(p: Peer, k: Known, counter: int) -> None:
    p.put(k.latched("robot/stop", "robot/release"), counter, False, "stranger", k.press)


@attempt(STOPPED, "command a robot that is stopped", hertz=40)
def drive_stopped(p: Peer, k: Known, n: int) -> None:
    _drive(p, k, k.instance("goto"))


# Tokens, cards and replies ------------------------------------------------------------------------


@attempt(DRIVES, "2,000 forged tokens")
def tokens(p: Peer, k: Known, n: int) -> None:
    names = ("goto", "avoid", "robot", "sonar", "stranger")
    for number in range(2000):
        p.token(_token(f"{names[number % 5]}-{secrets.randbits(64):016x}"))


@attempt(DRIVES, "declare and drop the tokens of the agents that are there", hertz=10)
def drop_tokens(p: Peer, k: Known, n: int) -> None:
    for instance in k.alive.values():
        p.token(_token(instance))
        p.drop_tokens()


@attempt(DRIVES, "declare and drop tokens of routers", hertz=10)
def router_token(p: Peer, k: Known, n: int) -> None:
    p.token(f"router/{secrets.randbits(128):032x}")
    p.drop_tokens()


@attempt(DRIVES, "answer for all cards, with another protocol")
def cards(p: Peer, k: Known, n: int) -> None:
    name, instance = next(iter(k.alive.items()), ("goto", k.holder))
    card: Values = [name, instance, "x", 1, "0", 99, [], [], []]
    for each in ("*/*", *(f"{agent}/{one}" for agent, one in k.alive.items())):
        p.answer(f"agent/{each}/card", lambda _: (f"agent/{name}/{instance}/card", card))
    for agent in k.alive:
        p.token(_token(k.forged(agent)))


@attempt(DRIVES, "answer the society's other queries: plans, bids, parameters")
def replies(p: Peer, k: Known, n: int) -> None:
    for pattern in ("path/plan", "agent/*/*/bids", "agent/*/*/parameters", "mission/request", "**"):
        p.answer(pattern, lambda key: (key, [[[9.0, 9.0, 0.0]], ""]) if "*" not in key else None)


# States of others ---------------------------------------------------------------------------------


@attempt(DRIVES, "publish a path without waypoints", hertz=5)
def end_mission(p: Peer, k: Known, n: int) -> None:
    counter, mission = k.mission
    p.put(k.latched("trajectory"), k.beyond(counter), mission + n % 2, [])


@attempt(DRIVES, "shift the odometry's origin by 5 m", hertz=5)
def origin(p: Peer, k: Known, n: int) -> None:
    if k.origin:
        number, _, *more = k.origin
        assert isinstance(number, int)
        more[2] = 5.0
        p.put(k.latched("encoder/origin"), number + n + 1, secrets.randbits(63), *more)
        p.put([f"encoder/initial/{name}" for name in k.names()], 0.0, 5.0, 1.5)


@attempt(DRIVES, "publish poses and corrections that are wrong", hertz=20)
def pose(p: Peer, k: Known, n: int) -> None:
    p.put("encoder/pose", k.ahead(1), 2.0, 4.0, 1.5, [], 0)
    p.put("localization/correction", k.ahead(1), 2.0, 4.0, 1.5, [0.001] * 9, 1.0, False, 0)


@attempt(DRIVES, "publish a wall in front of the robot", hertz=20)
def obstacles(p: Peer, k: Known, n: int) -> None:
    near, wall = [0.35, 0.0], [[0.35, y / 10] for y in range(-4, 5)]
    keys = [f"{name}/obstacles" for name in ("sonar", "laser", "stranger")]
    p.put(keys, k.ahead(), near, near, None, None, wall)
    p.put("robot/sonar", k.ahead(), 5.0, [[0.2, 0.0, 0.0, 0.2]])


@attempt(DRIVES, "publish states of the robot: strays, other epochs, cycles ahead", hertz=20)
def states(p: Peer, k: Known, n: int) -> None:
    _, *more = k.state
    for cycle in (k.ahead(3), k.ahead(1 + n % 4), [k.drawn, n], k.ahead(10_000)):
        p.put("robot/state", cycle, *more)


@attempt(DRIVES, "publish acknowledgements that the largest term is 2^52", hertz=20)
def acks(p: Peer, k: Known, n: int) -> None:
    term = LARGEST if n % 2 else k.term + JUMP * (n % 3)
    p.put("resource/wheels/ack", "wheels", k.ahead(1), [term, 1.0, True, k.forged("goto")])


@attempt(DRIVES, "claims with terms of 2^52, and in rising steps of 2^32", hertz=20)
def ballots(p: Peer, k: Known, n: int) -> None:
    rest = [0.0, 0.0]
    for term in (LARGEST, k.term + JUMP, k.term + n * JUMP):
        for name in (k.forged("goto"), k.holder, k.instance("avoid")):
            ballot: Values = [min(term, LARGEST), 1.0, True, name]
            claims = _of("resource/wheels/utility", name)
            p.put(claims, "wheels", ballot, k.cycle, 1.0, True, rest, rest)
            p.put(f"robot/cmd/{name}", "wheels", k.cycle, ballot, rest)


@attempt(DRIVES, "describe the robot as a slow one", hertz=10)
def description(p: Peer, k: Known, n: int) -> None:
    if k.description:
        slow = list(k.description)
        slow[5] = slow[6] = 0.02
        p.put("robot/description", *slow)


@attempt(DRIVES, "change the parameters of agents, by the latched state and by query", hertz=5)
def tuning(p: Peer, k: Known, n: int) -> None:
    setting = ["v_max", "0.05"]
    for name, instance in k.alive.items() if n == 0 else ():
        p.ask(f"agent/{name}/{instance}/parameters", [setting], "stranger", within=0.2)
    settings = [[name, setting] for name in ("goto", "robot")]
    p.put(k.latched("tuning"), k.beyond(1), k.drawn, settings)


@attempt(DRIVES, "publish boards of missions and tasks", hertz=5)
def boards(p: Peer, k: Known, n: int) -> None:
    p.put(k.latched("mission/board"), n + 9, 1, [], [], False)
    p.put(k.latched("tasks/board"), n + 9, 1, 0, [], [], 0)
    p.put("mission/status", 0, "reached", 0.0, 0, "", 0, 0.0, 0.0)


@attempt(DRIVES, "order launchers to end agents, and cancel missions, by query", hertz=5)
def orders(p: Peer, k: Known, n: int) -> None:
    if n == 0:
        for order in ("stop", "restart", "kill", "start"):
            for name in ("goto", "robot"):
                p.ask("wakeup/*", order, name, 0, "stranger", within=0.2)
        p.ask("mission/cancel", 0, "stranger", within=0.2)
        p.ask("mission/request", None, within=0.2)
    for own in (*map(k.instance, {"monitor", "wakeup"} & {*k.alive}), k.forged("monitor")):
        p.put(f"monitor/{own}", own, 0, True, ["goto", "robot"], "stranger", [])


@attempt(DRIVES, "write lines into the log in another's name", hertz=5)
def log(p: Peer, k: Known, n: int) -> None:
    p.put(f"log/{k.instance('robot')}", 40, "FORGED: on fire", "")


# Keys, payloads and floods ------------------------------------------------------------------------


@attempt(DRIVES, "publish on key expressions instead of keys", hertz=20)
def wildcards(p: Peer, k: Known, n: int) -> None:
    for key in ("**", "robot/**", "robot/cmd/*", "robot/*/*", "robot/cmd/go$*", "robot/st$*/**"):
        p.put(key, "wheels", k.cycle, k.ballot, list(STEERS))
        p.put(key, "wheels", k.ballot, k.cycle, None)
        p.put(key, k.beyond(k.counter), True, "stranger", k.drawn)


@attempt(DRIVES, "delete keys", hertz=20)
def deletes(p: Peer, k: Known, n: int) -> None:
    p.delete("**", "robot/**", "robot/state", f"robot/cmd/{k.holder}", "resource/wheels/ack")


@attempt(DRIVES, "NaN, wrong shapes, tags, deep nesting and 70 kB on each key", hertz=4)
def malformed(p: Peer, k: Known, n: int) -> None:
    nan, inf = float("nan"), float("inf")
    deep = b"\x81" * 5000 + b"\x00"
    tagged = b"\xc4\x82\x3a\x00\x0f\x42\x3f\xc2\x5a\x00\x00\xff\xff" + b"\xff" * 65535
    command = f"robot/cmd/{k.holder}"
    keys = (
        *(command, f"resource/wheels/utility/{k.holder}", "resource/wheels/ack", "robot/state"),
        *("robot/sonar", "encoder/pose", "sonar/obstacles", "trajectory/x", "robot/stop/x"),
        *("tuning/x", "log/x", "mission/status"),
    )
    for payload in (b"", b"\xff", deep, tagged, bytes(70_000), cbor2.dumps([nan] * 12)):
        p.put_bytes(keys, payload)
    for action in ([nan, inf], [1e9, -1e9]):
        p.put(command, "wheels", k.cycle, k.ballot, action)


@attempt(DRIVES, "10,000 messages a second on the keys of the drive", hertz=1250)
def flood(p: Peer, k: Known, n: int) -> None:
    own = k.forged("goto")
    keys = (
        *(f"robot/cmd/{k.holder}", f"robot/cmd/{own}", f"resource/wheels/utility/{own}"),
        *("sonar/obstacles", "robot/state", f"log/{own}", f"robot/stop/{own}"),
        "resource/wheels/ack",
    )
    p.put(keys, "wheels", k.cycle, [1, 0.1, False, own], [0.0, 0.0])


@attempt(DRIVES, "64 KiB messages, 500 a second", hertz=100)
def flood_large(p: Peer, k: Known, n: int) -> None:
    keys = ("sonar/obstacles", "robot/state", f"robot/cmd/{k.holder}", "stranger/obstacles", "x")
    p.put(keys, k.cycle, None, None, None, None, POINTS)


@attempt(DRIVES, "1,000 queries a second for everything", hertz=1000)
def queries(p: Peer, k: Known, n: int) -> None:
    p.ask(("agent/*/*/card", "**")[n % 2], within=0.05)


# Replays ------------------------------------------------------------------------------------------


def _replay(p: Peer, k: Known, speed: float, share: float = 1.0) -> None:
    """Play the recording, again and again, for a share of the attempt's duration."""
    turn = time.monotonic()
    end = turn + share * k.seconds
    while k.tape and time.monotonic() < end:
        for at, key, data in k.tape:
            time.sleep(max(turn + (at - k.tape[0][0]) / speed - time.monotonic(), 0.0))
            if time.monotonic() > end:
                return
            p.put_bytes(key, data)
        turn = time.monotonic()


@attempt(DRIVES, "play a recording of an earlier day while the robot drives")
def replay(p: Peer, k: Known, n: int) -> None:
    _replay(p, k, 1.0)


@attempt(DRIVES, "the same at 100 times the speed")
def replay_100x(p: Peer, k: Known, n: int) -> None:
    _replay(p, k, 100.0)


@attempt(RESTS, "play it to a robot without a mission")
def replay_at_rest(p: Peer, k: Known, n: int) -> None:
    for speed in (1.0, 100.0):
        _replay(p, k, speed, 0.5)


@attempt(STOPPED, "play it, with a release of a stop, to a stopped robot")
def replay_stopped(p: Peer, k: Known, n: int) -> None:
    replay_at_rest(p, k, n)
