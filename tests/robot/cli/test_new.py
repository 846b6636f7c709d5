"""An agent of one's own from nothing: what is written works as it is."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

from armadico import cli
from armadico.cli.new import KINDS, package
from armadico.cli.options import UsageError
from tests.programs import Done, call

OTHERS = {"robot": "own-robot", "resource": "own-lamp", "task": "own-task"}
"""What else can be new, and the name of each here."""

NAMES = {kind: f"own-{kind}" for kind in KINDS}

OUT_OF_RANGE = {"own-behaviour": "speed=-3", "own-sensor": "width=-1", "own-planner": "keep_off=-1"}
"""A parameter of each, set to what makes no sense."""

REFUSED = """
import sys
from armadico import ConfigError
from armadico.core.discovery import agent_class
from armadico.config.loading import load_parameters
name, setting = sys.argv[1:]
try:
    print("taken:", load_parameters(agent_class(name).parameters, None, [setting]))
except ConfigError as error:
    print(error)
"""

EDITABLE = "from setuptools.build_meta import build_editable; build_editable('../wheel')"
"""What `pip install -e .` has the build backend make."""


def new(folder: Path, *words: str) -> Done:
    return call("new", "agent", *words, "--into", str(folder))


def python(folder: Path, *words: str) -> str:
    """What Python says in a folder where the packages are installed."""
    env = os.environ | {"PYTHONPATH": str(folder / "site"), "TMPDIR": str(folder)}
    done = call(*words, program=sys.executable, cwd=folder, env=env, within=300.0)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def check_style(folder: Path) -> None:
    style = ("--isolated", "--line-length=100")
    python(folder, "-m", "ruff", "check", *style, "--select=E,F,I,N,W", ".")
    python(folder, "-m", "ruff", "format", *style, "--check", ".")


def test_what_is_written_is_installed_found_by_its_name_and_passes_its_own_test(
    tmp_path: Path,
) -> None:
    for kind, name in NAMES.items():
        done = new(tmp_path, name, "--kind", kind)
        assert done.returncode == 0, done.stderr
        module = name.replace("-", "_")
        written = sorted(path.name for path in (tmp_path / name).iterdir())
        assert written == [f"{module}.py", "pyproject.toml", f"test_{module}.py"]
    check_style(tmp_path)
    folders = [f"./{name}" for name in NAMES.values()]
    quietly = ("--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target", "site")
    python(tmp_path, "-m", "pip", "install", *quietly, *folders)
    listed = python(tmp_path, "-m", "armadico", "agent", "--list")
    assert {f"The {name} agent" in listed for name in NAMES.values()} == {True}
    said = python(tmp_path, "-m", "pytest", "-q", "-n0", "-p", "no:cacheprovider", *folders)
    assert "5 passed" in said
    for name, setting in OUT_OF_RANGE.items():
        refused = python(tmp_path, "-c", REFUSED, name, setting)
        assert refused.startswith(f"--set {setting}: "), refused


@pytest.mark.parametrize(("what", "name"), OTHERS.items())
def test_a_new_robot_resource_or_task_is_written_in_good_style(
    tmp_path: Path, what: str, name: str
) -> None:
    assert cli.main(["new", what, name, "--into", str(tmp_path)]) == 0
    check_style(tmp_path)


@pytest.mark.long
def test_a_new_robot_resource_and_task_are_installed_and_keep_their_contracts(
    tmp_path: Path,
) -> None:
    for what, name in OTHERS.items():
        assert cli.main(["new", what, name, "--into", str(tmp_path)]) == 0
    folders = [f"./{name}" for name in OTHERS.values()]
    quietly = ("--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target", "site")
    python(tmp_path, "-m", "pip", "install", *quietly, *folders)
    drive = ("run", "sc1", "--virtual", "--profile", "own-robot")
    assert "sc1: reached" in python(tmp_path, "-m", "armadico", *drive)
    judged = python(tmp_path, "-m", "armadico.contracts", "robot", "own-robot")
    assert "counts_a_collision " in judged
    options = ("-q", "-n0", "-p", "no:cacheprovider", "-k", "not killed and not repeats")
    said = python(tmp_path, "-m", "pytest", *options, "own-lamp", "own-task")
    assert " passed" in said


def test_beside_the_folder_the_module_is_imported_and_not_the_folder(tmp_path: Path) -> None:
    """A folder of the module's name is a namespace package: it hides modules of import hooks."""
    assert new(tmp_path, "weaver").returncode == 0
    (tmp_path / "wheel").mkdir()
    python(tmp_path / "weaver", "-c", EDITABLE)
    with ZipFile(next((tmp_path / "wheel").iterdir())) as wheel:
        wheel.extractall(tmp_path / "editable")
    call = "import site; site.addsitedir('editable'); import weaver; print(weaver.Weaver.name)"
    assert python(tmp_path, "-c", call) == "weaver\n"


@pytest.mark.parametrize(
    ("name", "suggestion"),
    [
        ("wall_follower", "wall-follower"),
        ("2-wheelers", "wheelers"),
        ("../weaver", "weaver"),
        ("", ""),
        ("straße", "strasse"),
        ("false", ""),  # its class would be False
        ("a" * 41, "a" * 40),
        ("goto", ""),
        ("while", ""),
        ("numpy", ""),
    ],
)
def test_an_invalid_name_is_rejected_with_a_valid_suggestion(name: str, suggestion: str) -> None:
    with pytest.raises(UsageError, match=f"^{re.escape(repr(name))}") as refused:
        package(name, "behaviour")
    assert ("did you mean" in str(refused.value)) == bool(suggestion)
    if suggestion:
        assert repr(suggestion) in str(refused.value)
        assert package(suggestion, "behaviour")


def test_what_is_there_already_stays_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "weaver").mkdir()
    (tmp_path / "weaver" / "weaver.py").write_text("mine\n")
    done = new(tmp_path, "weaver")
    assert done.returncode == 1
    assert f"{tmp_path}/weaver " in done.stderr
    assert [p.read_text() for p in (tmp_path / "weaver").iterdir()] == ["mine\n"]
