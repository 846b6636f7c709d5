"""Who may use the page: hosts, origins, tokens."""

from __future__ import annotations

import pytest

from armadico.gateways.page.guard import (
    Guard,
    GuardError,
    Refusal,
    bearer,
    is_loopback,
    subprotocol,
    token_in,
)
from armadico.mesh.ports import LOOPBACK

TOKEN = "correct horse battery staple"
HERE = Guard.of(LOOPBACK, None)
OPEN = Guard.of("0.0.0.0", TOKEN, ("Lab", "lab.local"))


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8090", "localhost:8090", "localhost", "[::1]:8090", "192.168.1.5:1"]
)
def test_this_machine_may_be_asked_for_by_address_or_as_localhost(host: str) -> None:
    assert HERE.refusal(host, None) is None
    assert HERE.refusal(host, f"http://{host}") is None


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example:8090", "", "[", "lab"])
def test_by_another_name_it_is_refused_since_anybodys_name_may_lead_here(host: str) -> None:
    refusal = HERE.refusal(host, f"http://{host}")
    assert refusal is not None
    assert refusal.status == 403
    assert host in refusal.why


def test_without_a_host_it_is_refused() -> None:
    assert HERE.refusal(None, None) == Refusal(403, "this server is not called nothing")


def test_its_own_names_may_be_told() -> None:
    assert OPEN.refusal("lab:8090", "http://lab:8090") is None
    assert OPEN.refusal("LAB.local:8090", "https://lab.local:8090") is None
    assert OPEN.refusal("labs:8090", None) is not None


@pytest.mark.parametrize(
    "origin",
    [
        *("http://evil.example", "http://127.0.0.1:3000", "http://localhost:8090", "null", ""),
        *("file://127.0.0.1:8090", "http://127.0.0.1:8090.evil.example", "http://["),
    ],
)
def test_a_page_from_elsewhere_is_refused_one_of_this_machines_other_servers_too(
    origin: str,
) -> None:
    refusal = HERE.refusal("127.0.0.1:8090", origin)
    assert refusal is not None
    assert refusal.status == 403


def test_what_is_repeated_of_a_stranger_is_short_and_printable() -> None:
    refusal = HERE.refusal("\x1b[2J" + "x" * 1000, None)
    assert refusal is not None
    assert refusal.why.isprintable()
    assert len(refusal.why) < 120


def test_on_loopback_no_token_is_needed() -> None:
    assert HERE.admit(None) is None


@pytest.mark.parametrize(("given", "why"), [(None, "a token is needed"), ("", "a token is needed")])
def test_without_a_token_it_is_said_where_it_is(given: str | None, why: str) -> None:
    refusal = OPEN.admit(given)
    assert refusal is not None
    assert (refusal.status, refusal.why.startswith(why)) == (401, True)


def test_a_wrong_token_is_refused_and_the_right_one_is_not() -> None:
    assert OPEN.admit(TOKEN[:-1]) == Refusal(401, "this token is not the right one")
    assert OPEN.admit("ünbekannt") == Refusal(401, "this token is not the right one")
    assert OPEN.admit(TOKEN) is None


@pytest.mark.parametrize("given", ["\udcff" * len(TOKEN), "\ud800", TOKEN + "\udc80"])
def test_a_token_of_bytes_that_are_no_text_is_a_wrong_one(given: str) -> None:
    assert OPEN.admit(given) == OPEN.admit("wrong")


def test_no_address_is_not_everybodys() -> None:
    with pytest.raises(GuardError, match=r"0\.0\.0\.0 is for everybody"):
        Guard.of("", TOKEN, ("",))


@pytest.mark.parametrize("address", ["0.0.0.0", "192.168.1.5", "::", "lab"])
def test_another_address_than_loopback_needs_a_token(address: str) -> None:
    assert not is_loopback(address)
    with pytest.raises(GuardError, match="needs a token"):
        Guard.of(address, None)
    assert Guard.of(address, TOKEN).token == TOKEN


@pytest.mark.parametrize("address", ["127.0.0.1", "127.3.2.1", "::1", "localhost"])
def test_loopback_needs_none(address: str) -> None:
    assert Guard.of(address, None).token == ""


@pytest.mark.parametrize(
    ("token", "why"), [("short", "at least 16"), ("", "at least 16"), ("ü" * 20, "ASCII")]
)
def test_a_token_that_can_be_guessed_or_not_be_sent_is_none(token: str, why: str) -> None:
    with pytest.raises(GuardError, match=why):
        Guard.of(LOOPBACK, token)


def test_a_token_goes_through_a_subprotocol() -> None:
    assert token_in(["armadico.page", subprotocol(TOKEN)]) == TOKEN
    assert token_in(["armadico.page"]) is None
    assert OPEN.admit(token_in(["token.%%%"])) is not None


@pytest.mark.parametrize(
    ("header", "token"),
    [("Bearer abc", "abc"), ("bearer abc", "abc"), ("Basic abc", None), ("", None), (None, None)],
)
def test_a_token_in_a_header(header: str | None, token: str | None) -> None:
    assert bearer(header) == token
