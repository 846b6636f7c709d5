"""`armadico page` as it is called."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from armadico.cli.additions import Start
from armadico.cli.options import Mesh
from armadico.config.scenarios import load_scenario
from armadico.mesh.ports import free_port
from armadico.watch.beside import Helpers
from armadico.watch.commands.page import TOKEN_VARIABLE
from armadico.watch.commands.page_option import OfRun
from tests.programs import SOON, starter

LINK = re.compile(r"page: (http://\S+?:(\d+)/)(?:#token=(\S+))?(?: \(also at .*\))?\n")


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


def check_end_of(pid: int, process: subprocess.Popen[str]) -> None:
    """A process ends with another one that is killed."""
    beside = psutil.Process(pid)
    try:
        process.send_signal(signal.SIGKILL)
        _, left = psutil.wait_procs([beside], timeout=SOON)
        assert not left, "it would hold its port"
    finally:
        with suppress(psutil.NoSuchProcess):
            beside.kill()


@pytest.mark.live
def test_beside_a_command_that_is_killed_it_ends_too(tmp_path: Path) -> None:
    script = """if True:
        import time
        from armadico.cli.additions import Start
        from armadico.cli.options import Mesh
        from armadico.watch.beside import served

        with served(Start(scenario=None, mesh=Mesh(), namespaces=("p",)), "page", "--port=0") as it:
            print(it.popen.pid, flush=True)
            time.sleep(1e6)
    """
    with starter((sys.executable, "-c", script), cwd=tmp_path) as start:
        process = start()
        assert process.stdout is not None
        check_end_of(int(process.stdout.readline()), process)


@pytest.mark.long
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
    start = Start(
        scenario=load_scenario("sc1"), mesh=Mesh(namespace="p"), namespaces=["p/r1", "p/r2"]
    )
    with OfRun(page=True).beside(start):
        found = LINK.fullmatch(capsys.readouterr().err)
        assert found is not None
        with urllib.request.urlopen(found[1], timeout=20) as answer:
            assert answer.status == 200
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(found[1], timeout=20)


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
