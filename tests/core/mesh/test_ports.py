"""Free ports that are not ephemeral."""

from __future__ import annotations

import os
import socket
from contextlib import ExitStack

import pytest

from armadico.mesh import ports


def test_two_processes_that_look_at_once_find_others(monkeypatch: pytest.MonkeyPatch) -> None:
    ours = set(ports.free_ports(20))
    other = os.getpid() + 1
    monkeypatch.setattr(os, "getpid", lambda: other)
    assert not ours & set(ports.free_ports(20))


def test_a_port_in_use_is_not_returned() -> None:
    with ExitStack() as stack:
        taken = {ports.free_port() for _ in range(3)}
        for port in taken:
            stack.enter_context(socket.create_server((ports.LOOPBACK, port)))
        rest = ports.free_ports(ports.SLICE - len(taken))
        assert not taken & set(rest)
        with pytest.raises(OSError, match="no 100 free ports"):
            ports.free_ports(ports.SLICE)
