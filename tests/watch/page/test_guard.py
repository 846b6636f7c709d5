"""Access checks of the page: hosts, origins, tokens."""

from __future__ import annotations

import pytest

from armadico.mesh.ports import LOOPBACK
from armadico.watch.page.guard import (
    Guard,
    GuardError,
    bearer,
    is_loopback,
    token_in,
)

TOKEN = "correct horse battery staple"
HERE = Guard.of(LOOPBACK, None)
OPEN = Guard.of("0.0.0.0", TOKEN, ("Lab", "lab.local"))


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8090", "localhost:8090", "localhost", "[::1]:8090", "192.168.1.5:1"]
)
def test_addresses_and_localhost_are_allowed_as_host(host: str) -> None:
    assert HERE.refusal(host, None) is None
    assert HERE.refusal(host, f"http://{host}") is None


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example:8090", "", "[", "lab"])
def test_other_names_are_refused_as_host(host: str) -> None:
    refusal = HERE.refusal(host, f"http://{host}")
    assert refusal is not None
    assert refusal.status == 403
    assert host in refusal.why


def test_without_a_host_it_is_refused() -> None:
    refusal = HERE.refusal(None, None)
    assert refusal is not None
    assert refusal.status == 403


def test_configured_names_are_allowed_as_host() -> None:
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
def test_a_page_of_another_server_is_refused(
    origin: str,
) -> None:
    refusal = HERE.refusal("127.0.0.1:8090", origin)
    assert refusal is not None
    assert refusal.status == 403


def test_a_society_with_keys_needs_a_token_on_loopback_too() -> None:
    with pytest.raises(GuardError, match="keys"):
        Guard.of(LOOPBACK, None, closed=True)
    assert not Guard.of(LOOPBACK, TOKEN, closed=True).may(None)


@pytest.mark.parametrize("given", ["\udcff" * len(TOKEN), "\ud800", TOKEN + "\udc80"])
def test_a_token_with_invalid_text_is_wrong(given: str) -> None:
    assert OPEN.admit(given) == OPEN.admit("wrong")


@pytest.mark.parametrize("address", ["0.0.0.0", "192.168.1.5", "::", "lab"])
def test_another_address_than_loopback_needs_a_token(address: str) -> None:
    assert not is_loopback(address)
    with pytest.raises(GuardError, match="token"):
        Guard.of(address, None)
    assert Guard.of(address, TOKEN).token == TOKEN


@pytest.mark.parametrize(("token", "named"), [("short", "16"), ("", "16"), ("ü" * 20, "ASCII")])
def test_short_tokens_and_tokens_that_are_not_ascii_are_refused(token: str, named: str) -> None:
    with pytest.raises(GuardError, match=named):
        Guard.of(LOOPBACK, token)


def test_a_token_as_subprotocol() -> None:
    assert token_in(["armadico.page"]) is None
    assert not OPEN.may(token_in(["token.%%%"]))


@pytest.mark.parametrize(
    ("header", "token"),
    [("Bearer abc", "abc"), ("bearer abc", "abc"), ("Basic abc", None), ("", None), (None, None)],
)
def test_a_token_in_a_header(header: str | None, token: str | None) -> None:
    assert bearer(header) == token
