"""Drive the robot by hand, with the keys of a terminal; the space bar stops it."""

from __future__ import annotations

import getpass
import os
import re
import secrets
import select
import shutil
import signal
import socket
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.beside import Helpers
from armadico.cli.parsing import Command, flag, group
from armadico.runtime.errors import SocietyError

if TYPE_CHECKING:
    from armadico.agents.teleop.messages import Stick
    from armadico.core.messages import Cycle, RobotState
    from armadico.launch.processes import Process
    from armadico.runtime.client import Client

LOOK_S: Final = 0.05
"""How often the keys are looked at."""

FIRST_S: Final = 0.7
"""A key that was pressed once counts as pressed for so long: a terminal tells of no release, and
most repeat a key only after half a second."""

AGAIN_S: Final = 0.3
"""And from its first repetition on for so long after each."""

COME_S: Final = 20.0
"""What an agent that is started here may take to be there."""

STEP: Final = 0.1

EXAMPLES: Final = """\
  armadico teleop                        this robot, on this machine
  armadico teleop --namespace robot2     another one
  ssh lab1 armadico teleop --host lab1 --hosts lab.toml
"""

KEYS: Final = """\
  w or up       forwards             u o    forwards, and left or right
  s or down     backwards            k      stand, and keep the stick
  a or left     turn left            + -    faster, slower
  d or right    turn right           space  STOP       r    release the stop
                                     q      let go, and leave
"""

DIRECTIONS: Final = {
    **dict.fromkeys(("w", "i", "\x1b[A", "\x1bOA"), (1.0, 0.0)),
    **dict.fromkeys(("s", ",", "\x1b[B", "\x1bOB"), (-1.0, 0.0)),
    **dict.fromkeys(("a", "j", "\x1b[D", "\x1bOD"), (0.0, 1.0)),
    **dict.fromkeys(("d", "l", "\x1b[C", "\x1bOC"), (0.0, -1.0)),
    "u": (1.0, 0.5),
    "o": (1.0, -0.5),
    "m": (-1.0, -0.5),
    ".": (-1.0, 0.5),
    "k": (0.0, 0.0),
}
"""(v, w) of keys, as shares; w, a, s, d and the arrows, or those of ROS's teleop_twist_keyboard."""

_KEY: Final = re.compile(r"\x1bO[A-Za-z]|\x1b\[[0-9;]*[A-Za-z~]|[^\x1b]")
"""One key of what a terminal sends."""


class Order(Enum):
    """What is done once, at the press of a key."""

    STOP = " "
    RESUME = "r"
    QUIT = "q"


class Keys:
    """What keys that are pressed say, of a terminal that tells of presses only."""

    def __init__(self) -> None:
        self.share = 0.5  # of what the stick may say
        self._direction = (0.0, 0.0)
        self._key = ""
        self._pressed_at = self._until = float("-inf")

    def press(self, key: str, now: float) -> Order | None:
        """Take a key, or its repetition; what is to be done at once, if anything is."""
        if key in ("+", "=", "-", "_"):
            step = STEP if key in "+=" else -STEP
            self.share = round(min(max(self.share + step, STEP), 1.0), 2)
            return None
        if key in DIRECTIONS:
            repeats = key == self._key and now - self._pressed_at <= FIRST_S
            self._key, self._pressed_at = key, now
            self._direction = DIRECTIONS[key]
            self._until = now + (AGAIN_S if repeats else FIRST_S)
            return None
        self.release()  # any other key: whoever hits one by mistake drives no farther
        key = "q" if key == "\x04" else key  # Ctrl-D
        return Order(key) if key in {order.value for order in Order} else None

    def release(self) -> None:
        self._key, self._until = "", float("-inf")

    def wish(self, now: float) -> tuple[float, float] | None:
        """(v, w), shares of what the stick may say; None: no hand is on it."""
        if now >= self._until:
            return None
        v, w = self._direction
        return self.share * v, self.share * w


class Hand:
    """What a hand says of its stick: once a cycle while it is on it, and once that it is not."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._number = 0
        self._said: Cycle | None = None
        self._on = False

    def stick(self, cycle: Cycle, wish: tuple[float, float] | None) -> Stick | None:
        """What to publish, if anything; `cycle` is the newest that was heard of the robot."""
        from armadico.agents.teleop.messages import Stick

        if wish is None:
            if not self._on:
                return None
        elif self._on and cycle == self._said:
            return None
        self._number += 1
        self._on, self._said = wish is not None, cycle
        v, w = wish or (0.0, 0.0)
        return Stick(cycle, self.name, self._number, v, w, self._on)


@dataclass(frozen=True, kw_only=True)
class Options:
    no_start: bool = flag("start no agent here")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise options.UsageError(
            "the keys of a terminal are the stick, and this is none; programs publish teleop/stick"
        )
    mesh = args.mesh.join()
    from armadico.agents.teleop.messages import TeleopStatus
    from armadico.core.messages import RobotState
    from armadico.runtime.client import Client

    with mesh, ExitStack() as stack:
        client = Client(mesh)
        client.listen(RobotState, TeleopStatus)
        if not _somebody_takes_it(client):
            if args.no_start:
                raise options.FailedError("nobody takes a stick: `armadico-agent teleop` would")
            stack.enter_context(_started(args, client))
        print(KEYS)
        with _raw(sys.stdin.fileno()):
            _drive(client, Hand(f"{_person()}-{secrets.token_hex(4)}"), sys.stdin.fileno())
    return 0


def _person() -> str:
    """Whose hand it is, for the others."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a user without a name
        user = str(os.getuid())
    return options.shown(f"{user}@{socket.gethostname()}")[:100]


# The agent ----------------------------------------------------------------------------------------


def _somebody_takes_it(client: Client) -> bool:
    """Whether an agent is alive that listens to sticks, whatever it is called."""
    from armadico.agents.teleop.messages import Stick
    from armadico.core.services import service_of

    key = service_of(Stick).key
    return any(card is not None and key in card.requests for card in client.cards().values())


@contextmanager
def _started(args: Options, client: Client) -> Iterator[None]:
    """An agent that takes it, for as long as this lasts. Raises FailedError."""
    from armadico.config.scenarios import society

    name = society().by_hand
    print(f"nobody takes a stick: the agent {name} is started here", flush=True)
    with Helpers(args.mesh) as helpers:
        helpers.start(args.mesh.namespace, name)
        _await(client, helpers.processes[args.mesh.namespace, name], name)
        yield


def _await(client: Client, process: Process, name: str) -> None:
    def there() -> bool:
        return process.ended() or any(name == alive for alive, _ in client.alive)

    if not client.wait_for(there, COME_S) or process.ended():
        raise options.FailedError(f"{name} did not come:\n{process.last_words()}")


# The terminal -------------------------------------------------------------------------------------


@contextmanager
def _raw(terminal: int) -> Iterator[None]:
    """Each key as it is pressed, and not shown; however it ends the terminal is as it was."""
    before = termios.tcgetattr(terminal)
    ended = signal.signal(signal.SIGTERM, _leave)
    try:
        tty.setcbreak(terminal)
        yield
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
        signal.signal(signal.SIGTERM, ended)
        print(flush=True)


def _leave(*_: object) -> None:
    raise KeyboardInterrupt  # by Python's own way out, past everything that has to be put back


def _pressed(terminal: int) -> list[str]:
    """The keys that were pressed since, or the end of all."""
    if not select.select([terminal], [], [], 0.0)[0]:
        return []
    data = os.read(terminal, 1024)
    return _KEY.findall(data.decode(errors="replace")) if data else ["\x04"]


def _drive(client: Client, hand: Hand, terminal: int) -> None:
    keys, said = Keys(), ""
    state: RobotState | None = None
    try:
        while True:
            for key in _pressed(terminal):
                order = keys.press(key, client.mesh.now())
                if order is Order.QUIT:
                    return
                if order is not None:
                    _show(keys, "stopping ..." if order is Order.STOP else "releasing ...")
                    said = _ordered(client, hand, order)
                elif key in DIRECTIONS:
                    said = ""
            state = _heard(client)
            if state is not None:
                _say(client, hand, state, keys.wish(client.mesh.now()))
            _show(keys, said or _note(client, hand, state))
            client.wait_for(lambda: None, LOOK_S)
    finally:
        if state is not None:
            _say(client, hand, state, None)


def _heard(client: Client) -> RobotState | None:
    from armadico.core.messages import RobotState

    return client.fresh(RobotState)


def _say(client: Client, hand: Hand, state: RobotState, wish: tuple[float, float] | None) -> None:
    stick = hand.stick(state.cycle, wish)
    if stick is not None:
        client.publish(stick)


def _ordered(client: Client, hand: Hand, order: Order) -> str:
    """Stop the robot, or release it: what came of it."""
    do: Callable[..., None] = client.stop if order is Order.STOP else client.resume
    try:
        do(by=hand.name)
    except SocietyError as error:
        return str(error)
    return "STOPPED: r releases it" if order is Order.STOP else "released"


def _note(client: Client, hand: Hand, state: RobotState | None) -> str:
    """What the robot does, and whose hand it is."""
    from armadico.agents.teleop.messages import TeleopStatus
    from armadico.core.hands import remedy

    if state is None:
        return "nothing is heard of the robot"
    status = client.fresh(TeleopStatus)
    if status is None:
        return "nobody takes the stick"
    going = f"{state.v:+.2f} m/s {state.w:+.2f} rad/s"
    if status.hand not in ("", hand.name):
        return f"{going}  {status.hand} has the stick: it lets go first"
    stopped = ""
    if state.stop.stopped:
        first = remedy(state.stop, motors=state.motors)
        stopped = f"stopped by {state.stop.who}: {f'{first}, then r' if first else 'r releases it'}"
    return f"{going}  {stopped or status.note or ('by hand' if status.holds else '')}"


def _show(keys: Keys, text: str) -> None:
    """One line, written over the one before."""
    width = shutil.get_terminal_size().columns
    line = options.shown(f"{keys.share:4.0%}  {text}")[: max(width - 1, 1)]
    print(f"\r{line}\x1b[K", end="", flush=True)


main: Final = Command(
    "armadico teleop",
    Options,
    run,
    "Drive the robot by hand. While a key is pressed, this hand contends for the wheels; when"
    " it is released the others have them back. It does not drive into what is known to be in"
    " the way. Who takes the stick is an agent: if there is none, it is started here, for as"
    " long as this runs.\n\nkeys:\n" + KEYS,
    EXAMPLES,
)
