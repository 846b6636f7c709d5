from __future__ import annotations

import string
from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509
from hypothesis import given
from hypothesis import strategies as st

from armadico.keys.authority import (
    KeyFileError,
    create,
    facts,
    is_issued_by,
    is_pair,
    issue,
)
from tests.keys.labs import NOW, named

AUTHORITY = create("lab", NOW)
OTHER = create("lab", NOW)

NAMES = st.text(string.ascii_letters + string.digits + "._+-/", min_size=1, max_size=64)
TIMES = st.datetimes(datetime(2000, 1, 1), datetime(2045, 1, 1), timezones=st.just(UTC))


@given(NAMES, TIMES, st.floats(0.01, 1000.0))
def test_a_certificate_has_the_name_and_the_time_that_it_was_issued_for(
    name: str, now: datetime, hours: float
) -> None:
    pair = issue(AUTHORITY, name, now, hours=hours)
    about = facts(pair.certificate)
    assert about.name == name
    assert about.begins <= now <= about.ends
    assert abs(about.ends - now - timedelta(hours=hours)) < timedelta(seconds=1)
    assert is_issued_by(pair.certificate, AUTHORITY.certificate)
    assert not is_issued_by(pair.certificate, OTHER.certificate)
    assert is_pair(pair.certificate, pair.private)


@pytest.mark.parametrize("name", ["", "robot1/goto\nrobot1/robot", "robot1:x", "a" * 65, "r*"])
def test_names_that_a_rule_or_the_dictionary_would_read_otherwise_are_refused(name: str) -> None:
    with pytest.raises(KeyFileError, match="cannot be a common name"):
        issue(AUTHORITY, name, NOW)


def test_only_a_certificate_with_addresses_is_a_servers() -> None:
    client = issue(AUTHORITY, "robot1/goto", NOW)
    router = issue(AUTHORITY, "robot1/robot", NOW, addresses=("lab1", "10.0.0.2", "::1"))
    assert (facts(client.certificate).server, facts(router.certificate).server) == (False, True)
    parsed = x509.load_pem_x509_certificate(router.certificate)
    names = parsed.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["lab1"]
    assert [str(a) for a in names.get_values_for_type(x509.IPAddress)] == ["10.0.0.2", "::1"]


def test_no_certificate_but_the_authoritys_issues_others() -> None:
    parsed = x509.load_pem_x509_certificate(issue(AUTHORITY, "robot1/goto", NOW).certificate)
    assert not parsed.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    assert not parsed.extensions.get_extension_for_class(x509.KeyUsage).value.key_cert_sign


@pytest.mark.parametrize("what", [b"", b"x", AUTHORITY.private, AUTHORITY.certificate[:200]])
def test_what_is_no_certificate_or_key_is_named(what: bytes) -> None:
    with pytest.raises(KeyFileError, match="is not a certificate in PEM"):
        facts(what)
    with pytest.raises(KeyFileError, match="is not a private key in PEM"):
        is_pair(AUTHORITY.certificate, what[:50])


def test_a_certificate_with_several_names_has_none() -> None:
    """Zenoh and the porter could each take another one."""
    assert facts(named(AUTHORITY, "r/goto").certificate).name == "r/goto"
    assert facts(named(AUTHORITY, "r/goto", "r/robot").certificate).name == ""
