"""What the commands of keys tell a person who runs them again, or has lost a file."""

from __future__ import annotations

import itertools
import json
import re
import shutil
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import pytest

from armadico import cli
from armadico.cli import options
from armadico.keys import derived, store
from armadico.keys.checking import Checks
from armadico.keys.expiry import user_in
from armadico.keys.store import MEMBERS, Store, write_private


def test_keys_that_exist_are_named_and_the_authority_is_left_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "lab.toml"
    table.write_text('keys = "keys"\n[lab1]\nrouter = "tcp/127.0.0.1:7447"\nagents = ["robot"]\n')

    def keys(*words: str) -> str:
        assert cli.main(["keys", *words, "--hosts", str(table), "--host", "lab1"]) == 0
        return capsys.readouterr().out

    authority = tmp_path / "keys" / "authority.key"
    assert "already" not in keys("init")
    first = authority.read_bytes()
    keys("person", "ben")
    again = keys("init")
    assert authority.read_bytes() == first
    assert "the authority exists already and was left alone" in again
    assert "1 left alone" in again, "the key of ben"
    assert "already" not in keys("init", "--anew")
    assert authority.read_bytes() != first


def test_a_list_of_identities_that_was_cut_is_named_by_doctor_without_a_society(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    table = tmp_path / "lab.toml"
    table.write_text('keys = "keys"\n[lab1]\nrouter = "tcp/127.0.0.1:1"\nagents = ["robot"]\n')
    words = ["--hosts", str(table), "--host", "lab1"]
    assert cli.main(["keys", "init", *words]) == 0
    members = tmp_path / "keys" / "members.json"
    members.write_bytes(members.read_bytes()[:100])
    capsys.readouterr()
    assert cli.main(["doctor", *words]) == 1
    assert f"keys: {members}: cannot be read" in capsys.readouterr().out


TABLE = """\
keys = "keys"
[lab1]
router = "tcp/127.0.0.1:7447"
agents = ["robot", "encoder", "goto"]
[lab2]
address = "127.0.0.2"
agents = ["goto"]
[desk]
address = "127.0.0.3"
"""


class Lab:
    """A lab of three computers whose keys were given out, and one person's laptop."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder, self._capsys = folder, capsys
        (folder / "lab.toml").write_text(TABLE)
        self.store = Store(folder / "keys")
        self.keys("init", "--person", "olga")
        for host in ("lab2", "desk"):
            self.keys("host", host, "--person", "olga", "--out", str(folder / host))
        self.keys("person", "anna", "--out", str(folder / "anna"))

    def keys(self, *words: str, code: int = 0) -> str:
        """Run a verb; return what it prints."""
        self._capsys.readouterr()
        table = str(self.folder / "lab.toml")
        found = cli.main(["keys", *words, "--hosts", table, "--host", "lab1", "--namespace", "r"])
        out, err = self._capsys.readouterr()
        assert found == code, (words, out, err)
        return out + err

    def count(self, holder: str) -> set[str]:
        """The keys in the folder of a computer or an archive that the robot admits."""
        store = self.store if holder == "lab1" else Store(self.folder / holder)
        admitted = self.store.users("r").read_text().splitlines()
        return {
            identity.last
            for identity in store.identities()
            for user in [user_in(identity.certificate.read_bytes())]
            if f"{user}:{identity.password.read_text()}" in admitted
        }


@pytest.fixture
def lab(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Lab:
    return Lab(tmp_path, capsys)


def test_what_a_computer_that_is_no_host_of_the_table_lacks_is_not_known(
    lab: Lab, capsys: pytest.CaptureFixture[str]
) -> None:
    text = TABLE.replace('"keys"', '"anna"').replace("127.0.0.", "198.51.100.")
    (lab.folder / "laptop.toml").write_text(text)
    words = ["--hosts", str(lab.folder / "laptop.toml"), "--namespace", "r"]
    capsys.readouterr()
    assert cli.main(["keys", "check", *words]) == options.UNKNOWN
    out = capsys.readouterr().out
    assert "not known" in out
    assert "nothing is wrong" not in out
    assert cli.main(["keys", "check", "--json", *words]) == options.UNKNOWN
    (doubt,) = json.loads(capsys.readouterr().out)
    assert "not known" in doubt
    (key, *_) = (each.private for each in Store(lab.folder / "anna").identities())
    key.chmod(0o644)
    assert cli.main(["keys", "check", *words]) == options.FAILED, "what is wrong comes first"


def test_nothing_of_a_revoked_persons_archive_counts_and_all_else_does(lab: Lab) -> None:
    others = {holder: lab.count(holder) for holder in ("lab1", "lab2", "desk")}
    assert {"person-anna", "page", "mcp", "viewer", "ros2"} <= lab.count("anna")
    lab.keys("revoke", "person-anna")
    assert lab.count("anna") == set()
    assert {holder: lab.count(holder) for holder in others} == others


def test_nothing_of_a_revoked_computer_counts_and_the_others_drive_and_stop(lab: Lab) -> None:
    others = {holder: lab.count(holder) for holder in ("lab1", "desk", "anna")}
    assert {"robot", "encoder", "goto", "page"} <= others["lab1"]
    out = lab.keys("revoke", "lab2")
    (line,) = [line for line in out.splitlines() if line.startswith("lab2 loses ")]
    assert "goto," in line
    assert "`armadico keys host lab2 --person olga`" in line
    assert out.index(line) < out.index("r/goto@1 is revoked")
    assert lab.count("lab2") == set()
    assert {holder: lab.count(holder) for holder in others} == others
    lab.keys("host", "lab2", "--out", str(lab.folder / "again"))
    assert "goto" in lab.count("again")
    assert lab.count("lab2") == set()


def test_one_key_of_an_agent_is_revoked_or_all_of_them(lab: Lab) -> None:
    lab.keys("revoke", "goto@1")  # lab2's
    assert "goto" in lab.count("lab1")
    assert "goto" not in lab.count("lab2")
    out = lab.keys("revoke", "goto")
    assert "lab1 loses goto; new keys for it: `armadico keys host lab1`" in out
    assert "goto" not in lab.count("lab1")


def test_a_client_program_has_one_key_which_is_revoked_without_the_others(lab: Lab) -> None:
    for name in ("claude", "other"):
        told = lab.keys("client", name, "--out", str(lab.folder / name))
        assert f'[clients."mcp-{name}"]' in told
        assert lab.count(name) == {f"mcp-{name}"}
    out = lab.keys("revoke", "mcp-claude")
    assert "`armadico keys client claude --out FILE`" in out
    assert (lab.count("claude"), lab.count("other")) == (set(), {"mcp-other"})
    assert "mcp" in lab.count("lab1")
    assert "'a b': expected a name of letters" in lab.keys("client", "a b", code=2)
    assert "at most 36" in lab.keys("client", "x" * 37, code=2)


def test_a_person_who_also_used_a_computer_is_out_and_the_computers_keys_are_named(
    lab: Lab,
) -> None:
    out = lab.keys("revoke", "person-olga")
    assert not any("person-olga" in lab.count(holder) for holder in ("lab1", "lab2", "desk"))
    assert "page" in lab.count("desk")
    assert "person-olga had a key on desk, whose other keys stay valid" in out
    assert "`armadico keys revoke desk`" in out


def test_shared_keys_of_an_older_folder_are_revoked_once_the_other_computers_have_new_ones(
    lab: Lab,
) -> None:
    file = lab.store.folder / MEMBERS
    rows = json.loads(file.read_text())
    for row in rows:
        row["hosts"] = sorted({holder for each in row.pop("issues") for holder in each["holders"]})
        row |= {"issue": 0, "revoked": ""}
    file.write_text(json.dumps(rows))
    shared = {f"{row['name']}:" for row in rows if "lab2" in row["hosts"]}

    def admitted() -> set[str]:
        users = lab.store.users("r").read_text().splitlines()
        return {begin for begin in shared for user in users if user.startswith(begin)}

    assert "r/goto:" in shared == admitted()
    out = lab.keys("revoke", "lab2", code=2)
    for host in ("lab1", "desk"):
        assert f"`armadico keys host {host} --person olga`" in out
    assert "nothing was revoked" in out
    assert "--yes" in out
    assert admitted() == shared

    lab.keys("host", "lab1", "--person", "olga")
    lab.keys("host", "desk", "--person", "olga", "--out", str(lab.folder / "desk2"))
    lab.keys("person", "anna", "--out", str(lab.folder / "anna2"))
    lab.keys("revoke", "lab2")
    assert admitted() == set()
    assert {"robot", "encoder", "goto", "page", "person-olga"} <= lab.count("lab1")
    assert {"page", "person-olga"} <= lab.count("desk2")


def test_the_robots_computer_cannot_be_revoked(lab: Lab) -> None:
    assert "--anew" in lab.keys("revoke", "lab1", code=2)
    assert "did you mean 'person-anna'" in lab.keys("revoke", "person-ana", code=2)


def test_a_list_of_keys_tells_which_computer_has_each(lab: Lab) -> None:
    lab.keys("revoke", "goto@1")
    lines = {line.split()[0]: line for line in lab.keys("list").splitlines()}
    assert "lab1" in lines["r/goto"]
    assert "lab2" in lines["r/goto@1"]
    assert "revoked" in lines["r/goto@1"]


def test_rights_are_printed_where_no_list_of_identities_is(
    lab: Lab, capsys: pytest.CaptureFixture[str]
) -> None:
    table = lab.folder / "there.toml"
    table.write_text(TABLE.replace('"keys"', '"lab2"'))
    words = ["--hosts", str(table), "--host", "lab2", "--namespace", "r"]
    capsys.readouterr()
    assert cli.main(["keys", "rights", "goto", *words]) == 0
    out, err = capsys.readouterr()
    assert "publishes resource/wheels/utility/goto-$*" in out
    assert "on the computer that has the authority's key" in err
    for option in ("--write", "--json"):
        assert cli.main(["keys", "rights", option, *words]) == 2
        assert f"no list of identities, which {option} needs" in capsys.readouterr().err


class KilledError(BaseException):
    """Ends a command as a signal would."""


def _kill_at(nth: int, patch: pytest.MonkeyPatch) -> None:
    writes = itertools.count(1)

    def write(path: Path, data: bytes) -> None:
        if next(writes) == nth:
            raise KilledError
        write_private(path, data)

    for module in (store, derived):
        patch.setattr(module, "write_private", write)


@pytest.mark.parametrize(
    "words",
    [("init", "--person", "olga"), ("init", "--anew", "--person", "olga"), ("agent", "laser")],
)
def test_a_command_that_was_killed_before_any_file_can_be_repeated(
    lab: Lab, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    def faults(keys: Store) -> list[str]:
        return [*Checks(keys, datetime.now(UTC)).everything()]

    before, there = lab.folder / "before", lab.folder / "there"
    shutil.copytree(lab.store.folder, before)
    for nth in (1, 2, 3, 4, 5, 6, 9):
        shutil.rmtree(lab.store.folder)
        if words[:2] != ("init", "--person"):
            shutil.copytree(before, lab.store.folder)
        with monkeypatch.context() as patch:
            _kill_at(nth, patch)
            with suppress(KilledError):
                lab.keys(*words)
        if not faults(lab.store):  # then what it gives out is right, too
            lab.keys("host", "lab2", "--out", str(there))
            assert faults(Store(there)) == [], nth
            shutil.rmtree(there)
        lab.keys(*words)
        assert faults(lab.store) == [], nth


def test_the_printed_commands_make_what_each_computer_and_archive_lost(lab: Lab) -> None:
    lab.keys("agent", "laser", "relocate", "--out", str(lab.folder / "laser"))
    lab.keys("agent", "laser")
    lab.keys("person", "ben")
    for name in ("laser", "laser+relocate", "person-ben", "person-olga", "page", "person-anna"):
        before = [each for each in _valid(lab.store) if each[0].endswith(f"/{name}")]
        for words in re.findall(r"`armadico keys ([^`]*)`", _losses(lab.keys("revoke", name))):
            out = str(lab.folder / f"{name}-{words.replace(' ', '-')}")
            elsewhere = ["--out", out] if words.startswith("host") and "lab1" not in words else []
            lab.keys(*words.replace("FILE", out).split(), *elsewhere)
        assert [each for each in _valid(lab.store) if each[0].endswith(f"/{name}")] == before


def _losses(out: str) -> str:
    return "\n".join(line for line in out.splitlines() if " loses " in line)


def _valid(store: Store) -> list[tuple[str, str]]:
    """The identities that count, and what has their keys."""
    return sorted(
        (member.name, holder)
        for member in store.members().values()
        for issue in member.users.values()
        if issue.given
        for holder in issue.holders
    )


def test_what_was_revoked_before_is_no_unknown_name(lab: Lab) -> None:
    lab.keys("revoke", "lab2")
    assert "r/goto@1 was revoked before, 20" in lab.keys("revoke", "lab2")
    assert "no identity or host" in lab.keys("revoke", "lab3", code=2)


def test_who_revokes_a_person_of_the_robots_computer_is_not_sent_to_what_is_refused(
    lab: Lab,
) -> None:
    out = lab.keys("revoke", "person-olga")
    lines = [line for line in out.splitlines() if "had a key on" in line]
    assert len(lines) == 3
    assert not [line for line in lines if "keys revoke lab1" in line]
    lab.keys("revoke", "lab1", code=2)
