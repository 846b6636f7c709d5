"""Free ports that are not ephemeral."""

from __future__ import annotations

import os
import socket
from contextlib import ExitStack

import pytest

from armadico.mesh import ports


def test_two_processes_that_look_at_once_find_others(monkeypatch: pytest.MonkeyPatch) -> None:
    ours = {ports.free_port() for _ in range(20)}
    other = os.getpid() + 1
    monkeypatch.setattr(os, "getpid", lambda: other)
    assert not ours & {ports.free_port() for _ in range(20)}


def test_a_port_in_use_is_not_returned() -> None:
    with ExitStack() as stack:
        taken = {ports.free_port() for _ in range(3)}
        for port in taken:
            stack.enter_context(socket.create_server((ports.LOOPBACK, port)))
        rest = {ports.free_port() for _ in range(ports.SLICE - len(taken))}
        assert not taken & rest
        for port in rest:
            stack.enter_context(socket.create_server((ports.LOOPBACK, port)))
        with pytest.raises(OSError, match="no free port"):
            ports.free_port()
