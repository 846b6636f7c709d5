"""The demo on a real engine: a failover, and a page that this machine reaches."""

from __future__ import annotations

import re
import subprocess
import urllib.request

import pytest

from armadico.core.judgement import Answer
from armadico_tools.hosts.compose import ComposeHosts, demo, lacking
from tests.whole.house.tree import ROOT

BASE = "python:3.11-slim-bookworm"

pytestmark = [pytest.mark.live, pytest.mark.long, pytest.mark.timeout(400)]


def why_not() -> str | None:
    """Why this cannot be tried here; None if it can."""
    trouble = lacking()
    if trouble is not None:
        return trouble
    if not _quiet("image", "inspect", BASE):
        return f"the engine has no image {BASE}; docker pull {BASE}"
    file = str(ROOT / "deploy" / "compose.yaml")
    if _out("compose", "--file", file, "ps", "--quiet"):
        return "the demo is up on this engine: make demo-down"
    return None


def _quiet(*words: str) -> bool:
    return subprocess.run(["docker", *words], capture_output=True, check=False).returncode == 0


def _out(*words: str) -> str:
    done = subprocess.run(["docker", *words], capture_output=True, text=True, check=False)
    return done.stdout.strip()


def test_a_host_is_killed_and_another_takes_over_at_once() -> None:
    reason = why_not()
    if reason is not None:
        pytest.skip(reason)
    lines: list[str] = []
    with ComposeHosts("sc4", lines.append) as hosts:
        (page,) = [line for line in lines if line.startswith("page: ")]
        found = re.fullmatch(r"page: (http://127\.0\.0\.1:\d+/)#token=\S{32}", page)
        assert found is not None, page
        with urllib.request.urlopen(found[1], timeout=10.0) as answer:
            assert b"<html" in answer.read()
        judgement = demo(hosts, "sc4", lines.append)
    assert judgement.answer is Answer.YES, "\n".join([str(judgement), *lines])
    assert not _out("ps", "--all", "--quiet", "--filter", "name=armadico-demo")
