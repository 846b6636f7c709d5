"""New certificates for present keys: from the authority's key, or from a robot's porter."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from armadico.core.config_errors import ConfigError
from armadico.keys import authority
from armadico.keys.asking import ask, renewed
from armadico.keys.door import _KeyDoor
from armadico.keys.expiry import LINKS, ending, validity
from armadico.keys.renewing import Renewing
from armadico.keys.store import Identity, Store, write_private
from armadico.mesh.zenoh import ZenohMesh

from .labs import NAMESPACE, Lab
from .porters import Door, works

DAY = 86_400.0


def elsewhere(lab: Lab, folder: Path, name: str = "goto") -> tuple[Store, Identity]:
    """The keys of a computer without the authority's."""
    store = Store(folder / "elsewhere")
    found = lab.store.identity(NAMESPACE, name)
    member = lab.store.members()[found.name]
    certificate, private = found.certificate.read_bytes(), found.private.read_bytes()
    identity = store.save(member, certificate, private, found.password.read_text())
    write_private(store.authority, lab.store.authority.read_bytes())
    return store, identity


def endpoint(door: Door) -> str:
    return "tls/{}:{}".format(*door.place)


def expired(lab: Lab, identity: Identity, ago: float) -> None:
    """Give an identity a certificate that expired so long ago, s."""
    public = authority.public_of(identity.private.read_bytes())
    at = datetime.fromtimestamp(datetime.now(UTC).timestamp() - ago - 3600.0, UTC)
    pair = authority.issue(lab.pair, identity.name, at, hours=1.0, public=public)
    write_private(identity.certificate, pair.certificate)


def test_the_validity_that_is_read_without_the_library_is_the_certificates(lab: Lab) -> None:
    certificate = lab.store.identity(NAMESPACE, "goto").certificate.read_bytes()
    about = authority.facts(certificate)
    assert validity(certificate) == (about.begins.timestamp(), about.ends.timestamp())
    assert validity(certificate).life == pytest.approx(DAY)
    with pytest.raises(ValueError, match="no certificate"):
        validity(b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n")


def test_a_days_certificate_is_renewed_in_its_last_third_and_announced_in_its_last_hour(
    lab: Lab,
) -> None:
    identity = lab.store.identity(NAMESPACE, "goto")
    ends = validity(identity.certificate.read_bytes()).ends
    clock = [ends - 0.34 * DAY]
    mesh = SimpleNamespace(
        where=SimpleNamespace(door=_KeyDoor(lab.store, identity), connect=()),
        joined_at="unixsock-stream/x",
        wait_joined=lambda _: True,
    )
    renewing = Renewing(cast("ZenohMesh", mesh), wall=lambda: clock[0])
    renewing.close()
    assert renewing.step()
    assert validity(identity.certificate.read_bytes()).ends == ends
    clock[0] = ends - 0.33 * DAY
    assert renewing.step()
    assert validity(identity.certificate.read_bytes()).ends > ends
    assert validity(identity.certificate.read_bytes()).announce_at == pytest.approx(
        clock[0] + DAY - 3600.0, abs=1.0
    )


def test_the_porter_renews_a_present_certificate(door: Door, tmp_path: Path) -> None:
    store, identity = elsewhere(door.lab, tmp_path)
    expired(door.lab, identity, -60.0)
    new = ask(store, identity, endpoint(door))
    assert authority.is_pair(new, identity.private.read_bytes())
    assert authority.facts(new).name == identity.name
    assert validity(new).ends > validity(identity.certificate.read_bytes()).ends + 3000.0


def test_where_the_authoritys_key_is_no_port_is_needed(lab: Lab) -> None:
    identity = lab.store.identity(NAMESPACE, "goto")
    expired(lab, identity, 3 * DAY)
    renewed(lab.store, identity, [])
    assert validity(identity.certificate.read_bytes()).ends > datetime.now(UTC).timestamp()


def test_what_is_not_renewed_is_named(door: Door, tmp_path: Path) -> None:
    lab = door.lab
    store, identity = elsewhere(lab, tmp_path)
    before = identity.certificate.read_bytes()

    expired(lab, identity, 31 * DAY)
    with pytest.raises(ConfigError, match="more than 30 days ago"):
        ask(store, identity, endpoint(door))

    write_private(identity.certificate, before)
    year = 365 * DAY
    with pytest.raises(ConfigError, match="compare the clocks"):
        ask(store, identity, endpoint(door), wall=lambda: datetime.now(UTC).timestamp() - year)

    with pytest.raises(ConfigError, match="gives no new certificate"):
        ask(store, identity, "tls/127.0.0.1:1")
    with pytest.raises(ConfigError, match="has no port of the robot"):
        renewed(store, identity, [])

    key = lab.store.authority_key.read_bytes()
    lab.store.authority_key.unlink()
    with pytest.raises(ConfigError, match="not on the robot's computer"):
        ask(store, identity, endpoint(door))

    write_private(lab.store.authority_key, key)
    lab.revoke("goto")
    with pytest.raises(ConfigError):
        ask(store, identity, endpoint(door))
    assert identity.certificate.read_bytes() == before


def test_an_expired_certificate_gets_a_new_one_and_no_link(door: Door, tmp_path: Path) -> None:
    router = door.start_router()
    _, identity = elsewhere(door.lab, tmp_path)
    expired(door.lab, identity, 60.0)
    pair = authority.Pair(identity.certificate.read_bytes(), identity.private.read_bytes())
    with pytest.raises(OSError, match="certificate expired"):
        door.connect(pair).recv(1)
    link = door.connect(pair, asks=True)
    link.sendall(b"forward")
    assert link.recv(10).startswith(b"-----BEGIN"[:10])
    assert not router.received


def test_elsewhere_the_computers_own_certificates_are_announced(lab: Lab, tmp_path: Path) -> None:
    store, identity = elsewhere(lab, tmp_path)
    now = datetime.now(UTC).timestamp()
    assert ending(store, NAMESPACE, now) == {}
    assert ending(store, NAMESPACE, now + DAY - 3500.0) == {
        identity.name: pytest.approx(3500, abs=2)
    }


def test_on_the_robots_computer_links_are_announced_and_its_own_certificate_weeks_before(
    door: Door, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    lab = door.lab
    monkeypatch.setattr("armadico.mesh.sockets.socket_of", lambda _: door.path)
    door.start_router()
    now = datetime.now(UTC).timestamp()
    links = door.path.with_suffix(LINKS)
    _, identity = elsewhere(lab, tmp_path)
    expired(lab, identity, -500.0)
    link = door.connect(
        authority.Pair(identity.certificate.read_bytes(), identity.private.read_bytes())
    )
    assert works(link)
    while identity.name not in (links.read_text() if links.exists() else ""):
        assert works(link)
    assert ending(lab.store, NAMESPACE, now) == {identity.name: pytest.approx(500, abs=2)}
    robots = lab.store.identity(NAMESPACE, "robot")
    later = now + 360 * DAY
    assert robots.name in ending(lab.store, NAMESPACE, later)
