"""What the commands of keys tell a person who runs them again, or has lost a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico import cli


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
