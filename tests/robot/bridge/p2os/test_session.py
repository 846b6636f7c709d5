"""The client's session by its table, against bytes written by hand."""

from __future__ import annotations

import math

import pytest

from armadico.bridge.p2os.commands import SYNC0, SYNC1, SYNC2, Cmd, command, decode_command
from armadico.bridge.p2os.configuration import Configuration, encode_configuration
from armadico.bridge.p2os.handshake import (
    DRAIN_S,
    ECHO_TIMEOUT_S,
    LINK_TIMEOUT_S,
)
from armadico.bridge.p2os.packets import Decoder, encode
from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.p2os.session import (
    HANG_S,
    MOST_REPEATS,
    Connected,
    Event,
    LinkLost,
    Reported,
    Session,
    Unanswered,
)
from armadico.bridge.p2os.status import Status, encode_status

NAMES = encode(b"\x02Rob\0Pioneer\0p2dx\0")
CLOSE = command(Cmd.CLOSE)


@pytest.fixture
def session(profile: P2osRobot) -> Session:
    return Session(profile, 0.0)


def status(profile: P2osRobot, **fields: object) -> bytes:
    plain = {"x_m": 0, "y_m": 0, "theta_rad": 0, "left_m_s": 0, "right_m_s": 0, "battery_v": 12}
    return encode(encode_status(Status(**(plain | fields)), profile.p2os))  # type: ignore[arg-type]


def sent(session: Session) -> list[tuple[int, int]]:
    """Number and value of the commands written since the last call."""
    commands = map(decode_command, Decoder().feed(session.outgoing()))
    return [(command.number, command.value) for command in commands]


def passed(session: Session, until: float) -> list[Event]:
    """Time goes by, and the owner calls whenever it is due."""
    events: list[Event] = []
    while not events and (due := session.next_wakeup) is not None and due <= until:
        events += session.tick(due)
    return events


def opened(session: Session, now: float = 0.0) -> Session:
    for answer in (SYNC0, SYNC1, NAMES):
        session.receive(answer, now)
    session.outgoing()
    return session


def test_the_handshake_ends_with_motors_on_at_zero_speed_and_limits_set(session: Session) -> None:
    assert session.outgoing() == CLOSE + SYNC0, "first of all, what may be open is closed"
    session.receive(SYNC0, 0.1)
    assert session.outgoing() == SYNC1
    session.receive(SYNC1, 0.2)
    assert session.outgoing() == SYNC2
    assert session.receive(NAMES, 0.3) == [Connected("Rob", "Pioneer", "p2dx")]
    assert sent(session) == [
        (Cmd.OPEN, 0),
        (Cmd.VEL, 0),
        (Cmd.RVEL, 0),
        (Cmd.ENABLE, 1),
        (Cmd.SONAR, 1),
        (Cmd.SETV, 1600),
        (Cmd.SETRV, 298),
        (Cmd.SETA, 300),
        (Cmd.SETA, -600),
        (Cmd.SETRA, 100),
        (Cmd.SETRA, -100),
        (Cmd.CONFIG, 1),
    ]


def test_no_request_is_sent_before_the_link_is_open(session: Session) -> None:
    session.outgoing()
    session.drive(0.3, 0.0)
    session.pulse()
    assert session.outgoing() == b""
    assert (Cmd.VEL, 300) not in sent(opened(session))


def test_a_missing_answer_is_reported_and_requested_again(session: Session) -> None:
    session.outgoing()
    assert session.next_wakeup == pytest.approx(ECHO_TIMEOUT_S)
    assert session.tick(ECHO_TIMEOUT_S) == [Unanswered("the echo of SYNC0", 1)]
    assert sent(session) == [(Cmd.VEL, 0), (Cmd.RVEL, 0), (Cmd.CLOSE, 0)]
    assert session.tick(ECHO_TIMEOUT_S + DRAIN_S) == []
    assert session.outgoing() == CLOSE + SYNC0
    assert session.tick(2 * ECHO_TIMEOUT_S + DRAIN_S) == [Unanswered("the echo of SYNC0", 2)]


def test_the_configuration_is_wanted_and_not_required(session: Session, profile: P2osRobot) -> None:
    opened(session)
    repeats = []
    for n in range(1, 31):
        events = session.receive(status(profile, motors_enabled=True), n / 10)
        assert isinstance(events[0], Reported)
        session.tick(n / 10)
        repeats += [number for number, _ in sent(session)]
    assert repeats == [Cmd.CONFIG] * MOST_REPEATS
    assert session.is_open


def test_a_received_configuration_is_not_requested_again(session: Session) -> None:
    opened(session)
    session.receive(encode(encode_configuration(Configuration(name="Rob"))), 0.05)
    session.tick(0.25)
    assert Cmd.CONFIG not in [number for number, _ in sent(session)]


def test_motors_switched_off_by_hand_stay_off(session: Session, profile: P2osRobot) -> None:
    opened(session)
    session.receive(status(profile, motors_enabled=True), 0.1)
    for n in range(2, 40):
        session.receive(status(profile, motors_enabled=False), n / 10)
        session.tick(n / 10)
    assert (Cmd.ENABLE, 1) not in sent(session)


def test_an_enable_that_was_lost_is_repeated(session: Session, profile: P2osRobot) -> None:
    opened(session)
    session.receive(status(profile, motors_enabled=False), 0.1)
    session.tick(0.2)
    assert (Cmd.ENABLE, 1) in sent(session)


def test_only_the_latest_speeds_go_out_and_only_once(session: Session) -> None:
    opened(session)
    for v in (0.1, 0.2, 0.3):
        session.drive(v, 0)
    assert sent(session) == [(Cmd.VEL, 300), (Cmd.RVEL, 0)]
    assert session.outgoing() == b""


@pytest.mark.parametrize(("v", "w"), [(math.nan, 0), (0, math.inf), (40, 0)])
def test_speeds_that_the_wire_cannot_carry_are_refused_whole(
    session: Session, v: float, w: float
) -> None:
    opened(session)
    with pytest.raises((ValueError, OverflowError)):
        session.drive(v, w)
    assert session.outgoing() == b""


def test_pulses_do_not_pile_up(session: Session) -> None:
    opened(session)
    for _ in range(100):
        session.pulse()
    assert sent(session) == [(Cmd.PULSE, 0)]
    session.drive(0.1, 0)
    session.pulse()
    assert (Cmd.PULSE, 0) not in sent(session)


def test_the_session_alone_never_feeds_the_watchdog(session: Session, profile: P2osRobot) -> None:
    opened(session)
    for n in range(1, 100):
        session.receive(status(profile, motors_enabled=True), n / 10)
        session.tick(n / 10)
        if n == 15:
            session.outgoing()
    assert session.outgoing() == b""


def test_after_a_hang_zero_speeds_go_first_and_the_link_is_not_lost(
    session: Session, profile: P2osRobot
) -> None:
    opened(session)
    session.receive(status(profile, motors_enabled=True), 0.1)
    session.outgoing()
    late = 0.2 + HANG_S
    assert session.tick(late) == []
    assert sent(session)[:2] == [(Cmd.VEL, 0), (Cmd.RVEL, 0)]
    session.drive(0.3, 0)
    assert (Cmd.VEL, 300) in sent(session)
    assert session.is_open
    assert passed(session, late + LINK_TIMEOUT_S) == [LinkLost("no status packet for 1.0 s")]


@pytest.mark.parametrize("hang", [0.65, 0.94, LINK_TIMEOUT_S, 1.05, 1.2])
def test_after_a_shorter_hang_the_link_is_not_what_was_silent(
    session: Session, profile: P2osRobot, hang: float
) -> None:
    """One that ends just on the time-out, too."""
    opened(session)
    session.receive(status(profile, motors_enabled=True), 0.1)
    session.outgoing()
    assert session.tick(0.1 + hang) == []
    assert sent(session)[:2] == [(Cmd.VEL, 0), (Cmd.RVEL, 0)]
    assert session.is_open


def test_a_pulse_after_a_long_silence_brings_zero_speeds_first(
    session: Session, profile: P2osRobot
) -> None:
    opened(session)
    session.receive(status(profile, motors_enabled=True), 0.1)
    session.drive(0.3, 0)
    session.outgoing()
    for n in range(2, 25):
        session.receive(status(profile), n / 10)
    session.pulse()
    assert sent(session)[-3:] == [(Cmd.VEL, 0), (Cmd.RVEL, 0), (Cmd.PULSE, 0)]
    session.pulse()
    assert sent(session) == [(Cmd.PULSE, 0)]


def test_close_stops_switches_off_and_ends(session: Session) -> None:
    opened(session).drive(0.3, 0)
    session.close()
    assert sent(session) == [(Cmd.VEL, 0), (Cmd.RVEL, 0), (Cmd.ENABLE, 0), (Cmd.CLOSE, 0)]
    assert session.next_wakeup is None
    assert session.tick(100.0) == []
    assert session.outgoing() == b""
    session.restart(101.0)
    assert session.outgoing() == CLOSE + SYNC0


class FirstPacketIsSync:
    """MobileSim and AMRISim before OPEN: any first packet is the SYNC of its number."""

    def __init__(self) -> None:
        self._decoder = Decoder()
        self._sync = 0

    def answers(self, data: bytes) -> bytes:
        answer = b""
        for payload in self._decoder.feed(data):
            if self._sync > 2:
                if payload[0] == Cmd.CLOSE:
                    self._sync = 0
                continue
            answer += NAMES if payload[0] == 2 else encode(payload[:1])
            self._sync = payload[0] + 1
        return answer


@pytest.mark.parametrize("first", [b"", SYNC0, SYNC0 + SYNC1, SYNC0 + SYNC1 + SYNC2])
def test_a_controller_that_takes_the_first_packet_for_a_sync_is_connected_to(
    session: Session, first: bytes
) -> None:
    """Whatever another client has left it in the middle of, on a line that reports nothing."""
    controller = FirstPacketIsSync()
    controller.answers(first)
    now, events = 0.0, session.receive(controller.answers(session.outgoing()), 0.0)
    while not session.is_open and now < 5.0:
        now += 0.05
        events += session.tick(now)
        events += session.receive(controller.answers(session.outgoing()), now)
    assert events[-1] == Connected("Rob", "Pioneer", "p2dx")
    assert session.is_open


def test_a_controller_that_streams_and_never_answers_is_reported_repeatedly(
    session: Session, profile: P2osRobot
) -> None:
    """The wire from us to the robot is broken."""
    events: list[Event] = []
    for n in range(1, 51):
        events += session.receive(status(profile), n / 10)
        events += session.tick(n / 10)
    assert all(isinstance(event, Unanswered) and event.streaming for event in events)
    assert len(events) > 10
