from __future__ import annotations

import subprocess
from datetime import timedelta
from pathlib import Path

import pytest

from armadico.core.config_errors import ConfigError
from armadico.keys.authority import facts, is_pair
from armadico.keys.issuing import Issuer, archive
from armadico.keys.members import kind_of, of_agents, of_person, of_table
from armadico.keys.store import Store
from tests.keys.labs import NOW, lab_in


def test_a_table_gives_each_process_an_identity(tmp_path: Path) -> None:
    table, _ = lab_in(tmp_path)
    members = of_table(table, "robot1", ["anna"])
    assert members["robot1/robot"].agents == ("robot",)
    assert members["robot1/encoder+sonar"].hosts == ("lab1",)
    assert members["robot1/goto"].hosts == ("lab1", "lab2")
    assert members["robot1/encoder"].hosts == ("lab1", "lab2")  # lab2 may take it over
    assert "robot1/laser" not in members
    assert {name: kind_of(name) for name in members} == {n: m.kind for n, m in members.items()}


def test_an_identity_of_a_future_host_is_listed_before_it_is_issued(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    assert "robot1/launcher-lab2" in issuer.store.members()
    assert not issuer.store.identity("robot1", "launcher-lab2").certificate.exists()


def test_only_the_computer_of_the_authority_issues(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    issuer.store.authority_key.unlink()
    with pytest.raises(ConfigError, match=r"authority\.key is missing: .*armadico keys init"):
        Issuer.of(issuer.store)


def test_a_revoked_identity_gets_another_password_when_it_is_issued_again(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    goto = of_agents("robot1", ("goto",))
    before = issuer.store.checked("robot1", "goto").password.read_text()
    assert issuer.revoke(["robot1/goto"], NOW) == ["robot1/goto"]
    assert issuer.revoke(["robot1/goto"], NOW) == []
    issuer.store.users("robot1")
    assert before not in issuer.store.users("robot1").read_text()
    issuer.give([goto], issuer.store, NOW)
    again = issuer.store.checked("robot1", "goto").password.read_text()
    assert again != before
    assert f"robot1/goto:{again}" in issuer.store.users("robot1").read_text()


def test_a_second_computer_gets_the_password_and_a_key_of_its_own(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    laptop = Store(tmp_path / "laptop")
    issuer.give([of_person("robot1", "anna")], laptop, NOW)
    one, other = issuer.store.of("robot1/person-anna"), laptop.of("robot1/person-anna")
    assert one.password.read_text() == other.password.read_text()
    assert one.private.read_bytes() != other.private.read_bytes()


def test_renewing_keeps_key_and_password(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    goto = issuer.store.of("robot1/goto")
    before = goto.private.read_bytes(), goto.password.read_bytes()
    later = NOW + timedelta(hours=20)
    assert issuer.renew([goto], later) == (["robot1/goto"], [])
    assert (goto.private.read_bytes(), goto.password.read_bytes()) == before
    assert facts(goto.certificate.read_bytes()).ends == later + timedelta(hours=24)
    assert is_pair(goto.certificate.read_bytes(), goto.private.read_bytes())


def test_a_revoked_identity_is_not_renewed(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    issuer.revoke(["robot1/goto"], NOW)
    before = issuer.store.of("robot1/goto").certificate.read_bytes()
    renewed, (why,) = issuer.renew([issuer.store.of("robot1/goto")], NOW)
    assert (renewed, "was revoked" in why) == ([], True)
    assert issuer.store.of("robot1/goto").certificate.read_bytes() == before


def test_too_long_names_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    _, issuer = lab_in(tmp_path)
    before = issuer.store.members()
    with pytest.raises(ConfigError, match="use a shorter namespace"):
        issuer.give([of_agents("n" * 70, ("goto",))], issuer.store, NOW)
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
