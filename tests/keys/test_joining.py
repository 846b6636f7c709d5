"""Processes join a society with keys, by the socket and by TLS, or are told why they do not."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from armadico.config.endpoints import Endpoints
from armadico.keys.authority import create, issue
from armadico.keys.porter import Porter
from armadico.mesh.ports import LOOPBACK
from tests.keys.labs import NAMESPACE
from tests.keys.society import SOON_S, Heard, Society, soon

pytestmark = pytest.mark.live

DAY_S = 86_400.0


def test_a_process_on_each_computer_is_received_by_the_other(society: Society) -> None:
    society.router()
    here, there = society.join("person-anna"), society.join("goto", "lab2")
    assert here.wait_joined(SOON_S), here.missing
    assert Heard(here).from_(there)
    viewer = society.join("person-ben", "lab2")
    assert Heard(viewer).from_(society.join("goto"))


def test_a_command_without_a_table_finds_the_keys_of_the_society_on_this_computer(
    society: Society, monkeypatch: pytest.MonkeyPatch
) -> None:
    society.router()
    monkeypatch.setenv("LOGNAME", "anna")
    command = society.open(Endpoints(namespace=NAMESPACE).mesh())
    assert command.wait_joined(SOON_S), command.missing


def _expired(society: Society) -> None:
    """For so long that the robot's porter does not renew it."""
    society.date("goto", DAY_S, 40 * DAY_S)


def _of_next_year(society: Society) -> None:
    society.date("goto", DAY_S, -365 * DAY_S)


def _foreign(society: Society) -> None:
    """Both its authority and its certificate are of another lab."""
    now = datetime.now(UTC)
    other = create("lab", now)
    society.store.authority.write_bytes(other.certificate)
    society.replace("goto", issue(other, f"{NAMESPACE}/goto", now))


def _mismatched(society: Society) -> None:
    other = issue(society.issuer.pair, f"{NAMESPACE}/goto", datetime.now(UTC))
    society.identity().private.write_bytes(other.private)


def _revoked(society: Society) -> None:
    """Before the robot agent started."""
    society.revoke("goto")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_expired, "expired"),
        (_of_next_year, "is not valid before"),
        (_foreign, "the robot's certificate is of another authority"),
        (_mismatched, "is not the key of its certificate"),
        (_revoked, "the key was revoked or made anew"),
    ],
)
def test_a_process_that_the_robot_does_not_let_in_is_told_why(
    society: Society, spoil: Callable[[Society], None], words: str
) -> None:
    spoil(society)
    society.router()
    process = society.join("goto", "lab2")
    assert soon(lambda: words in process.missing), process.missing
    assert not process.wait_joined(0.0)


def test_a_process_without_keys_is_told_that_the_society_is_closed(society: Society) -> None:
    society.router()
    endpoint = f"tcp/{society.endpoint.partition('/')[2]}"
    process = society.open(Endpoints(namespace=NAMESPACE, connect=(endpoint,)).mesh())
    assert soon(lambda: "is closed" in process.missing), process.missing
    assert not process.wait_joined(0.0)


def test_a_process_with_keys_is_told_that_the_society_is_open(society: Society) -> None:
    society.open(Endpoints(namespace=NAMESPACE).mesh(router=True))
    process = society.join("goto")
    assert soon(lambda: "is open, and this process has keys" in process.missing), process.missing
    assert not process.wait_joined(0.0)


@pytest.mark.parametrize(
    ("spoil", "words", "mend"),
    [
        (_expired, "expired", lambda society: society.date("goto", DAY_S)),
        (_revoked, "revoked", Society.give_lab2),
    ],
)
def test_a_process_that_waits_joins_by_a_new_key_without_being_started_again(
    society: Society,
    spoil: Callable[[Society], None],
    words: str,
    mend: Callable[[Society], None],
) -> None:
    spoil(society)
    society.router()
    process = society.join("goto", "lab2")
    assert soon(lambda: words in process.missing), process.missing
    assert not process.wait_joined(0.0)
    mend(society)
    assert process.wait_joined(SOON_S), process.missing


def test_a_robot_agent_that_does_not_answer_is_not_taken_for_a_refusal_of_the_key(
    society: Society, tmp_path: Path
) -> None:
    """Its porter is there, and no router behind it."""
    listening = society.stack.enter_context(
        socket.create_server((LOOPBACK, int(society.endpoint.rpartition(":")[2])))
    )
    over, end = os.pipe()
    porter = Porter([listening], NAMESPACE, society.issuer.store, tmp_path / "no.sock")
    thread = threading.Thread(target=porter.run, args=(over,))
    thread.start()
    society.stack.callback(porter.close)
    society.stack.callback(thread.join)
    society.stack.callback(os.close, end)
    process = society.join("goto", "lab2")
    assert soon(lambda: "accepts this key" in process.missing), process.missing
    society.revoke("goto")
    assert soon(lambda: "the key was revoked" in process.missing), process.missing
