from __future__ import annotations

import json
import stat
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.core.config_errors import ConfigError
from armadico.keys.members import of_host
from armadico.keys.store import (
    AUTHORITY_KEY,
    MEMBERS,
    SECRET,
    Issue,
    Member,
    Store,
)
from armadico.mesh.door import LONGEST_NAME, launcher, name_of, person
from tests.keys.labs import NOW, authority_in, lab_in


def test_only_their_user_can_read_any_file_of_keys(tmp_path: Path) -> None:
    lab_in(tmp_path)
    for path in (tmp_path / "keys", *(tmp_path / "keys").rglob("*")):
        expected = 0o700 if path.is_dir() else 0o600
        assert stat.S_IMODE(path.stat().st_mode) == expected, path


@pytest.mark.parametrize("file", ["private.key", "password"])
def test_a_key_that_others_can_read_is_refused_with_the_remedy(tmp_path: Path, file: str) -> None:
    _, issuer = lab_in(tmp_path)
    path = issuer.store.identity("robot1", "goto").folder / file
    path.chmod(0o640)
    with pytest.raises(ConfigError, match=rf"mode 0640\); expected 0600: chmod 600 {path}"):
        issuer.store.checked("robot1", "goto")


def test_a_folder_of_keys_that_others_can_enter_is_refused(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    issuer.store.folder.chmod(0o755)
    with pytest.raises(ConfigError, match="chmod 700"):
        issuer.store.checked("robot1", "goto")


def test_a_missing_key_is_named_with_the_command_that_makes_it(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    for name, command in (
        ("wander", "keys agent wander"),
        ("person-ben", "keys person ben"),
        ("launcher-lab9", "keys host lab9"),
    ):
        with pytest.raises(ConfigError, match=f"no key of robot1/{name} .*{command}"):
            issuer.store.checked("robot1", name)
    with pytest.raises(ConfigError, match="keys person ben --namespace lab/r2`"):
        issuer.store.checked("lab/r2", "person-ben")
    with pytest.raises(ConfigError, match="armadico keys init"):
        Store(tmp_path / "elsewhere").checked("robot1", "goto")


NAMES = st.text("abc", min_size=1, max_size=20)


@given(st.lists(NAMES, min_size=1, max_size=12, unique=True))
def test_a_group_has_one_name_in_any_order_and_it_fits(names: list[str]) -> None:
    assert name_of(names[::-1]) == name_of(names) == name_of([*names, names[0]])
    assert len(name_of(names)) <= LONGEST_NAME
    assert "/" not in name_of(names)


def test_a_part_of_a_group_has_the_groups_key(tmp_path: Path) -> None:
    store = authority_in(tmp_path / "keys")
    group = ("encoder", "goto", "sonar")
    for agents in (group, (*group, "avoid")):
        member = Member(f"robot1/{name_of(agents)}", "agent", agents)
        store.save(member, b"certificate", b"private", "password")
    assert store.of_agents("robot1", ("sonar", "encoder")) == name_of(group)
    assert store.of_agents("robot1", ("avoid", "goto")) == name_of((*group, "avoid"))
    assert store.of_agents("robot1", ("laser", "goto")) == "goto+laser"


@pytest.mark.parametrize("text", ["", "{", '[{"kind": "agent"}]', '[{"name": "a", "x": 1}]', "3"])
def test_a_damaged_list_is_named(tmp_path: Path, text: str) -> None:
    store = authority_in(tmp_path / "keys")
    (store.folder / MEMBERS).write_text(text)
    with pytest.raises(ConfigError, match=str(store.folder / MEMBERS)):
        store.members()


def test_the_router_knows_its_society_and_the_robots_beside_it_but_no_revoked_one(
    tmp_path: Path,
) -> None:
    store = authority_in(tmp_path / "keys")
    one, other = (Issue(0, ("a",)),), (Issue(0, revoked="2030-01-01"), Issue(1))
    members = [
        Member("lab/r1/robot", "robot", issues=one),
        Member("lab/r1/goto", "agent", issues=one),
        Member("lab/r1/avoid", "agent", issues=other[:1]),
        Member("lab/r1/wander", "agent", issues=other),
        Member("lab/r2/robot", "robot", issues=one),
        Member("lab/r2/goto", "agent", issues=one),
        Member("yard/r3/robot", "robot", issues=one),
        Member("r1/robot", "robot", issues=one),
    ]
    store.save_members({member.name: member for member in members})
    store.identity("lab/r1", "robot").folder.mkdir(parents=True)
    lines = store.users("lab/r1").read_text().splitlines()
    assert sorted(line.partition(":")[0] for line in lines) == [
        "lab/r1/goto",
        "lab/r1/robot",
        "lab/r1/wander@1",
        "lab/r2/robot",
    ]


def test_a_hosts_folder_has_neither_the_authoritys_key_nor_other_hosts_agents(
    tmp_path: Path,
) -> None:
    table, issuer = lab_in(tmp_path)
    lab2 = Store(tmp_path / "lab2")
    issuer.give(of_host(table, "lab2", "robot1", ["ben"]), "lab2", lab2, NOW)
    here = {path.name for path in lab2.folder.iterdir()}
    assert not here & {AUTHORITY_KEY, SECRET, MEMBERS}
    names = {identity.name.partition("/")[2] for identity in lab2.identities()}
    assert {"goto", "avoid", "encoder", "launcher-lab2", "person-ben"} <= names
    assert not names & {"robot", "sonar", "encoder+sonar", "launcher-lab1", "person-anna"}
    private = {path.read_bytes() for path in lab2.folder.rglob("private.key")}
    assert not private & {path.read_bytes() for path in issuer.store.folder.rglob("*.key")}


def test_the_robots_folder_has_what_its_router_needs(tmp_path: Path) -> None:
    table, issuer = lab_in(tmp_path)
    lab1 = Store(tmp_path / "lab1")
    issuer.give(of_host(table, "lab1", "robot1", ["anna"]), "lab1", lab1, NOW)
    assert not (lab1.folder / AUTHORITY_KEY).exists()
    assert lab1.members() == issuer.store.members()
    known = lab1.users("robot1").read_text().splitlines()
    assert f"robot1/goto:{issuer.store.password('robot1/goto')}" in known
    assert json.loads((lab1.folder / MEMBERS).read_text())


def test_long_names_of_hosts_and_users_stay_different() -> None:
    long = "the-computer-of-the-second-floor-of-the-house-"
    for named in (launcher, person):
        names = {named(long + str(number)) for number in range(10)}
        assert len(names) == 10
        assert all(len(name) <= LONGEST_NAME for name in names)


def test_keys_of_numbers_that_are_listed_no_more_are_void() -> None:
    """In older folders only the newest one was listed, and a key that was revoked had another."""
    member = Member("r1/goto", "agent", issues=(Issue(1, ("a",), revoked="2030-01-01"), Issue(3)))
    assert member.void == {"r1/goto", "r1/goto@1", "r1/goto@2"}
