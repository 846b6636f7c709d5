from __future__ import annotations

from collections.abc import Collection
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from armadico.keys.authority import create, issue
from armadico.keys.issuing import Issuer
from armadico.keys.members import of_agents
from armadico.keys.signing import Verifier, sign
from tests.keys.labs import NOW, lab_in, revoke

DATA = b"robot/stop 7"


@pytest.fixture(scope="module")
def issuer(tmp_path_factory: pytest.TempPathFactory) -> Issuer:
    return lab_in(tmp_path_factory.mktemp("lab"))[1]


def verifier(issuer: Issuer, now: datetime = NOW, void: Collection[str] | None = ()) -> Verifier:
    return Verifier("robot1", issuer.store.authority, lambda: now, lambda: void)


def test_a_signature_is_its_authors_alone(issuer: Issuer) -> None:
    signed = sign(issuer.store.of("robot1/goto"), DATA)
    verify = verifier(issuer)
    assert verify("goto", DATA, signed)
    assert not verify("avoid", DATA, signed)
    assert not verify("goto", DATA + b"1", signed)
    assert not Verifier("robot2", issuer.store.authority, lambda: NOW, set)("goto", DATA, signed)


def test_a_signature_of_a_revoked_key_does_not_count_and_one_of_the_next_key_does(
    tmp_path: Path,
) -> None:
    _, issuer = lab_in(tmp_path)
    name = "robot1/goto"
    goto = issuer.store.of(name)
    revoked = sign(goto, DATA)
    revoke(issuer, name)
    issuer.give([of_agents("robot1", ("goto",))], "lab1", issuer.store, NOW)
    verify = verifier(issuer, void=issuer.store.members()[name].void)
    assert not verify("goto", DATA, revoked)
    assert verify("goto", DATA, sign(goto, DATA))


def test_no_signature_counts_while_it_is_not_known_which_keys_are_revoked(issuer: Issuer) -> None:
    signed = sign(issuer.store.of("robot1/goto"), DATA)
    assert not verifier(issuer, void=None)("goto", DATA, signed)


@given(st.integers(0, 2000), st.integers(1, 255))
@example(14, 128)  # a serial number below zero, of which the library warns
@example(11, 1)  # a version of certificates that does not exist
def test_a_changed_signature_does_not_count(issuer: Issuer, at: int, by: int) -> None:
    signed = bytearray(sign(issuer.store.of("robot1/goto"), DATA))
    signed[at % len(signed)] ^= by
    assert not verifier(issuer)("goto", DATA, bytes(signed))


def test_a_signature_counts_as_long_as_its_certificate(issuer: Issuer) -> None:
    signed = sign(issuer.store.of("robot1/goto"), DATA)
    for hours, counts in ((-2, False), (0, True), (23, True), (25, False)):
        assert verifier(issuer, NOW + timedelta(hours=hours))("goto", DATA, signed) is counts


def test_another_authoritys_signature_does_not_count(issuer: Issuer, tmp_path: Path) -> None:
    goto = issuer.store.of("robot1/goto")
    pair = issue(create("lab", NOW), goto.name, NOW)
    forged = type(goto)(goto.name, tmp_path)
    forged.certificate.write_bytes(pair.certificate)
    forged.private.write_bytes(pair.private)
    assert not verifier(issuer)("goto", DATA, sign(forged, DATA))
