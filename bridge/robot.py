"""The robot agent: sole owner of the controller's port (thesis 3.7.1).

It numbers the status packets, which makes the cycles; obeys whoever's ballot is the largest, and
chooses nobody; echoes what it obeys; orders a stop after 300 ms without a valid command; latches
`robot/stop` from anyone; and keeps the controller's watchdog fed only while all of this works.
"""

from __future__ import annotations

from collections import Counter
from math import isfinite, radians
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico import agent
from armadico.agent import ERROR, WARNING, DeviceAgent
from armadico.bridge.p2os.session import Connected, Event, LinkLost, Reported, Session, Unanswered
from armadico.bridge.reflex import Reflex
from armadico.config.loading import find, load
from armadico.config.profile import RobotProfile
from armadico.coordination import Owner, Verdict
from armadico.geometry import wrap
from armadico.messages import (
    Claim,
    Command,
    Cycle,
    Description,
    Echo,
    Message,
    RobotState,
    Sonar,
    Stop,
)
from armadico.services import Service

STOP_AFTER_S = 0.3
"""Without a valid command for so long, a stop is ordered."""

PULSE_S = 0.5
"""How often the watchdog is fed when there is nothing else to say."""

HEALTHY_S = 0.5
"""The watchdog is fed only while status packets keep coming at least this often."""

AT_REST_M_S = 0.02
"""Rims slower than this rest."""

SONARS_SILENT = 4
"""Without a reading for so many cycles the sonars are said to be silent."""

DESCRIBE_CYCLES = 10
"""The description is published once in so many cycles, for those who come late."""

REPORT_S = 2.0
"""Refusals are reported at most so often."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The port and the robot behind it."""

    port: Annotated[str, Meta(min_length=1)] = "tcp://127.0.0.1:8101"
    profile: str = "pioneer-2dx"


class Robot(DeviceAgent):
    """The robot, as the society knows it."""

    name = "robot"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (Command, Claim, Stop)
    provides: ClassVar[tuple[type[Message], ...]] = (RobotState, Description, Sonar)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self.profile = load(find("robots", self.p.profile), RobotProfile)
        self.owner = Owner(self.cycles)
        self._epoch = self.rng.getrandbits(63)
        self._number = 0
        self._session: Session | None = None
        self._stops = Stop()
        self._moving = False  # whether the controller was last told to move
        self._obeyed_at = float("-inf")
        self._reported_at = float("-inf")
        self._pulsed_at = float("-inf")
        self._ordered = (0.0, 0.0)  # what was last obeyed, m/s and rad/s
        self._reflex = Reflex(self.profile)
        self._unheard = 0  # cycles since a sonar fired
        self._refusals: Counter[Verdict] = Counter()
        self._complained_at = float("-inf")

    @classmethod
    def subscriptions(cls) -> dict[type[Message], Service]:
        """It makes the cycles, so it does not hear them."""
        found = super().subscriptions()
        del found[RobotState]
        return found

    # The port ------------------------------------------------------------------------------------

    def on_link(self, up: bool, why: str) -> None:
        """The port was opened, or is gone."""
        if not up:
            self._moving = False
            self.log(f"the port {self.p.port} is gone: {why}", ERROR)
            return
        self.log(f"the port {self.p.port} is open")
        if self._session is None:
            self._session = Session(self.profile.p2os, self.now, self.profile.limits)
        else:
            self._take(self._session.restart(self.now))
        self._send()

    def on_bytes(self, data: bytes) -> None:
        """What the controller says."""
        if self._session is not None:
            self._take(self._session.receive(data, self.now))
            self._send()

    def on_wakeup(self) -> None:
        """Time-outs: of the session, of the last valid command, of the watchdog."""
        if self._session is None:
            return
        self._take(self._session.tick(self.now))
        if self._moving and self.now - self._obeyed_at >= STOP_AFTER_S:
            self.log(f"no valid command for {STOP_AFTER_S} s: stop", WARNING)
            self._halt()
        if self._healthy and self.now - self._pulsed_at >= PULSE_S:
            self._session.pulse()
        self._send()

    @property
    def _healthy(self) -> bool:
        return self.now - self._reported_at <= HEALTHY_S

    def stop(self, now: float) -> None:
        """Leave the robot at rest, and its controller closed."""
        super().stop(now)
        if self._session is not None:
            self._session.close()
            self._send()

    def _take(self, events: list[Event]) -> None:
        for event in events:
            if isinstance(event, Reported):
                self._report(event)
            elif isinstance(event, Connected):
                who = f"{event.name} ({event.class_name} {event.subclass})"
                self.log(f"connected to {who} on {self.p.port}")
            elif isinstance(event, LinkLost):
                self._moving = False
                self.log(f"the controller is silent: {event.reason}; trying again", ERROR)
            elif isinstance(event, Unanswered):
                self.log(
                    f"no answer on {self.p.port} (waiting for {event.awaited},"
                    f" attempt {event.attempts}); is the robot on?",
                    WARNING,
                )

    def _send(self) -> None:
        """Write what the session has to say, and wake for what it waits for."""
        assert self._session is not None
        data = self._session.outgoing()
        if data:
            self._pulsed_at = self.now
            self.write(data)
        due = [self._session.next_wakeup]
        if self._session.is_open and self._healthy:
            due.append(self._pulsed_at + PULSE_S)
        if self._moving:
            due.append(self._obeyed_at + STOP_AFTER_S)
        soonest = min((at for at in due if at is not None), default=None)
        if soonest is not None:
            self.wake_at(max(soonest, self.now + 0.001))

    # One status packet, one cycle ----------------------------------------------------------------

    def _report(self, report: Reported) -> None:
        status, pose = report.status, report.pose
        self._number += 1
        self._reported_at = self.now
        cycle = Cycle(self._epoch, self._number)
        self.cycles.advance(cycle, self.now)
        left, right = status.left_m_s, status.right_m_s
        owner = self.owner
        self.publish(
            RobotState(
                cycle=cycle,
                x=pose.x,
                y=pose.y,
                theta=wrap(pose.theta),
                v=0.5 * (left + right),
                w=0.5 * (right - left) / self.profile.body.half_track_m,
                battery_v=status.battery_v,
                motors=status.motors_enabled,
                stalled=status.left_stall or status.right_stall,
                largest=owner.largest,
                obeyed=owner.obeyed,
                obeyed_cycle=owner.obeyed_cycle,
                stop=self._stops,
            )
        )
        if self._number % DESCRIBE_CYCLES == 1:
            self.publish(self.description())
        echoes = self._echoes(report)
        self._say_sonar(cycle, echoes)
        self._heed(report, echoes)
        self._insist(left, right)
        self._complain()

    def description(self) -> Description:
        """The robot's body and limits, by its profile."""
        body, limits, p2os = self.profile.body, self.profile.limits, self.profile.p2os
        return Description(
            robot=self.profile.name,
            cycle_s=p2os.cycle_s,
            front=body.front_m,
            rear=body.rear_m,
            half_width=body.width_m / 2,
            v_max=limits.v_max,
            w_max=limits.w_max,
            v_accel=limits.v_accel,
            v_decel=limits.v_decel,
            w_accel=limits.w_accel,
            w_decel=limits.w_decel,
            silence_s=STOP_AFTER_S,
            watchdog_s=p2os.watchdog_s,
        )

    def _insist(self, left: float, right: float) -> None:
        """Order the stop again while the wheels still turn: it may have been lost on the line.

        A pulse would only feed the watchdog of a controller that goes on as it was told before.
        """
        if not self._moving and max(abs(left), abs(right)) > AT_REST_M_S:
            self._halt()

    def _heed(self, report: Reported, echoes: tuple[Echo, ...]) -> None:
        """Slow down for what the front sonars have just heard, whoever is obeyed."""
        pose, left, right = report.pose, report.status.left_m_s, report.status.right_m_s
        measured = 0.5 * (left + right), 0.5 * (right - left) / self.profile.body.half_track_m
        self._reflex.hear(echoes, (pose.x, pose.y, pose.theta), measured, self.now)
        if self._moving and self._session is not None:
            v, w = self._ordered
            if self._reflex.cap(v, w) < v:
                self._obey(v, w)
        if (text := self._reflex.complaint(self.now)) is not None:
            self.log(text, WARNING)

    def _obey(self, v: float, w: float) -> None:
        """Order what was commanded, m/s and rad/s, capped by the reflex."""
        assert self._session is not None
        self._ordered = v, w
        self._session.drive(self._reflex.cap(v, w), w)

    def _say_sonar(self, cycle: Cycle, echoes: tuple[Echo, ...]) -> None:
        """Pass the readings on; a cycle in which no sonar fired has none.

        So sonars that have fallen silent are stale obstacles three cycles later, not a free way.
        """
        if echoes:
            self._unheard = 0
            self.publish(Sonar(cycle, self.profile.sonar.max_m, echoes))
            return
        self._unheard += 1
        if self._unheard == SONARS_SILENT:
            self.log(f"no sonar has fired for {SONARS_SILENT} cycles: nobody drives blind", ERROR)

    def _echoes(self, report: Reported) -> tuple[Echo, ...]:
        ring = self.profile.sonar
        echoes = []
        for index, distance in report.status.echoes:
            if index < len(ring.sonars):
                sonar = ring.sonars[index]
                heard = 0.0 < distance < ring.max_m * 0.999
                echoes.append(
                    Echo(
                        sonar.x_m,
                        sonar.y_m,
                        radians(sonar.bearing_deg),
                        distance if heard else None,
                    )
                )
        return tuple(echoes)

    # What the society says -----------------------------------------------------------------------

    def on_command(self, command: Command) -> None:
        """Obey, or refuse with the reason; without a controller nobody is obeyed."""
        if self._session is None or not self._session.is_open:
            return
        limits = self.profile.limits
        sound = (
            isfinite(command.v)
            and isfinite(command.w)
            and abs(command.v) <= limits.v_max
            and abs(command.w) <= limits.w_max
        )
        if self.cycles.alive(self.now):
            verdict = self.owner.judge(
                command.cycle, command.ballot, stopped=self._stops.stopped, sound=sound
            )
        else:  # it hung, or the controller is silent: what waited answers a cycle of before
            verdict = Verdict.OLD_CYCLE
        if verdict is not Verdict.OBEYED:
            self._refusals[verdict] += 1
            return
        self._obeyed_at = self.now
        self._moving = command.v != 0.0 or command.w != 0.0
        self._obey(command.v, command.w)
        self._send()

    def on_claim(self, claim: Claim) -> None:
        """Learn of a ballot, to refuse smaller ones."""
        self.owner.hear(claim)

    def on_stop(self, stop: Stop) -> None:
        """Latch or release the stop: the larger counter stands, at equal ones the stop."""
        newer = stop.counter > self._stops.counter
        if newer or (stop.counter == self._stops.counter and stop.stopped):
            if stop.stopped != self._stops.stopped:
                self.log(f"{'stopped' if stop.stopped else 'released'} by {stop.by}", WARNING)
            self._stops = stop
        if self._stops.stopped and self._session is not None:
            self._halt()
            self._send()

    def _acceptable(self, message: Message) -> bool:  # noqa: ARG002
        """The owner judges, and says why it refuses."""
        return True

    def _halt(self) -> None:
        assert self._session is not None
        self._moving = False
        self._session.stop()

    def _complain(self) -> None:
        """Report refusals, seldom."""
        if self._refusals and self.now - self._complained_at >= REPORT_S:
            self._complained_at = self.now
            text = "; ".join(f"{count} x {verdict}" for verdict, count in self._refusals.items())
            self.log(f"commands refused: {text}", WARNING)
            self._refusals.clear()
