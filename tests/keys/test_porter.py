"""The porter of a robot's TLS port: who gets a link, how long it lasts, and what floods it."""

from __future__ import annotations

import os
import socket
import ssl
import threading
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime

import pytest

from armadico.keys.admission import Admission
from armadico.keys.authority import Pair, create
from armadico.keys.link import LARGEST
from armadico.keys.porter import LINKS_OF_A_NAME
from armadico.keys.store import Member
from armadico.mesh.ports import LOOPBACK

from .labs import NAMESPACE, Lab, named
from .porters import SOON, Door, closes, works


def gets_in(door: Door) -> bool:
    """Whether a member gets a link by one attempt."""
    with suppress(OSError):
        return works(door.connect())
    return False


# Who gets a link ----------------------------------------------------------------------------------


def test_what_a_member_and_the_router_send_arrives_whole(door: Door) -> None:
    door.start_router()
    link = door.connect()
    assert works(link)
    sent = os.urandom(3 * LARGEST)
    back = bytearray()

    def read() -> None:
        while len(back) < len(sent):
            back.extend(link.recv(65_536))

    reading = threading.Thread(target=read)
    reading.start()
    link.sendall(sent)
    reading.join()
    assert bytes(back) == sent


STRANGERS: dict[str, Callable[[Lab], Pair | None]] = {
    "none": lambda _: None,
    "foreign authority": lambda _: named(create("lab", datetime.now(UTC)), f"{NAMESPACE}/goto"),
    "expired": lambda lab: lab.pair_of("goto", begins_s=-7200.0),
    "not yet valid": lambda lab: lab.pair_of("goto", begins_s=7200.0),
    "no common name": lambda lab: named(lab.pair),
    "two common names": lambda lab: named(lab.pair, f"{NAMESPACE}/goto", f"{NAMESPACE}/avoid"),
    "another society's": lambda lab: lab.pair_of("robot2/goto", full=True),
    "no member": lambda lab: lab.pair_of("gothrough"),
    "a robot's name": lambda lab: lab.pair_of("goto/robot"),
}


@pytest.mark.parametrize("kind", STRANGERS)
def test_a_stranger_reaches_no_router(door: Door, kind: str) -> None:
    router = door.start_router()
    pair = STRANGERS[kind](door.lab)
    with suppress(OSError):  # the handshake may fail already
        link = door.connect_without() if pair is None else door.connect(pair)
        assert not works(link)
    assert works(door.connect())
    assert router.received == b"hello"


def test_a_member_of_another_society_of_this_lab_is_no_member(lab: Lab) -> None:
    member = Member("robot2/goto", "agent", ("goto",))
    lab.issuer.give([member], "lab2", lab.store, datetime.now(UTC))
    admission = Admission(NAMESPACE, lab.store)
    assert admission.refusal(f"{NAMESPACE}/goto") == ""
    assert "robot2/goto" in admission.refusal("robot2/goto")


def test_before_tls_1_3_nobody_gets_a_link(door: Door) -> None:
    """A session that is resumed shows no certificate, and `num_tickets` is of TLS 1.3 alone."""
    with pytest.raises(ssl.SSLError):
        door.connect(newest=ssl.TLSVersion.TLSv1_2)


def test_plain_tcp_and_noise_reach_no_router(door: Door) -> None:
    router = door.start_router()
    almost = b"\x16\x03\x01\xff\xff\x01" * 999
    for data in (b"GET / HTTP/1.1\r\n\r\n", os.urandom(5000), almost):
        with socket.create_connection(door.place, SOON) as line, suppress(OSError):
            line.sendall(data)
            line.recv(1)
    assert works(door.connect())
    assert router.received == b"hello"


def test_a_member_that_opens_many_links_keeps_no_other_out(door: Door) -> None:
    door.start_router()
    links = [door.connect() for _ in range(LINKS_OF_A_NAME)]
    assert works(links[-1])
    with suppress(OSError):
        assert not works(door.connect())
    assert works(door.connect(name="avoid"))


def test_a_member_that_comes_before_the_router_is_served_once_it_is_there(door: Door) -> None:
    link = door.connect()
    link.sendall(b"early")
    door.start_router()
    assert link.recv(5) == b"early"


# How long it lasts --------------------------------------------------------------------------------


def test_a_link_ends_with_its_certificate_and_what_was_sent_before_is_passed_on(
    door: Door,
) -> None:
    router = door.start_router()
    link = door.connect(door.lab.pair_of("goto", lives_s=2.0))
    link.sendall(b"stop")
    assert link.recv(4) == b"stop"
    assert closes(link)
    assert router.received == b"stop"


def test_a_renewed_certificate_keeps_the_link(door: Door) -> None:
    door.start_router()
    link = door.connect(door.lab.pair_of("goto", lives_s=3.0))
    other = door.connect(door.lab.pair_of("avoid", lives_s=4.0), name="avoid")
    assert works(link)
    assert works(other)

    door.connect().close()  # shows the one of a day

    assert closes(other)  # its time was over after that of the other one
    assert works(link)


def test_a_revoked_identity_is_out_and_the_others_stay(door: Door) -> None:
    door.start_router()
    link, other = door.connect(), door.connect(name="avoid")
    assert works(link)
    assert works(other)

    door.lab.revoke("goto")

    assert closes(link)
    assert works(other)
    with suppress(OSError):
        assert not works(door.connect())


def test_a_revoked_key_gets_neither_a_link_nor_a_certificate_after_its_name_is_made_anew(
    door: Door,
) -> None:
    router = door.start_router()
    own = door.lab.store.identity(NAMESPACE, "goto")
    stolen = Pair(own.certificate.read_bytes(), own.private.read_bytes())
    assert door.connect(stolen, asks=True).recv(10) == b"-----BEGIN"

    door.lab.revoke("goto")
    door.lab.give("goto")

    assert any(gets_in(door) for _ in range(int(SOON * 100)))
    before = bytes(router.received)
    with suppress(OSError):
        assert not works(door.connect(stolen))
    with suppress(OSError):
        assert not door.connect(stolen, asks=True).recv(10)
    assert router.received == before
    assert door.connect(asks=True).recv(10) == b"-----BEGIN"


def test_the_porters_own_certificate_is_read_again(door: Door) -> None:
    door.start_router()
    link = door.connect()
    before = link.getpeercert(binary_form=True)

    door.lab.give("robot", kind="robot")

    def is_new() -> bool:
        return door.connect().getpeercert(binary_form=True) != before

    assert any(is_new() for _ in range(int(SOON * 100)))
    assert works(link)


def test_a_table_may_name_its_hosts_by_name_and_one_that_is_not_known_is_left_out(
    door: Door,
) -> None:
    door.start_router()
    door.porter.prefer(["no-such-host.invalid", "localhost", "10.0.0.7", "::1"])
    assert {LOOPBACK, "10.0.0.7", "::/64"} <= door.porter._lobby.named
    assert works(door.connect())


# Floods -------------------------------------------------------------------------------------------


def test_silent_connections_keep_no_member_out(door: Door) -> None:
    door.start_router()
    silent = [socket.create_connection(door.place, SOON) for _ in range(300)]
    assert works(door.connect())
    for line in silent:
        line.close()


@pytest.mark.parametrize("kind", ["noise", "handshakes"])
def test_failed_handshakes_keep_no_member_out(door: Door, kind: str) -> None:
    """A member at the same address needs a few attempts."""
    door.start_router()
    ends = threading.Event()

    def flood() -> None:
        context = ssl.create_default_context(cafile=str(door.lab.store.authority))
        while not ends.wait(0.002):
            with socket.create_connection(door.place, SOON) as line, suppress(OSError):
                if kind == "noise":
                    line.sendall(b"this is no handshake")
                else:
                    with context.wrap_socket(line, server_hostname=LOOPBACK) as link:
                        link.recv(1)

    flooding = [threading.Thread(target=flood) for _ in range(2)]
    for each in flooding:
        each.start()
    try:
        for _ in range(10):
            assert any(gets_in(door) for _ in range(10))
    finally:
        ends.set()
        for each in flooding:
            each.join()


def test_a_client_that_does_not_read_stops_no_other(door: Door) -> None:
    door.start_router()
    deaf = door.connect()
    deaf.settimeout(0.5)
    with suppress(OSError):
        while True:
            deaf.sendall(bytes(65_536))  # it comes back, and nobody reads it
    assert works(door.connect(name="avoid"))


def test_files_that_cannot_be_used_change_nothing(
    door: Door, caplog: pytest.LogCaptureFixture
) -> None:
    door.start_router()
    own = door.lab.store.identity(NAMESPACE, "robot")
    good = own.certificate.read_bytes()
    own.certificate.write_text("no certificate")
    while "stay in use" not in caplog.text:
        assert works(door.connect())
    door.lab.revoke("avoid")  # the list is read with the rest
    assert works(door.connect())

    own.certificate.write_bytes(good)

    link = door.connect(name="avoid")
    assert not works(link) or closes(link)
