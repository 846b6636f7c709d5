"""Mutants: the code that decides, changed in one place at a time; the tests must notice.

    python -m armadico_tools.mutants                    # all that have not been run yet
    python -m armadico_tools.mutants cycles --again     # unexplained survivors, once more

Cosmic Ray (`pip install cosmic-ray`) makes the changes; besides, each statement is left out once. A
mutant never touches a file: a forked process imports the changed module and runs the tests that
`TESTS` names, until one fails or the processor time is up. What came out is kept, a line each, so a
run that was interrupted goes on. Survivors that break no promise are
explained in `mutants_explained.py`; the others end the command with 1.
"""

from __future__ import annotations

import argparse
import ast
import gc
import hashlib
import importlib.machinery
import importlib.util
import os
import random
import re
import resource
import sys
import textwrap
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from types import CodeType
from typing import Any, Final

from msgspec import Struct

from armadico_tools.mutants_explained import EXPLAINED
from armadico_tools.results import Rows

ROOT: Final = Path(__file__).resolve().parents[2]

_FRAMEWORK = ("framework/test_coordination.py", "framework/test_resources.py")
TESTS: Final[dict[str, tuple[str, ...]]] = {
    "exchange": ("core/test_exchange.py", *_FRAMEWORK),
    "cycles": ("core/test_cycles.py", *_FRAMEWORK),
    "latched": ("core/test_latched.py", "runtime/test_latch.py"),
    "coordination": (
        "framework/test_contender.py",
        "framework/test_owner.py",
        *_FRAMEWORK,
        "framework/test_agent.py",
        "framework/test_coordination_faults.py",
    ),
    "safety": ("core/test_safety.py", "agents/test_avoid.py", "agents/test_goto.py"),
}
"""The tests of each module, the quickest first."""

PRELOADED: Final = ("cbor2", "hypothesis.stateful", "msgspec", "numpy", "psutil", "pytest", "zenoh")

SKIPPED: Final = re.compile(
    r"BinaryOperator_BitOr_"  # in annotations only, which are not evaluated
    r"|BinaryOperator_\w+_(FloorDiv|Mod|Pow|RShift|LShift|Bit\w+)$"  # + - * / are enough
    r"|ComparisonOperator_Is_(?!IsNot)"  # `is None`: `==` is the same, and `<` raises at once
    r"|ComparisonOperator_IsNot_(?!Is$)"
    r"|ComparisonOperator_(?!Is_|IsNot_|Eq_Is$|NotEq_IsNot$)\w+_Is(Not)?$"  # `<` to `is`
)
"""Changes that no test is expected to notice."""

LEFT_OUT: Final = "LeaveOut"


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change of a module."""

    id: str
    module: str
    line: int
    operator: str
    was: str
    becomes: str
    source: str


class Outcome(Struct, frozen=True):
    """What the tests made of a mutant; `by` names the first that failed, or the time limit."""

    id: str  # a hash of the changed source
    module: str
    line: int
    operator: str
    was: str = ""
    becomes: str = ""
    killed: bool = False
    by: str = ""
    seconds: float = 0.0

    @property
    def explained(self) -> str:
        """Why it may live, or nothing."""
        return EXPLAINED.get((self.place, self.was, self.becomes), "")

    @property
    def place(self) -> str:
        """The function that it is in, or the class or the module."""
        inside = [name for name, first, last in places(self.module) if first <= self.line <= last]
        return inside[-1]


# Making them --------------------------------------------------------------------------------------


def mutants(module: str) -> list[Mutant]:
    """All mutants of a module, each once, in the order of their lines."""
    source = path_of(module).read_text(encoding="utf-8")
    lines = source.splitlines()
    found: dict[str, Mutant] = {}
    for operator, changed in (*_by_cosmic_ray(source), *_left_out(source)):
        if changed == source or not _compiles(changed):
            continue
        known = hashlib.sha256(changed.encode()).hexdigest()[:12]
        was, becomes, line = _difference(lines, changed.splitlines())
        if was.startswith("@dataclass("):
            continue  # frozen and slots forbid what no code does
        found.setdefault(known, Mutant(known, module, line, operator, was, becomes, changed))
    return sorted(found.values(), key=lambda mutant: (mutant.line, mutant.operator, mutant.becomes))


def path_of(module: str) -> Path:
    """Where a module's source is."""
    return ROOT / "armadico" / "core" / f"{module}.py"


def name_of(module: str) -> str:
    """By what it is imported."""
    return f"armadico.core.{module}"


@cache
def places(module: str) -> tuple[tuple[str, int, int], ...]:
    """The module, its classes and functions, the outer first, with their lines."""

    def within(node: ast.AST, name: str) -> Iterator[tuple[str, int, int]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                inner = f"{name}.{child.name}"
                yield inner, child.lineno, child.end_lineno or child.lineno
                yield from within(child, inner)

    source = path_of(module).read_text(encoding="utf-8")
    return (module, 1, len(source.splitlines())), *within(ast.parse(source), module)


def _by_cosmic_ray(source: str) -> Iterator[tuple[str, str]]:
    from cosmic_ray.ast import ast_nodes, get_ast  # noqa: PLC0415 - no dependency of the package
    from cosmic_ray.mutating import mutate_code  # noqa: PLC0415
    from cosmic_ray.plugins import get_operator, operator_names  # noqa: PLC0415

    kinds = {name: get_operator(name) for name in operator_names() if not SKIPPED.search(name)}
    for text, whole in _parts(source):
        nodes = list(ast_nodes(get_ast(text)))
        for name, kind in kinds.items():
            if kind.arguments():
                continue
            count = sum(len(list(kind().mutation_positions(node))) for node in nodes)
            for occurrence in range(count):
                changed = mutate_code(text, kind(), occurrence)
                if changed is not None:
                    yield name.partition("/")[2], whole(changed)


def _parts(source: str) -> Iterator[tuple[str, Callable[[str], str]]]:
    """Each function, and what is left, with how to put it back: parsing all of it takes long."""
    lines = source.splitlines(keepends=True)
    rest, bodies = list(lines), list[str]()
    tree = ast.parse(source)
    parents: list[ast.Module | ast.ClassDef] = [tree]
    parents += [node for node in tree.body if isinstance(node, ast.ClassDef)]
    for node in (node for parent in parents for node in parent.body):
        if not isinstance(node, ast.FunctionDef) or node.end_lineno is None:
            continue
        begin = min([node.lineno, *(each.lineno for each in node.decorator_list)]) - 1
        before, after = "".join(lines[:begin]), "".join(lines[node.end_lineno :])
        own, indent = "".join(lines[begin : node.end_lineno]), " " * node.col_offset
        yield textwrap.dedent(own), partial(_between, before, after, indent)
        rest[begin : node.end_lineno] = [""] * (node.end_lineno - begin)
        rest[begin] = f"{indent}pass  # {len(bodies)}\n"
        bodies.append(own)
    yield (
        "".join(rest),
        lambda text: re.sub(r"(?m)^ *pass  # (\d+)\n", lambda m: bodies[int(m[1])], text),
    )


def _between(before: str, after: str, indent: str, text: str) -> str:
    return before + textwrap.indent(text, indent) + after


def _left_out(source: str) -> Iterator[tuple[str, str]]:
    """Each statement of each function once replaced by `pass`, but for docstrings and asserts."""
    lines = source.splitlines(keepends=True)
    functions = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.FunctionDef)]
    simple = (ast.Assign, ast.AnnAssign, ast.AugAssign, ast.Expr, ast.Return, ast.Delete)
    for node in (node for function in functions for node in ast.walk(function)):
        if not isinstance(node, simple) or node.end_lineno is None:
            continue
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            continue
        first = lines[node.lineno - 1]
        if first[: node.col_offset].strip():
            continue  # not alone in its line
        kept = first[: node.col_offset] + "pass\n"
        yield LEFT_OUT, "".join([*lines[: node.lineno - 1], kept, *lines[node.end_lineno :]])


def _compiles(source: str) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            compile(source, "mutant", "exec", dont_inherit=True)
        except SyntaxError:
            return False
    return True


def _difference(before: list[str], after: list[str]) -> tuple[str, str, int]:
    """What was and what becomes of it, and the line."""
    shorter, first, same = min(len(before), len(after)), 0, 0
    while first < shorter and before[first] == after[first]:
        first += 1
    while same < shorter - first and before[-1 - same] == after[-1 - same]:
        same += 1
    parts = (before[first : len(before) - same], after[first : len(after) - same])
    was, becomes = (" ".join(line.strip() for line in part) for part in parts)
    return was, becomes, first + 1


# Running them -------------------------------------------------------------------------------------


class _Changed(importlib.machinery.SourceFileLoader):
    """Loads one module from a text instead of its file."""

    def __init__(self, fullname: str, path: str, source: str) -> None:
        super().__init__(fullname, path)
        self._source = source

    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002
        """The changed text, whatever is on the disk."""
        return compile(self._source, self.path, "exec", dont_inherit=True)


class _Finder:
    """Finds the changed module before any other finder."""

    def __init__(self, module: str, source: str) -> None:
        self._name = name_of(module)
        self._loader = _Changed(self._name, str(path_of(module)), source)

    def find_spec(self, fullname: str, *_: object) -> importlib.machinery.ModuleSpec | None:
        """Find the changed module only."""
        if fullname != self._name:
            return None
        return importlib.util.spec_from_file_location(
            fullname, self._loader.path, loader=self._loader
        )


class _FirstFailure:
    """A plugin of pytest that keeps the first test that failed."""

    def __init__(self) -> None:
        self.name = ""

    def pytest_runtest_logreport(self, report: Any) -> None:
        """One phase of one test."""
        if report.failed and not self.name:
            self.name = report.nodeid.removeprefix("tests/")


def _test(module: str, source: str, pipe: int, seconds: int) -> int:
    """In the forked process: import the changed module and run its tests. The exit status."""
    import hypothesis  # noqa: PLC0415 - of the tests
    import pytest  # noqa: PLC0415

    assert name_of(module) not in sys.modules, "it would not be imported again, changed"
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    null = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(null, stream)
    os.chdir(ROOT)
    sys.dont_write_bytecode = True
    sys.meta_path.insert(0, _Finder(module, source))
    phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)  # nothing is shrunk
    hypothesis.settings.register_profile(
        "mutants",
        derandomize=True,
        database=None,
        phases=phases,
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    hypothesis.settings.load_profile("mutants")
    first = _FirstFailure()
    status = pytest.main(
        [
            *("-x", "-q", "--tb=no", "--timeout=0", "--assert=plain"),
            *("-p", "no:cacheprovider", "-p", "no:unraisableexception"),
            *(f"tests/{name}" for name in TESTS[module]),
        ],
        plugins=[first],
    )
    os.write(pipe, (first.name or f"pytest ends with {int(status)}").encode()[:4000])
    return int(status)


def test(module: str, source: str, seconds: int) -> tuple[bool, str, float]:
    """Whether the tests fail with this source of a module, the first that does, and how long."""
    began, (out, into) = time.monotonic(), os.pipe()
    child = os.fork()
    if child == 0:
        status = 70
        try:
            os.close(out)
            status = _test(module, source, into, seconds)
        except BaseException as error:
            os.write(into, repr(error).encode()[:4000])
        finally:
            os._exit(status)
    os.close(into)
    with os.fdopen(out, "rb") as pipe:
        by = pipe.read().decode()
    _, ended = os.waitpid(child, 0)
    status, took = os.waitstatus_to_exitcode(ended), time.monotonic() - began
    if status < 0:
        by = f"ended by signal {-status}"
    return status != 0, by if status else "", took


def run(module: str, todo: Iterable[Mutant], into: Rows[Outcome], deadline: float) -> int:
    """Run mutants and write each outcome as it comes. How many were run."""
    began = time.process_time(), os.times().children_user
    source = path_of(module).read_text(encoding="utf-8")
    failed, by, _ = test(module, source, 600)
    if failed:
        raise SystemExit(f"{module}: the tests fail without a change, {by}")
    limit = int(10 + 4 * (os.times().children_user - began[1]))
    done = 0
    for mutant in todo:
        if time.monotonic() > deadline:
            break
        killed, by, took = test(module, mutant.source, limit)
        about = asdict(mutant)
        del about["source"]
        outcome = Outcome(**about, killed=killed, by=by, seconds=round(took, 2))
        into.add(outcome)
        if not killed and not outcome.explained:
            print(f"{module}:{mutant.line}: {mutant.was}  ->  {mutant.becomes}", flush=True)
        done += 1
    return done


def outcomes(rows: Rows[Outcome]) -> dict[str, Outcome]:
    """What is known of each mutant, the newest last."""
    return {outcome.id: outcome for outcome in rows.read()}


# The command --------------------------------------------------------------------------------------


def summary(module: str, made: Sequence[Mutant], known: dict[str, Outcome]) -> tuple[str, int]:
    """A line of the table in docs/reliability.md, and how many survivors are not explained."""
    tried = [known[mutant.id] for mutant in made if mutant.id in known]
    lived = [outcome for outcome in tried if not outcome.killed]
    explained = sum(bool(outcome.explained) for outcome in lived)
    killed = len(tried) - len(lived)
    share = f"{killed / len(tried):.1%}" if tried else "-"
    numbers = (len(made), len(tried), killed, share, explained, len(lived) - explained)
    return f"| `{module}` | {' | '.join(map(str, numbers))} |", len(lived) - explained


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is left to run, then print the outcome; 1 if a survivor is not explained."""
    parser = argparse.ArgumentParser(description="Change the code in one place; the tests notice.")
    parser.add_argument("modules", nargs="*", metavar="MODULE", help=", ".join(TESTS))
    parser.add_argument("--sample", type=int, help="so many of each module, drawn by --seed")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop after so long")
    parser.add_argument("--again", action="store_true", help="run unexplained survivors again")
    parser.add_argument("--killers", action="store_true", help="count what each test killed")
    parser.add_argument("--results", type=Path, default=ROOT / "results" / "mutants")
    args = parser.parse_args(argv)
    unknown = set(args.modules) - set(TESTS)
    if unknown:
        parser.error(f"no tests are named for {', '.join(sorted(unknown))}")
    for name in PRELOADED:
        importlib.import_module(name)
    gc.freeze()
    deadline, unexplained = time.monotonic() + 60 * args.minutes, 0
    table, killers = [], Counter[str]()
    for module in args.modules or TESTS:
        rows, made = Rows(args.results / f"{module}.csv", Outcome), mutants(module)
        known = outcomes(rows)
        chosen = made
        if args.sample is not None and args.sample < len(made):
            chosen = random.Random(args.seed).sample(made, args.sample)
        survived = {key for key, o in known.items() if not o.killed and not o.explained}
        run(
            module,
            [m for m in chosen if (m.id in survived if args.again else m.id not in known)],
            rows,
            deadline,
        )
        known = outcomes(rows)
        line, left = summary(module, made, known)
        table.append(line)
        unexplained += left
        killers.update(known[m.id].by for m in made if m.id in known)
        for outcome in known.values():
            if not outcome.killed and outcome.id in {m.id for m in made}:
                print(f"{module}:{outcome.line}: {outcome.was}  ->  {outcome.becomes}")
                print(f"    {outcome.explained or 'not explained'}")
    print("| module | mutants | run | killed | share | explained | not explained |")
    print("| --- | --- | --- | --- | --- | --- | --- |", *table, sep="\n")
    if args.killers:
        print(*(f"{count:5} {name}" for name, count in killers.most_common()), sep="\n")
    return 1 if unexplained else 0


if __name__ == "__main__":
    sys.exit(main())
