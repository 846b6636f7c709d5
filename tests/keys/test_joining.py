"""Processes join a society with keys, by the socket and by TLS, or are told why they do not."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from time import monotonic, sleep

import pytest

from armadico.config.endpoints import Endpoints
from armadico.config.hosts import HostTable, load_hosts
from armadico.core.messages import Log
from armadico.keys.authority import Pair, create, issue
from armadico.keys.issuing import Issuer
from armadico.keys.members import of_host
from armadico.keys.store import Identity, Store
from armadico.mesh.door import ROBOT, VIEWER
from armadico.mesh.ports import free_port
from armadico.mesh.zenoh import ZenohMesh
from tests.keys.labs import lab_in

pytestmark = pytest.mark.live

SOON_S = 20.0  # a deadline, not an expectation
NAMESPACE = "robot1"


@dataclass
class Lab:
    """A society with keys: lab1 has the robot's router, lab2 has a folder of its own."""

    table: HostTable
    issuer: Issuer
    there: HostTable
    stack: ExitStack

    def start(self) -> ZenohMesh:
        where = Endpoints(namespace=NAMESPACE, table=self.table, name="lab1")
        return self.stack.enter_context(where.mesh(ROBOT, router=True))

    def join(self, name: str, host: str = "lab1") -> ZenohMesh:
        """A process of a host, which may be waiting."""
        table = self.table if host == "lab1" else self.there
        where = Endpoints(namespace=NAMESPACE, table=table, name=host)
        return self.stack.enter_context(where.mesh(name))

    def identity(self, name: str) -> Identity:
        """One of lab2's."""
        assert self.there.keys_folder is not None
        return Store(self.there.keys_folder).identity(NAMESPACE, name)

    def replace(self, name: str, pair: Pair) -> None:
        self.identity(name).certificate.write_bytes(pair.certificate)
        self.identity(name).private.write_bytes(pair.private)


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    now = datetime.now(UTC)
    table, issuer = lab_in(tmp_path, now, free_port())
    elsewhere = tmp_path / "lab2"
    elsewhere.mkdir()
    (elsewhere / "lab.toml").write_text(Path(table.file).read_text())
    issuer.give(of_host(table, "lab2", NAMESPACE, ["ben"]), Store(elsewhere / "keys"), now)
    with ExitStack() as stack:
        yield Lab(table, issuer, load_hosts(elsewhere / "lab.toml"), stack)


def soon(holds: Callable[[], object]) -> bool:
    end = monotonic() + SOON_S
    while not holds():
        if monotonic() > end:
            return False
        sleep(0.02)
    return True


def test_processes_join_by_the_socket_and_by_tls(lab: Lab) -> None:
    lab.start()
    here, there = lab.join("goto"), lab.join("goto", "lab2")
    for one, other in ((here, there), (there, here)):
        assert one.wait_joined(SOON_S), one.missing
        assert other.wait_joined(SOON_S), other.missing


def test_a_command_without_a_table_finds_the_keys_of_the_society_on_this_computer(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab.start()
    monkeypatch.setenv("LOGNAME", "anna")
    command = lab.stack.enter_context(Endpoints(namespace=NAMESPACE).mesh())
    assert command.wait_joined(SOON_S), command.missing


def _expired(lab: Lab) -> None:
    """For so long that the robot's porter does not renew it."""
    before = datetime.now(UTC) - timedelta(days=40)
    lab.replace("goto", issue(lab.issuer.pair, "robot1/goto", before))


def _of_next_year(lab: Lab) -> None:
    later = datetime.now(UTC) + timedelta(days=365)
    lab.replace("goto", issue(lab.issuer.pair, "robot1/goto", later))


def _foreign(lab: Lab) -> None:
    """Both its authority and its certificate are of another lab."""
    now = datetime.now(UTC)
    other = create("lab", now)
    Store(lab.identity("goto").folder.parents[1]).authority.write_bytes(other.certificate)
    lab.replace("goto", issue(other, "robot1/goto", now))


def _mismatched(lab: Lab) -> None:
    other = issue(lab.issuer.pair, "robot1/goto", datetime.now(UTC))
    lab.identity("goto").private.write_bytes(other.private)


def _old(lab: Lab) -> None:
    """It was revoked before the robot agent started."""
    lab.issuer.revoke(["robot1/goto"], datetime.now(UTC))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_expired, "expired"),
        (_of_next_year, "is not valid before"),
        (_foreign, "the robot's certificate is of another authority"),
        (_mismatched, "is not the key of its certificate"),
        (_old, "the key was revoked or made anew"),
    ],
)
def test_a_process_that_the_robot_does_not_let_in_is_told_why(
    lab: Lab, spoil: Callable[[Lab], None], words: str
) -> None:
    spoil(lab)
    lab.start()
    process = lab.join("goto", "lab2")
    assert soon(lambda: words in process.missing), process.missing
    assert not process.wait_joined(0.0)


def test_a_process_without_keys_is_told_that_the_society_is_closed(lab: Lab) -> None:
    lab.start()
    endpoint = f"tcp/{str(lab.table.robots_router).partition('/')[2]}"
    process = lab.stack.enter_context(Endpoints(namespace=NAMESPACE, connect=(endpoint,)).mesh())
    assert soon(lambda: "is closed" in process.missing), process.missing
    assert not process.wait_joined(0.0)


def test_a_process_with_keys_is_told_that_the_society_is_open(lab: Lab) -> None:
    lab.stack.enter_context(Endpoints(namespace=NAMESPACE).mesh(router=True))
    process = lab.join("goto")
    assert soon(lambda: "is open, and this process has keys" in process.missing), process.missing
    assert not process.wait_joined(0.0)


def test_what_a_robot_does_not_know_yet_joins_once_it_does(lab: Lab) -> None:
    """A process waits, and needs no restart when its certificate is renewed."""
    _expired(lab)
    lab.start()
    process = lab.join("goto", "lab2")
    assert soon(lambda: "expired" in process.missing)
    goto = lab.identity("goto")
    now = datetime.now(UTC)
    lab.replace("goto", issue(lab.issuer.pair, "robot1/goto", now))
    assert process.wait_joined(SOON_S), (process.missing, goto)


def test_a_message_goes_from_one_computer_to_another(lab: Lab) -> None:
    lab.start()
    here, there = lab.join(VIEWER), lab.join("goto", "lab2")  # which may read logs
    assert here.wait_joined(SOON_S)
    assert there.wait_joined(SOON_S)
    arrived: list[str] = []
    here.subscribe("log/**", lambda key, _: arrived.append(key))
    key = "log/goto-0000000000000001"

    def sent() -> bool:
        there.publish(key, Log(20, "hello"))
        return key in arrived

    assert soon(sent)


def test_a_process_that_was_revoked_joins_by_a_new_key_without_being_started_again(
    lab: Lab,
) -> None:
    there = lab.join("goto", "lab2")
    lab.issuer.revoke([f"{NAMESPACE}/goto"], datetime.now(UTC))
    lab.start()
    assert soon(lambda: "goto" in there.missing and "revoked" in there.missing), there.missing
    assert not there.wait_joined(0.0)
    given = of_host(lab.table, "lab2", NAMESPACE, ["ben"])
    folder = lab.there.keys_folder
    assert folder is not None
    lab.issuer.give(given, Store(folder), datetime.now(UTC))
    assert there.wait_joined(SOON_S), there.missing
