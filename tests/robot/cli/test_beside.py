"""The namespace of a society that starts beside others of the same user."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from armadico.cli.options import BESIDE, FailedError, Mesh
from armadico.mesh.sockets import RUNTIME_VARIABLE, socket_of
from armadico.mesh.topology import DEFAULT_NAMESPACE, NAMESPACE_VARIABLE
from tests.runtime_folder import fresh_folder

Take = Callable[[str], None]


@pytest.fixture
def take(monkeypatch: pytest.MonkeyPatch) -> Iterator[Take]:
    """Listen on the socket of a namespace, as its router does."""
    monkeypatch.setenv(RUNTIME_VARIABLE, fresh_folder())
    monkeypatch.delenv(NAMESPACE_VARIABLE, raising=False)
    with ExitStack() as stack:

        def listen(namespace: str) -> None:
            server = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            server.bind(str(socket_of(namespace)))
            server.listen()

        yield listen


def chosen(namespace: str = DEFAULT_NAMESPACE) -> str:
    with Mesh(namespace=namespace).beside_others() as mesh:
        return mesh.namespace


def test_alone_it_has_the_default_namespace(take: Take, capsys: pytest.CaptureFixture[str]) -> None:
    assert chosen() == DEFAULT_NAMESPACE
    assert capsys.readouterr().err == ""


def test_beside_others_it_takes_the_first_free_one_and_says_so(
    take: Take, capsys: pytest.CaptureFixture[str]
) -> None:
    take("robot1")
    take("robot1-2")
    assert chosen() == "robot1-3"
    assert "another society is in namespace 'robot1': this one is in 'robot1-3'" in (
        capsys.readouterr().err
    )


def test_a_namespace_that_was_chosen_is_kept_for_the_refusal_to_name(
    take: Take, monkeypatch: pytest.MonkeyPatch
) -> None:
    take("lab")
    take("robot1")
    assert chosen("lab") == "lab"
    monkeypatch.setenv(NAMESPACE_VARIABLE, "robot1")
    assert chosen() == "robot1"


def test_if_none_is_free_the_default_one_is_refused_later(take: Take) -> None:
    for name in ("robot1", *(f"robot1-{number}" for number in range(2, BESIDE + 2))):
        take(name)
    assert chosen() == "robot1"


def test_societies_that_start_in_the_same_instant_get_two_names(take: Take) -> None:
    """The router of the first does not listen yet."""
    with Mesh().beside_others() as first, Mesh().beside_others() as second:
        assert (first.namespace, second.namespace) == ("robot1", "robot1-2")
    assert chosen() == "robot1", "it is free again"


def test_of_two_that_start_in_one_chosen_namespace_the_second_is_refused(take: Take) -> None:
    lab = Mesh(namespace="lab")
    with lab.beside_others(), pytest.raises(FailedError, match="--namespace"), lab.beside_others():
        pass
