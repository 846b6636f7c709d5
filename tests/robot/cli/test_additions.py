"""Options of other packages: used at their stages, or named and left out."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from tests.programs import Done, call

TOY = '''"""A lamp, and what cannot be used."""
import sys
from contextlib import contextmanager
from dataclasses import dataclass, replace
from armadico.cli.additions import Addition
from armadico.cli.options import UsageError
from armadico.cli.parsing import flag, option
def say(*words): print("lamp:", *words, file=sys.stderr)
@dataclass(frozen=True, kw_only=True)
class Lamp(Addition):
    title = "the lamp"
    lamp: str | None = option("light this lamp")
    def check(self, start):
        if self.lamp == "broken":
            raise UsageError(f"--lamp {self.lamp}: {start.scenario.name} has none")
        say("check", self.lamp, start.seeds)
    def changed(self, options):
        return replace(options, limit=20.0)
    @contextmanager
    def beside(self, start):
        say("on", start.on is not None, *start.namespaces)
        yield
        say("off")
    def driven(self, start, run, *, interrupted):
        say("driven", run.limit, interrupted)
    def done(self, start, run):
        say("done", run.measures.reached)
        if self.lamp == "full":
            raise OSError("the lamp is full")
@dataclass(frozen=True, kw_only=True)
class Seed(Addition):
    seed: bool = flag("another seed")
@dataclass(frozen=True, kw_only=True)
class Older(Addition):
    old: bool = flag("of an older core")
    def check(self): ...
@dataclass(frozen=True, kw_only=True)
class Attribute(Addition):
    newer: bool = flag("of a newer core")
    def check(self, start): start.nothing
@dataclass(frozen=True, kw_only=True)
class Typo(Addition):
    typo: "NoSuchType" = option("not known")
@dataclass(frozen=True, kw_only=True)
class Needed(Addition):
    plain: int
    needed: bool = flag("has a field without an option")
@dataclass(frozen=True, kw_only=True)
class Help(Addition):
    help: bool = flag("another help")
@dataclass(frozen=True, kw_only=True)
class Leaves(Addition):
    leaves: bool = flag("fails when it is left")
    @contextmanager
    def beside(self, start):
        yield
        raise ValueError("on leaving")
@dataclass(frozen=True, kw_only=True)
class Nothing(Addition):
    nothing: bool = flag("changes the options to nothing")
    def changed(self, options): return None
@dataclass(frozen=True, kw_only=True)
class Five(Addition):
    five: bool = flag("is for no commands")
    commands = 5
@dataclass(frozen=True, kw_only=True)
class Says(Addition):
    says: bool = flag("has examples that are no texts")
    examples = (7,)
class Chair: ...
def building(): ...
def nobody(scenario): return None
from armadico.config.slots import Need, Slot
WRONG = Slot(needs=3)
DRIVES = Slot(needs={"drive": Need(agents=("teleop",))})
ZAPS = Slot(needs={"zap": Need(like=("nokind",))})
'''

LEFT_OUT = {
    "armadico.options, agone = toy_gone:Lamp": "ModuleNotFoundError: No module named 'toy_gone'",
    "armadico.options, attribute = toy:Attribute": "'Start' object has no attribute 'nothing'",
    "armadico.options, chair = toy:Chair": "must be a class derived from Addition",
    "armadico.options, ends = toy_ends:Lamp": "SystemExit: 7",
    "armadico.options, help = toy:Help": "conflicting option string: --help",
    "armadico.options, needed = toy:Needed": "missing 1 required keyword-only argument: 'plain'",
    "armadico.options, older = toy:Older": "check must take (self, start",
    "armadico.options, seed = toy:Seed": "the option --seed exists",
    "armadico.options, map = toy:Lamp": "armadico has an entry point of this name",
    "armadico.options, typo = toy:Typo": "name 'NoSuchType' is not defined",
    "armadico.agents, sonar = toy:Chair": "armadico has an entry point of this name",
    "armadico.commands, run = toy:Chair": "armadico has an entry point of this name",
    "armadico.guests, older = toy:building": "takes 0 positional arguments",
    "armadico.slots, chair = toy:Chair": "must be an armadico.config.slots.Slot",
    "armadico.messages, ends = toy_ends": "SystemExit: 7",
    "armadico.options, leaves = toy:Leaves": "ValueError: on leaving",
    "armadico.options, nothing = toy:Nothing": "`changed` returned None",
    "armadico.options, five = toy:Five": "TypeError: argument of type 'int' is not iterable",
    "armadico.options, says = toy:Says": "title and examples must be texts",
    "armadico.guests, nobody = toy:nobody": "which has no method 'due'",
    "armadico.slots, wrong = toy:WRONG": "Expected `object`, got `int`",
}
"""What is reported of each unusable entry point."""


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    """A distribution, installed as far as Python can tell."""
    (tmp_path / "toy.py").write_text(TOY)
    (tmp_path / "toy_ends.py").write_text("import sys\nsys.exit(7)\n")
    info = tmp_path / "toy-2.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: toy\nVersion: 2.0\n")
    points = ["[armadico.options]", "lamp = toy:Lamp"]
    points += ["[armadico.slots]", "drives = toy:DRIVES", "zaps = toy:ZAPS"]
    for group, _, point in (each.partition(", ") for each in LEFT_OUT):
        points += [f"[{group}]", point]
    (info / "entry_points.txt").write_text("\n".join(points))
    return tmp_path


def run(toy: Path, *words: str) -> Done:
    return call(*words, env={**os.environ, "PYTHONPATH": str(toy)}, cwd=toy)


def test_what_cannot_be_used_is_named_once_and_everything_else_works(toy: Path) -> None:
    done = run(toy, "run", "sc1", "--virtual", "--sensors=ideal", "--json", "--lamp", "red")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["reached"] is True
    for entry, why in LEFT_OUT.items():
        (line,) = (line for line in done.stderr.splitlines() if entry in line)
        assert line.startswith(f"package toy: {entry} is left out: ")
        assert why in line
    stages = [line for line in done.stderr.splitlines() if line.startswith("lamp: ")]
    assert stages == [
        "lamp: check red range(0, 1)",
        "lamp: on True robot1",
        "lamp: driven 20.0 False",
        "lamp: off",
        "lamp: done True",
    ]


def test_a_slot_changes_no_need_that_exists_and_leans_on_none_that_is_not_there(toy: Path) -> None:
    script = "from armadico.config.needs import needs, table; table(); print(*needs(['drive']))"
    env = os.environ | {"PYTHONPATH": str(toy)}
    done = call("-c", script, program=sys.executable, env=env)
    assert done.stdout.split() == ["robot", "encoder", "sonar", "goto", "avoid", "interface"]
    assert "drives = toy:DRIVES is left out: its need 'drive' exists" in done.stderr
    assert "zaps = toy:ZAPS is left out: its need 'zap' is like ('nokind',)" in done.stderr


def test_an_option_that_was_asked_for_and_fails_before_the_start_ends_the_run(toy: Path) -> None:
    done = run(toy, "run", "sc1", "--virtual", "--sensors=ideal", "--newer")
    assert done.returncode == 1
    assert "--newer: AttributeError: 'Start' object has no attribute 'nothing'" in done.stderr


def test_an_addition_can_refuse_and_its_failure_costs_no_measures(toy: Path) -> None:
    words = ("run", "sc1", "--virtual", "--sensors=ideal", "--json", "--lamp")
    refused = run(toy, *words, "broken")
    assert refused.returncode == 2
    assert "--lamp broken: sc1 has none" in refused.stderr
    assert json.loads(refused.stdout)["reached"] is False
    failed = run(toy, *words, "full")
    assert failed.returncode == 1
    assert "armadico: the lamp is full" in failed.stderr
    assert json.loads(failed.stdout)["reached"] is True


def test_an_addition_says_which_runs_it_is_for(toy: Path) -> None:
    pytest.importorskip("armadico.agents.fleet")
    fleet = run(toy, "run", "fleet", "--virtual", "--lamp", "red")
    assert "--lamp is for the run of one robot" in fleet.stderr


def test_its_options_have_their_own_part_of_the_help_of_its_commands(toy: Path) -> None:
    shown = run(toy, "run", "--help").stdout
    assert "the lamp:\n  --lamp LAMP" in shown
    assert run(toy, "up", "--lamp", "red").stderr.count("--lamp: no such option") == 1
