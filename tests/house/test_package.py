"""What is installed is what is in the tree, and everything that it announces is there."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from armadico.config.discovery import Found
from armadico.core.agent import Agent
from tests.house.tree import FOLDERS, ROOT, modules, package_files, project

ENTRIES = [
    Found(name, value, "armadico")
    for points in project()["project"]["entry-points"].values()
    for name, value in points.items()
]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """The names of the files in a wheel that is built, without the network, from a copy."""
    copy = tmp_path_factory.mktemp("checkout")
    ignore = shutil.ignore_patterns("__pycache__")
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, copy / folder, symlinks=True, ignore=ignore)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    command = [*("-m", "build", "--wheel", "--no-isolation", "--outdir", "dist"), "."]
    done = subprocess.run(
        [sys.executable, *command], cwd=copy, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (built,) = (copy / "dist").glob("*.whl")
    with zipfile.ZipFile(built) as archive:
        return set(archive.namelist())


def test_the_wheel_is_the_tree(wheel: set[str]) -> None:
    inside = {name for name in wheel if ".dist-info/" not in name}
    assert inside == {name for name, _ in package_files()}


def test_the_wheel_has_the_licence_and_the_type_marker(wheel: set[str]) -> None:
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in wheel)
    assert "armadico/py.typed" in wheel


def test_it_takes_one_name_among_other_peoples_packages(wheel: set[str]) -> None:
    assert {Path(name).parts[0].partition("-")[0] for name in wheel} == {"armadico"}


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_every_entry_point_can_be_loaded_and_says_what_it_is_for(entry: Found) -> None:
    assert callable(entry.load())
    assert entry.summary


def test_every_agent_goes_by_the_name_of_its_entry_point() -> None:
    agents = project()["project"]["entry-points"]["armadico.agents"]
    for name, value in agents.items():
        kind = Found(name, value, "armadico").load()
        assert issubclass(kind, Agent)
        assert kind.name == name


def test_every_agent_and_command_has_an_entry_point() -> None:
    points = project()["project"]["entry-points"]
    announced = {
        value.partition(":")[0]
        for group in ("armadico.agents", "armadico.commands")
        for value in points[group].values()
    }
    helpers = ("options", "latch", "places", "agent")
    not_commands = {f"armadico.cli.{name}" for name in helpers}
    there = {
        name
        for name in modules()
        if name.count(".") == 2 and name.startswith(("armadico.agents.", "armadico.cli."))
    }
    missing = there - announced - not_commands - {"armadico.agents.methods"}
    assert not missing
