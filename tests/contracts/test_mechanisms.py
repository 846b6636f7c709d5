"""The contract of mechanisms: each planted defect breaks one check, and a sound one none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import copysign
from typing import Any

import pytest

from armadico.contracts import __main__ as command
from armadico.contracts.mechanisms import MechanismContract
from armadico.core import mechanisms
from armadico.core.coordination import Contender
from armadico.core.cycles import CycleClock
from armadico.core.exchange import EXCHANGES, Bid
from armadico.core.individual import Individual
from armadico.core.judgement import Answer
from armadico.core.messages import Ack, Claim, Command, Cycle, Message
from armadico.core.resources import Resource
from armadico.mobile.resources import TRAJECTORY


class Sound(Contender):
    """Ballots, as a mechanism of another name."""


class Double(Sound):
    """Says that all of the command is its own."""

    @property
    def share(self) -> float:
        return 1.0


class Wishes(Sound):
    """Commands another action than is wanted, or follows another bid."""

    @staticmethod
    def instead(bid: Bid | None) -> Bid | None:
        """What it bids in place of an agent's bid."""
        return bid

    def bid(
        self, cycle: Cycle, bid: Bid | None, now: float, inputs: Cycle | None = None
    ) -> list[Message]:
        return super().bid(cycle, self.instead(bid), now, inputs)


def wishing(name: str, instead: Callable[[float, Any], tuple[float, Any]]) -> type[Sound]:
    """A mechanism that makes another utility and action of each bid."""

    def change(bid: Bid | None) -> Bid | None:
        return bid and Bid(*instead(bid.utility, bid.action))

    return type(name, (Wishes,), {"instead": staticmethod(change)})


Strong = wishing("Strong", lambda u, vw: (u, (2.0 * vw[0], 2.0 * vw[1])))
Opposite = wishing("Opposite", lambda u, vw: (u, (-vw[0], -vw[1])))
Forward = wishing("Forward", lambda u, vw: (u, (abs(vw[0]), vw[1])))
Still = wishing("Still", lambda u, _: (u, (0.0, 0.0)))
Worst = wishing("Worst", lambda u, vw: (1.0 - u, vw))


class Untrue(Sound):
    """Says that the command is the other agent's."""

    @property
    def share(self) -> float:
        return 1.0 - super().share


class Unsaid(Sound):
    """Says that the command is nobody's."""

    @property
    def share(self) -> float:
        return 0.0


class Fixed(wishing("Creeps", lambda u, vw: (u, tuple(copysign(0.02, x) for x in vw)))):  # type: ignore[misc]
    """Creeps in the direction that is wanted, whatever else is, as a part of both agents' wish."""

    @property
    def share(self) -> float:
        return 0.5


class Endless(Wishes):
    """Commands its last action where there is no bid."""

    @staticmethod
    def instead(bid: Bid | None) -> Bid | None:
        return bid or Bid(0.5, (0.1, 0.1))


class Blocked(Sound):
    """Never takes over from another agent."""

    def _reason(self, now: float) -> Any:
        return super()._reason(now) if self.rival is None and self.largest is None else None


class Mute(Sound):
    """Never commands."""

    def _command(self, cycle: Cycle, bid: Bid) -> list[Message]:
        return [each for each in super()._command(cycle, bid) if not isinstance(each, Command)]

    def acked(self, ack: Ack, now: float) -> list[Message]:
        return [each for each in super().acked(ack, now) if isinstance(each, Claim)]


@dataclass(frozen=True)
class Point:
    """An entry point, as far as it is needed."""

    name: str
    kind: type[Contender]
    value: str = ""

    def load(self) -> Any:
        kind = self.kind

        class Made:
            arbiter = ""

            @staticmethod
            def contender(resource: Resource, agent: Individual, clock: CycleClock) -> Contender:
                return kind(resource, agent.instance, clock, EXCHANGES["abrupt"], agent.rng)

        return Made


KINDS = (
    *(Sound, Double, Strong, Opposite, Forward, Still, Endless, Blocked, Mute),
    *(Worst, Untrue, Unsaid, Fixed),
)


@pytest.fixture(autouse=True)
def _installed(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [Point(kind.__name__.lower(), kind) for kind in KINDS]
    found = [(point, point.load()) for point in points]
    monkeypatch.setattr(mechanisms, "loaded", lambda _group: found)


def broken(name: str) -> list[str]:
    contract: MechanismContract = type("Judged", (MechanismContract,), {"coordination": name})()
    return [check for check, found in contract.judge().items() if found.answer is Answer.NO]


def test_a_sound_mechanism_keeps_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["mechanism", "sound"]) == 0
    assert "decides" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "check"),
    [
        ("double", "decides"),
        ("mute", "decides"),
        ("strong", "stays_within_what_is_proposed"),
        ("opposite", "stays_within_what_is_proposed"),
        ("forward", "stays_within_what_is_proposed"),
        ("untrue", "commands_what_its_shares_say"),
        ("unsaid", "commands_what_its_shares_say"),
        ("endless", "rests_without_bids"),
        ("blocked", "goes_on_after_a_kill"),
    ],
)
def test_a_planted_defect_breaks_its_check(name: str, check: str) -> None:
    assert check in broken(name)


@pytest.mark.parametrize(
    ("name", "seen"), [("sound", "followed the larger one"), ("worst", "followed the smaller one")]
)
def test_which_bid_is_followed_is_told_and_not_judged(
    name: str, seen: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(["mechanism", name]) == 0
    (said,) = (line for line in capsys.readouterr().out.splitlines() if "which bid" in line)
    assert said.startswith("not checked")
    assert seen in said


def test_a_command_that_does_not_depend_on_what_is_wanted_is_not_taken_for_a_decision() -> None:
    contract: MechanismContract = type("Judged", (MechanismContract,), {"coordination": "fixed"})()
    assert contract.check_commands_what_its_shares_say().answer is Answer.UNKNOWN


def test_one_that_decides_nothing_with_its_settings_is_not_judged_by_what_ballots_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    unlearned = Point("unlearned", Sound)
    made = unlearned.load()
    made.lacking = staticmethod(lambda agents: f"{' and '.join(agents)} have no weights")
    monkeypatch.setattr(mechanisms, "loaded", lambda _group: [(unlearned, made)])
    contract: Any = type("Judged", (MechanismContract,), {"coordination": "unlearned"})
    for judged in contract().judge().values():
        assert judged.answer is Answer.UNKNOWN
        assert "have no weights" in judged.reason


def test_one_that_only_rests_has_not_been_seen_to_decide() -> None:
    contract: MechanismContract = type("Judged", (MechanismContract,), {"coordination": "still"})()
    found = contract.judge()
    for check in ("decides", "stays_within_what_is_proposed"):
        assert found[check].answer is Answer.UNKNOWN
        assert "nothing but rest" in found[check].reason


def test_an_unknown_mechanism_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["mechanism", "nothing"]) == 2
    assert "sound" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("about", "cured"),
    [(Resource("head", ("pan",), (1.0,), (0.0,)), True), (TRAJECTORY, False), ("task-", False)],
)
def test_only_a_mechanism_that_could_be_judged_is_told_how(
    about: Resource | str, cured: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Elsewhere:
        arbiter = ""
        resource = about

        @staticmethod
        def contender(*_: object) -> None:
            return None

    found = [(Point("elsewhere", Sound), Elsewhere)]
    monkeypatch.setattr(mechanisms, "loaded", lambda _group: found)
    contract: Any = type("Judged", (MechanismContract,), {"coordination": "elsewhere"})
    for judged in contract().judge().values():
        assert judged.answer is Answer.UNKNOWN
        assert mechanisms.decides(Elsewhere()) in judged.reason
        assert bool(judged.cure) is cured
