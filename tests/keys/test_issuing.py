from __future__ import annotations

import fcntl
import json
import os
import subprocess
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

from armadico.core.config_errors import ConfigError
from armadico.keys.authority import facts, is_pair
from armadico.keys.authority import issue as make
from armadico.keys.checking import Checks
from armadico.keys.expiry import user_in
from armadico.keys.issuing import Issuer, archive
from armadico.keys.members import kind_of, of_agents, of_host, of_table
from armadico.keys.store import MEMBERS, Identity, Member, Store, user_of
from tests.keys.labs import NOW, authority_in, lab_in, revoke


def test_a_table_gives_each_process_an_identity(tmp_path: Path) -> None:
    table, _ = lab_in(tmp_path)
    members = of_table(table, "robot1", ["anna"])
    names = {host: {member.name for member in its} for host, its in members.items()}
    both = names["lab1"] & names["lab2"]
    assert {"robot1/robot", "robot1/encoder+sonar"} <= names["lab1"] - both
    assert {"robot1/goto", "robot1/encoder"} <= both  # lab2 may take encoder over
    assert "robot1/laser" not in names["lab1"] | names["lab2"]
    each = [member for its in members.values() for member in its]
    assert [kind_of(member.name) for member in each] == [member.kind for member in each]
    (robot,) = [member for member in each if member.kind == "robot"]
    assert robot.agents == ("robot",)


def test_an_identity_of_a_future_host_is_listed_before_it_is_issued(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    assert "robot1/launcher-lab2" in issuer.store.members()
    assert not issuer.store.identity("robot1", "launcher-lab2").certificate.exists()


def test_only_the_computer_of_the_authority_issues(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    issuer.store.authority_key.unlink()
    with pytest.raises(ConfigError, match=r"authority\.key is missing: .*armadico keys init"):
        Issuer.of(issuer.store)


def test_a_revoked_key_gets_another_user_and_password_when_it_is_made_again(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    goto = of_agents("robot1", ("goto",))
    before = issuer.store.checked("robot1", "goto").password.read_text()
    assert "robot1/goto" in revoke(issuer, "robot1/goto")
    assert revoke(issuer, "robot1/goto") == []
    assert before not in issuer.store.users("robot1").read_text()
    issuer.give([goto], "lab1", issuer.store, NOW)
    again = issuer.store.checked("robot1", "goto")
    user, password = user_in(again.certificate.read_bytes()), again.password.read_text()
    assert password != before
    assert f"{user}:{password}" in issuer.store.users("robot1").read_text().splitlines()


def test_each_computer_has_keys_and_passwords_of_its_own_also_of_shared_identities(
    tmp_path: Path,
) -> None:
    table, issuer = lab_in(tmp_path)
    lab2 = Store(tmp_path / "lab2")
    issuer.give(of_host(table, "lab2", "robot1", ["anna"]), "lab2", lab2, NOW)
    for name in ("goto", "page", "person-anna"):
        one, other = issuer.store.of(f"robot1/{name}"), lab2.of(f"robot1/{name}")
        assert (
            facts(one.certificate.read_bytes()).name != facts(other.certificate.read_bytes()).name
        )
        assert one.password.read_text() != other.password.read_text()
        assert one.private.read_bytes() != other.private.read_bytes()


def test_a_certificate_of_a_revoked_key_is_not_renewed_after_its_name_was_made_anew(
    tmp_path: Path,
) -> None:
    _, issuer = lab_in(tmp_path)
    goto = issuer.store.of("robot1/goto")
    stolen = goto.certificate.read_bytes()
    assert issuer.again(stolen, NOW)
    revoke(issuer, goto.name)
    with pytest.raises(ConfigError, match="robot1/goto was revoked"):
        issuer.again(stolen, NOW)
    issuer.give([of_agents("robot1", ("goto",))], "lab1", issuer.store, NOW)
    with pytest.raises(ConfigError, match="robot1/goto was revoked"):
        issuer.again(stolen, NOW)
    assert facts(issuer.again(goto.certificate.read_bytes(), NOW)).name != goto.name


def of_before(issuer: Issuer, issue: int) -> dict[str, str]:
    """Make a folder as it was before each computer had keys of its own; return the passwords."""
    store, passwords = issuer.store, {}
    rows = json.loads((store.folder / MEMBERS).read_text())
    for row in rows:
        del row["issues"]
        number = 0 if row["kind"] == "robot" else issue
        row |= {"hosts": ["lab1", "lab2"], "issue": number, "revoked": ""}
        identity = store.of(row["name"])
        if identity.certificate.exists():
            passwords[row["name"]] = password = store.password(user_of(row["name"], number))
            identity.password.write_text(password)
            pair = make(issuer.pair, identity.name, NOW)
            identity.certificate.write_bytes(pair.certificate)
            identity.private.write_bytes(pair.private)
    (store.folder / MEMBERS).write_text(json.dumps(rows))
    return passwords


def test_keys_of_a_folder_of_before_count_until_they_are_revoked(tmp_path: Path) -> None:
    table, issuer = lab_in(tmp_path)
    old = of_before(issuer, 0)
    store = issuer.store

    def known() -> list[str]:
        return store.users("robot1").read_text().splitlines()

    assert {f"{name}:{password}" for name, password in old.items()} <= {*known()}
    assert issuer.again(store.of("robot1/goto").certificate.read_bytes(), NOW)
    assert not [*Checks(store, NOW).everything()]
    # A new archive has keys of its own; the old ones count beside them.
    lab2 = Store(tmp_path / "lab2")
    issuer.give(of_host(table, "lab2", "robot1", []), "lab2", lab2, NOW)
    assert f"robot1/goto:{old['robot1/goto']}" in known()
    assert f"robot1/goto@1:{lab2.of('robot1/goto').password.read_text()}" in known()


def test_a_key_of_before_that_was_made_anew_once_is_mended_by_renewing(tmp_path: Path) -> None:
    """Its certificate does not tell that it is not the revoked one."""
    _, issuer = lab_in(tmp_path)
    old, goto = of_before(issuer, 2), issuer.store.of("robot1/goto")
    with pytest.raises(ConfigError, match="from before robot1/goto was revoked and made anew"):
        issuer.again(goto.certificate.read_bytes(), NOW)
    faults = [*Checks(issuer.store, NOW).everything()]
    assert any(str(goto.certificate) in line and "keys renew" in line for line in faults)
    _, refused = issuer.renew([*issuer.store.identities()], NOW)
    assert refused == []
    assert facts(goto.certificate.read_bytes()).name == "robot1/goto@2"
    assert goto.password.read_text() == old["robot1/goto"]
    assert not [*Checks(issuer.store, NOW).everything()]


def test_a_revocation_is_not_lost_while_other_commands_make_keys(tmp_path: Path) -> None:
    table, issuer = lab_in(tmp_path)
    members = of_host(table, "lab2", "robot1", [])

    def give(number: int) -> None:
        issuer.give(members, f"host{number}", Store(tmp_path / str(number)), NOW)

    def end(name: str) -> None:
        issuer.revoke([name], NOW)

    names = [member.name for member in members]
    with ThreadPoolExecutor() as pool:
        done = [pool.submit(give, number) for number in range(6)]
        done += [pool.submit(end, name) for name in names]
        for each in done:
            each.result()
    listed = issuer.store.members()
    assert not [name for name in names if name in listed[name].users]
    assert all(len(listed[name].users) >= 6 for name in names)


def test_no_namespace_or_name_can_be_taken_for_the_number_of_a_key(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    for name in ("robot1@2/goto", "robot1/goto@x", "robot1/goto@1@2", "robot1/@1/goto"):
        with pytest.raises(ConfigError, match="cannot be a common name"):
            issuer.give([Member(name, "agent", ("goto",))], "lab1", issuer.store, NOW)


def test_a_private_key_of_before_a_revocation_is_not_renewed_by_hand(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    revoke(issuer, "robot1/goto")
    laptop = Store(tmp_path / "laptop")
    issuer.give([of_agents("robot1", ("goto",))], "laptop", laptop, NOW)
    goto = issuer.store.of("robot1/goto")  # left here
    renewed, (why,) = issuer.renew([goto], NOW)
    assert (renewed, "was revoked" in why) == ([], True)


def test_renewing_keeps_key_and_password(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    goto = issuer.store.of("robot1/goto")
    before = goto.private.read_bytes(), goto.password.read_bytes()
    later = NOW + timedelta(hours=20)
    assert issuer.renew([goto], later) == (["robot1/goto"], [])
    assert (goto.private.read_bytes(), goto.password.read_bytes()) == before
    assert facts(goto.certificate.read_bytes()).ends == later + timedelta(hours=24)
    assert is_pair(goto.certificate.read_bytes(), goto.private.read_bytes())


def test_too_long_names_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    before = issuer.store.members()
    with pytest.raises(ConfigError, match="use a shorter namespace"):
        issuer.give([of_agents("n" * 70, ("goto",))], "lab1", issuer.store, NOW)
    assert issuer.store.members() == before


def test_an_archive_is_private_and_so_is_what_it_unpacks(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    file = tmp_path / "lab2.tar"
    file.touch(0o644)
    archive(issuer.store.folder, "keys", file)
    assert file.stat().st_mode & 0o777 == 0o600
    there = tmp_path / "there"
    there.mkdir()
    subprocess.run(["tar", "-xf", str(file), "-C", str(there)], check=True)
    Store(there / "keys").checked("robot1", "goto")


@pytest.mark.parametrize(
    "name", ["person-follower", "guest-book", "launcher-lab1", "page", "viewer"]
)
def test_no_agent_gets_the_identity_of_another_kind_of_process(name: str) -> None:
    with pytest.raises(ConfigError, match=f"an agent called '{name}' could be taken for another"):
        of_agents("robot1", (name,))


def test_keys_are_written_while_no_other_command_writes_some(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise two could leave the private key of one with the certificate of the other."""
    table, issuer = lab_in(tmp_path)
    save, free = Store.save, list[str]()

    def look(store: Store, member: Member, *rest: Any) -> Identity:
        folder = os.open(issuer.store.folder, os.O_RDONLY)
        with suppress(BlockingIOError):
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
            free.append(member.name)
        os.close(folder)
        return save(store, member, *rest)

    monkeypatch.setattr(Store, "save", look)
    issuer.give(of_host(table, "lab1", "robot1", ["anna"]), "lab1", issuer.store, NOW)
    assert issuer.renew(issuer.store.identities(), NOW)[0]
    assert free == []


def test_an_authority_that_was_replaced_meanwhile_issues_nothing(tmp_path: Path) -> None:
    table, issuer = lab_in(tmp_path)
    authority_in(tmp_path / "keys")
    goto = issuer.store.of("robot1/goto")
    before = goto.certificate.read_bytes()
    with pytest.raises(ConfigError, match="meanwhile"):
        issuer.give(of_host(table, "lab1", "robot1", ["anna"]), "lab1", issuer.store, NOW)
    with pytest.raises(ConfigError, match="meanwhile"):
        issuer.renew([goto], NOW)
    assert goto.certificate.read_bytes() == before


def test_the_robots_certificate_alone_is_a_routers(tmp_path: Path) -> None:
    """A member with another one could pose as the robot before other computers."""
    table, issuer = lab_in(tmp_path)
    lab2 = Store(tmp_path / "lab2")
    addresses = table.host("lab1").addresses
    members = of_host(table, "lab2", "robot1", ["anna"])
    issuer.give(members, "lab2", lab2, NOW, addresses=addresses)
    issuer.renew(issuer.store.identities(), NOW, addresses=addresses)
    found = [*issuer.store.identities(), *lab2.identities()]
    assert {each.last for each in found if facts(each.certificate.read_bytes()).server} == {"robot"}
