from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from armadico.config.endpoints import Endpoints
from armadico.keys.authority import Pair, create, issue
from armadico.keys.checking import Checks
from armadico.keys.derived import doubts
from armadico.keys.door import open_door
from armadico.keys.issuing import Issuer
from armadico.keys.members import of_agents
from armadico.keys.store import Identity
from tests.keys.labs import NOW, lab_in, revoke

HOUR = timedelta(hours=1)


@pytest.fixture
def issuer(tmp_path: Path) -> Issuer:
    return lab_in(tmp_path)[1]


@pytest.fixture
def goto(issuer: Issuer) -> Identity:
    return issuer.store.of("robot1/goto")


def faults(issuer: Issuer, goto: Identity, after: timedelta = timedelta()) -> list[str]:
    return list(Checks(issuer.store, NOW + after).of(goto))


def test_fresh_keys_have_no_fault(issuer: Issuer) -> None:
    assert list(Checks(issuer.store, NOW).everything()) == []


@pytest.mark.parametrize(
    ("after", "words"),
    [
        (25 * HOUR, ["expired 2030-01-03 03:04 UTC, 60 min ago", "armadico keys renew"]),
        (400 * 24 * HOUR, ["days ago", "this computer's clock says 2031-02-06", "set it, if"]),
        (-2 * HOUR, ["not valid before 2030-01-02 02:04 UTC, in 60 min", "set the clock"]),
        (-365 * 24 * HOUR, ["in 365 days", "this computer's clock says 2029-01-02"]),
    ],
)
def test_a_wrong_time_is_named_with_the_file_and_since_when(
    issuer: Issuer, goto: Identity, after: timedelta, words: list[str]
) -> None:
    found = [line for line in faults(issuer, goto, after) if str(goto.certificate) in line]
    assert len(found) == 1
    assert all(word in found[0] for word in words), found


def test_the_last_hour_of_a_certificate_is_announced(issuer: Issuer, goto: Identity) -> None:
    def at(hours: float) -> str:
        return Checks(issuer.store, NOW + hours * HOUR).expiring(goto)

    assert at(22.9) == ""
    assert "expires in 30 min" in at(23.5)
    assert at(24.1) == ""  # then it is a fault


def _swap(issuer: Issuer, goto: Identity) -> None:
    other = issuer.store.of("robot1/person-anna")
    goto.private.write_bytes(other.private.read_bytes())


def _foreign(issuer: Issuer, goto: Identity) -> None:
    pair = issue(create("lab", NOW), goto.name, NOW)
    goto.certificate.write_bytes(pair.certificate)
    goto.private.write_bytes(pair.private)


def _another_name(issuer: Issuer, goto: Identity) -> None:
    pair: Pair = issue(issuer.pair, "robot2/goto", NOW)
    goto.certificate.write_bytes(pair.certificate)
    goto.private.write_bytes(pair.private)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_swap, "private.key is not the key of its certificate"),
        (_foreign, "certificate.pem is not of the authority in"),
        (_another_name, "certificate.pem is of robot2/goto, not of robot1/goto"),
        (lambda _, goto: goto.certificate.write_text("x"), "certificate.pem is not a certificate"),
        (lambda _, goto: goto.private.write_text("x"), "private.key is not a private key in PEM"),
        (lambda _, goto: goto.private.unlink(), "private.key: cannot be read"),
        (lambda _, goto: goto.private.chmod(0o604), "chmod 600"),
        (lambda issuer, _: issuer.store.authority.write_text("x"), "authority.pem is not a cert"),
    ],
)
def test_a_spoilt_key_is_named(
    issuer: Issuer, goto: Identity, spoil: Callable[[Issuer, Identity], None], words: str
) -> None:
    spoil(issuer, goto)
    assert any(words in line for line in faults(issuer, goto)), faults(issuer, goto)
    assert any(words in line for line in Checks(issuer.store, NOW).everything())


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("authority.key", b""),
        ("authority.key", create("lab", NOW).private),
        ("passwords.key", None),
        ("members.json", None),
        ("robot1/goto/password", None),
        ("robot1/goto/password", b"\xff"),
    ],
)
def test_a_file_that_is_damaged_or_gone_is_named_and_all_else_is_checked(
    issuer: Issuer, goto: Identity, name: str, data: bytes | None
) -> None:
    file = issuer.store.folder / name
    if data is None:
        file.unlink()
    else:
        file.write_bytes(data)
    goto.private.chmod(0o604)
    found = list(Checks(issuer.store, NOW).everything())
    assert any(line.startswith(f"{goto.private}: other users") for line in found), found
    assert any(str(file) in line or str(file.parent) + ":" in line for line in found), found


def test_a_key_that_a_restored_list_lacks_is_named(issuer: Issuer, goto: Identity) -> None:
    """The robot refuses it."""
    listed = issuer.store.members()
    del listed[goto.name]
    issuer.store.save_members(listed)
    found = list(Checks(issuer.store, NOW).everything())
    assert any(f"{goto.folder}: robot1/goto is not in the list" in line for line in found), found


@pytest.mark.parametrize("name", ["members.json", "robot1/rights.json"])
def test_a_list_or_table_that_was_cut_is_named_and_all_else_is_checked(
    issuer: Issuer, goto: Identity, name: str
) -> None:
    file = issuer.store.folder / name
    file.write_bytes(file.read_bytes()[:-40])
    goto.private.chmod(0o604)
    found = list(Checks(issuer.store, NOW).everything())
    assert any(line.startswith(f"{goto.private}: other users") for line in found), found
    assert any(line.startswith(f"{file}: cannot be read") for line in found), found
    (shown,) = doubts(issuer.store, "robot1", ())  # of `ps` and `doctor`
    assert shown.startswith(f"{file}: cannot be read")
    assert "armadico keys" in shown or "archive" in shown


def test_a_revoked_key_and_one_from_before_it_was_issued_again_are_named(issuer: Issuer) -> None:
    def everything() -> str:
        return "\n".join(Checks(issuer.store, NOW).everything())

    goto = issuer.store.of("robot1/goto")
    old = goto.password.read_text(), goto.certificate.read_text()
    revoke(issuer, goto.name)
    assert "robot1/goto was revoked 2030-01-02" in everything()
    issuer.give([of_agents("robot1", ("goto",))], "lab1", issuer.store, NOW)
    assert everything() == ""
    goto.password.write_text(old[0])
    assert "is not that of robot1/goto@2" in everything()
    goto.certificate.write_text(old[1])
    assert f"{goto.folder}: robot1/goto was revoked" in everything()


def test_on_the_robots_computer_a_key_that_the_router_does_not_know_is_named(
    issuer: Issuer, goto: Identity
) -> None:
    assert list(Checks(issuer.store, NOW).on_socket(goto)) == []  # it has not started yet
    issuer.store.users("robot1")
    late = NOW + 1000 * HOUR
    assert list(Checks(issuer.store, late).on_socket(goto)) == []  # the socket asks for no date
    revoke(issuer, goto.name)
    issuer.store.users("robot1")
    (line,) = Checks(issuer.store, NOW).on_socket(goto)
    assert "does not know this key" in line


@pytest.mark.parametrize("name", ["authority.pem", "robot1/robot/certificate.pem"])
def test_ps_and_doctor_name_what_lets_nobody_in_on_the_robots_computer(
    tmp_path: Path, name: str
) -> None:
    table, issuer = lab_in(tmp_path, datetime.now(UTC))
    door = open_door(Endpoints(namespace="robot1", table=table, name="lab1"), "goto")
    assert list(door.doubts(())) == []
    file = issuer.store.folder / name
    file.write_text("x")
    assert any(str(file) in line for line in door.doubts(()))
