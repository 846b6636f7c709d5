"""What is wrong with an agent of one's own is said with its name, its file and its line."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.programs import Done, call

SOURCE = '''"""Agents of one's own."""
import time
from armadico import Behaviour, Bid, Obstacles, Parameters
class Mine(Behaviour):
    reacts_to = Obstacles
class Raiser(Mine):
    """Divides by zero."""
    name = "raiser"
    def propose(self, pose, obstacles):
        return Bid(1 / 0, (0.1, 0.0))  # here
class Unsound(Mine):
    name = "unsound"
    def propose(self, pose, obstacles):
        return Bid(0.3, (0.1, 0.0, 3.0))
class Slow(Mine):
    name = "slow"
    def propose(self, pose, obstacles):
        time.sleep(0.15)
        return Bid(0.7, (0.1, 0.0))
class Broken(Mine):
    name = "broken"
    def __init__(self, *given):
        super().__init__(*given)
        raise KeyError("at the start")  # there
class Twin(Broken):
    name = "twin"
    class parameters(Parameters, frozen=True):
        world: str | list[str] = "gazebo"
class Pair(Mine):
    name = "pair"
    def propose(self, pose, obstacles):
        return 0.3, (0.1, 0.0)
class Short(Mine):  # a class
    name = "short"
    def propose(self, pose): ...
class Idle(Mine):
    name = "idle"
class Wordy(Mine):
    name = "wordy"
    reacts_to = "sonar/obstacles"
class Bare(Mine):
    name = "bare"
    def __init__(self): ...
class Other(Mine):
    name = "another"
class Nameless(Mine): ...
class Listing(Mine):
    name = "listing"
    parameters = {"wall": "left"}
class Chair: ...
'''
NAMES = re.findall(r"^class (?!Mine)(\w+)", SOURCE, re.MULTILINE)
POINTS = {
    **{n.lower(): f"own:{n}" for n in NAMES},
    "spelling": "own_spelling:Agent",
    "missing": "own:Missing",
    "syntax": "own_syntax:Agent",
    "raises": "own_raises:Agent",
}

Run = Callable[..., Done]


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """It is installed, as far as Python can tell."""
    (tmp_path / "own.py").write_text(SOURCE, encoding="utf-8")
    (tmp_path / "own_syntax.py").write_text("def (\n", encoding="utf-8")
    (tmp_path / "own_spelling.py").write_text("\nfrom armadico import Behavior\n", encoding="utf-8")
    (tmp_path / "own_raises.py").write_text("\n1 / 0\n", encoding="utf-8")
    info = tmp_path / "own-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own\nVersion: 1.0\n")
    points = "\n".join(f"{name} = {value}" for name, value in POINTS.items())
    (info / "entry_points.txt").write_text(f"[armadico.agents]\n{points}\n")
    return tmp_path


@pytest.fixture
def run(package: Path) -> Run:
    """`armadico run` of a metre's way, with some of its agents."""

    def run(*names: str, words: tuple[str, ...]) -> Done:
        agents = ["encoder", "sonar", "goto", "path-planning", "interface", *names]
        text = f'world = "sc1"\nstart = [0, 0, 0]\ngoal = [1, 0, 0]\nagents = {agents}\n'
        (package / "mine.toml").write_text(text, encoding="utf-8")
        return of(package, "run", str(package / "mine.toml"), *words)

    return run


def of(package: Path, *words: str, program: str = "armadico") -> Done:
    """A program of ours, where the package is installed."""
    return call(*words, program=program, env={**os.environ, "PYTHONPATH": str(package)})


def line(text: str) -> int:
    """Where it is in the source."""
    return 1 + next(at for at, row in enumerate(SOURCE.splitlines()) if row.endswith(text))


def test_one_that_raises_in_a_virtual_run_is_named_with_file_and_line(
    run: Run, package: Path
) -> None:
    done = run("raiser", words=("--virtual",))
    assert done.returncode == 1
    said = done.stderr.splitlines()
    assert said[0] == "armadico: raiser failed:"
    assert said[1] == f'  File "{package}/own.py", line {line("# here")}, in propose'
    assert said[-1] == "ZeroDivisionError: division by zero"
    assert "Traceback" not in done.stderr
    assert "/armadico/" not in done.stderr, "what calls it is of no use to whoever wrote it"


def test_so_is_one_that_cannot_even_begin(package: Path) -> None:
    done = of(package, "broken", program="armadico-agent")
    assert done.returncode == 1
    assert f'own.py", line {line("# there")}, in __init__' in done.stderr
    assert done.stderr.endswith("KeyError: 'at the start'\n")
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("words", [(), ("--set", 'world=["a", "b"]')])
def test_a_parameter_world_need_not_name_a_map(package: Path, words: tuple[str, ...]) -> None:
    done = of(package, "twin", *words, program="armadico-agent")
    assert done.stderr.endswith("KeyError: 'at the start'\n"), "it got as far as that"


@pytest.mark.long
def test_in_a_virtual_run_too_a_bid_that_is_not_sound_is_told_with_whose_it_is(run: Run) -> None:
    done = run("unsound", words=("--virtual",))
    assert done.returncode == 0, "goto drives, whatever that one bids"
    assert done.stderr.startswith("unsound-")
    assert "its bid is invalid: wheels takes 2 numbers ('v', 'w')" in done.stderr
    done = run("pair", words=("--virtual",))
    assert "its bid is invalid: expected a Bid, not tuple" in done.stderr


@pytest.mark.long(but=("short-propose() takes 2 positional arguments but 3 were given",))
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("short", "propose() takes 2 positional arguments but 3 were given"),
        ("idle", "propose(self, pose, obstacles)"),
        ("wordy", "'sonar/obstacles' is no message with a row in the table of services"),
        ("bare", "__init__() takes 1 positional argument but 3 were given"),
    ],
)
def test_what_our_own_lines_stumble_over_is_told_with_its_class(
    run: Run, package: Path, name: str, says: str
) -> None:
    """A traceback through ours is of no use to whoever wrote a method with too few arguments."""
    said = run(name, words=("--virtual",)).stderr
    assert said.startswith(f'armadico: {name} failed:\n  File "{package}/own.py", line ')
    assert says in said.splitlines()[-1]
    assert "Traceback" not in said
    if name == "short":
        assert f"line {line('# a class')}, class Short\n" in said
    else:
        started = of(package, name, program="armadico-agent") if name != "idle" else None
        assert started is None or (says in started.stderr and "Traceback" not in started.stderr)


@pytest.mark.long
@pytest.mark.live
def test_a_live_run_tells_what_is_wrong_with_each_of_ones_own_agents(run: Run) -> None:
    words = ("--namespace", f"own-{os.getpid()}")
    said = run("raiser", "unsound", "slow", words=words).stderr
    assert "raiser has ended (status 1)" in said
    assert f'own.py", line {line("# here")}, in propose' in said
    assert "ZeroDivisionError: division by zero" in said
    unsound, slow = (
        next(row for row in said.splitlines() if text in row)
        for text in ("its bid is invalid", "too slow")
    )
    assert unsound.startswith("unsound-")
    assert slow.startswith("slow-")
    assert "a cycle is 0.1 s" in slow


@pytest.mark.long(but=("spelling-own_spelling.py, line 2)",))
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("chair", "chair (own:Chair) "),
        ("syntax", "own_syntax.py, line 1)"),
        ("raises", "cannot be loaded: ZeroDivisionError: division by zero ("),
        ("spelling", "own_spelling.py, line 2)"),
        ("missing", "cannot be loaded: module 'own' has no attribute 'Missing'"),
        ("nameless", "nameless (own:Nameless) has name = ''"),
    ],
)
def test_an_entry_point_that_leads_to_no_agent_is_a_line(
    run: Run, package: Path, name: str, says: str
) -> None:
    for done in (of(package, name, program="armadico-agent"), run(name, words=("--virtual",))):
        assert done.returncode == 1
        assert says in done.stderr
        assert len(done.stderr.splitlines()) == 1
