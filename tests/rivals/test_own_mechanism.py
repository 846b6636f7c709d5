"""A mechanism is a package of its own: docs/rivals.md has these two."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest

from armadico.agents.rivals.proposer import Arbitrated
from armadico.mobile.resources import TRAJECTORY
from tests.programs import Done, call

PAGE = Path(__file__).parents[2] / "docs" / "rivals.md"
POINTS = """
[armadico.agents]
loudest = own_rivals:Loudest
[armadico.coordinations]
loudest = own_rivals:LOUDEST
committed = own_rivals:Committed
auction = own_rivals:LOUDEST
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """The package of the page is installed, as far as Python can tell."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    both = "\n\n".join((blocks[0], blocks[2]))  # between them is an arbiter of the tutorial's head
    (tmp_path / "own_rivals.py").write_text(both, encoding="utf-8")
    info = tmp_path / "own_rivals-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own-rivals\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(POINTS)
    return tmp_path


def run(package: Path, name: str, *more: str) -> Done:
    words = ("run", "sc4", "--virtual", "--seed", "1", "--json", "--coordination", name, *more)
    return call(*words, env={**os.environ, "PYTHONPATH": str(package)})


def test_an_arbiter_of_ones_own_drives(package: Path) -> None:
    done = run(package, "loudest")
    result = json.loads(done.stdout)
    assert result["reached"], done.stderr
    assert "loudest" in result["conditions"]["scenario"]["agents"]


def test_a_mechanism_without_an_arbiter_drives(package: Path) -> None:
    result = json.loads(run(package, "committed").stdout)
    assert result["reached"]
    ballots = json.loads(call("run", "sc4", "--virtual", "--seed", "1", "--json").stdout)
    assert 0 < result["exchanges"] < ballots["exchanges"]


def test_no_other_package_takes_the_name_of_a_shipped_mechanism(package: Path) -> None:
    done = run(package, "auction", "--for", "1")
    agents = json.loads(done.stdout)["conditions"]["scenario"]["agents"]
    assert "auction" in agents
    assert "loudest" not in agents
    assert "own-rivals: armadico.coordinations, auction" in done.stderr


def test_an_arbiter_of_another_resource_is_told_how_it_is_named() -> None:
    with pytest.raises(ValueError, match="resource=RESOURCE"):
        Arbitrated("loudest", TRAJECTORY)  # type: ignore[arg-type]
