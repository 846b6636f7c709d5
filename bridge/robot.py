"""The robot agent: sole owner of the controller's port (thesis 3.7.1).

It owns the wheels: the base class decides which agent to obey, acknowledges, and stops on silence
and on `robot/stop`. This class has the robot's part. Each report makes a cycle, speeds are sent
through the session, and the robot's watchdog is fed only while all of this works. Only the session
depends on the protocol.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import copysign, inf, radians
from typing import Annotated, ClassVar

from msgspec import Meta
from msgspec.structs import replace

from armadico.bridge.kind import kind_of
from armadico.bridge.obedience import Obedience
from armadico.bridge.readings import Readings, sound
from armadico.bridge.reflex import Reflex, Touch
from armadico.bridge.response import Response
from armadico.bridge.session import (
    Brakes,
    Connected,
    Differs,
    LinkLost,
    Noted,
    Reported,
    Session,
    Unanswered,
    Unfit,
    Unread,
)
from armadico.config.lines import line_of
from armadico.config.loading import read_text
from armadico.config.profile import NEVER_S, load_profile
from armadico.config.shipped import find
from armadico.core import agent
from armadico.core.agent import ERROR, INFO, WARNING, DeviceAgent
from armadico.core.config_errors import ConfigError
from armadico.core.cycles import CycleCounter, epoch_of
from armadico.core.discovery import TRANSPORTS, installed
from armadico.core.hands import Hand, keeps_motors_off
from armadico.core.messages import (
    LABEL,
    Card,
    Cycle,
    Description,
    Line,
    LogEvent,
    Message,
    Point,
    RobotState,
    Stop,
    TopSpeed,
    Twist,
    line,
)
from armadico.core.outgoing import EXPIRY_S
from armadico.core.resources import WHEELS, Resource
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Origin, Scan, Sonar, Trajectory
from armadico.mobile.scans import points_of

PULSE_S = 0.5
"""Period of feeding the watchdog when nothing else is sent."""

RENEW_S = EXPIRY_S / 2
"""Period of renewing a command, which its guard lets hold for `EXPIRY_S`."""
LATE_S = 0.05
"""So much later than this agent would order rest without commands, its guard brakes: this agent may
be late by as much as its computer is busy."""

HEALTHY_S = 0.5
"""The watchdog is fed only while status packets arrive at least this often."""

PATIENCE_S = 10.0
"""A port that is missing for this time, s, is reported as a warning."""

AT_REST_M_S = 0.02
"""A wheel rim slower than this is at rest."""

LOGGED_ATTEMPTS = tuple(2**n for n in range(20))
"""Numbers of attempts that are logged. If status packets arrive, not the first: it was open."""

_HINTS = (
    "is the robot on",
    "it sends status packets and does not receive: is the line to the robot intact",
)

LINE_LOG_S = 10.0
"""Least time between two logs of the line's counts."""

_SIDES = {1: "ahead", -1: "behind", 0: "on turning"}

ROUNDING = 1e-9
"""m/s and rad/s by which a command may exceed the top speeds: sums of floats round."""

DESCRIBE_CYCLES = 10
"""Cycles between two publications of the description, for agents that start later."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The port and the robot on it."""

    port: Annotated[str, Meta(min_length=1)] = "tcp://127.0.0.1:8101"
    profile: str = "pioneer-2dx"
    v_max: TopSpeed | None = None  # m/s: a limit below the profile's, such as a scenario's
    reflex: bool = True  # slow down for obstacles sensed ahead, at any command
    simulator: str = ""  # the id of the simulator behind the port; "": its controller's name


@dataclass
class Known:
    """What is known about the controller."""

    name: str = ""  # by its own report
    named: tuple[str, str, str] | None = None  # the names of the last one that was opened
    openings: int = 0  # of the port, since the last status packet
    connections: int = 0  # completed handshakes since then
    refusals: int = 0  # how often it was refused
    unfit: str = ""  # why it was refused
    unread: str = ""  # why no node reads its commands
    differs: tuple[str, ...] = ()  # where the robot differs from the profile
    rolls: bool = False  # it stopped answering while it moved, which was logged
    faults: int = 0  # reports with something that is no number
    doubts: tuple[str, ...] = ()  # what is wrong with its motion and its reports now


@dataclass
class Orders:
    """Measured and commanded speeds of the wheels, m/s and rad/s."""

    measured: tuple[float, float] = (0.0, 0.0)
    ordered: tuple[float, float] = (0.0, 0.0)  # the last command obeyed
    driven: tuple[float, float] = (0.0, 0.0)  # what was sent to the controller
    capped: str = ""  # why it is not what was ordered, for people
    moving: bool = False  # whether the controller was last commanded to move


class Robot(DeviceAgent):
    """The robot, as other agents know it."""

    name = "robot"
    alone = True
    owns = (WHEELS,)
    provides: ClassVar[tuple[type[Message], ...]] = (RobotState, Description, Sonar, Scan)
    parameters = Parameters
    launched_with = ("port", "profile", "v_max", "simulator")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.address = self.p.port
        self.profile = load_profile(self.p.profile)
        self._kind = kind_of(self.profile)
        self._kind.check()
        scheme, schemes = self.p.port.partition(":")[0], self._kind.schemes
        if scheme in installed(TRANSPORTS) and scheme not in schemes:
            raise ConfigError(
                f"no robot with a table [{self.profile.section}] in its profile, as"
                f" {self.profile.name} has, is at {self.p.port}: its address begins with"
                f" {' or '.join(f'{each}://' for each in schemes)}; name your robot's profile, as"
                " do armadico run --profile turtlebot4, and robot = 'turtlebot4' in a scenario's"
                " file"
            )
        self._v_max = min(self.p.v_max or inf, self.profile.limits.v_max)
        self.cycles.period = self.profile.cycle_s
        drawn, own = self.rng.getrandbits(63), epoch_of(self.instance)
        self._counter = CycleCounter(drawn if own is None else own, self.cycles.period)
        self._session: Session | None = None
        self._awaited = ""  # before the port was first open: the reason
        self._known = Known()
        self._guarded = False  # a guard brakes the robot without this agent
        self._guard_v_max = inf  # m/s: by how far the robot would roll if one of both failed
        self._orders = Orders()
        self._reported_at = float("-inf")
        self._pulsed_at = self._written_at = float("-inf")
        self._described = 0  # cycles since the last description
        self._described_top = 0.0  # m/s, in the last description
        self._readings = Readings(self.profile)
        try:
            self._reflex = Reflex(self.profile)
        except ConfigError as error:
            path = find("robots", self.p.profile)
            raise error.at(path, line_of(read_text(path), ("limits",))) from None
        self._touch, self._response = Touch(), Response(self.profile)
        self._obedience = Obedience(self.profile)
        self._logged_line, self._line_logged_at = Line(), -inf

    def on_appeared(self, name: str, instance: str) -> None:  # noqa: ARG002
        """Publish the description with the next status packet, for the new agent."""
        self._described = 0

    # The port ------------------------------------------------------------------------------------

    def on_link(self, up: bool, why: str) -> None:
        if not up and self._session is None:  # started before the port was there
            self._awaited = f"waiting for the port {self.p.port}: {why}"
            self.log(self._awaited)
            self.wake_at(self.now + PATIENCE_S)
            return
        self._known.openings += up
        logged = self._known.openings in LOGGED_ATTEMPTS or not self._known.openings
        logged = logged and not self._known.unfit  # a controller that is refused hangs up
        if not up:
            self._orders.moving = False
            if logged and self._known.unfit:  # as a refused controller does
                self.log(f"the port {self.p.port} was closed by the other end")
            elif logged:
                self.log(f"the port {self.p.port} is gone: {why}", ERROR)
            return
        if logged:
            self.log(f"the port {self.p.port} is open")
        if self._session is None:
            origin = self.memory.newest(Origin)  # as others remember it
            near = (0.0, 0.0) if origin is None else (origin.at_x, origin.at_y)
            self._session = self._kind.session(self.profile, self.now, near)
            stop = self.stopped  # a robot agent before this one may have latched it
            self._session.held = stop is not None and keeps_motors_off(stop)
        else:
            self._on_events(self._session.restart(self.now))
        self._send()

    def on_bytes(self, data: bytes) -> None:
        if self._session is not None:
            self._on_events(self._session.receive(data, self.now))
            self._send()

    def on_guard(self, acts_s: float, restarts_s: float) -> None:
        """Limit the speed by how far the robot would roll until something brakes it."""
        watchdog_s, roll_m = self.profile.watchdog_s, self.profile.stop_within_m
        braked = self._session is None or self._braking is not None
        rolls_s = min(acts_s if braked else inf, watchdog_s)
        why = ""
        if acts_s == inf or not braked:
            why = "no guard brakes it if the robot agent fails"
        elif acts_s > EXPIRY_S:
            why = "its guard may not have priority over other programs, and may be late"
        if watchdog_s >= NEVER_S:
            rolls_s = max(rolls_s, restarts_s)
            why = why or "the base has no watchdog: if its guard fails, it drives on until the next"
        self._guarded = acts_s < inf
        self._guard_v_max = roll_m / rolls_s
        self._described = 0  # with the next status packet
        slower = self._guard_v_max < self._v_max
        if why:
            limit = f", so it drives at most {self._guard_v_max:.2f} m/s" if slower else ""
            self.log(f"{why}, {rolls_s:.2f} s{limit}", WARNING if slower else INFO)

    def on_braked(self) -> None:
        if self._braking is not None:
            self._braking.braked()

    def on_wakeup(self) -> None:
        """Timeouts: of the session, of the last valid command, of the watchdog."""
        if self._session is None:
            self.log(f"still {self._awaited}", WARNING)
            return
        self._on_events(self._session.tick(self.now))
        if self._healthy and self.now - self._pulsed_at >= PULSE_S:
            self._session.pulse()
            self._pulsed_at = self.now
        if self._renews and self.now - self._written_at >= RENEW_S:
            self._renew()
        self._send()

    def _renew(self) -> None:
        """Tell the guard that this agent lives; order rest again if it was ordered."""
        assert self._session is not None
        if self._orders.moving:
            self.write(b"", brakes=self._brakes(), moves=True, holds_s=self._holds_s)
            self._written_at = self.now
            return
        self._session.stop()
        if not self._healthy and not self._known.rolls:
            self._known.rolls = True
            v, w = self._orders.measured
            self.log(
                f"the controller stopped answering at {v:.2f} m/s, {w:.2f} rad/s; rest is repeated",
                ERROR,
            )

    @property
    def _renews(self) -> bool:
        """Whether an order is repeated if no other follows soon: a guard's command, or rest."""
        return self._rolls and (self._guarded or not self._orders.moving)

    @property
    def _rolls(self) -> bool:
        """Whether the robot moves, or is to, as far as it is known."""
        session = self._session
        open_ = session is not None and session.is_open
        return open_ and (self._orders.moving or self._turns(*self._orders.measured))

    def _turns(self, v: float, w: float) -> bool:
        """Whether a wheel turns at these measured speeds, m/s and rad/s."""
        return (
            abs(v) + abs(w) * self.profile.body.half_track_m > AT_REST_M_S
        )  # the faster one's rim

    def _brakes(self) -> tuple[bytes, ...]:
        """What brakes the robot without this agent; empty if it rests."""
        braking = self._braking if self._guarded and self._rolls else None
        return () if braking is None else braking.brakes()

    @property
    def _holds_s(self) -> float:
        """How long a guard lets a write hold, s: no longer than the command that is obeyed."""
        silent_at = self.owner(WHEELS).silent_at
        if silent_at is None:
            return EXPIRY_S
        return min(EXPIRY_S, max(silent_at + LATE_S - self.now, 0.0))

    @property
    def _braking(self) -> Brakes | None:
        """The session, if a guard can brake its robot."""
        session: object = self._session
        return session if isinstance(session, Brakes) else None

    @property
    def _healthy(self) -> bool:
        return self.now - self._reported_at <= HEALTHY_S

    def on_leave(self) -> None:
        """Close the controller of the robot, which rests."""
        if self._session is not None:
            self._session.close()
            self._send()

    def _on_events(self, events: Iterable[object]) -> None:
        for event in events:
            match event:
                case Reported():
                    self._judge(event)
                case Connected():
                    self._connected(event)
                case Unfit():
                    self._refuse(event)
                case LinkLost():
                    self._lost_link(event)
                case Unanswered():
                    self._unanswered(event)
                case Differs(text) if text not in self._known.differs:
                    self._known.differs = (*self._known.differs, text)
                    self.log(text, WARNING)
                case Noted(text):
                    self.log(text, WARNING)
                case Unread(text):
                    self._known.unread = text
                    if text:
                        self.log(f"no command reaches the robot: {text}", ERROR, LogEvent.UNFIT)

    def _lost_link(self, event: LinkLost) -> None:
        """Log the silence; latch the stop if the controller was reset."""
        self._orders.moving = False
        self._line()
        if self._known.connections in (0, *LOGGED_ATTEMPTS):
            self.log(f"the controller is silent: {event.reason}; trying again", ERROR)
        if event.reset and self.stopped is None:
            # Its motors are off then; opening it again switches them on.
            self.latch(Hand.RESET)

    def _unanswered(self, event: Unanswered) -> None:
        """Log some of the attempts to open the controller."""
        if event.attempts not in LOGGED_ATTEMPTS[event.streaming :]:
            return
        self._line()
        hint = event.hint or f"{_HINTS[event.streaming]}?"
        self.log(
            f"no answer on {self.p.port} (waiting for {event.awaited},"
            f" attempt {event.attempts}); {hint}",
            WARNING,
        )

    def _judge(self, event: Reported) -> None:
        """Process a report; log what is no number in it, which is left out."""
        report, fault = sound(event)
        self._known.faults += bool(fault)
        if fault and self._known.faults in LOGGED_ATTEMPTS:
            text = f"the driver of {self.profile.name} reports {fault}: it is left out"
            self.log(f"{text} ({self._known.faults} so far)", ERROR)
        if report is not None:
            self._report(report)

    def _connected(self, event: Connected) -> None:
        """Note which controller answers: one of another type is another robot."""
        self._touch.begin()
        self._response.begin()
        self._obedience.begin()
        self._known.connections += 1
        if self._known.connections in LOGGED_ATTEMPTS:
            self.log(f"connected to {_names_of(event)} on {self.p.port}")
        self._known.name = "".join(filter(str.isprintable, event.name))[:LABEL]
        self._described, self._known.unfit, self._known.refusals = 0, "", 0
        named = (event.name, event.class_name.casefold(), event.subclass.casefold())
        before = self._known.named or named
        self._known.named = (event.name or before[0], *named[1:])
        if before[0] and event.name and before != named:
            self.log(
                f"it was {_names_of(Connected(*before))} before: is it the same robot?", WARNING
            )
        if before[1:] != named[1:] and self.stopped is None:
            self.latch(Hand.EXCHANGED)

    def _refuse(self, event: Unfit) -> None:
        """Report a controller that the profile does not match; it is not opened."""
        self._orders.moving = False
        self._known.refusals += 1
        why = self._kind.unfit(self.profile, event)
        self._known.unfit = f"{_names_of(event)} on {self.p.port} is not driven: {why}"
        if self._known.refusals in LOGGED_ATTEMPTS:
            self.log(self._known.unfit, ERROR, LogEvent.UNFIT)

    def _catch_up(self) -> None:
        """Update the session's time: after a pause its ramps start from the last command.

        Otherwise the first step would be that of the moment before the pause.
        """
        if self._session is not None:
            self._on_events(self._session.tick(self.now))

    def _send(self) -> None:
        """Write the session's bytes, and set the wake-up that it needs."""
        assert self._session is not None
        data = self._session.outgoing()
        if data:
            self._pulsed_at = self._written_at = self.now
            moving = self._orders.moving
            self.write(data, brakes=self._brakes(), moves=moving, holds_s=self._holds_s)
        due = [self._session.next_wakeup]
        if self._renews:
            due.append(self._written_at + RENEW_S)
        if self._session.is_open and self._healthy:
            due.append(self._pulsed_at + PULSE_S)
        soonest = min((at for at in due if at is not None), default=None)
        if soonest is not None:
            self.wake_at(max(soonest, self.now + 0.001))

    # One status packet, one cycle ----------------------------------------------------------------

    def _report(self, report: Reported) -> None:
        pose = report.pose
        self._reported_at, self._known.openings, self._known.connections = self.now, 0, 0
        self._known.rolls = False
        cycle = self._counter.next(self.now)
        self.cycles.advance(cycle, self.now)
        v, w = self._orders.measured = report.v, report.w
        ordered = self._orders.driven
        self._check_response(report)
        self._check_touch(report)
        self._check_hands(report)
        self._check_obedience(report, ordered)
        self.publish(
            RobotState(
                cycle=cycle,
                x=pose.x,
                y=pose.y,
                theta=wrap(pose.theta),
                v=v,
                w=w,
                battery_v=report.battery_v,
                motors=report.motors,
                stalled=self._touch.touching,
                stop=self.memory.newest(Stop) or Stop(),
                touch=self._touched(),
                line=self._line(),
                charging=report.charging,
                fault=line(self._fault),
                ordered=Twist(*self._orders.ordered),
                admitted=Twist(*self._orders.driven),
                capped=line(self._orders.capped),
                driver=self._driver,
            )
        )
        self.acknowledge()
        top = self._top
        if self._described % DESCRIBE_CYCLES == 0 or top != self._described_top:
            self.publish(self.description())
        self._described, self._described_top = self._described + 1, top
        self._perceive(cycle, report)
        self._apply_reflex(report)
        self._repeat_stop(v, w)

    def _line(self) -> Line:
        """The counts of invalid data on the line; new ones are logged at a limited rate."""
        session = self._session
        assert session is not None, "it has a line"
        line = session.line
        if line != self._logged_line and self.now - self._line_logged_at >= LINE_LOG_S:
            self._logged_line, self._line_logged_at = line, self.now
            self.log(f"from the controller so far: {line.summary}", WARNING)
        return line

    def fill_card(self, card: Card) -> Card:
        """Leave out the messages of sensors that this robot lacks; add its faults."""
        none = {self.key_of(kind) for kind in (Sonar, Scan) if kind not in self._readings.provides}
        provides = tuple(key for key in card.provides if key not in none)
        doubts = line("; ".join((*self._known.doubts, *self._known.differs)))
        fault = line(self._known.unfit or self._fault)
        return replace(card, provides=provides, fault=fault, doubts=doubts)

    @property
    def _fault(self) -> str:
        """Why the robot cannot be driven although it reports; empty: it can, as far as known."""
        return self._known.unread or self._response.fault

    @property
    def _top(self) -> float:
        """The top speed, by the profile, the scenario, the guard and the mission, m/s."""
        known = self.memory.newest(Trajectory)
        terms = None if known is None else known.terms
        mission_v_max = inf if terms is None or terms.v_max is None else terms.v_max
        return min(self._v_max, self._guard_v_max, mission_v_max)

    def description(self) -> Description:
        """The robot's footprint and limits, by its profile."""
        body, limits, cycle_s = self.profile.body, self.profile.limits, self.profile.cycle_s
        ring = self.profile.sonar
        return Description(
            robot=self.profile.name,
            cycle_s=cycle_s,
            front=body.front_m,
            rear=body.rear_m,
            half_width=body.width_m / 2,
            v_max=self._top,
            w_max=limits.w_max,
            v_accel=limits.v_accel,
            v_decel=limits.v_decel,
            w_accel=limits.w_accel,
            w_decel=limits.w_decel,
            silence_s=WHEELS.silence(cycle_s),
            watchdog_s=self.profile.watchdog_s,
            controller=self._known.name,
            sensors=self._readings.sensors,
            cone=0.0 if ring is None else radians(ring.cone_deg),
            nearest=0.0 if ring is None else ring.min_m,
            simulator="" if self.p.simulator == self._known.name else self.p.simulator,
        )

    def _check_hands(self, report: Reported) -> None:
        """Latch the stop when a person at the robot stops it.

        Motors that come back must not drive off at once: that takes a deliberate release. A release
        while they are off, or while the button is pressed, does not hold. Motors that a stall has
        switched off were not switched off by a person.
        """
        assert self._session is not None
        off = not (report.motors or self._touch.cut) and self._session.motors_due
        self._session.held = self._session.held or off or report.stop_button
        if self.stopped is None:
            if report.stop_button:
                self.latch(Hand.BUTTON)
            elif report.lifted:
                self.latch(Hand.LIFTED)
            elif off:
                self.latch(Hand.MOTORS)

    def _check_obedience(self, report: Reported, ordered: tuple[float, float]) -> None:
        """Stop a robot that disobeys, by all means, until a person releases it."""
        assert self._session is not None
        if not self._obedience.update(report, ordered, self.now, held=self._touch.touching):
            return
        self.log(f"{self._obedience.fault}: emergency stop", ERROR)
        if self.stopped is None:
            self.latch(Hand.DISOBEYS)
        self._session.emergency_stop()
        self._send()

    def _check_response(self, report: Reported) -> None:
        """Compare the motion with the commands, and log each disagreement once."""
        if self._response.update(report, self._orders.driven, self.now):
            self._found_fault()
        doubts = tuple(filter(None, (*self._response.doubts, report.doubt)))
        for text in doubts:
            known = text == self._response.fault or _name_of(text) in map(
                _name_of, self._known.doubts
            )
            if not known:
                self.log(text, WARNING)
        self._known.doubts = doubts

    def _found_fault(self) -> None:
        """Stop: the robot does not do what is commanded."""
        self.log(self._response.fault, ERROR, LogEvent.FAULT)
        self.rest(WHEELS)

    def _check_touch(self, report: Reported) -> None:
        """Stop at a collision; the next holder continues."""
        v, w = self._orders.driven
        if self._touch.update(report, (v, w), self.now, held=self._response.held):
            self.rest(WHEELS)
            where = _SIDES[self._touch.side]
            text = f"touched an obstacle {where}: {v:.2f} m/s, {w:.2f} rad/s ordered,"
            self.log(
                f"{text} {self._orders.measured[0]:.2f}, {self._orders.measured[1]:.2f} measured",
                WARNING,
            )

    def _touched(self) -> Point | None:
        """Where it touches an obstacle: the middle of an edge, since the place is unknown."""
        body, touch = self.profile.body, self._touch
        if not touch.touching or touch.side == 0:
            return None
        return Point(body.front_m if touch.side > 0 else -body.rear_m, 0.0)

    @property
    def _driver(self) -> str:
        """The instance whose command is obeyed; empty: none is."""
        owner = self.owner(WHEELS)
        obeyed = None if owner.silent_at is None else owner.obeyed
        return "" if obeyed is None else obeyed.instance

    def _repeat_stop(self, v: float, w: float) -> None:
        """Command the stop again while the wheels still turn: it may have been lost on the line.

        A pulse would only feed the watchdog of a controller that continues with the old speeds.
        """
        if not self._orders.moving and self._turns(v, w):
            self.rest(WHEELS)

    def _perceive(self, cycle: Cycle, report: Reported) -> None:
        readings = self._readings
        readings.update(cycle, report)
        for message in (readings.sonar, readings.scan):
            if message is not None:
                self.publish(message)
        for complaint in readings.complaints:
            self.log(complaint, ERROR)

    def _apply_reflex(self, report: Reported) -> None:
        """Slow down for obstacles sensed ahead in this cycle, at any command."""
        pose, sonar, scan = report.pose, self._readings.sonar, self._readings.scan
        self._reflex.update(
            () if sonar is None else sonar.echoes,
            (pose.x, pose.y, pose.theta),
            self._orders.measured,
            self.now,
            scan,
            self._orders.driven,
        )
        if scan is not None and self._response.see(points_of(scan), pose):
            self._found_fault()
        if self._orders.moving and self.p.reflex and self._session is not None:
            driven = self._orders.driven
            if self._reflex.cap(*driven) != driven:
                self._order(*self._orders.ordered)
        if (text := self._reflex.complaint(self.now)) is not None:
            self.log(text, WARNING, LogEvent.SLOWED)

    def _order(self, v: float, w: float) -> None:
        """Send a command, m/s and rad/s, capped by the reflexes."""
        assert self._session is not None
        orders, why = self._orders, ""
        orders.ordered = v, w
        if abs(v) > (top := self._top):
            v, w = copysign(top, v), w * top / abs(v)
            why = f"the top speed is {top:.2f} m/s"
        if self._touch.cap(v) != v:
            v, why = 0.0, "it touches an obstacle on that side"
        if self.p.reflex:
            v, w = self._reflex.cap(v, w)
            why = self._reflex.why or why
        orders.driven, orders.capped = (v, w), why
        self._session.drive(v, w)

    # The wheels ----------------------------------------------------------------------------------

    def obey(self, resource: Resource, action: tuple[float, float]) -> None:  # noqa: ARG002 - it owns one
        """Send the speeds, m/s and rad/s; above the limit slower, on the same arc.

        `beyond` refuses what no such robot can do. An agent that does not know a scenario's limit
        is not refused for exceeding it.
        """
        assert self._session is not None, "unavailable without one"
        self._catch_up()
        v, w = action
        self._orders.moving = v != 0.0 or w != 0.0
        self._order(v, w)
        self._send()

    def rest(self, resource: Resource) -> None:  # noqa: ARG002 - it owns one
        """Command zero speeds, down the controller's ramps."""
        orders = self._orders
        orders.moving, orders.capped = False, ""
        orders.ordered = orders.driven = (0.0, 0.0)
        self._catch_up()
        if self._session is not None:
            self._session.stop()
            self._send()

    def measure(self, resource: Resource) -> tuple[float, float]:  # noqa: ARG002 - it owns one
        return self._orders.measured

    def beyond(self, resource: Resource, action: tuple[float, float]) -> str:  # noqa: ARG002 - it owns one
        """The refusal of speeds beyond the profile's limits."""
        limits, (v, w) = self.profile.limits, action
        if abs(v) <= limits.v_max + ROUNDING and abs(w) <= limits.w_max + ROUNDING:
            return ""
        return f"{v:g} m/s, {w:g} rad/s is beyond {limits.v_max:g} m/s, {limits.w_max:g} rad/s"

    def unavailable(self, resource: Resource) -> str:  # noqa: ARG002 - it owns one
        """The refusal without a controller."""
        ready = self._session is not None and self._session.is_open
        if ready:
            return self._known.unread
        return self._known.unfit or "the controller does not answer"


def _names_of(event: Connected | Unfit) -> str:
    """A controller by its own names, for the log."""
    kind = f"{event.class_name} {event.subclass}".strip() or "type unknown"
    return f"{event.name or 'a controller without a name'} ({kind})"


def _name_of(doubt: str) -> str:
    """The kind of a doubt, without its numbers."""
    return doubt.partition(":")[0]
