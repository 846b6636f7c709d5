"""`armadico teleop`: keys as a terminal sends them, and a robot on the virtual mesh."""

from __future__ import annotations

import os
import pty
import re
import termios
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from armadico import cli
from armadico.cli import options
from armadico.config.scenarios import Scenario, ideal
from armadico.core.messages import Cycle, RobotState
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.launch.virtual_session import VirtualSession
from armadico.mobile.messages import Truth
from armadico.watch.commands import teleop
from armadico.watch.commands.teleop import AGAIN_S, FIRST_S, Hand, Keys, Order
from armadico.watch.teleop.messages import Stick
from armadico.watch.teleop.teleop import Teleop
from tests.driven import Driven

LINE = ideal(Scenario(name="line", world="sc1", start=(-1.5, 0.0, 0.0), goal=(6.5, 0.0, 0.0)))
UP = "\x1b[A"

# Keys ---------------------------------------------------------------------------------------------


def test_a_key_counts_as_pressed_until_it_would_have_been_repeated() -> None:
    keys = Keys()
    assert keys.deflection(0.0) is None
    assert keys.press("w", 1.0) is None
    assert keys.deflection(1.0 + FIRST_S - 0.01) == (0.5, 0.0)
    assert keys.deflection(1.0 + FIRST_S) is None


def test_once_it_is_repeated_its_release_is_noticed_sooner() -> None:
    keys = Keys()
    keys.press("w", 1.0)
    keys.press("w", 1.5)
    keys.press("w", 1.53)
    assert keys.deflection(1.53 + AGAIN_S - 0.01) == (0.5, 0.0)
    assert keys.deflection(1.53 + AGAIN_S) is None


def test_another_direction_takes_the_place_of_the_one_before() -> None:
    keys = Keys()
    keys.press("w", 1.0)
    keys.press("a", 1.1)
    assert keys.deflection(1.2) == (0.0, 0.5)
    keys.press("u", 1.2)
    assert keys.deflection(1.3) == (0.5, 0.25)
    keys.press("k", 1.3)
    assert keys.deflection(1.4) == (0.0, 0.0)  # it stands, and the hand is on the stick


def test_the_share_grows_and_shrinks_within_its_bounds() -> None:
    keys = Keys()
    for _ in range(9):
        keys.press("+", 0.0)
    assert keys.share == 1.0
    for _ in range(20):
        keys.press("-", 0.0)
    assert keys.share == 0.1


@pytest.mark.parametrize(
    ("key", "order"),
    [(" ", Order.STOP), ("r", Order.RESUME), ("q", Order.QUIT), ("\x04", Order.QUIT), ("x", None)],
)
def test_any_other_key_lets_go(key: str, order: Order | None) -> None:
    keys = Keys()
    keys.press("w", 1.0)
    assert keys.press(key, 1.1) is order
    assert keys.deflection(1.1) is None


@pytest.mark.parametrize("key", [UP, "\x1bOA", "w", "i"])
def test_arrows_are_directions_however_the_terminal_sends_them(key: str) -> None:
    keys = Keys()
    for found in teleop._KEY.findall(f"\x1b[15~{key}"):
        keys.press(found, 1.0)
    assert keys.deflection(1.0) == (0.5, 0.0)


# A hand -------------------------------------------------------------------------------------------


def test_a_hand_speaks_once_a_cycle_and_once_when_it_lets_go() -> None:
    hand = Hand("ann-1")
    first, second = Cycle(1, 7), Cycle(1, 8)
    assert hand.stick(first, None) is None
    assert hand.stick(first, (0.5, 0.0)) == Stick(first, "ann-1", 1, 0.5, 0.0)
    assert hand.stick(first, (0.5, 0.0)) is None
    assert hand.stick(second, (0.5, 0.1)) == Stick(second, "ann-1", 2, 0.5, 0.1)
    assert hand.stick(second, None) == Stick(second, "ann-1", 3, 0.0, 0.0, held=False)
    assert hand.stick(second, None) is None
    assert hand.stick(second, (0.5, 0.0)) == Stick(second, "ann-1", 4, 0.5, 0.0)


# The command --------------------------------------------------------------------------------------


class Seat(Driven):
    """A robot, and somebody at a terminal."""

    def __init__(self) -> None:
        super().__init__(Rehearsal(LINE, Options(seed=1)), Truth, Stick, RobotState)
        self.keyboard, self.terminal = pty.openpty()
        self.screen: list[str] = []

    def type(self, at: float, text: str, times: int = 1) -> None:
        """Press a key so many s from now, and hold it: it is repeated each 0.1 s."""
        begun = self.mesh.now + at
        for number in range(times):
            self.mesh.call_at(begun + 0.1 * number, self._write, text.encode())

    def then(self, at: float, do: Callable[[], Any]) -> None:
        self.mesh.call_at(self.mesh.now + at, lambda _a, _b: do())

    def _write(self, data: bytes, _: Any) -> None:
        os.write(self.keyboard, data)

    def teleop(self, *words: str) -> int:
        """The command, at this terminal; its exit code."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                options.Mesh, "join", lambda _args: VirtualSession(self.mesh, name="hand")
            )
            patch.setattr("sys.stdin", Terminal(self.terminal, []))
            patch.setattr("sys.stdout", Terminal(self.terminal, self.screen))
            return cli.main(["teleop", *words])

    @property
    def lines(self) -> str:
        """What was shown, a line each."""
        return re.sub(r"\r|\x1b\[K", "\n", "".join(self.screen))


class Terminal:
    """What the command takes for the standard streams."""

    def __init__(self, descriptor: int, shown: list[str]) -> None:
        self.descriptor = descriptor
        self.shown = shown

    def isatty(self) -> bool:
        return os.isatty(self.descriptor)

    def fileno(self) -> int:
        return self.descriptor

    def write(self, text: str) -> int:
        self.shown.append(text)
        return len(text)

    def flush(self) -> None:
        pass


@pytest.fixture
def seat() -> Iterator[Seat]:
    made = Seat()
    made.run.start()
    yield made
    os.close(made.keyboard)
    os.close(made.terminal)


def test_keys_drive_the_robot_and_a_release_has_it_stand(seat: Seat) -> None:
    seat.run.add(Teleop)
    before = termios.tcgetattr(seat.terminal)
    seat.type(1.0, "+", times=5)
    seat.type(4.0, UP, times=30)
    seat.then(6.9, lambda: speeds.append(seat.last(Truth).v))
    seat.then(9.5, lambda: speeds.append(seat.last(Truth).v))
    seat.type(9.6, "q")
    speeds: list[float] = []
    assert seat.teleop() == 0
    assert speeds[0] > 0.45
    assert abs(speeds[1]) < 0.01
    assert {stick.v for stick in seat.of(Stick) if stick.held} == {1.0}
    assert not seat.last(Stick).held
    assert termios.tcgetattr(seat.terminal) == before
    assert "by hand" in seat.lines


def test_the_space_bar_stops_it_and_r_releases_it(seat: Seat) -> None:
    seat.run.add(Teleop)
    seat.type(3.0, "w", times=30)
    seat.type(6.0, " ")
    seat.type(6.1, "w", times=10)
    seat.then(10.0, lambda: stops.append(seat.last(RobotState).stop))
    seat.type(10.1, "r")
    seat.then(11.5, lambda: stops.append(seat.last(RobotState).stop))
    seat.type(12.0, "q")
    stops: list[Any] = []
    assert seat.teleop() == 0
    assert [stop.stopped for stop in stops] == [True, False]
    assert "@" in stops[0].by
    assert "STOPPED: r releases it" in seat.lines
    assert "released" in seat.lines


def test_who_comes_second_is_told_whose_it_is(seat: Seat) -> None:
    seat.run.add(Teleop)
    other = VirtualSession(seat.mesh, name="other")
    number = iter(range(10**6))

    def push(*_: object) -> None:
        cycle = seat.last(RobotState).cycle
        other.publish("teleop/stick", Stick(cycle, "bob", next(number), 0.0, 0.0))
        seat.mesh.call_at(seat.mesh.now + 0.1, push)

    seat.mesh.call_at(seat.mesh.now, push)
    seat.type(3.0, "w", times=10)
    seat.type(5.0, "q")
    assert seat.teleop() == 0
    assert "bob has the stick" in seat.lines
    assert abs(seat.last(Truth).v) < 0.01


def test_a_terminal_that_is_closed_lets_go(seat: Seat) -> None:
    seat.run.add(Teleop)
    seat.type(3.0, "w", times=5)
    seat.type(3.5, "\x04")
    assert seat.teleop() == 0
    assert not seat.last(Stick).held


def test_where_nobody_takes_a_stick_that_is_said(
    seat: Seat, capsys: pytest.CaptureFixture[str]
) -> None:
    assert seat.teleop("--no-start") == 1
    assert "armadico-agent teleop" in capsys.readouterr().err
