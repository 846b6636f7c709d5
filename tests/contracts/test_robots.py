"""The contract of robots: the shipped ones keep it, and each planted defect breaks it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest
from msgspec.structs import replace as changed

from armadico.bridge import p2os_kind
from armadico.bridge.kind import RobotKind
from armadico.bridge.session import Reported, Session
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.contracts.contract import judged
from armadico.contracts.robots import RobotContract
from armadico.core.judgement import Answer
from armadico.mobile.messages import Truth

KIND: RobotKind[Any] = p2os_kind.P2OS


class Pioneer(RobotContract):
    profile = "pioneer-2dx"


class TestPioneer(RobotContract):
    profile = "pioneer-2dx"


class Wrapped:
    """A driver with a defect around the real one."""

    def __init__(self, session: Session) -> None:
        vars(self)["_session"] = session

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._session, name, value)

    def receive(self, data: bytes, now: float) -> Sequence[object]:
        return [
            self.spoil(event) if isinstance(event, Reported) else event
            for event in self._session.receive(data, now)
        ]

    def spoil(self, report: Reported) -> Reported:
        return report


class NotANumber(Wrapped):
    def spoil(self, report: Reported) -> Reported:
        return changed(report, v=float("nan"))


class TooFar(Wrapped):
    def spoil(self, report: Reported) -> Reported:
        return changed(report, pose=changed(report.pose, x=1.2 * report.pose.x))


class WrongWayRound(Wrapped):
    def spoil(self, report: Reported) -> Reported:
        return changed(report, pose=changed(report.pose, theta=-report.pose.theta), w=-report.w)


class SeesHalf(Wrapped):
    def spoil(self, report: Reported) -> Reported:
        return changed(report, echoes=tuple((k, 0.5 * away) for k, away in report.echoes))


class NeverStops(Wrapped):
    def stop(self) -> None: ...

    def emergency_stop(self) -> None: ...

    def close(self) -> None: ...


class Twice(Wrapped):
    def receive(self, data: bytes, now: float) -> Sequence[object]:
        events = super().receive(data, now)
        return [*events, *(event for event in events if isinstance(event, Reported))]


class Deaf(Wrapped):
    def receive(self, data: bytes, now: float) -> Sequence[object]:
        return []


class Fragile(Wrapped):
    def receive(self, data: bytes, now: float) -> Sequence[object]:
        before = self.line
        events = super().receive(data, now)
        if self.line != before:
            raise IndexError("bytes that no robot sends")
        return events


class Blind(SimulatedRobot):
    """Counts no collisions."""

    def truth(self) -> Truth:
        return changed(super().truth(), collisions=0, clearance=1.0)


class WithoutTruth(SimulatedRobot):
    """Publishes none."""

    def watch(self, watcher: Callable[[Truth], None]) -> None: ...

    def live(self, now: float) -> None:
        self.plant.add_walls = lambda _walls: None  # type: ignore[method-assign]
        super().live(now)


def defect(monkeypatch: pytest.MonkeyPatch, kind: type[Any]) -> None:
    """Give Pioneers a driver, or a simulator, with a defect."""

    def session(*words: Any) -> Any:
        return kind(KIND.session(*words))

    def simulated(*words: Any) -> SimulatedRobot:
        robot = KIND.simulated(*words)
        robot.__class__ = kind
        return robot

    field = {"simulated": simulated} if issubclass(kind, SimulatedRobot) else {"session": session}
    monkeypatch.setattr(p2os_kind, "P2OS", replace(KIND, **field))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("kind", "check", "answer", "reason"),
    [
        (NotANumber, "opens_and_reports_each_cycle", Answer.NO, "v = nan"),
        (Twice, "opens_and_reports_each_cycle", Answer.NO, "2.00 reports in a cycle"),
        (Deaf, "opens_and_reports_each_cycle", Answer.NO, "did not open"),
        (TooFar, "odometry_agrees_with_the_truth", Answer.NO, "m off after"),
        (WrongWayRound, "odometry_agrees_with_the_truth", Answer.NO, "rad off"),
        (SeesHalf, "sees_a_wall_where_it_is", Answer.NO, "is seen at"),
        (NeverStops, "stops_within_its_bound", Answer.NO, "its ramps allow"),
        (NeverStops, "is_at_rest_after_its_driver_ends", Answer.NO, "drives on"),
        (Fragile, "survives_damaged_bytes", Answer.NO, "IndexError: bytes that no robot sends"),
        (Blind, "counts_a_collision", Answer.NO, "0 collisions are counted"),
        (WithoutTruth, "drives_a_scenario_with_all_agents", Answer.UNKNOWN, "collisions unknown"),
    ],
)
def test_a_defect_breaks_its_check(
    kind: type[Any], check: str, answer: Answer, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    defect(monkeypatch, kind)
    judgement = judged(getattr(Pioneer(), f"check_{check}"))
    assert judgement.answer is answer, judgement
    assert reason in judgement.reason


def test_a_profile_that_claims_a_watchdog_is_held_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    robot: Any = Pioneer().robot
    claimed = changed(robot, p2os=changed(robot.p2os, watchdog_s=0.5))
    monkeypatch.setattr(Pioneer, "robot", claimed)
    sped = {"simulated": lambda _profile, stage: KIND.simulated(robot, stage)}
    monkeypatch.setattr(p2os_kind, "P2OS", replace(KIND, **sped))
    judgement = judged(Pioneer().check_stops_when_its_driver_hangs)
    assert judgement.answer is Answer.NO, judgement
