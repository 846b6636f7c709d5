"""What is installed is what is in the tree, and everything that it announces is there."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path

import pytest

from armadico import cli
from armadico.core.agent import Agent
from armadico.core.discovery import Found
from tests.whole.house.tree import (
    FOLDERS,
    JUNK,
    LABORATORY,
    ROOT,
    package_files,
    project,
    sources,
)

LEAST = ("pyproject.toml", "README.md", "LICENSE")
TEXTS = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "Makefile", "MANIFEST.in")
SCRIPTS = "deploy/bin"
BESIDES = ("docs", "requirements", "tests", "deploy")
"""Of no package, and in the source distribution all the same."""

DISTRIBUTIONS = {"armadico": ".", "armadico_tools": LABORATORY}
"""Packages, and the folders of the project files that they are built by."""

POINTS = [
    (group, name, value)
    for folder in DISTRIBUTIONS.values()
    for group, points in project(folder)["project"]["entry-points"].items()
    for name, value in points.items()
]
ENTRIES = [Found(name, value, "armadico") for _, name, value in POINTS]


@pytest.fixture(scope="module", params=DISTRIBUTIONS)
def package(request: pytest.FixtureRequest) -> str:
    """Each distribution, by the name of its package."""
    name: str = request.param
    return name


@pytest.fixture(scope="module")
def wheel(package: str, tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """The names of the files in a wheel that is built, without the network, from a copy."""
    copy = checkout(tmp_path_factory.mktemp("checkout"), (*FOLDERS, SCRIPTS), LEAST)
    with zipfile.ZipFile(built(copy, "--wheel", DISTRIBUTIONS[package])) as archive:
        return set(archive.namelist())


def checkout(copy: Path, folders: Iterable[str], files: Iterable[str]) -> Path:
    """A copy of these of the checkout."""
    ignore = shutil.ignore_patterns(*JUNK, "*.egg-info")
    for folder in folders:
        shutil.copytree(ROOT / folder, copy / folder, symlinks=True, ignore=ignore)
    for name in files:
        shutil.copy(ROOT / name, copy)
    return copy


def built(copy: Path, what: str, folder: str = ".") -> Path:
    """A distribution that is built of a checkout."""
    command = [*("-m", "build", what, "--no-isolation", "--outdir", "dist"), folder]
    done = subprocess.run(
        [sys.executable, *command], cwd=copy, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (archive,) = (path for path in (copy / "dist").iterdir() if path.is_file())
    return archive


@pytest.mark.long
def test_the_source_distribution_has_what_it_is_built_tried_and_read_with(tmp_path: Path) -> None:
    copy = checkout(tmp_path, (*FOLDERS, *BESIDES), (*LEAST, *TEXTS))
    with tarfile.open(built(copy, "--sdist")) as archive:
        inside = {name.partition("/")[2] for name in archive.getnames()}
    assert {*LEAST, *TEXTS} <= inside
    there = {
        path.relative_to(ROOT).as_posix()
        for folder in (*BESIDES, LABORATORY)
        for path in sources(folder, "*")
        if path.is_file() and path.suffix != ".pyc" and ".egg-info" not in str(path)
    }
    assert not there - inside
    assert not {name for name, _ in package_files() if name.startswith("armadico/")} - inside


@pytest.mark.long(but=("armadico",))
def test_the_wheel_is_the_tree(wheel: set[str], package: str) -> None:
    """So no experiment is in the product's."""
    inside = {name for name in wheel if ".dist-info/" not in name}
    scripts = {name for name in inside if ".data/scripts/" in name}
    inside -= scripts
    assert {Path(name).name for name in scripts} == (
        {"armadico"} if package == "armadico" else set()
    )
    assert inside == {name for name, _ in package_files() if Path(name).parts[0] == package}


@pytest.mark.long(but=("armadico",))
def test_the_wheel_has_the_licence_and_the_type_marker(wheel: set[str], package: str) -> None:
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in wheel)
    assert f"{package}/py.typed" in wheel


@pytest.mark.long(but=("armadico",))
def test_it_takes_one_name_among_other_peoples_packages(wheel: set[str], package: str) -> None:
    assert {Path(name).parts[0].partition("-")[0] for name in wheel} == {package}


def test_both_are_of_one_version_and_the_laboratory_needs_that_one() -> None:
    product, laboratory = (project(folder)["project"] for folder in DISTRIBUTIONS.values())
    assert product["version"] == laboratory["version"]
    needed = [d for d in laboratory["dependencies"] if d.startswith("armadico")]
    assert needed == [f"armadico[plot]=={product['version']}"]


def test_the_product_knows_by_name_what_the_laboratory_would_bring() -> None:
    brought = project(LABORATORY)["project"]["entry-points"]["armadico.commands"]
    assert tuple(brought) == cli.TOOLS


def test_what_the_laboratory_needs_besides_is_locked() -> None:
    needed = set(project(LABORATORY)["project"]["dependencies"])
    lines = (ROOT / "requirements" / "tools.in").read_text(encoding="utf-8").splitlines()
    assert {d for d in needed if not d.startswith("armadico")} == {*lines[1:]}


def test_every_entry_point_can_be_loaded() -> None:
    for entry in ENTRIES:
        assert entry.load() if ":" in entry.value else import_module(entry.module), entry


def test_every_agent_goes_by_the_name_of_its_entry_point() -> None:
    agents = project()["project"]["entry-points"]["armadico.agents"]
    for name, value in agents.items():
        kind = Found(name, value, "armadico").load()
        assert issubclass(kind, Agent)
        assert kind.name == name
