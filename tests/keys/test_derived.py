"""The stored table of rights: it is made with the keys, and a stale one is named."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.agents.driving.goto import Goto
from armadico.config.endpoints import Endpoints
from armadico.config.hosts import HostTable
from armadico.core.config_errors import ConfigError
from armadico.keys.authority import create
from armadico.keys.checking import Checks
from armadico.keys.derived import access_control, derive_again, doubts, file_of, load, save
from armadico.keys.door import open_door
from armadico.keys.issuing import Issuer
from armadico.keys.rights import Does
from armadico.keys.store import Member, Store
from armadico.mobile.messages import Planned

NAMESPACE = "robot1"
NOW = datetime.now(UTC)
LABELS = (("avoid", "goto"), ("encoder",))


@pytest.fixture
def store(tmp_path: Path) -> Store:
    found = Store(tmp_path / "keys")
    pair = create("lab", NOW)
    found.begin(pair.certificate, pair.private)
    members = [
        Member(f"{NAMESPACE}/robot", "robot", ("robot",)),
        Member(f"{NAMESPACE}/avoid+goto", "agent", ("avoid", "goto")),
        Member(f"{NAMESPACE}/encoder", "agent", ("encoder",)),
    ]
    Issuer.of(found).give(members, "lab1", found, NOW)
    return found


def test_making_keys_derives_the_rights(store: Store) -> None:
    table = load(store, NAMESPACE)
    assert table.why("avoid+goto", Does.PUT, "robot/cmd/goto-1f")
    assert not [*doubts(store, NAMESPACE, LABELS)]
    users = [each["id"] for each in access_control(store, NAMESPACE)["subjects"]]
    assert users == [f"{NAMESPACE}/avoid+goto", f"{NAMESPACE}/encoder"]


def test_each_key_of_an_identity_has_its_rights_and_a_revoked_one_has_none(store: Store) -> None:
    issuer, encoder = Issuer.of(store), f"{NAMESPACE}/encoder"

    def users() -> dict[str, list[str]]:
        subjects = access_control(store, NAMESPACE)["subjects"]
        return {each["id"]: each["usernames"] for each in subjects}

    issuer.give([Member(encoder, "agent", ("encoder",))], "lab2", store, NOW)
    assert users()[encoder] == [encoder, f"{encoder}@1"]
    issuer.revoke([encoder], NOW)
    assert users()[encoder] == [f"{encoder}@1"]
    issuer.revoke([f"{encoder}@1"], NOW)
    assert encoder not in users(), "a subject without users would be everybody"
    assert all(users().values())


def test_another_member_derives_them_again(store: Store) -> None:
    sonar = Member(f"{NAMESPACE}/sonar", "agent", ("sonar",))
    Issuer.of(store).give([sonar], "lab1", store, NOW)
    assert load(store, NAMESPACE).why("sonar", Does.PUT, "sonar/obstacles")


def test_a_computer_of_agents_gets_the_table_with_its_keys(store: Store, tmp_path: Path) -> None:
    there = Store(tmp_path / "there")
    encoder = Member(f"{NAMESPACE}/encoder", "agent", ("encoder",))
    Issuer.of(store).give([encoder], "lab2", there, NOW)
    assert load(there, NAMESPACE) == load(store, NAMESPACE)


def test_an_agent_that_was_upgraded_is_named_until_the_table_is_derived_again(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Goto, "provides", (Planned,))
    (found,) = doubts(store, NAMESPACE, LABELS)
    assert "avoid+goto lacks one right, such as publishes path/planned" in found
    assert "goto.py" in found
    assert "armadico keys rights --write" in found
    assert found in [*Checks(store, NOW).everything()]
    derive_again(store, NAMESPACE)
    assert not [*doubts(store, NAMESPACE, LABELS)]


def test_a_surplus_right_is_named_too(store: Store) -> None:
    table = load(store, NAMESPACE)
    more = table.rights[0]._replace(identity="encoder", key="robot/cmd/encoder-$*", does=Does.PUT)
    save(store, NAMESPACE, replace(table, rights=(*table.rights, more)))
    (found,) = doubts(store, NAMESPACE, LABELS)
    assert "encoder has one right that its class does not declare" in found


@pytest.mark.parametrize("text", [None, "{"])
def test_a_missing_or_damaged_table_is_named_with_what_to_do(
    store: Store, text: str | None
) -> None:
    path = file_of(store, NAMESPACE)
    path.unlink() if text is None else path.write_text(text)
    with pytest.raises(ConfigError, match="armadico keys rights --write"):
        access_control(store, NAMESPACE)
    assert [*doubts(store, NAMESPACE, LABELS)]


def test_an_agent_that_is_not_installed_has_no_rights_and_is_named(store: Store) -> None:
    stranger = Member(f"{NAMESPACE}/stranger", "agent", ("stranger",))
    store.save_members(store.members() | {stranger.name: stranger})
    with pytest.raises(ConfigError, match="no rights for the agent stranger"):
        derive_again(store, NAMESPACE)


def test_a_process_is_told_what_the_router_will_drop(store: Store) -> None:
    where = Endpoints(namespace=NAMESPACE, table=HostTable({}, keys=str(store.folder)))
    door = open_door(where, "avoid+goto")
    assert door.forbidden("put", "robot/cmd/goto-1f") == ""
    told = door.forbidden("put", "robot/cmd/encoder-1f")
    assert "robot1/avoid+goto has no right to put robot/cmd/encoder-1f" in told
    assert door.may_be_critical("avoid-1f", "wheels")
    assert not door.may_be_critical("goto-1f", "wheels")
    file_of(store, NAMESPACE).unlink()
    assert door.forbidden("put", "robot/cmd/encoder-1f") == ""
    assert not door.may_be_critical("avoid-1f", "wheels")
