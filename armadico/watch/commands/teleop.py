"""Drive the robot by hand, with the keys of a terminal; the space bar stops it."""

from __future__ import annotations

import getpass
import os
import re
import secrets
import select
import shutil
import socket
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.parsing import Command, flag, group
from armadico.runtime.errors import SocietyError
from armadico.watch.beside import Helpers

if TYPE_CHECKING:
    from armadico.core.messages import Cycle, RobotState
    from armadico.launch.client import Client
    from armadico.launch.processes import Process
    from armadico.mesh.base import Mesh
    from armadico.watch.teleop.messages import Stick

POLL_S: Final = 0.05  # the period of reading the keys

# A pressed key counts as held for this time: a terminal reports no release, and most repeat a key
# only after half a second.
FIRST_S: Final = 0.7

AGAIN_S: Final = 0.3  # the same after each repetition

COME_S: Final = 20.0  # the timeout for an agent that is started here

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
                                     q      quit
"""

# (v, w) as shares, by key: w, a, s, d and the arrows, or those of ROS's teleop_twist_keyboard.
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

# One key in a terminal's input.
_KEY: Final = re.compile(r"\x1bO[A-Za-z]|\x1b\[[0-9;]*[A-Za-z~]|[^\x1b]")


class Order(Enum):
    """An action that a key press triggers once."""

    STOP = " "
    RESUME = "r"
    QUIT = "q"


class Keys:
    """The stick's position from key presses; a terminal reports no releases."""

    def __init__(self) -> None:
        self.share = 0.5  # of the largest deflection
        self._direction = (0.0, 0.0)
        self._key = ""
        self._pressed_at = self._until = float("-inf")

    def press(self, key: str, now: float) -> Order | None:
        """Process a key press or its repetition; return an order to execute, if any."""
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
        self.release()  # any other key: a mistyped key must not keep the robot moving
        key = "q" if key == "\x04" else key  # Ctrl-D
        return Order(key) if key in {order.value for order in Order} else None

    def release(self) -> None:
        self._key, self._until = "", float("-inf")

    def deflection(self, now: float) -> tuple[float, float] | None:
        """Return (v, w) as shares of the largest deflection; None: no key is held."""
        if now >= self._until:
            return None
        v, w = self._direction
        return self.share * v, self.share * w


class Hand:
    """The messages of one stick: once a cycle while it is held, and once on release."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._number = 0
        self._cycle: Cycle | None = None  # of the last message
        self._on = False

    def stick(self, cycle: Cycle, deflection: tuple[float, float] | None) -> Stick | None:
        """Return the message to publish, if any; `cycle` is the newest received one."""
        from armadico.watch.teleop.messages import Stick

        if deflection is None:
            if not self._on:
                return None
        elif self._on and cycle == self._cycle:
            return None
        self._number += 1
        self._on, self._cycle = deflection is not None, cycle
        v, w = deflection or (0.0, 0.0)
        return Stick(cycle, self.name, self._number, v, w, self._on)


@dataclass(frozen=True, kw_only=True)
class Options:
    no_start: bool = flag("start no agent here")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise options.UsageError(
            "teleop needs a terminal for its keys; programs publish teleop/stick/HAND instead"
        )
    options.end_as_by_ctrl_c()
    mesh = args.mesh.join()
    from armadico.core.messages import RobotState
    from armadico.launch.client import Client
    from armadico.watch.teleop.messages import TeleopStatus

    with mesh, ExitStack() as stack:
        client = Client(mesh)
        client.listen(RobotState, TeleopStatus)
        if not _has_teleop(client):
            if args.no_start:
                raise options.FailedError("no teleop agent is alive: start `armadico-agent teleop`")
            stack.enter_context(_started(args, client))
        print(KEYS)
        with _raw(sys.stdin.fileno()):
            _drive(client, Hand(_hand(client.mesh)), sys.stdin.fileno())
    return 0


def _hand(mesh: Mesh) -> str:
    """Return the id of this hand on the stick, which begins with the operator's name."""
    return mesh.guest if mesh.closed else f"{_person()}-{secrets.token_hex(4)}"


def _person() -> str:
    """Return the operator's name for the other agents."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a user without a name
        user = str(os.getuid())
    return options.shown(f"{user}@{socket.gethostname()}")[:100]


# The agent ----------------------------------------------------------------------------------------


def _has_teleop(client: Client) -> bool:
    """Return whether an agent of any name is alive that receives sticks."""
    from armadico.core.services import requested
    from armadico.watch.teleop.messages import Stick

    return any(card is not None and requested(Stick, card) for card in client.cards().values())


@contextmanager
def _started(args: Options, client: Client) -> Iterator[None]:
    """Run a teleop agent during the context. Raises FailedError."""
    from armadico.watch.slot import BY_HAND

    (name,) = BY_HAND.besides
    print(f"no teleop agent is alive: starting {name}", flush=True)
    with Helpers(args.mesh) as helpers:
        helpers.start(args.mesh.namespace, name)
        _await(client, helpers.processes[args.mesh.namespace, name], name)
        yield


def _await(client: Client, process: Process, name: str) -> None:
    def there() -> bool:
        return process.ended() or any(name == alive for alive, _ in client.alive)

    if not client.wait_for(there, COME_S) or process.ended():
        raise options.FailedError(f"{name} did not start:\n{process.last_lines()}")


# The terminal -------------------------------------------------------------------------------------


@contextmanager
def _raw(terminal: int) -> Iterator[None]:
    """Read single keys without echo; restore the terminal in any case."""
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        yield
    finally:
        with suppress(termios.error, OSError):  # it is closed
            termios.tcsetattr(terminal, termios.TCSADRAIN, before)
            print(flush=True)


def _pressed(terminal: int) -> list[str]:
    """Return the keys pressed since the last call; Ctrl-D at the end of the input."""
    if not select.select([terminal], [], [], 0.0)[0]:
        return []
    data = os.read(terminal, 1024)
    return _KEY.findall(data.decode(errors="replace")) if data else ["\x04"]


def _drive(client: Client, hand: Hand, terminal: int) -> None:
    from armadico.core.messages import RobotState

    keys, text = Keys(), ""
    state: RobotState | None = None
    try:
        while True:
            for key in _pressed(terminal):
                order = keys.press(key, client.mesh.now())
                if order is Order.QUIT:
                    return
                if order is not None:
                    _show(keys, "stopping ..." if order is Order.STOP else "releasing ...")
                    text = _execute(client, hand, order)
                elif key in DIRECTIONS:
                    text = ""
            state = client.fresh(RobotState)
            if state is not None:
                _publish(client, hand, state, keys.deflection(client.mesh.now()))
            _show(keys, text or _note(client, hand, state))
            client.wait_for(lambda: None, POLL_S)
    finally:
        if state is not None:
            _publish(client, hand, state, None)


def _publish(
    client: Client, hand: Hand, state: RobotState, deflection: tuple[float, float] | None
) -> None:
    stick = hand.stick(state.cycle, deflection)
    if stick is not None:
        client.publish(stick)


def _execute(client: Client, hand: Hand, order: Order) -> str:
    """Stop the robot, or release it; return the result."""
    do: Callable[..., None] = client.stop if order is Order.STOP else client.resume
    try:
        do(by=hand.name)
    except SocietyError as error:
        return str(error)
    return "STOPPED: r releases it" if order is Order.STOP else "released"


def _note(client: Client, hand: Hand, state: RobotState | None) -> str:
    """Return the robot's speeds, and which hand drives."""
    from armadico.core.hands import remedy
    from armadico.watch.teleop.messages import TeleopStatus

    if state is None:
        return "no message from the robot"
    status = client.fresh(TeleopStatus)
    if status is None:
        return "no teleop agent is alive"
    going = f"{state.v:+.2f} m/s {state.w:+.2f} rad/s"
    if status.hand not in ("", hand.name):
        return f"{going}  {status.hand} has the stick: wait until it is released"
    stopped = ""
    if state.stop.stopped:
        first = remedy(state.stop, motors=state.motors)
        stopped = (
            f"stopped by {state.stop.requester}: {f'{first}, then r' if first else 'r releases it'}"
        )
    return f"{going}  {stopped or status.note or ('by hand' if status.holds else '')}"


def _show(keys: Keys, text: str) -> None:
    """Print one line over the previous one."""
    width = shutil.get_terminal_size().columns
    line = options.shown(f"{keys.share:4.0%}  {text}")[: max(width - 1, 1)]
    print(f"\r{line}\x1b[K", end="", flush=True)


main: Final = Command(
    "armadico teleop",
    Options,
    run,
    "Drive the robot by hand. While a key is held, the teleop agent contends for the wheels; after"
    " the release the other agents drive again. It does not drive into known obstacles. If no"
    " teleop agent is alive, one is started for the time of this command.\n\nkeys:\n" + KEYS,
    EXAMPLES,
)
