"""`armadico page` as it is called."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import urllib.error
import urllib.request
from typing import NamedTuple

import pytest

from armadico.cli import main as armadico
from armadico.cli.beside import Helpers, beside
from armadico.cli.options import Mesh
from armadico.mesh.ports import free_port
from armadico.watch.commands import page
from armadico.watch.commands.page import TOKEN_VARIABLE
from tests.programs import heavy, imports_nothing, starter

LINK = re.compile(r"page: (http://\S+?:(\d+)/)(?:#token=(\S+))?(?: \(also at .*\))?\n")


def refusal(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    return armadico(["page", *words]), capsys.readouterr().err


@pytest.mark.live
def test_a_port_that_is_taken_is_named_with_what_to_do(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        code, said = refusal(capsys, f"--port={port}")
    assert code == 1
    assert f"cannot listen on 127.0.0.1, port {port}" in said
    assert "--port 0" in said


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--port=70000"], "65535"),
        (["--token=short"], "16"),
        (["--namespace", "a b"], "'a b'"),
        (["--world", "nowhere"], "nowhere"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_starts(
    capsys: pytest.CaptureFixture[str], words: list[str], expected: str
) -> None:
    code, said = refusal(capsys, *words)
    assert code == 2
    assert expected in said


class Address(NamedTuple):
    family: socket.AddressFamily
    address: str


class State(NamedTuple):
    isup: bool


def test_for_other_machines_the_link_has_an_address_that_a_phone_needs_not_resolve(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cards = {
        "lo": [Address(socket.AF_INET, "127.0.0.1")],
        "br0": [Address(socket.AF_INET, "172.17.0.1")],
        "wlan0": [Address(socket.AF_INET, "192.168.1.5"), Address(socket.AF_INET6, "2001:db8::5")],
        "eth1": [Address(socket.AF_INET, "10.0.0.9")],
    }
    monkeypatch.setattr("psutil.net_if_addrs", lambda: cards)
    monkeypatch.setattr("psutil.net_if_stats", lambda: {n: State(n != "eth1") for n in cards})
    monkeypatch.setattr(page, "_outward", lambda family: "192.168.1.5")
    monkeypatch.setattr("socket.gethostname", lambda: "bench")
    assert page._addresses("0.0.0.0") == ["192.168.1.5", "172.17.0.1", "bench"]
    assert page._addresses("::") == ["2001:db8::5", "bench"]
    assert page._addresses("127.0.0.1") == ["127.0.0.1"]
    assert page._link("2001:db8::5", 8090, "t") == "http://[2001:db8::5]:8090/#token=t"


@pytest.mark.parametrize("words", [["--virtual"], ["--runs", "2"]])
def test_beside_a_run_it_is_for_one_live_run(
    capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    assert armadico(["run", "sc1", "--page", *words]) == 2
    assert "--page is for one live run" in capsys.readouterr().err


def page_of(process: subprocess.Popen[str]) -> str:
    """The page's link, of a command that prints it first, on standard error."""
    assert process.stderr is not None
    found = LINK.fullmatch(process.stderr.readline())
    assert found is not None, process.communicate()
    return found[1]


def read(link: str) -> bytes:
    with urllib.request.urlopen(link, timeout=10.0) as answer:
        return bytes(answer.read())


@pytest.mark.long
@pytest.mark.live
def test_beside_a_society_it_is_there_until_that_is_ended() -> None:
    with starter() as start:
        port = free_port("127.0.0.1")
        process = start("up", "sc1", f"--page-port={port}", "--namespace=p")
        link = page_of(process)
        assert link == f"http://127.0.0.1:{port}/", "the same at each start"
        assert process.stdout is not None
        assert " is up after " in process.stdout.readline()
        assert b"<html" in read(link)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 0, errors
        assert "no robot agent" not in errors, "it was being started"
        with pytest.raises(urllib.error.URLError):
            read(link)


@pytest.mark.live
def test_beside_a_run_it_stays_with_the_society_when_the_goal_is_reached() -> None:
    with starter() as start:
        goal = ("--goal", "0.3", "0", "0")
        process = start("run", "sc1", *goal, "--page", "--no-plot", "--json", "--namespace=p")
        link = page_of(process)
        assert process.stderr is not None
        said = iter(process.stderr.readline, "")
        assert any("the society and its page stay until" in line for line in said)
        assert b"<html" in read(link)
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=60)
        assert process.returncode == 0, errors
        assert json.loads(out)["reached"]


@pytest.mark.live
def test_for_everybody_the_link_has_a_token_and_the_command_ends_in_order() -> None:
    with starter() as start:
        process = start("page", "--port=0", "--no-open", "--bind=0.0.0.0", "--namespace=p")
        assert process.stdout is not None
        found = LINK.fullmatch(process.stdout.readline())
        assert found is not None, process.communicate()
        port, token = found[2], found[3]
        assert len(token) >= 32
        on_query = urllib.request.Request(
            f"http://127.0.0.1:{port}/allowed", headers={"Authorization": f"Bearer {token}"}
        )
        with urllib.request.urlopen(on_query, timeout=20) as answer:
            assert answer.status == 200
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0, process.communicate()


@pytest.mark.live
def test_a_token_of_ones_own_is_not_seen_among_the_processes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, "0123456789abcdef")
    with starter() as start:
        process = start("page", "--port=0", "--no-open", "--namespace=p")
        assert process.stdout is not None
        found = LINK.fullmatch(process.stdout.readline())
        assert found is not None, process.communicate()
        assert found[3] == "0123456789abcdef"


@pytest.mark.live
def test_beside_a_run_it_prints_its_link_and_ends_with_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    args = Mesh(namespace="p")
    with beside(args, "page", "sc1", ["p/r1", "p/r2"]):
        found = LINK.fullmatch(capsys.readouterr().err)
        assert found is not None
        with urllib.request.urlopen(found[1], timeout=20) as answer:
            assert answer.status == 200
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(found[1], timeout=20)


def test_help_imports_nothing_heavy() -> None:
    among = ("numpy", "zenoh", "websockets", "msgspec", "asyncio")
    assert imports_nothing(heavy("armadico.cli", ["page", "--help"], among))


@pytest.mark.live
def test_who_takes_the_stick_is_started_beside_the_page_once_and_ends_with_it() -> None:
    args = Mesh()
    with Helpers(args) as helpers:
        assert helpers.start("p", "nobody") == ""
        (first,) = helpers.processes.values()
        assert first.popen.wait(60) == 2
        assert "nobody" in helpers.start("p", "nobody")  # what it said when it ended
        (second,) = helpers.processes.values()
        assert second is not first
    assert second.ended()
