"""Each end of `armadico stop` without a stopped robot says so, and is no success."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from armadico.mesh.sockets import RUNTIME_VARIABLE, folder, lock_of, share_of, socket_of
from tests.programs import Done, call
from tests.runtime_folder import fresh_folder, locked

pytestmark = pytest.mark.live

NOT = "NOT stopped: "
BRIEFLY = ("--timeout", "0.5")


@pytest.fixture
def base(monkeypatch: pytest.MonkeyPatch) -> Path:
    made = Path(fresh_folder())
    monkeypatch.setenv(RUNTIME_VARIABLE, str(made))
    return made


def failed(done: Done, code: int) -> str:
    assert (done.returncode, done.stdout) == (code, ""), done
    assert NOT in done.stderr
    assert "Traceback" not in done.stderr
    return done.stderr


def test_without_a_robot(base: Path) -> None:
    assert f"no robot agent at {base}" in failed(call("stop", *BRIEFLY), 1)


def test_where_the_robot_runs_with_another_runtime_folder(
    base: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = fresh_folder()
    monkeypatch.setenv(RUNTIME_VARIABLE, other)
    namespace = f"lonely-{os.getpid()}"
    with locked(lock_of(socket_of(namespace))):
        monkeypatch.setenv(RUNTIME_VARIABLE, str(base))
        said = failed(call("stop", "--namespace", namespace, *BRIEFLY), 1)
    assert f"{RUNTIME_VARIABLE}={other}" in said
    assert str(os.getpid()) in said


def test_with_a_folder_that_others_can_write_to(base: Path) -> None:
    folder().chmod(0o777)
    assert f"chmod 700 {base}" in failed(call("stop"), 2)


def test_with_a_host_table_whose_keys_are_missing(base: Path, tmp_path: Path) -> None:
    table = tmp_path / "lab.toml"
    table.write_text('keys = "keys"\n[robot]\nrouter = "tls/127.0.0.1:9"\nagents = ["robot"]\n')
    assert "keys" in failed(call("stop", "--hosts", str(table)), 2)


def test_with_an_endpoint_where_nothing_listens(base: Path) -> None:
    assert "tcp/127.0.0.1:9" in failed(call("stop", "--connect", "tcp/127.0.0.1:9", *BRIEFLY), 1)


@pytest.mark.parametrize(
    "words", [("robot2",), ("--tiemout", "3"), ("--timeout", "0"), ("--namespace", "a b")]
)
def test_with_a_wrong_command_line(base: Path, words: tuple[str, ...]) -> None:
    failed(call("stop", *words), 2)


def test_another_robot_of_this_computer_is_named(base: Path) -> None:
    with locked(share_of("robot2", "desk")):
        assert "on this computer are robot2" in failed(call("stop", *BRIEFLY), 1)


def test_down_of_another_namespace_names_the_robots_that_go_on(base: Path) -> None:
    """As of a mistyped one: what was asked for did not happen to this robot."""
    with locked(share_of("robot1", "lab1")):
        done = call("down", "--namespace", "robto1")
    assert "still up on this machine: robot1" in done.stderr
