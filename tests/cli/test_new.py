"""An agent of one's own from nothing: what is written works as it is."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

from armadico.cli.new import KINDS, package
from armadico.cli.options import UsageError
from tests.programs import Done, call

NAMES = {kind: f"own-{kind}" for kind in KINDS}

OUT_OF_RANGE = {"own-behaviour": "speed=-3", "own-sensor": "width=-1", "own-planner": "keep_off=-1"}
"""A parameter of each, set to what makes no sense."""

REFUSED = """
import sys
from armadico import ConfigError
from armadico.config.discovery import agent_class
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
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder / "site"), "TMPDIR": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_what_is_written_is_installed_found_by_its_name_and_passes_its_own_test(
    tmp_path: Path,
) -> None:
    for kind, name in NAMES.items():
        done = new(tmp_path, name, "--kind", kind)
        assert done.returncode == 0, done.stderr
        module = name.replace("-", "_")
        written = sorted(path.name for path in (tmp_path / name).iterdir())
        assert written == [f"{module}.py", "pyproject.toml", f"test_{module}.py"]
    python(
        tmp_path,
        "-m",
        "ruff",
        "check",
        "--isolated",
        "--select=E,F,I,N,W",
        "--line-length=100",
        ".",
    )
    python(tmp_path, "-m", "ruff", "format", "--isolated", "--check", "--line-length=100", ".")
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


def test_beside_the_folder_the_module_is_imported_and_not_the_folder(tmp_path: Path) -> None:
    """A folder of the module's name is a namespace package: it hides modules of import hooks."""
    assert new(tmp_path, "weaver").returncode == 0
    (tmp_path / "wheel").mkdir()
    python(tmp_path / "weaver", "-c", EDITABLE)
    with ZipFile(next((tmp_path / "wheel").iterdir())) as wheel:
        wheel.extractall(tmp_path / "editable")
    call = "import site; site.addsitedir('editable'); import weaver; print(weaver.Weaver.name)"
    assert python(tmp_path, "-c", call) == "weaver\n"


def test_the_first_kind_is_half_a_page() -> None:
    text = package("weaver", "behaviour")["weaver.py"]
    assert text.count("\n") <= 38


def test_what_is_to_be_typed_next_is_said_and_a_planner_takes_the_others_place(
    tmp_path: Path,
) -> None:
    said = new(tmp_path, "way-round", "--kind", "planner").stdout
    assert f"pip install -e {tmp_path}/way-round'[test]'" in said
    assert "--with way-round --without path-planning " in said
    assert "--without" not in new(tmp_path, "weaver").stdout


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("Weaver", "a letter first, at most 40 in all; 'weaver' would"),
        ("wall_follower", "'wall-follower' would"),
        ("WallFollower", "'wall-follower' would"),
        ("2-wheelers", "'wheelers' would"),
        ("2-wheels", "at most 40 in all"),
        ("../weaver", "'weaver' would"),
        ("", "single hyphens, a letter first, at most 40 in all"),
        ("straße", "'strasse' would"),
        ("Ärger", "'aerger' would"),
        ("Café", "'cafe' would"),
        ("false", "Python means something by it"),
        ("a" * 41, f"'{'a' * 40}' would"),
        ("goto", "an agent of that name is installed, by armadico"),
        ("while", "Python means something by it"),
        ("random", "the module 'random' that is there already"),
        ("numpy", "the module 'numpy' that is there already"),
        ("armadico", "the module 'armadico' that is there already"),
        ("behaviour", "Behaviour is the name of something that it needs"),
        ("settings", "Settings is the name of something that it needs"),
    ],
)
def test_a_name_that_will_not_do_is_refused_and_nothing_is_written(name: str, says: str) -> None:
    with pytest.raises(UsageError) as refused:
        package(name, "behaviour")
    assert str(refused.value).startswith(f"{name!r} will not do: ")
    assert says in str(refused.value)
    if hint := re.search(r"; '(.*)' would", str(refused.value)):
        assert package(hint[1], "behaviour")


def test_what_is_there_already_stays_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "weaver").mkdir()
    (tmp_path / "weaver" / "weaver.py").write_text("mine\n")
    done = new(tmp_path, "weaver")
    assert done.returncode == 1
    assert done.stderr == f"armadico: {tmp_path}/weaver is there already: nothing was written\n"
    assert [p.read_text() for p in (tmp_path / "weaver").iterdir()] == ["mine\n"]


def test_a_folder_that_is_not_there_and_a_kind_that_nobody_knows_are_usage(tmp_path: Path) -> None:
    assert "there is no such folder" in new(tmp_path / "nowhere", "weaver").stderr
    assert new(tmp_path, "weaver", "--kind", "arbiter").returncode == 2
    assert not list(tmp_path.iterdir())
